"""Play as an image encoder perceives it: a state policy that is to act behind that encoder learns from it.

A policy that learned from true states acts on every difference between the current state and the goal. An encoder's
estimates always differ a little, and by a lot for what is hidden, so behind an encoder such a policy moves the wrong
object, or waits. The encoder's errors at some moments of each episode, rendered by the simulator, are applied to the
moments around them and added to the recorded states; the labels stay those of the true state.
"""

from playlearn.perceived.config import PerceivedConfig
from playlearn.perceived.generate import make_perceived
from playlearn.perceived.vary import Perceived

__all__ = ["Perceived", "PerceivedConfig", "make_perceived"]
