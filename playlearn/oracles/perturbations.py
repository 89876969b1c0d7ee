"""What makes play unlike a flawless expert: each perturbation is a class of its own, with its own state.

A skill being carried out is a `SkillExecution`, one control step of it a `PlayStep`. A perturbation draws in `begin`
what happens during this execution, and changes in `apply` what is executed at a step, or its label.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from playlearn.episode import Array
from playlearn.oracles.end_effector import OPEN, EndEffector, Style
from playlearn.oracles.open_loop import Plan
from playlearn.oracles.skills import Skill

MAX_STEPS = 170  # steps of closed-loop control after which a skill is given up
_GIVE_UP_AFTER = (10, 60)  # steps into it at which a skill is dropped on purpose
_HOLD_STEPS = (14, 24)  # for which an outcome that does not last, such as a lift, is held
_MISTAKE_STEPS = (25, 45)  # for which a misjudged position is believed in under closed-loop control
_MISTAKE_OFFSET = (0.03, 0.055)  # meters
_SLIP_AFTER = (3, 15)  # steps after the grasp
_SLIP_STEPS = 9
_NOISE_SCALE = np.array([1, 1, 0.6, 0.15, 0.15, 0.5])  # of dx dy dz droll dpitch dyaw


@dataclass
class SkillExecution:
    """One skill being carried out, until its outcome is there or its steps are used up.

    hand, achieved: what was observed when it began.
    plan: followed without looking at the objects; None under closed-loop control.
    plan_completed: whether a plan was followed to its end.
    pause_steps: steps of standing still that it begins with.
    hold_steps: steps for which its outcome is still to be held.
    steps_left: after which it is given up.
    """

    skill: Skill
    style: Style
    hand: EndEffector
    achieved: Array
    plan: Plan | None = None
    plan_completed: bool = False
    pause_steps: int = 0
    hold_steps: int = 0
    steps_left: int = MAX_STEPS + 1

    def over(self, hand: EndEffector, achieved: Array) -> bool:
        """Asked once a step: whether the next skill is due."""
        if self.steps_left <= 0:
            return True
        if self.plan is not None or not self.skill.done(hand, achieved):
            return False
        self.hold_steps -= 1
        return self.hold_steps <= 0

    def step(self, hand: EndEffector, achieved: Array) -> "PlayStep":
        """The next step as the skill or its plan has it, unperturbed."""
        self.steps_left -= 1
        closed_loop = self.skill.act(hand, achieved, self.style)
        label = closed_loop if self.plan is None else self.plan.act(hand)
        return PlayStep(hand, achieved, hand, closed_loop, label, label.copy())

    def act(self, hand: EndEffector, achieved: Array) -> Array:
        """(A,) the action of the plan, or of the skill where there is none."""
        return self.skill.act(hand, achieved, self.style) if self.plan is None else self.plan.act(hand)

    def advance(self, step: "PlayStep") -> None:
        """The step was executed."""
        if self.plan is not None and not step.paused:
            self.plan.advance(step.believed_hand)
            if self.plan.over:
                self.plan, self.plan_completed = None, True


@dataclass
class PlayStep:
    """One control step while it is put together.

    hand: the end effector.
    believed_hand: the same, relative to where the objects are believed to be.
    closed_loop: (A,) what the skill does at the true state.
    label: (A,) what is meant.
    action: (A,) what is executed; not yet clipped.
    paused: the end effector stands still, and a plan does not go on.
    marks: what the step is annotated with beside the skill's name.
    """

    hand: EndEffector
    achieved: Array
    believed_hand: EndEffector
    closed_loop: Array
    label: Array
    action: Array
    paused: bool = False
    marks: list[str] = field(default_factory=list)


class Perturbation(Protocol):
    """One way in which play departs from its skills; state is that of one environment's play."""

    def begin(self, execution: SkillExecution, rng: np.random.Generator) -> None:
        """A skill begins: draw what happens during it."""
        ...

    def apply(self, step: PlayStep, execution: SkillExecution, rng: np.random.Generator) -> None:
        """Change this step."""
        ...


def happens(probability: float, rng: np.random.Generator) -> bool:
    """Draws nothing where the probability is 0."""
    return probability > 0 and bool(rng.random() < probability)


@dataclass
class Pause:
    """Stands still before the skill begins, for `steps` [from, below) steps; the label goes on."""

    probability: float
    steps: tuple[int, int]
    _left: int = 0

    def begin(self, execution: SkillExecution, rng: np.random.Generator) -> None:
        self._left = int(rng.integers(*self.steps)) if happens(self.probability, rng) else 0
        execution.pause_steps = self._left

    def apply(self, step: PlayStep, execution: SkillExecution, rng: np.random.Generator) -> None:
        if self._left > 0:
            self._left -= 1
            step.paused = True
            step.marks.append("pause")
            step.action[:6] = 0.0


