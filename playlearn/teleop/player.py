"""Unstructured play: skills chained at random, with the mistakes that make it worth learning from.

Every action that is executed may carry noise, a pause or a mistake; the label beside it
(`Decision.label`) is what the same driver, at that very state, meant to do (noise injection as in
DART, Laskey et al. 2017, here with drifting noise).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from playlearn.episode import Array, Decision, Goal, Observation
from playlearn.teleop.driver import Driver, Idea, pick
from playlearn.teleop.hand import OPEN, Hand, Style
from playlearn.teleop.skills import Reach, Skill

_PATIENCE = 170  # steps after which a skill is given up
_KEEP = (14, 24)  # steps for which an outcome that does not last, such as a lift, is held
_OFFSET_STEPS = (25, 45)  # how long a misjudged place is believed in
_UNTIL_SLIP = (3, 15)  # steps after the grasp
_SLIP_STEPS = 9


@dataclass(frozen=True)
class PlayConfig:
    """How somebody plays.

    weights: how often each kind of skill is tried, where it can be; what is not named here keeps the weight
    that its driver gives it. speed, approach, carry: ranges of
    the driver's style, drawn anew for every skill (share of full speed; metres). noise, drift: spread
    of the noise on the executed motion and its AR(1) memory. pause, aimless: how likely before a
    skill; mistake: how likely a skill begins at a misjudged place; slip: how likely a carried block is
    let go on the way.
    """

    weights: dict[str, float] = field(default_factory=dict)
    speed: tuple[float, float] = (0.75, 1.0)
    approach: tuple[float, float] = (0.05, 0.09)
    carry: tuple[float, float] = (0.07, 0.11)
    noise: float = 0.2
    drift: float = 0.85
    pause: float = 0.1
    aimless: float = 0.06
    mistake: float = 0.12
    slip: float = 0.05


class Player:
    """An Actor without goals: it makes its own, one after the other, for as long as it is asked."""

    name = "player"
    cameras: tuple[str, ...] = ()

    def __init__(self, driver: Driver, config: PlayConfig) -> None:
        self._driver, self._config = driver, config
        self._hands: list[_Playing] = []

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        ideas = self._driver.ideas()
        self._hands = [_Playing(self._config, self._driver, ideas, np.random.default_rng(seed)) for seed in seeds]

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> Sequence[Decision]:
        nothing = Decision(np.zeros(7))
        return [
            playing.act(seen) if running else nothing
            for playing, seen, running in zip(self._hands, observations, active, strict=True)
        ]


@dataclass
class _Playing:
    """One player in one world: what it is doing now, and for how long still."""

    config: PlayConfig
    driver: Driver
    ideas: Sequence[Idea]
    rng: np.random.Generator
    skill: Skill | None = None
    style: Style = field(default_factory=Style)
    steps: int = 0
    pausing: int = 0
    keeping: int = 0
    offset: Array = field(default_factory=lambda: np.zeros(2))
    misjudged: int = 0
    until_slip: int | None = None
    slipping: int = 0
    noise: Array = field(default_factory=lambda: np.zeros(6))

    def act(self, seen: Observation) -> Decision:
        hand, achieved = Hand.seen(seen), seen.achieved
        skill = self.skill
        if skill is None or self._over(skill, hand, achieved):
            skill = self._begin(hand, achieved)
        self.steps += 1
        label = skill.act(hand, achieved, self.style)
        action = self._executed(hand, achieved, label, skill)
        return Decision(action, label, skill.name)

    def _over(self, skill: Skill, hand: Hand, achieved: Array) -> bool:
        if self.steps > _PATIENCE:
            return True
        if not skill.done(hand, achieved):
            return False
        self.keeping -= 1
        return self.keeping <= 0

    def _begin(self, hand: Hand, achieved: Array) -> Skill:
        config, rng = self.config, self.rng
        self.style = Style(rng.uniform(*config.speed), rng.uniform(*config.approach), rng.uniform(*config.carry))
        skill = self.skill = self._next(hand, achieved)
        self.steps = 0
        self.pausing = int(rng.integers(4, 14)) if rng.random() < config.pause else 0
        self.keeping = 0 if skill.lasting else int(rng.integers(*_KEEP))
        self.misjudged = int(rng.integers(*_OFFSET_STEPS)) if rng.random() < config.mistake else 0
        angle = rng.uniform(-np.pi, np.pi)
        self.offset = rng.uniform(0.03, 0.055) * np.array([np.cos(angle), np.sin(angle)])
        self.until_slip = int(rng.integers(*_UNTIL_SLIP)) if rng.random() < config.slip else None
        self.slipping = 0
        return skill

    def _next(self, hand: Hand, achieved: Array) -> Skill:
        if self.driver.holding(hand, achieved):
            return self.driver.put_down(hand, achieved, self.rng)
        if self.rng.random() < self.config.aimless:
            x, y, z = self.rng.uniform(*self.driver.aimless)
            return Reach("aimless", (x, y, z))
        idea = pick(self.ideas, self.config.weights, achieved, self.rng)
        skill = None if idea is None else idea.skill(hand, achieved, self.rng)
        return skill or self.driver.towards(hand, achieved, achieved)  # nowhere to go: step back

    def _executed(self, hand: Hand, achieved: Array, label: Array, skill: Skill) -> Array:
        config, rng = self.config, self.rng
        spread = config.noise * np.array([1, 1, 0.6, 0.15, 0.15, 0.5])
        self.noise = config.drift * self.noise + np.sqrt(1 - config.drift**2) * spread * rng.standard_normal(6)
        action = label.copy()
        if self.misjudged > 0:  # acts as if everything stood `offset` away from where it is
            self.misjudged -= 1
            away = np.array([*self.offset, 0.0])
            action = skill.act(Hand(hand.position - away, hand.rotation, hand.opening), achieved, self.style)
        if self.until_slip is not None and self.driver.holding(hand, achieved):
            self.until_slip -= 1
            if self.until_slip < 0:
                self.until_slip, self.slipping = None, _SLIP_STEPS
        # People tremble less where they go slowly and look closely.
        action[:6] += self.noise * (0.2 + 0.8 * min(1.0, float(np.linalg.norm(label[:3]))))
        if self.slipping > 0:
            self.slipping -= 1
            action[-1] = OPEN
        if self.pausing > 0:
            self.pausing -= 1
            action[:6] = 0.0
        return action.clip(-1, 1)
