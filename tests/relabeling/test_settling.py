"""Thresholds that are read from the play: their laws, and that they find what hand-set ones find."""

import numpy as np
import pytest

from playlearn.errors import UsageError
from playlearn.quantity import FINEST
from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.relabeling.calibrate import CHANGE_OF_NOISE, SWITCHED, measure
from playlearn.relabeling.settling import thresholds
from tests.synthetic import ACHIEVED, FPS, QUANTITIES, make_episode

DECLARED = QUANTITIES.achieved
WINDOW = SettlingConfig().window(FPS)
MEASURED = SettlingConfig(change={"default": None}, rest={"default": None})


@pytest.fixture(scope="module")
def play() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [make_episode(rng, 600).achieved for _ in range(6)]


def test_they_find_the_moments_that_hand_set_ones_find(play: list[np.ndarray]) -> None:
    """Things here move one at a time and rest for a second: nearly every moment is found at the same time."""
    by_hand = RelabelIndex.build(play, ACHIEVED, FPS, SettlingConfig(), DECLARED)
    measured = RelabelIndex.build(play, ACHIEVED, FPS, MEASURED, DECLARED)
    there = np.concatenate([measured.rows[e] + measured.settled(e)[0] for e in range(len(play))])
    found = [
        np.abs(there - (by_hand.rows[e] + moment)).min() <= 0.2 * FPS
        for e in range(len(play))
        for moment in by_hand.settled(e)[0]
    ]
    assert np.mean(found) > 0.95
    assert abs(len(measured.moments) - len(by_hand.moments)) <= 0.05 * len(by_hand.moments)


def test_noise_raises_them_and_hides_no_move(play: list[np.ndarray]) -> None:
    """5 mm of noise on everything: hand-set thresholds see no rest at all, measured ones most of the moments."""
    rng = np.random.default_rng(1)
    noisy = [one + rng.normal(0, 0.005, one.shape) for one in play]
    assert len(RelabelIndex.build(noisy, ACHIEVED, FPS, SettlingConfig(), DECLARED).moments) == 0
    true = RelabelIndex.build(play, ACHIEVED, FPS, SettlingConfig(), DECLARED)
    seen = RelabelIndex.build(noisy, ACHIEVED, FPS, MEASURED, DECLARED)
    assert 0.7 * len(true.moments) < len(seen.moments) < 1.3 * len(true.moments)


def test_a_constant_dimension_changes_nothing(play: list[np.ndarray]) -> None:
    """Not even one of the same kind as others (.x), and it has no threshold to pass itself."""
    for value in (0.0, 3.0):
        more = [np.concatenate([one, np.full((len(one), 1), value, one.dtype)], axis=1) for one in play]
        for before, after in zip(
            measure(play, DECLARED, FPS, WINDOW), measure(more, (*DECLARED, "length x"), FPS, WINDOW), strict=True
        ):
            np.testing.assert_array_equal(after[:-1], before)
            assert after[-1] == np.inf


@pytest.mark.parametrize("factor", [0.3, 1000.0])
def test_other_units_scale_them(play: list[np.ndarray], factor: float) -> None:
    """Of one kind alone (.opening): its thresholds follow, the others stay."""
    own = ACHIEVED.index("drawer.opening")
    scale = np.where(np.arange(len(ACHIEVED)) == own, factor, 1.0)
    scaled = [one * scale for one in play]
    for before, after in zip(measure(play, DECLARED, FPS, WINDOW), measure(scaled, DECLARED, FPS, WINDOW), strict=True):
        np.testing.assert_allclose(after, before * scale, rtol=1e-6)


def test_dimensions_of_one_quantity_share_theirs_in_any_order(play: list[np.ndarray]) -> None:
    """A thing that was hardly touched is measured by how far its like are moved."""
    nudged = [np.concatenate([one, 0.01 * one[:, :1]], axis=1) for one in play]
    declared = (*DECLARED, "length x")
    change, rest = measure(nudged, declared, FPS, WINDOW)
    assert change[-1] == change[0]
    assert rest[-1] == rest[0]
    order = np.random.default_rng(0).permutation(len(declared))
    mixed, _ = measure([one[:, order] for one in nudged], [declared[k] for k in order], FPS, WINDOW)
    np.testing.assert_allclose(mixed, change[order], rtol=1e-12)


