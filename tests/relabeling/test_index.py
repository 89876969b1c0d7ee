"""The settled moments, on a world whose every motion is known."""

import numpy as np
import pytest

from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.relabeling.settling import thresholds
from tests.synthetic import ACHIEVED, FPS, QUANTITIES, make_episode

DECLARED = QUANTITIES.achieved
NAMES = ("red.x", "lamp.on")


def env(*pieces: tuple[int, float, float]) -> np.ndarray:
    """achieved (T+1, 2) of pieces (observations, red.x at their end, lamp); red.x goes there evenly."""
    x, rows = 0.0, []
    for count, end, lamp in pieces:
        rows += [(x + (end - x) * (i + 1) / count, lamp) for i in range(count)]
        x = end
    return np.array(rows, np.float32)


# The lamp goes on at observation 10, red moves 0.1 m over 30 ... 39 and rests until 80.
MOVED = env((10, 0.0, 0.0), (20, 0.0, 1.0), (10, 0.1, 1.0), (41, 0.1, 1.0))


def table(*envs: np.ndarray, **settling: object) -> RelabelIndex:
    return RelabelIndex.build(list(envs), NAMES, FPS, SettlingConfig(**settling), ("length x", "binary on"))


def test_settled_moments_come_a_rest_after_each_change() -> None:
    moments, ends = table(MOVED).settled(0)
    # 0.3 s are 6 steps: the lamp changed between 9 and 10, so 10 ... 16 is the first window without it.
    # red stands still from 39 on: the window 38 ... 44 still holds its last 1 cm, 39 ... 45 does not.
    assert moments.tolist() == [16, 45]
    # The lamp's configuration lasts until red's first step (30), red's until the end.
    assert ends.tolist() == [29, 80]


def test_following_and_valid() -> None:
    made = table(MOVED, MOVED)
    second = np.array([1])
    assert made.moments[made.following(second, np.array([0]))] == 16
    assert made.moments[made.following(second, np.array([15]))] == 16
    # At the settled moment itself the next one is due: a goal is later than its step.
    assert made.moments[made.following(second, np.array([16]))] == 45
    assert made.following(second, np.array([45])) == made.offsets[2]
    assert made.valid(0).tolist() == [True] * 45 + [False] * 35


def test_changes_name_what_differs_around_a_step() -> None:
    changes = table(MOVED).changes(0)
    assert changes[:16].tolist() == [[False, True]] * 16
    assert changes[16:45].tolist() == [[True, False]] * 29
    assert not changes[45:].any()
    assert table(MOVED).change_counts() == {"red": 1, "lamp": 1}


def test_less_than_the_threshold_is_no_change() -> None:
    # 1.4 cm and back again: never further than 1.5 cm from where it was settled.
    assert len(table(env((20, 0.0, 0.0), (10, 0.014, 0.0), (20, 0.014, 0.0))).moments) == 0
    # Two such steps add up to 2.8 cm from the last settled configuration: one change.
    twice = env((20, 0.0, 0.0), (10, 0.014, 0.0), (20, 0.014, 0.0), (10, 0.028, 0.0), (20, 0.028, 0.0))
    assert len(table(twice).moments) == 1


def test_a_moving_world_never_settles() -> None:
    # 0.2 m/s: 6 cm within any 0.3 s.
    assert len(table(env((100, 1.0, 0.0))).moments) == 0


def test_a_pause_shorter_than_the_rest_is_part_of_the_motion() -> None:
    paused = env((20, 0.0, 0.0), (10, 0.1, 0.0), (4, 0.1, 0.0), (10, 0.2, 0.0), (20, 0.2, 0.0))
    assert len(table(paused).moments) == 1
    assert len(table(paused, rest_seconds=0.1).moments) == 2


@pytest.mark.parametrize("seed", range(5))
def test_laws_on_random_play(seed: int) -> None:
    rng = np.random.default_rng(seed)
    envs = [make_episode(rng, int(rng.integers(1, 400))).achieved for _ in range(4)]
    made = RelabelIndex.build(envs, ACHIEVED, FPS, SettlingConfig(), DECLARED)
    change = thresholds(SettlingConfig().change, ACHIEVED, DECLARED, "change")
    rest = thresholds(SettlingConfig().rest, ACHIEVED, DECLARED, "rest")
    assert sum(len(made.settled(e)[0]) for e in range(4)) == len(made.moments)
    for e, achieved in enumerate(envs):
        moments, ends = made.settled(e)
        assert (np.diff(moments) > 0).all()
        assert (moments > 0).all()
        assert (ends < len(achieved)).all()
        assert (moments <= ends).all()
        assert (ends[:-1] < moments[1:]).all()
        before = achieved[0]
        for moment, end in zip(moments, ends, strict=True):
            assert (np.abs(achieved[moment] - before) > change).any()
            held = np.abs(achieved[moment : end + 1] - achieved[moment])
            assert (held <= rest).all()
            before = achieved[moment]


def test_synthetic_segments_are_all_found() -> None:
    # Every synthetic segment ends with 1 s of rest, so a change is missed only where the episode cuts it.
    episode = make_episode(np.random.default_rng(3), 2000)
    found = RelabelIndex.build([episode.achieved], ACHIEVED, FPS, SettlingConfig(), DECLARED)
    # Segments last 45 to 73 steps and each is one change, so 2,000 steps hold 27 whole ones at least.
    assert 27 <= len(found.moments) <= 1 + 2000 // 45


def test_another_spelling_of_the_same_pose_is_no_change() -> None:
    """A thing lies still; its yaw is read as pi or -pi, its quaternion as q or -q, a noisy lamp as 0.3 or -0.1."""
    flip = np.arange(120) % 7 < 3
    rows = np.zeros((120, 6), np.float32)
    rows[:, 0] = np.where(flip, 3.141, -3.141)
    rows[:, 1:5] = np.where(flip[:, None], 1, -1) * np.array([0.6, 0.0, 0.8, 0.0])
    rows[:, 5] = np.where(flip, 0.3, -0.1)
    names = ("red.yaw", *(f"red.q{k}" for k in range(4)), "lamp")
    declared = ("angle yaw", *("quaternion red",) * 4, "binary on")
    for settling in (SettlingConfig(), SettlingConfig(change={"default": None}, rest={"default": None})):
        assert len(RelabelIndex.build([rows], names, FPS, settling, declared).moments) == 0
    turned = rows.copy()  # half a turn about an axis, from observation 60 on: one change
    turned[60:, 0] = 0.0
    turned[60:, 1:5] = np.where(flip[60:, None], 1, -1) * np.array([0.0, 0.6, 0.0, 0.8])
    turned[60:, 5] = 1.0
    made = RelabelIndex.build([turned], names, FPS, SettlingConfig(), declared)
    assert made.moments.tolist() == [66]
    assert made.changed.tolist() == [[True] * 6]
    assert made.groups_apart(rows[:1], rows[3:4]).tolist() == [[False, False]]
