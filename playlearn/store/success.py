"""What is known of an episode's success. A reward is not one: it may be shaped, scaled, or a cost for every step.

Known is a recorded success, robomimic's convention of rewards (0, and 1 where the task is solved), and what the user
says by a rule:

    all, none            every episode, no episode
    dones                some step is marked as done
    reward>=X            some step's reward is at least X; also >, <, <= and ==
    last_reward>=X       the last step's
"""

import operator
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from playlearn.episode import Array
from playlearn.errors import UsageError

_COMPARE = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    ">": operator.gt,
    "<": operator.lt,
}
_RULE = re.compile(r"\s*(last_reward|reward)\s*(>=|<=|==|>|<)\s*([-+.\deE]+)\s*")
_ENDED = {True: "success", False: "length", None: "unknown"}


@dataclass(frozen=True, eq=False)
class Signals:
    """What a recording of n steps says of its outcome; None where it says nothing.

    rewards: (n,).
    dones: (n,).
    """

    rewards: Array | None = None
    dones: Array | None = None


@dataclass(frozen=True)
class SuccessRule:
    """A rule of the user, see above."""

    text: str

    def __post_init__(self) -> None:
        """Raises UsageError if it is not a rule."""
        if self.text not in ("all", "none", "dones"):
            self._comparison()

    def __call__(self, signals: Signals, where: str) -> bool:
        """Whether an episode succeeded; `where` names it. Raises UsageError if the rule asks for what is not there."""
        if self.text in ("all", "none"):
            return self.text == "all"
        if self.text == "dones":
            return bool(self._given(signals.dones, "dones", where).any())
        which, compare, value = self._comparison()
        rewards = self._given(signals.rewards, "rewards", where)
        return bool(_COMPARE[compare](rewards[-1:] if which == "last_reward" else rewards, value).any())

    def _comparison(self) -> tuple[str, str, float]:
        match = _RULE.fullmatch(self.text)
        try:
            return (match[1], match[2], float(match[3])) if match else self._refuse()
        except ValueError:
            return self._refuse()

    def _refuse(self) -> tuple[str, str, float]:
        raise UsageError(f"success: {self.text!r} is none of all, none, dones, reward>=1, last_reward>=0 and the like")

    def _given(self, values: Array | None, what: str, where: str) -> Array:
        if values is None:
            raise UsageError(f"success: {self.text!r} asks for {what}, and {where} has none; say all or none")
        return values


def follow_convention(rewards: Sequence[Array]) -> bool:
    """Whether all rewards of a file are 0 or 1, with a 1 in it: robomimic's mark of a solved task.

    Zeros alone say nothing: they are also written where no reward was computed.
    """
    values = np.unique(np.concatenate([np.zeros(0), *rewards]))
    return bool(np.isin(values, (0.0, 1.0)).all() and 1.0 in values)


def how_ended(success: bool | None) -> str:
    """Why a recording of somebody else ended, for `EpisodeMeta.ended`."""
    return _ENDED[success]
