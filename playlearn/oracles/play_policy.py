"""Unstructured play: skills chained at random, with the mistakes that make it worth learning from.

What is executed may carry noise, a pause or a mistake; the label beside it (`Decision.label`) is what the same
driver, at that very state, meant to do:

- Noise on the action is not meant: executed noisy, labeled clean (DART, Laskey et al., 2017; here it drifts).
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
from playlearn.oracles.end_effector import OPEN, EndEffector, Style
from playlearn.oracles.open_loop import Plan
from playlearn.oracles.skill_library import SkillLibrary, SkillOption, pick, skill_library_for
from playlearn.oracles.skills import Reach, Skill
from playlearn.sim.environment import Actor, Environment

_PATIENCE = 170  # steps of looking and correcting after which a skill is given up
_GIVING_UP = (10, 60)  # steps into it at which a skill is dropped on purpose
_KEEP = (14, 24)  # steps for which an outcome that does not last, such as a lift, is held
_OFFSET_STEPS = (25, 45)  # how long a misjudged place is believed in, where it is looked at
_UNTIL_SLIP = (3, 15)  # steps after the grasp
_SLIP_STEPS = 9


@dataclass(frozen=True)
class PlayPolicyConfig(draccus.ChoiceRegistry):
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


@PlayPolicyConfig.register_subclass("skills")
@dataclass(frozen=True)
class PlayConfig(PlayPolicyConfig):
    """How somebody plays; `configs/collect/{clean,human,noisy}.yaml` are three characters.

    weights: how often each kind of skill is tried, where it can be; what is not named here keeps the weight
        that its driver gives it.
    speed, approach, carry: ranges of the driver's style, drawn anew for every skill (share of full speed; meters).
    planned: share of skills that are planned once and followed without looking (`playlearn.oracles.open_loop`); the
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
    open_loop: float = 0.0
    path_noise: float = 0.0
    noise: float = 0.2
    noise_autocorrelation: float = 0.85
    pause: float = 0.1
    pause_steps: tuple[int, int] = (4, 14)
    idle: float = 0.06
    mistake: float = 0.12
    slip: float = 0.05
    give_up: float = 0.0

    def __post_init__(self) -> None:
        for name in ("open_loop", "pause", "idle", "mistake", "slip", "give_up"):
            if not 0 <= getattr(self, name) <= 1:
                raise UsageError(f"{name} is a share between 0 and 1, got {getattr(self, name)}")
        for name in ("speed", "approach", "carry", "pause_steps"):
            low, high = getattr(self, name)
            if not 0 < low <= high:
                raise UsageError(f"{name} is a range [low, high] above 0, got [{low}, {high}]")
        if self.speed[1] > 1 or not 0 <= self.noise_autocorrelation < 1 or min(self.noise, self.path_noise) < 0:
            raise UsageError(
                "speed goes up to 1, noise_autocorrelation lies in [0, 1), noise and path_noise are not negative"
            )
        if self.pause_steps[0] == self.pause_steps[1]:
            raise UsageError(f"pause_steps [from, below) is empty: {list(self.pause_steps)}")
        for kind, weight in self.weights.items():
            if not 0 <= weight < np.inf:
                raise UsageError(f"weights.{kind} must be 0 or more, got {weight}")

    def build(self, environment: Environment) -> "PlayPolicy":
        return PlayPolicy(skill_library_for(environment), self)

    def noisier(self, noise: float) -> Self:
        return replace(self, noise=max(noise, self.noise))

    def check(self, options: Sequence[SkillOption]) -> None:
        """Raises UsageError where `weights` names a kind that nobody offers, or leaves nothing to do."""
        kinds = sorted({option.kind for option in options})
        for kind in self.weights:
            if kind not in kinds:
                raise UsageError(f"play.weights: there is no kind of skill {kind!r} here{nearest(kind, kinds)}")
        if not any(self.weights.get(option.kind, option.weight) > 0 for option in options):
            raise UsageError(f"play.weights leave nothing to do: give one of {', '.join(kinds)} a weight above 0")


