"""Unstructured play: skills chained at random, with the mistakes that make it worth learning from.

What is executed may carry noise, a pause or a mistake (`playlearn.oracles.perturbations`); the label beside it
(`Decision.label`) is what the same skill, at that very state, meant to do:

- Noise on the action is not meant: executed noisy, labeled clean (DART, Laskey et al., 2017; here it is AR(1)).
- A pause, a slip and a misjudged position are not meant: the label is the closed-loop action at the true state.
- A plan is meant, its smooth noise too: the label is the clean action that follows the plan.

The annotation of a step is its skill's name and what else holds of it (`playlearn.episode.annotation`):
`open_loop`, `pause`, `mistake`, `slip`; `gave_up` at the last step of a skill that is left without its outcome, and
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
from playlearn.oracles.end_effector import EndEffector, Style
from playlearn.oracles.perturbations import (
    GiveUp,
    HoldOutcome,
    Misjudgment,
    MotionNoise,
    OpenLoop,
    Pause,
    Perturbation,
    SkillExecution,
    Slip,
    happens,
)
from playlearn.oracles.skill_library import SkillLibrary, SkillOption, pick, skill_library_for
from playlearn.oracles.skills import Reach, Skill
from playlearn.sim.environment import Actor, Environment


@dataclass(frozen=True)
class PlayPolicyConfig(draccus.ChoiceRegistry):
    """Base of every play policy's config; `type:` in a YAML picks the kind."""

    @classmethod
    def default_choice_name(cls) -> str:
        return "skills"

    def build(self, environment: Environment) -> Actor:
        """Raises UsageError where this kind cannot play there, or weighs a kind of skill that is not offered there."""
        raise NotImplementedError

    def noisier(self, noise: float) -> Self:
        """The same config with at least this much noise on what is executed."""
        raise NotImplementedError


@PlayPolicyConfig.register_subclass("skills")
@dataclass(frozen=True)
class PlayConfig(PlayPolicyConfig):
    """How play behaves; `configs/collect/{clean,human,noisy}.yaml` are three characters.

    weights: how often each kind of skill is tried, where it is possible; a kind that is not named keeps the weight of
        its `SkillOption`.
    speed: range, as a fraction of full speed; drawn anew for every skill, as are `approach` and `carry`.
    approach: range in meters above an object at which the end effector arrives.
    carry: range in meters at which an object is carried.
    open_loop: probability that a skill is planned once and followed without looking
        (`playlearn.oracles.open_loop`); all others are closed-loop, and so is every correction.
    path_noise: std of the smooth noise on a plan, as a fraction of the way.
    noise: std of the noise on the executed motion.
    noise_autocorrelation: of that noise from one step to the next, AR(1).
    pause: probability that the end effector stands still before a skill.
    pause_steps: range [from, below) of steps for which it does.
    idle: probability of only moving the empty gripper instead of a skill.
    mistake: probability that a skill begins at a misjudged position.
    slip: probability that what is carried is let go on the way.
    give_up: probability that a skill is dropped halfway, for no reason.
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
                raise UsageError(f"{name} is a probability between 0 and 1, got {getattr(self, name)}")
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
        """Raises UsageError where `weights` names a kind that is not offered, or leaves nothing to do."""
        kinds = sorted({option.kind for option in options})
        for kind in self.weights:
            if kind not in kinds:
                raise UsageError(f"play.weights: there is no kind of skill {kind!r} here{nearest(kind, kinds)}")
        if not any(self.weights.get(option.kind, option.weight) > 0 for option in options):
            raise UsageError(f"play.weights leave nothing to do: give one of {', '.join(kinds)} a weight above 0")


class PlayPolicy:
    """An Actor without goals: it draws its own, one after the other, for as long as it is asked.

    Raises:
        UsageError: the config weighs a kind of skill that this skill library does not have.
    """

    name = "player"
    cameras: tuple[str, ...] = ()

    def __init__(self, skill_library: SkillLibrary, config: PlayConfig) -> None:
        self._skill_library, self._config = skill_library, config
        self._options = skill_library.options()
        config.check(self._options)
        self._rows: list[_EnvironmentPlay] = []

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        self._rows = [
            _EnvironmentPlay(self._config, self._skill_library, self._options, np.random.default_rng(seed))
            for seed in seeds
        ]

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> Sequence[Decision]:
        nothing = Decision(np.zeros(7))
        return [
            row.act(observation) if running else nothing
            for row, observation, running in zip(self._rows, observations, active, strict=True)
        ]


class _EnvironmentPlay:
    """Play in one environment: the skill that is being carried out, and its perturbations."""

    def __init__(
        self,
        config: PlayConfig,
        skill_library: SkillLibrary,
        options: Sequence[SkillOption],
        rng: np.random.Generator,
    ) -> None:
        self._config, self._skill_library, self._options, self._rng = config, skill_library, options, rng
        self._execution: SkillExecution | None = None
        pause, hold = Pause(config.pause, config.pause_steps), HoldOutcome()
        mistake, slip = Misjudgment(config.mistake), Slip(config.slip, skill_library.holding)
        open_loop, give_up = OpenLoop(config.open_loop, config.path_noise), GiveUp(config.give_up)
        noise = MotionNoise(config.noise, config.noise_autocorrelation)
        # A seed's play depends on the order of the draws, and each step on the order of the changes.
        self._draw_order: tuple[Perturbation, ...] = (pause, hold, mistake, slip, open_loop, give_up)
        self._step_order: tuple[Perturbation, ...] = (open_loop, mistake, noise, slip, pause)

    def act(self, observation: Observation) -> Decision:
        hand, achieved = EndEffector.seen(observation), observation.achieved
        execution, again = self._execution, False
        if execution is None or execution.over(hand, achieved):
            before, execution = execution, self._begin(hand, achieved)
            again = before is not None and before.skill.name == execution.skill.name
        step = execution.step(hand, achieved)
        if again:
            step.marks.append("again")
        for perturbation in self._step_order:
            perturbation.apply(step, execution, self._rng)
        execution.advance(step)
        if execution.steps_left <= 0:
            step.marks.append("gave_up")
        return Decision(step.action.clip(-1, 1), step.label, annotation(execution.skill.name, step.marks))

    def _begin(self, hand: EndEffector, achieved: Array) -> SkillExecution:
        config, rng = self._config, self._rng
        style = Style(rng.uniform(*config.speed), rng.uniform(*config.approach), rng.uniform(*config.carry))
        execution = self._execution = SkillExecution(self._next_skill(hand, achieved), style, hand, achieved)
        for perturbation in self._draw_order:
            perturbation.begin(execution, rng)
        return execution

    def _next_skill(self, hand: EndEffector, achieved: Array) -> Skill:
        library, rng = self._skill_library, self._rng
        if library.holding(hand, achieved):
            return library.put_down(hand, achieved, rng)
        if happens(self._config.idle, rng) and library.idle is not None:
            x, y, z = rng.uniform(*library.idle)
            return Reach("idle", (x, y, z))
        option = pick(self._options, self._config.weights, achieved, rng)
        skill = None if option is None else option.skill(hand, achieved, rng)
        return skill or library.towards(hand, achieved, achieved)  # nothing is possible: step back
