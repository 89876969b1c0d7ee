"""The outcome of a training run."""

import math

import pytest

from playlearn.report.outcome import Outcome


def outcome(*losses: float, first_at: int = 0, of_steps: int = 0) -> Outcome:
    """Of a run whose held-out loss was measured every 100 updates."""
    lines = [{"step": 100 * i + first_at, "val/loss": loss} for i, loss in enumerate(losses)]
    steps = 100 * (len(losses) - 1) + first_at
    return Outcome.of([{"step": 1, "train/loss": 9.0}, *lines], steps, of_steps or steps, 61.234)


def test_a_run_that_learned_reports_its_losses() -> None:
    one = outcome(1.0, 0.4, 0.5)
    assert one.complaint() is None
    assert one.summary() == [
        "held-out loss: 1 before the first update, 0.5 after 200 updates; the least was 0.4 at update 100"
    ]
    assert one.numbers() == {
        "steps": 200,
        "of_steps": 200,
        "seconds": 61.23,
        "val_loss_first": 1.0,
        "first_at": 0,
        "val_loss_last": 0.5,
        "val_loss_least": 0.4,
        "least_at": 100,
    }


@pytest.mark.parametrize(
    ("losses", "message"),
    [
        ((1.0, 1.1), "too few updates"),
        ((1.0, 1.0), "too few updates"),
        ((1.0, math.nan), "the learning rate is too high"),
        ((1.0, 0.5, math.inf), "the learning rate is too high"),
    ],
)
def test_a_run_that_learned_nothing_names_likely_reasons(losses: tuple[float, ...], message: str) -> None:
    one = outcome(*losses)
    complaint = one.complaint()
    assert complaint is not None
    assert message in complaint
    assert f"after {one.steps} of {one.steps} updates" in complaint
    assert math.isfinite(one.numbers()["val_loss_least"] or 0.0)


def test_a_run_whose_loss_fell_and_rose_again_has_learned() -> None:
    """The NLL of an overconfident policy can end above its start, and the policy works."""
    one = outcome(1.0, 0.4, 1.2)
    assert one.complaint() is None
    assert one.summary()[-1].startswith("too many updates for so little play")


def test_a_run_that_hit_its_time_limit_says_so() -> None:
    messages = outcome(1.0, 0.9, of_steps=10_000).summary()
    assert len(messages) == 2
    assert "after 100 of 10000 updates (61 s): the result will be worse" in messages[0]


def test_without_a_loss_before_training_there_is_no_complaint() -> None:
    """Runs without an evaluation at step 0, and runs without a validation split."""
    old = outcome(0.3, 0.4, first_at=100)
    assert old.complaint() is None
    assert "0.3 at update 100" in old.summary()[0]
    none = Outcome.of([{"step": 1, "train/loss": 9.0}], 5, 5, 1.0)
    assert none.complaint() is None
    assert none.summary() == []
    assert none.numbers()["val_loss_first"] is None
