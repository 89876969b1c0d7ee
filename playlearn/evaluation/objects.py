"""Objects and fixtures in the achieved goal: dimensions that share a name, `red` of `red.x` and `red.y`."""

import numpy as np

from playlearn.episode import Array
from playlearn.layout import ObjectLayout
from playlearn.quantity import difference
from playlearn.sim.environment import Environment


def misplaced(environment: Environment, achieved: Array, goal: Array, tolerances: float = 1.0) -> list[str]:
    """The objects that would still not be reached if everything else were as in the goal (G,).

    tolerances: how many of the environment's own tolerances an object may be off.
    """
    found, off = [], difference(achieved, goal, environment.spec.quantities.achieved)
    for name, columns in ObjectLayout(environment.spec.achieved_names).objects().items():
        only = np.array(goal)
        only[columns] += off[columns] / tolerances
        if not environment.reached(only, goal):
            found.append(name)
    return found
