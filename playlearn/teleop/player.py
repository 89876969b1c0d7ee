"""Unstructured play: skills chained at random, with the mistakes that make it worth learning from.

What is executed may carry noise, a pause or a mistake; the label beside it (`Decision.label`) is what the same
driver, at that very state, meant to do:

- Noise on the action is not meant: executed noisy, labelled clean (DART, Laskey et al., 2017; here it drifts).
- A pause, a slip and a place misjudged are not meant: the label is what a driver who looks would do.
- A plan is meant, its smooth noise too: the label is the clean action that follows the plan.

The annotation of a step is its skill's name and what else can be said of it (`playlearn.episode.annotation`):
`planned`, `pause`, `mistake`, `slip`; `gave_up` at the last step of a skill that is left without its outcome, and
`again` at the first step of one that comes twice running.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import draccus
import numpy as np

from playlearn.config import nearest
from playlearn.episode import Array, Decision, Goal, Observation, annotation
from playlearn.errors import UsageError
from playlearn.sim.environment import Actor, Environment
from playlearn.teleop.driver import Driver, Idea, driver_for, pick
from playlearn.teleop.hand import OPEN, Hand, Style
from playlearn.teleop.planned import Plan
from playlearn.teleop.skills import Reach, Skill

_PATIENCE = 170  # steps of looking and correcting after which a skill is given up
_GIVING_UP = (10, 60)  # steps into it at which a skill is dropped on purpose
_KEEP = (14, 24)  # steps for which an outcome that does not last, such as a lift, is held
_OFFSET_STEPS = (25, 45)  # how long a misjudged place is believed in, where it is looked at
_UNTIL_SLIP = (3, 15)  # steps after the grasp
_SLIP_STEPS = 9


@dataclass(frozen=True)
class PlayerConfig(draccus.ChoiceRegistry):
    """Who plays, and how: the base of every player's config; `type:` in a YAML picks the kind."""

    @classmethod
    def default_choice_name(cls) -> str:
        return "skills"

    def build(self, environment: Environment) -> Actor:
        """Raises UsageError where this kind cannot play there, or is asked for what nobody offers there."""
        raise NotImplementedError

    def noisier(self, noise: float) -> Self:
        """The same with at least so much noise on what is executed."""
        raise NotImplementedError


@PlayerConfig.register_subclass("skills")
@dataclass(frozen=True)
class PlayConfig(PlayerConfig):
    """How somebody plays; `configs/collect/{clean,human,noisy}.yaml` are three characters.

    weights: how often each kind of skill is tried, where it can be; what is not named here keeps the weight
        that its driver gives it.
    speed, approach, carry: ranges of the driver's style, drawn anew for every skill (share of full speed; metres).
    planned: share of skills that are planned once and followed without looking (`playlearn.teleop.planned`); the
        others look at every step, and so does every correction. bow: spread of the smooth noise on a plan, as a
        share of the way.
    noise, drift: spread of the noise on the executed motion and its AR(1) memory.
    pause: share of skills before which the hand stands still, for `pause_steps` steps (from, below).
    aimless: share of skills that only move the empty hand. mistake: share that begin at a misjudged place.
    slip: share in which what is carried is let go on the way. give_up: share dropped halfway, for no reason.
    """

    weights: dict[str, float] = field(default_factory=dict)
    speed: tuple[float, float] = (0.75, 1.0)
    approach: tuple[float, float] = (0.05, 0.09)
    carry: tuple[float, float] = (0.07, 0.11)
    planned: float = 0.0
    bow: float = 0.0
    noise: float = 0.2
    drift: float = 0.85
    pause: float = 0.1
    pause_steps: tuple[int, int] = (4, 14)
    aimless: float = 0.06
    mistake: float = 0.12
    slip: float = 0.05
    give_up: float = 0.0

    def __post_init__(self) -> None:
        for name in ("planned", "pause", "aimless", "mistake", "slip", "give_up"):
            if not 0 <= getattr(self, name) <= 1:
                raise UsageError(f"{name} is a share between 0 and 1, got {getattr(self, name)}")
        for name in ("speed", "approach", "carry", "pause_steps"):
            low, high = getattr(self, name)
            if not 0 < low <= high:
                raise UsageError(f"{name} is a range [low, high] above 0, got [{low}, {high}]")
        if self.speed[1] > 1 or not 0 <= self.drift < 1 or min(self.noise, self.bow) < 0:
            raise UsageError("speed goes up to 1, drift lies in [0, 1), noise and bow are not negative")
        if self.pause_steps[0] == self.pause_steps[1]:
            raise UsageError(f"pause_steps [from, below) is empty: {list(self.pause_steps)}")
        for kind, weight in self.weights.items():
            if not 0 <= weight < np.inf:
                raise UsageError(f"weights.{kind} must be 0 or more, got {weight}")

    def build(self, environment: Environment) -> "Player":
        return Player(driver_for(environment), self)

    def noisier(self, noise: float) -> Self:
        return replace(self, noise=max(noise, self.noise))

    def check(self, ideas: Sequence[Idea]) -> None:
        """Raises UsageError where `weights` names a kind that nobody offers, or leaves nothing to do."""
        kinds = sorted({idea.kind for idea in ideas})
        for kind in self.weights:
            if kind not in kinds:
                raise UsageError(f"play.weights: there is no kind of skill {kind!r} here{nearest(kind, kinds)}")
        if not any(self.weights.get(idea.kind, idea.weight) > 0 for idea in ideas):
            raise UsageError(f"play.weights leave nothing to do: give one of {', '.join(kinds)} a weight above 0")


