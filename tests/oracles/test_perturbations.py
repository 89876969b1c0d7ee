"""Each perturbation by itself: what it draws, what it changes of a step, and what it leaves alone."""

from typing import Any

import numpy as np
import pytest

from playlearn.oracles.end_effector import OPEN, EndEffector, Style
from playlearn.oracles.perturbations import (
    GiveUp,
    Misjudgment,
    MotionNoise,
    OpenLoop,
    Pause,
    Perturbation,
    SkillExecution,
    Slip,
)
from playlearn.oracles.skills import Reach

DOWN = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])  # gripper down, fingers along y
HAND = EndEffector(np.array([0.0, 0.0, 0.5]), DOWN, 0.08)
NEVER: dict[str, Perturbation] = {
    "pause": Pause(0.0, (4, 9)),
    "slip": Slip(0.0, lambda *_: True),
    "open_loop": OpenLoop(0.0, 0.1),
    "give_up": GiveUp(0.0),
}


def execution() -> SkillExecution:
    return SkillExecution(Reach("point", (0.3, 0.0, 0.5)), Style(), HAND, np.zeros(3))


def begun(perturbation: Perturbation, seed: int = 0, **fields: Any) -> SkillExecution:
    made = execution()
    for name, value in fields.items():
        setattr(made, name, value)
    perturbation.begin(made, np.random.default_rng(seed))
    return made


@pytest.mark.parametrize("name", NEVER)
def test_what_never_happens_draws_nothing_and_changes_nothing(name: str) -> None:
    rng, untouched = np.random.default_rng(0), np.random.default_rng(0)
    made = execution()
    NEVER[name].begin(made, rng)
    step, plain = made.step(HAND, np.zeros(3)), execution().step(HAND, np.zeros(3))
    NEVER[name].apply(step, made, rng)
    assert rng.random() == untouched.random()
    np.testing.assert_array_equal(step.action, plain.action)
    np.testing.assert_array_equal(step.label, plain.label)
    assert step.marks == []


def test_a_pause_holds_the_plan_too() -> None:
    pause, plan = Pause(1.0, (3, 4)), OpenLoop(1.0, 0.0)
    made, rng = begun(plan), np.random.default_rng(0)
    pause.begin(made, rng)
    assert made.plan is not None
    left = []
    for _ in range(5):
        step = made.step(HAND, np.zeros(3))
        pause.apply(step, made, rng)
        made.advance(step)
        left.append(made.plan.steps)
    assert np.diff([left[0], *left]).tolist() == [0, 0, 0, -1, -1]  # three steps still, then it goes on


def test_a_slip_opens_the_gripper_and_drops_the_plan() -> None:
    slip, rng = Slip(1.0, lambda *_: True), np.random.default_rng(0)
    made = begun(slip)
    OpenLoop(1.0, 0.0).begin(made, rng)
    opened = []
    for _ in range(30):
        step = made.step(HAND, np.zeros(3))
        step.action[-1] = 1.0
        slip.apply(step, made, rng)
        opened.append(step.action[-1] == OPEN)
        assert (made.plan is None) == any(opened)
    assert sum(opened) == 9
    assert 3 <= opened.index(True) < 15


def test_a_misjudged_position_ends_with_the_plan_that_believes_in_it() -> None:
    mistake, rng = Misjudgment(1.0), np.random.default_rng(0)
    made = begun(mistake)
    step = made.step(HAND, np.zeros(3))
    mistake.apply(step, made, rng)
    # The target is 0.3 m away, so a shift of 3 to 5.5 cm is seen in the direction alone.
    assert 0.03 <= np.linalg.norm(step.believed_hand.position - HAND.position) <= 0.055
    np.testing.assert_array_equal(step.label, execution().step(HAND, np.zeros(3)).label)
    assert np.abs(step.action - step.label).max() > 0.01
    made.plan_completed = True
    step = made.step(HAND, np.zeros(3))
    mistake.apply(step, made, rng)
    np.testing.assert_array_equal(step.action, step.label)


def test_noise_leaves_gripper_and_label_alone() -> None:
    noise, rng, made = MotionNoise(0.2, 0.85), np.random.default_rng(0), execution()
    step, plain = made.step(HAND, np.zeros(3)), execution().step(HAND, np.zeros(3))
    noise.apply(step, made, rng)
    assert (step.action[:6] != plain.action[:6]).all()
    assert step.action[6] == plain.action[6]
    np.testing.assert_array_equal(step.label, plain.label)


def test_giving_up_does_not_count_the_pause() -> None:
    without = begun(GiveUp(1.0))
    paused = begun(GiveUp(1.0), pause_steps=20)
    assert paused.steps_left == without.steps_left + 20
    assert 10 <= without.steps_left < 60
