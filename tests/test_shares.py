"""How seldom a test of a share fails by chance, and how often it finds out."""

from itertools import product
from math import prod

import pytest

from tests.shares import often


@pytest.mark.parametrize(
    ("share", "done", "passes"), [(0.95, 2, 1 - 1 / 33_000), (0.95, 1, 1 - 1 / 160_000), (0.25, 2, 0.367)]
)
def test_the_chances_are_those_that_it_states(share: float, done: int, passes: float) -> None:
    """Over every outcome of five tries, each as likely as it is."""
    chance = sum(
        prod(share if success else 1 - share for success in outcome)
        for outcome in product([True, False], repeat=5)
        if often(outcome, done=done)
    )
    assert chance == pytest.approx(passes, abs=1e-6 if share > 0.9 else 1e-3)


def test_no_more_is_tried_than_tells() -> None:
    tries = iter([True, False, True, False])
    assert often(tries)
    assert list(tries) == [False]
    with pytest.raises(AssertionError, match="too few"):
        often([True, False, False])