class PlayPolicy:
    """An Actor without goals: it makes its own, one after the other, for as long as it is asked.

    Raises:
        UsageError: the config weighs a kind of skill that this driver does not have.
    """

    name = "player"
    cameras: tuple[str, ...] = ()

    def __init__(self, skill_library: SkillLibrary, config: PlayConfig) -> None:
        self._skill_library, self._config = skill_library, config
        self._options = skill_library.options()
        config.check(self._options)
        self._hands: list[_Playing] = []

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        self._hands = [
            _Playing(self._config, self._skill_library, self._options, np.random.default_rng(seed)) for seed in seeds
        ]

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
    skill_library: SkillLibrary
    options: Sequence[SkillOption]
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
        hand, achieved = EndEffector.seen(seen), seen.achieved
        skill, marks = self.skill, []
        if skill is None or self._over(skill, hand, achieved):
            before, skill = skill, self._begin(hand, achieved)
            marks = ["again"] if before is not None and before.name == skill.name else []
        self.left -= 1
        return self._decide(skill, hand, achieved, marks)

    def _over(self, skill: Skill, hand: EndEffector, achieved: Array) -> bool:
        if self.left <= 0:
            return True
        if self.plan is not None or not skill.done(hand, achieved):
            return False
        self.keeping -= 1
        return self.keeping <= 0

    def _begin(self, hand: EndEffector, achieved: Array) -> Skill:
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
        stops = skill.plan(hand, achieved, self.style) if self._happens(config.open_loop) else ()
        if stops:
            self.plan = Plan(stops, hand, self.style, config.path_noise, rng)
            self.left += self.plan.steps
        if self._happens(config.give_up):
            self.left = self.pausing + int(rng.integers(*_GIVING_UP))
        return skill

    def _happens(self, share: float) -> bool:
        return share > 0 and bool(self.rng.random() < share)

    def _next(self, hand: EndEffector, achieved: Array) -> Skill:
        if self.skill_library.holding(hand, achieved):
            return self.skill_library.put_down(hand, achieved, self.rng)
        if self._happens(self.config.idle) and self.skill_library.idle is not None:
            x, y, z = self.rng.uniform(*self.skill_library.idle)
            return Reach("idle", (x, y, z))
        option = pick(self.options, self.config.weights, achieved, self.rng)
        skill = None if option is None else option.skill(hand, achieved, self.rng)
        return skill or self.skill_library.towards(hand, achieved, achieved)  # nowhere to go: step back

    def _decide(self, skill: Skill, hand: EndEffector, achieved: Array, marks: list[str]) -> Decision:
        """What to do now, what was meant, and what to call it."""
        config, rng, plan = self.config, self.rng, self.plan
        looking = skill.act(hand, achieved, self.style)
        label = looking if plan is None or self.misjudged > 0 else plan.act(hand)
        if plan is not None:
            marks.append("open_loop")
        spread = config.noise * np.array([1, 1, 0.6, 0.15, 0.15, 0.5])
        self.noise = config.noise_autocorrelation * self.noise + np.sqrt(
            1 - config.noise_autocorrelation**2
        ) * spread * rng.standard_normal(6)
        action = label.copy()
        if self.misjudged > 0:  # acts as if everything stood `offset` away from where it is
            self.misjudged -= int(plan is None)  # a plan is believed in to its end
            marks.append("mistake")
            believed = EndEffector(hand.position - self.offset, hand.rotation, hand.opening)
            action = skill.act(believed, achieved, self.style) if plan is None else plan.act(believed)
        if self.until_slip is not None and self.skill_library.holding(hand, achieved):
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

    def _follow(self, plan: Plan, hand: EndEffector) -> None:
        """A step of the plan was made; at its end the player looks again."""
        plan.advance(
            hand if self.misjudged == 0 else EndEffector(hand.position - self.offset, hand.rotation, hand.opening)
        )
        if plan.over:
            self.plan, self.misjudged = None, 0
