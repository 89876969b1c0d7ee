"""What a goal speaks of, thing by thing: the parts of `achieved` that share a name, `red` of `red.x` and `red.y`."""

import numpy as np

from playlearn.episode import Array
from playlearn.layout import ObjectLayout
from playlearn.sim.environment import Environment


def misplaced(environment: Environment, achieved: Array, goal: Array, tolerances: float = 1.0) -> list[str]:
    """The things that, were all else as the goal (G,) shows it, would still not be reached.

    tolerances: how many of the environment's own they may be off.
    """
    found = []
    for thing, columns in ObjectLayout(environment.spec.achieved_names).objects().items():
        only = np.array(goal)
        only[columns] += (achieved[columns] - goal[columns]) / tolerances
        if not environment.reached(only, goal):
            found.append(thing)
    return found
