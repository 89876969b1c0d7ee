"""Objects and fixtures in the achieved goal: dimensions that share a name, `red` of `red.x` and `red.y`."""

from collections.abc import Sequence

import numpy as np

from playlearn.episode import Array
from playlearn.sim.environment import Environment


def object_columns(names: Sequence[str]) -> dict[str, list[int]]:
    """Object -> its columns of `achieved`, in order."""
    owners = [name.split(".")[0] for name in names]
    return {owner: [k for k, other in enumerate(owners) if other == owner] for owner in dict.fromkeys(owners)}


def misplaced(environment: Environment, achieved: Array, goal: Array, tolerances: float = 1.0) -> list[str]:
    """The objects that would still not be reached if everything else were as in the goal (G,).

    tolerances: how many of the environment's own tolerances an object may be off.
    """
    found = []
    for name, columns in object_columns(environment.spec.achieved_names).items():
        only = np.array(goal)
        only[columns] += (achieved[columns] - goal[columns]) / tolerances
        if not environment.reached(only, goal):
            found.append(name)
    return found