class HoldOutcome:
    """Holds for a while what does not last by itself, such as a lift."""

    def begin(self, execution: SkillExecution, rng: np.random.Generator) -> None:
        execution.hold_steps = 0 if execution.skill.lasting else int(rng.integers(*_HOLD_STEPS))

    def apply(self, step: PlayStep, execution: SkillExecution, rng: np.random.Generator) -> None:
        """Nothing: `SkillExecution.over` counts the steps."""


@dataclass
class Misjudgment:
    """Acts as if all objects were an offset away from where they are; the label does not.

    Under closed-loop control it is noticed after some steps; a plan is believed in to its end.
    """

    probability: float
    _left: int = 0
    _offset: Array = field(default_factory=lambda: np.zeros(3))

    def begin(self, execution: SkillExecution, rng: np.random.Generator) -> None:
        self._left = int(rng.integers(*_MISTAKE_STEPS)) if happens(self.probability, rng) else 0
        angle = rng.uniform(-np.pi, np.pi)
        self._offset = rng.uniform(*_MISTAKE_OFFSET) * np.array([np.cos(angle), np.sin(angle), 0.0])

    def apply(self, step: PlayStep, execution: SkillExecution, rng: np.random.Generator) -> None:
        if execution.plan_completed:
            self._left = 0
        if self._left > 0:
            self._left -= int(execution.plan is None)
            step.marks.append("mistake")
            position = step.hand.position - self._offset
            step.believed_hand = EndEffector(position, step.hand.rotation, step.hand.opening)
            step.label = step.closed_loop
            step.action = execution.act(step.believed_hand, step.achieved)


@dataclass
class OpenLoop:
    """Plans the skill once and follows the plan without looking at the objects; the plan is the label.

    path_noise: std of the smooth noise on a plan, as a fraction of the way.
    """

    probability: float
    path_noise: float

    def begin(self, execution: SkillExecution, rng: np.random.Generator) -> None:
        if not happens(self.probability, rng):
            return
        waypoints = execution.skill.plan(execution.hand, execution.achieved, execution.style)
        if waypoints:
            execution.plan = Plan(waypoints, execution.hand, execution.style, self.path_noise, rng)
            execution.steps_left += execution.plan.steps

    def apply(self, step: PlayStep, execution: SkillExecution, rng: np.random.Generator) -> None:
        if execution.plan is not None:
            step.marks.append("open_loop")


@dataclass
class MotionNoise:
    """AR(1) noise on the executed motion, not on the label: `autocorrelation` from step to step; std: of its x, y."""

    std: float
    autocorrelation: float
    _value: Array = field(default_factory=lambda: np.zeros(6))

    def begin(self, execution: SkillExecution, rng: np.random.Generator) -> None:
        """Nothing: it goes on from skill to skill."""

    def apply(self, step: PlayStep, execution: SkillExecution, rng: np.random.Generator) -> None:
        fresh = np.sqrt(1 - self.autocorrelation**2) * (self.std * _NOISE_SCALE) * rng.standard_normal(6)
        self._value = self.autocorrelation * self._value + fresh
        # People tremble less where they go slowly and look closely.
        step.action[:6] += self._value * (0.2 + 0.8 * min(1.0, float(np.linalg.norm(step.label[:3]))))


@dataclass
class Slip:
    """Lets go of what is carried, some steps after the grasp, and drops the plan.

    holding: (hand, achieved) -> whether the gripper has hold of something.
    """

    probability: float
    holding: Callable[[EndEffector, Array], bool]
    _until: int | None = None
    _left: int = 0

    def begin(self, execution: SkillExecution, rng: np.random.Generator) -> None:
        self._until = int(rng.integers(*_SLIP_AFTER)) if happens(self.probability, rng) else None
        self._left = 0

    def apply(self, step: PlayStep, execution: SkillExecution, rng: np.random.Generator) -> None:
        if self._until is not None and self.holding(step.hand, step.achieved):
            self._until -= 1
            if self._until < 0:
                self._until, self._left, execution.plan = None, _SLIP_STEPS, None
        if self._left > 0:
            self._left -= 1
            step.marks.append("slip")
            step.label, step.action[-1] = step.closed_loop, OPEN


@dataclass
class GiveUp:
    """Drops the skill halfway, for no reason; a pause before it does not count."""

    probability: float

    def begin(self, execution: SkillExecution, rng: np.random.Generator) -> None:
        if happens(self.probability, rng):
            execution.steps_left = execution.pause_steps + int(rng.integers(*_GIVE_UP_AFTER))

    def apply(self, step: PlayStep, execution: SkillExecution, rng: np.random.Generator) -> None:
        """Nothing: `SkillExecution.over` counts the steps."""