class Player:
    """An Actor without goals: it makes its own, one after the other, for as long as it is asked.

    Raises:
        UsageError: the config weighs a kind of skill that this driver does not have.
    """

    name = "player"
    cameras: tuple[str, ...] = ()

    def __init__(self, driver: Driver, config: PlayConfig) -> None:
        self._driver, self._config = driver, config
        self._ideas = driver.ideas()
        config.check(self._ideas)
        self._hands: list[_Playing] = []

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        self._hands = [_Playing(self._config, self._driver, self._ideas, np.random.default_rng(seed)) for seed in seeds]

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
    plan: Plan | None = None
    style: Style = field(default_factory=Style)
    left: int = 0
    pausing: int = 0
    keeping: int = 0
    offset: Array = field(default_factory=lambda: np.zeros(3))
    misjudged: int = 0
    until_slip: int | None = None
    slipping: int = 0
    noise: Array = field(default_factory=lambda: np.zeros(6))

    def act(self, seen: Observation) -> Decision:
        hand, achieved = Hand.seen(seen), seen.achieved
        skill, marks = self.skill, []
        if skill is None or self._over(skill, hand, achieved):
            before, skill = skill, self._begin(hand, achieved)
            marks = ["again"] if before is not None and before.name == skill.name else []
        self.left -= 1
        return self._decide(skill, hand, achieved, marks)

    def _over(self, skill: Skill, hand: Hand, achieved: Array) -> bool:
        if self.left <= 0:
            return True
        if self.plan is not None or not skill.done(hand, achieved):
            return False
        self.keeping -= 1
        return self.keeping <= 0

    def _begin(self, hand: Hand, achieved: Array) -> Skill:
        config, rng = self.config, self.rng
        self.style = Style(rng.uniform(*config.speed), rng.uniform(*config.approach), rng.uniform(*config.carry))
        skill = self.skill = self._next(hand, achieved)
        self.pausing = int(rng.integers(*config.pause_steps)) if self._happens(config.pause) else 0
        self.keeping = 0 if skill.lasting else int(rng.integers(*_KEEP))
        self.misjudged = int(rng.integers(*_OFFSET_STEPS)) if self._happens(config.mistake) else 0
        angle = rng.uniform(-np.pi, np.pi)
        self.offset = rng.uniform(0.03, 0.055) * np.array([np.cos(angle), np.sin(angle), 0.0])
        self.until_slip = int(rng.integers(*_UNTIL_SLIP)) if self._happens(config.slip) else None
        self.slipping = 0
        self.plan, self.left = None, _PATIENCE + 1
        stops = skill.plan(hand, achieved, self.style) if self._happens(config.planned) else ()
        if stops:
            self.plan = Plan(stops, hand, self.style, config.bow, rng)
            self.left += self.plan.steps
        if self._happens(config.give_up):
            self.left = self.pausing + int(rng.integers(*_GIVING_UP))
        return skill

    def _happens(self, share: float) -> bool:
        return share > 0 and bool(self.rng.random() < share)

    def _next(self, hand: Hand, achieved: Array) -> Skill:
        if self.driver.holding(hand, achieved):
            return self.driver.put_down(hand, achieved, self.rng)
        if self._happens(self.config.aimless) and self.driver.aimless is not None:
            x, y, z = self.rng.uniform(*self.driver.aimless)
            return Reach("aimless", (x, y, z))
        idea = pick(self.ideas, self.config.weights, achieved, self.rng)
        skill = None if idea is None else idea.skill(hand, achieved, self.rng)
        return skill or self.driver.towards(hand, achieved, achieved)  # nowhere to go: step back

    def _decide(self, skill: Skill, hand: Hand, achieved: Array, marks: list[str]) -> Decision:
        """What to do now, what was meant, and what to call it."""
        config, rng, plan = self.config, self.rng, self.plan
        looking = skill.act(hand, achieved, self.style)
        label = looking if plan is None or self.misjudged > 0 else plan.act(hand)
        if plan is not None:
            marks.append("planned")
        spread = config.noise * np.array([1, 1, 0.6, 0.15, 0.15, 0.5])
        self.noise = config.drift * self.noise + np.sqrt(1 - config.drift**2) * spread * rng.standard_normal(6)
        action = label.copy()
        if self.misjudged > 0:  # acts as if everything stood `offset` away from where it is
            self.misjudged -= int(plan is None)  # a plan is believed in to its end
            marks.append("mistake")
            believed = Hand(hand.position - self.offset, hand.rotation, hand.opening)
            action = skill.act(believed, achieved, self.style) if plan is None else plan.act(believed)
        if self.until_slip is not None and self.driver.holding(hand, achieved):
            self.until_slip -= 1
            if self.until_slip < 0:
                self.until_slip, self.slipping, self.plan = None, _SLIP_STEPS, None
        # People tremble less where they go slowly and look closely.
        action[:6] += self.noise * (0.2 + 0.8 * min(1.0, float(np.linalg.norm(label[:3]))))
        if self.slipping > 0:
            self.slipping -= 1
            marks.append("slip")
            label, action[-1] = looking, OPEN
        if self.pausing > 0:
            self.pausing -= 1
            marks.append("pause")
            action[:6] = 0.0
        elif plan is not None and self.slipping == 0:
            self._follow(plan, hand)
        if self.left <= 0:
            marks.append("gave_up")
        return Decision(action.clip(-1, 1), label, annotation(skill.name, marks))

    def _follow(self, plan: Plan, hand: Hand) -> None:
        """A step of the plan was made; at its end the player looks again."""
        plan.advance(hand if self.misjudged == 0 else Hand(hand.position - self.offset, hand.rotation, hand.opening))
        if plan.over:
            self.plan, self.misjudged = None, 0