def test_a_switch_has_moved_when_it_has_switched(play: list[np.ndarray]) -> None:
    """Past a half it is nearer to what it was not, however noisily it is read."""
    change, rest = measure(play, DECLARED, FPS, WINDOW)
    assert change[-1] == rest[-1] == SWITCHED


def test_hardly_any_play_will_do() -> None:
    """Two observations, of which one differs: the move is what there is of it. None at all: nothing to pass."""
    rows = [np.array([[0.0, 0.0], [0.7, 0.0]], np.float32)]
    change, rest = measure(rows, ("length x", "length y"), FPS, WINDOW)
    np.testing.assert_allclose(change, [0.7 * CHANGE_OF_NOISE, np.inf])  # the one window there is counts as noise
    assert (rest < change)[0]
    assert np.isinf(measure([], ("length x",), FPS, WINDOW)[0]).all()
    assert measure(rows, (), FPS, WINDOW)[0].shape == (0,)
    # Rounding in the last digit is no move, and the lamp of another episode has not moved in any.
    still = [np.full((50, 1), lamp, np.float32) + np.float32(1e-7) * (np.arange(50)[:, None] % 2) for lamp in (0, 1)]
    assert np.isinf(measure(still, ("binary on",), FPS, WINDOW)[0]).all()
    # To and fro in exactly the time over which moves are looked at: below any size that counts, never zero.
    swings = [np.sin(np.arange(400)[:, None] * 2 * np.pi / 40) * 1e-3]
    assert measure(swings, ("length x",), FPS, WINDOW)[1][0] >= FINEST


def test_null_is_measured_and_the_rest_kept(play: list[np.ndarray]) -> None:
    given = SettlingConfig(change={"default": None, "lamp*": 0.5}, rest={"default": 0.004, "*.c": None})
    found = given.measured(iter(play), ACHIEVED, DECLARED, FPS)
    change, rest = measure(play, DECLARED, FPS, WINDOW)
    at = {name: k for k, name in enumerate(ACHIEVED)}
    assert found.change["lamp.on"] == 0.5
    assert found.change["red.x"] == change[at["red.x"]]
    assert found.rest["red.x"] == 0.004
    assert found.rest["red.c"] == rest[at["red.c"]]
    assert found.measured(iter(()), ACHIEVED, DECLARED, FPS) is found
    with pytest.raises(UsageError, match=r"settling\.rest: red\.x needs a threshold"):
        SettlingConfig(change={"default": None}, rest={"lamp*": 0.5}).measured(play, ACHIEVED, DECLARED, FPS)


def test_thresholds_match_patterns_and_the_last_counts() -> None:
    found = thresholds({"default": 1.0, "*.c": 2.0, "red.*": 3.0}, ("blue.x", "blue.c", "red.c"), ("",) * 3, "change")
    assert found.tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("patterns", [{"red.*": 0.1}, {"default": 0.0}, {"default": -1.0}, {"default": None}])
def test_a_name_without_a_threshold_is_refused(patterns: dict[str, float | None]) -> None:
    with pytest.raises(UsageError, match=r"settling\.rest: lamp\.on"):
        thresholds({"red.x": 0.1, **patterns}, ("red.x", "lamp.on"), ("", ""), "rest")


def test_what_nobody_declared_alike_has_its_own_thresholds_at_any_scale(play: list[np.ndarray]) -> None:
    """Two joints, one in units 1e6 times as small, as `a.pos` and `b.pos`: neither knows of the other."""
    both = [np.stack([one[:, 0], 1e-6 * one[:, 0]], axis=1).astype(np.float64) for one in play]
    for threshold in measure(both, ("", ""), FPS, WINDOW):
        assert 0 < threshold[0] < np.inf
        np.testing.assert_allclose(threshold[1], 1e-6 * threshold[0])


def test_by_default_the_kind_decides_and_what_has_none_is_measured(play: list[np.ndarray]) -> None:
    names, declared = ("a.c", "b.c", "c.x"), ("", "direction c", "length x")
    given = SettlingConfig().measured([one[:, [0, 3, 0]] for one in play], names, declared, FPS)
    change = thresholds(given.change, names, declared, "change")
    assert change[1:].tolist() == [0.15, 0.015]
    assert change[0] == measure([one[:, :1] for one in play], ("",), FPS, WINDOW)[0][0]
