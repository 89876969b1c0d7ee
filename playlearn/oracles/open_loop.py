"""A skill as one plan: objects are looked at once, then the plan is tracked by the end effector's own pose alone.

Play by plans is not Markov, as people are not: what it does next depends on where objects were when it began.
After the `plan` oracles of OGBench (Park et al., 2024, arXiv:2410.20092), whose trajectories are drawn through
waypoints once, with smooth noise, and then tracked.

Between two waypoints the end effector moves with minimum jerk (Flash and Hogan, 1985): of a leg from p to q, at u in
[0, 1],

    p + (q - p) s + b_1 sin(pi s) + b_2 sin(2 pi s),    s = 10 u^3 - 15 u^4 + 6 u^5

with path noise b that vanishes at both ends: plans differ in their path, not in where they grasp and let go.
Fingers open as they leave a waypoint and close when they have reached the next.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from playlearn.episode import Array
from playlearn.oracles.end_effector import OPEN, EndEffector, Style
from playlearn.oracles.skills import Waypoint, turn, waypoint

PEAK = 1.875  # a minimum-jerk motion's highest speed over its mean
FASTEST, TURNING = 0.0125, 0.05  # meters and radians in a step that a full action brings about
_AHEAD = 4  # steps by which the arm lags behind a target that moves
_NEAR, _NEAR_YAW = 0.008, 0.12  # meters and radians within which a waypoint is reached
_LATE = 10  # steps for which a late end effector is waited for, where the plan stops anyway
_EMPTY = 0.004  # meters between the fingers, below which they hold nothing


@dataclass(frozen=True, eq=False)
class _Leg:
    """The path from one waypoint to the next, in `steps` steps. path_noise: (2, 3) m, b_1 and b_2."""

    begin: Waypoint
    end: Waypoint
    steps: int
    path_noise: Array

    def at(self, step: float) -> tuple[Array, float]:
        """Position (3,) m and yaw in rad at a step after its beginning."""
        u = min(1.0, step / self.steps)
        s = u**3 * (10 - 15 * u + 6 * u**2)
        here, there = np.array(self.begin.position), np.array(self.end.position)
        place = here + (there - here) * s + np.sin([np.pi * s, 2 * np.pi * s]) @ self.path_noise
        return place, self.begin.yaw + turn(self.begin.yaw, self.end.yaw, np.pi) * s

    def reached(self, hand: EndEffector) -> bool:
        near = np.linalg.norm(hand.position - self.end.position) < _NEAR
        return bool(near and hand.yaw_error(self.end.yaw) < _NEAR_YAW)


class Plan:
    """A plan that is being followed: `act` gives the action of this step, `advance` goes to the next.

    path_noise: std of the smooth noise on every leg, as a fraction of its length; downwards there is none.
    """

    def __init__(
        self,
        waypoints: Sequence[Waypoint],
        hand: EndEffector,
        style: Style,
        path_noise: float,
        rng: np.random.Generator,
    ) -> None:
        stops = [waypoint(hand.position, hand.yaw, waypoints[0].grip), *waypoints]
        self._legs = [_leg(begin, end, style, path_noise, rng) for begin, end in pairwise(stops)]
        self._step = self._waited = 0
        self._opened = False

    @property
    def over(self) -> bool:
        return not self._legs

    @property
    def steps(self) -> int:
        """About how many steps are left."""
        return sum(leg.steps + leg.end.wait for leg in self._legs) - self._step

    def act(self, hand: EndEffector) -> Array:
        """(A,) the action that follows the plan; it depends on the end effector alone, not on objects."""
        leg = self._legs[0]
        place, yaw = leg.at(self._step + _AHEAD)
        arrived = self._waited > 0
        return hand.move(place, yaw, leg.end.grip if arrived else min(leg.begin.grip, leg.end.grip))

    def advance(self, hand: EndEffector) -> None:
        """A step was executed. Where the fingers have closed on nothing the plan is given up."""
        leg = self._legs[0]
        self._step += 1
        passed = leg.end.wait == 0 or leg.reached(hand) or self._step >= leg.steps + _LATE
        if self._waited or (self._step >= leg.steps and passed):
            self._waited += 1
        self._opened = self._opened or leg.begin.grip == OPEN
        if self._opened and hand.opening < _EMPTY and leg.begin.grip != OPEN:
            self._legs = []
        elif self._waited > leg.end.wait:
            del self._legs[0]
            self._step = self._waited = 0


def _leg(begin: Waypoint, end: Waypoint, style: Style, path_noise: float, rng: np.random.Generator) -> _Leg:
    length = float(np.linalg.norm(np.subtract(end.position, begin.position)))
    slowest = max(length / FASTEST, abs(turn(begin.yaw, end.yaw, np.pi)) / TURNING)
    waves = path_noise * length * np.array([[1.0], [0.5]]) * rng.standard_normal((2, 3))
    waves[0, 2] = abs(waves[0, 2])
    waves[1, 2] = 0.0
    return _Leg(begin, end, max(1, round(PEAK * slowest / style.speed)), waves)
