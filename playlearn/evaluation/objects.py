"""What a goal speaks of, thing by thing: the parts of `achieved` that share a name, `red` of `red.x` and `red.y`."""

from collections.abc import Sequence

import numpy as np

from playlearn.episode import Array
from playlearn.sim.environment import Environment


def things(names: Sequence[str]) -> dict[str, list[int]]:
    """Thing -> the columns of `achieved` that are its own, in order."""
    owners = [name.split(".")[0] for name in names]
    return {owner: [k for k, other in enumerate(owners) if other == owner] for owner in dict.fromkeys(owners)}


def misplaced(environment: Environment, achieved: Array, goal: Array, tolerances: float = 1.0) -> list[str]:
    """The things that, were all else as the goal (G,) shows it, would still not be reached.

    tolerances: how many of the environment's own they may be off.
    """
    found = []
    for thing, columns in things(environment.spec.achieved_names).items():
        only = np.array(goal)
        only[columns] += (achieved[columns] - goal[columns]) / tolerances
        if not environment.reached(only, goal):
            found.append(thing)
    return found
