"""Which steps lead into a failure."""

import numpy as np

from playlearn.episode import read_annotation
from playlearn.relabeling import leads_to_failure

NAMES = ("push", "push:mistake", "push:open_loop:slip", "open:gave_up", "open", "open:again", "push:pause")
ANNOTATIONS = [read_annotation(name) for name in NAMES]


def failing(*pieces: tuple[int, str]) -> str:
    """A letter a step: x leads to a failure, - does not."""
    skill = np.concatenate([np.full(count, NAMES.index(name)) for count, name in pieces])
    return "".join("x" if step else "-" for step in leads_to_failure(skill, ANNOTATIONS))


def test_steps_fail_up_to_the_failure_and_recover_after_it() -> None:
    assert failing((3, "push"), (2, "push:open_loop:slip"), (3, "push")) == "xxxxx---"
    assert failing((1, "push"), (1, "push:mistake"), (1, "push"), (1, "push:mistake"), (2, "push")) == "xxxx--"


def test_a_failure_is_its_own_attempts_alone() -> None:
    assert failing((2, "push"), (2, "open"), (1, "open:gave_up")) == "--xxx"
    assert failing((1, "push:mistake"), (2, "open")) == "x--"
    # The same skill twice running: given up and begun again, or only begun again.
    assert failing((2, "open"), (1, "open:gave_up"), (2, "open")) == "xxx--"
    assert failing((2, "open"), (1, "open:again"), (1, "open"), (1, "open:gave_up")) == "--xxx"
    assert failing((2, "push"), (3, "push:pause")) == "-----"  # a pause is no failure


def test_play_without_annotation_does_not_fail() -> None:
    assert not leads_to_failure(np.zeros(5, np.int16), [("", ())]).any()
