"""Play as an image encoder perceives it: what a state policy learns from that is to act behind that encoder.

A policy that learned from true states takes every difference between now and the goal for something to be done. An
encoder's estimates always differ a little, and by much of what is hidden, so behind an encoder such a policy moves the
wrong thing, or waits. What the encoder gets wrong at some moments of each episode, drawn by the simulator, is carried
over to the moments around them and added to what was recorded; the labels stay those of the true state.
"""

from playlearn.perceived.config import PerceivedConfig
from playlearn.perceived.generate import make_perceived
from playlearn.perceived.vary import Perceived

__all__ = ["Perceived", "PerceivedConfig", "make_perceived"]
