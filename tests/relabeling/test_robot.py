"""Settled moments from the robot alone, on motions that are known."""

import numpy as np
import pytest

from playlearn.quantity import Quantities
from playlearn.relabeling import RelabelIndex, RobotConfig, SettlingConfig
from playlearn.relabeling.robot import RobotReader

FPS = 20.0
NAMES = ("eef.x", "eef.y", "eef.z", "eef.r00", "gripper.opening")
OPEN, BLOCK, SHUT = 0.08, 0.04, 0.0


def robot(*pieces: tuple[int, float, float]) -> np.ndarray:
    """(T+1, 5) of pieces (observations, eef.x and opening at their end); both go there evenly."""
    rows, now = [], (0.0, pieces[0][2])
    for count, *end in pieces:
        rows += [np.array(now) + (np.array(end) - now) * (i + 1) / count for i in range(count)]
        now = tuple(end)
    state = np.zeros((len(rows), len(NAMES)), np.float32)
    state[:, [0, 4]] = rows
    return state


def found(state: np.ndarray, names: tuple[str, ...] = NAMES, config: RobotConfig | None = None) -> tuple[list, ...]:
    return RobotReader.measured([state], names, ("",) * len(names), FPS, config or RobotConfig())(state)


# Grasped in 20 ... 23, carried 0.3 m over 30 ... 59, still; 0.1 m on over 80 ... 89; let go in 90 ... 93; back; still.
GRASPED = ((20, 0, OPEN), (4, 0, BLOCK), (6, 0, BLOCK), (30, 0.3, BLOCK), (20, 0.3, BLOCK))
CARRIED = robot(*GRASPED, (10, 0.4, BLOCK), (4, 0.4, OPEN))
CARRIED = np.concatenate(
    [CARRIED, robot((6, 0, OPEN), (30, -0.3, OPEN), (30, -0.3, OPEN)) + CARRIED[-1] * [1, 0, 0, 0, 0]]
)
CARRIED = CARRIED.astype(np.float32)


def test_a_thing_settles_where_the_arm_stops_with_it_and_where_it_is_let_go() -> None:
    moments, ends, kinds = found(CARRIED)
    stopped, opened = moments
    # The arm stands from 59 on; half a second is 10 steps, and the last steps of 1 cm each are no rest.
    assert 66 <= stopped <= 70
    # The fingers open over 90 ... 93: finished within `opens` of their widest, which is less than one step's 1 cm.
    assert opened == 93
    assert kinds == [[False, True], [True, False]]
    # What is held stays until it is carried on by 1 cm a step; what was let go stays, since the hand closes no more.
    assert ends[0] == 79
    assert ends[1] == len(CARRIED) - 1


def test_what_is_let_go_where_the_arm_had_stopped_has_settled_once() -> None:
    """Nothing has changed when the fingers open, and it stays until they close again, over 190 ... 193."""
    released = robot(*GRASPED, (4, 0.3, OPEN), (40, 0.1, OPEN), (66, 0.1, OPEN), (4, 0.1, SHUT), (10, 0.1, SHUT))
    moments, ends, kinds = found(released)
    assert moments == found(CARRIED)[0][:1]
    assert kinds == [[False, True]]
    assert 189 <= ends[0] <= 192


@pytest.mark.parametrize("pieces", [((4, 0, SHUT), (20, 0, SHUT), (4, 0, OPEN)), ((3, 0.0, BLOCK), (3, 0.1, OPEN))])
def test_a_grasp_that_failed_has_settled_nothing(pieces: tuple[tuple[int, float, float], ...]) -> None:
    """The fingers open where they closed; or they open at once, though the arm is on its way."""
    before, after = (20, 0.0, OPEN), (20, 0.5, OPEN)
    play = [robot(before, *pieces, after), CARRIED]
    reader = RobotReader.measured(play, NAMES, ("",) * len(NAMES), FPS, RobotConfig())
    assert reader(play[0])[0] == []
    assert len(reader(play[1])[0]) == 2


def test_a_hand_that_trembles_by_less_than_a_tenth_of_its_range_stays_shut() -> None:
    """OGBench's fingers do while they press a button, by 8 % of their range."""
    press = robot((20, 0, OPEN), (4, 0, SHUT), (20, 0.2, SHUT), (40, 0.2, SHUT), (4, 0.2, OPEN), (20, 0, OPEN))
    trembling = press.copy()
    trembling[46:70:2, 4] += 0.0075
    assert found(trembling)[0] == found(press)[0]


@pytest.mark.parametrize("closes", [None, "high"])
def test_a_gripper_that_closes_at_high_numbers_finds_the_same(closes: str | None) -> None:
    """In percent, as SO-101's could be: measured, for an object stops fingers only on their way to closing; or said."""

    def moments(play: list[np.ndarray], config: RobotConfig) -> list[list[int]]:
        reader = RobotReader.measured(play, NAMES, ("",) * len(NAMES), FPS, config)
        return [reader(state)[0] for state in play]

    play = [CARRIED, robot((20, 0, OPEN), (10, 0, SHUT), (20, 0.2, SHUT), (40, 0.2, SHUT), (10, 0.2, OPEN))]
    percent = [state * np.float32([1, 1, 1, 1, -1250]) + np.float32([0, 0, 0, 0, 100]) for state in play]
    expected = moments(play, RobotConfig())
    assert [len(one) for one in expected] == [2, 1]
    assert moments(percent, RobotConfig(gripper_closes=closes)) == expected
    assert moments(percent, RobotConfig(gripper_closes="low")) != expected


def test_a_hand_that_stops_open_in_mid_air_has_settled_nothing() -> None:
    """The last 30 observations of CARRIED are such a stop; here also before the first grasp."""
    waited = np.concatenate([robot((40, 0.2, OPEN), (40, 0.2, OPEN)), np.add(CARRIED, [0.2, 0, 0, 0, 0])]).astype(
        np.float32
    )
    assert [m - 80 for m in found(waited)[0]] == found(CARRIED)[0]


def test_a_grasp_settles_nothing_and_a_push_ends_where_it_stops() -> None:
    """With the hand shut all along: two pushes of 0.2 m with 1 s between them."""
    pushes = robot((20, 0, SHUT), (20, 0.2, SHUT), (20, 0.2, SHUT), (20, 0.4, SHUT), (20, 0.4, SHUT))
    moments, ends, _ = found(pushes)
    assert len(moments) == 2
    assert 40 < moments[0] <= 50
    assert 80 < moments[1] <= 90
    assert ends[0] in (59, 60)  # until the arm moves on by more than it rests within (a step is 1 cm)
    # Without a gripper it is the same: every stop of the arm may mean something.
    assert found(pushes[:, :4], NAMES[:4])[0] == moments


@pytest.mark.parametrize("scale", [0.5, 1250.0])
def test_units_and_the_place_of_zero_do_not_matter(scale: float) -> None:
    """A gripper may say 0 ... 100 and an arm its joints in degrees."""
    other = np.float32(scale) * CARRIED + np.float32(scale)
    assert found(other) == found(CARRIED)


def test_patterns_say_which_numbers_are_what() -> None:
    names = ("shoulder.pos", "elbow.pos", "wrist.pos", "lift.pos", "gripper.pos")
    assert RobotConfig().columns(names) == ([4], [0, 1, 2, 3])
    assert RobotConfig(gripper=("wrist*",), arm=("elbow*",)).columns(names) == ([2], [1])
    assert RobotConfig().columns(("Joint", "Gripper.Pos")) == ([1], [0])  # upper case like lower

    assert found(CARRIED, names) == found(CARRIED)
    # A gripper of the joints' part name, and of a hundred times their size, does not raise the joints' thresholds.
    wide = CARRIED * np.array([1, 1, 1, 1, 1000], np.float32)
    assert found(wide, names) == found(CARRIED)


def test_a_gripper_may_close_at_high_numbers_in_any_unit() -> None:
    """The moments of one that closes at low ones; taken for such a one, it would open where it closes."""
    for scale, zero in ((1.0, 0.0), (100.0, 5.0), (57.3, -20.0)):  # meters, percent, degrees
        turned = CARRIED.copy()
        turned[:, 4] = zero - scale * CARRIED[:, 4]
        assert found(turned, config=RobotConfig(gripper_closes="high")) == found(CARRIED)
        assert found(turned) != found(CARRIED)


def test_what_is_read_from_the_robot_is_said() -> None:
    assert "the gripper (gripper) has opened or, closed, the arm (x, y) stops" in RobotConfig().describe(
        ("x", "y", "gripper")
    )
    two = RobotConfig().describe(("x", "left_gripper", "right_gripper"))
    assert "the gripper (left_gripper)" in two
    assert "one gripper is read, and not right_gripper: `data.settling.robot.gripper` and `.arm` can name" in two
    high = RobotConfig(gripper_closes="high").describe(("x", "gripper"))
    assert "it is closed where it reads high (`data.settling.robot.gripper_closes`)" in high
    none = RobotConfig().describe(("state.0", "state.1"))
    assert none.startswith("no gripper (*gripper*): every stop of the arm (state.0, state.1) counts")


def test_noise_of_half_a_millimeter_moves_no_moment_by_half_a_second() -> None:
    rng = np.random.default_rng(0)
    noisy = (CARRIED + rng.normal(0, 5e-4, CARRIED.shape)).astype(np.float32)
    moments = found(noisy)[0]
    assert len(moments) == 2
    assert (np.abs(np.subtract(moments, found(CARRIED)[0])) <= 10).all()


def test_a_robot_that_never_moves_settles_nothing() -> None:
    assert found(np.zeros((50, 5), np.float32))[0] == []
    assert found(np.zeros((2, 5), np.float32))[0] == []


class Recorded:
    """A store of one such recording, without `achieved`."""

    class spec:  # noqa: N801 - a stand-in for a field
        achieved_names: tuple[str, ...] = ()
        state_names = NAMES
        quantities = Quantities()
        fps = FPS

    def __len__(self) -> int:
        return 1

    def array(self, i: int, key: str) -> np.ndarray:
        assert key == "observation.state"
        return CARRIED


def test_the_table_of_a_store_without_achieved_is_the_robots() -> None:
    table = RelabelIndex.of_store(Recorded(), SettlingConfig())
    assert table.moments.tolist() == found(CARRIED)[0]
    assert table.ends.tolist() == found(CARRIED)[1]
    assert table.change_counts() == {"gripper": 1, "arm": 1}
    assert table.valid(0).sum() == table.moments[-1]
