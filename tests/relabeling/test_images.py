"""Settled moments from robot and images, on pictures that are drawn here."""

import numpy as np
import pytest

from playlearn.errors import UsageError
from playlearn.quantity import Quantities
from playlearn.relabeling import ImagesConfig, RelabelIndex, SettlingConfig
from playlearn.relabeling.images import ImageReader, _medians
from tests.relabeling.test_robot import CARRIED, FPS, NAMES, OPEN, SHUT, robot

# A shut hand passes over the table, 0.2 m in 4 s without a stop, and opens in the end: 20 ... 23 it closes.
PASSES = robot((20, 0, OPEN), (4, 0, SHUT), (16, 0, SHUT), (80, 0.2, SHUT), (4, 0.21, OPEN), (36, 0.4, OPEN))
ARM, LAMP = (200, 200, 200), (250, 240, 40)


def filmed(state: np.ndarray, lamp_from: int | None = None, side: int = 1) -> np.ndarray:
    """(T+1, 32, 48, 3) of a gray table with an arm where eef.x says, and a lamp that is lit from some time on."""
    frames = np.full((len(state), 32, 48, 3), 90, np.uint8)
    for frame, x in zip(frames, state[:, 0], strict=True):
        column = 4 + round(80 * float(x))
        frame[4:14, column : column + 6] = ARM
    if lamp_from is not None:
        frames[lamp_from:, 24:28, 30:34] = LAMP
    return frames.repeat(side, axis=1).repeat(side, axis=2)


class Recorded:
    """A store of PASSES and CARRIED that hands out the robot's state and one of its cameras, nothing else."""

    class spec:  # noqa: N801 - a stand-in for a field
        achieved_names: tuple[str, ...] = ("lamp.on",)
        state_names = NAMES
        quantities = Quantities()
        fps = FPS

    def __init__(self, lamp_from: int | None = None, side: int = 1) -> None:
        self.states = [PASSES, CARRIED]
        self.frames = [filmed(PASSES, lamp_from, side), filmed(CARRIED)]

    def __len__(self) -> int:
        return len(self.states)

    def cameras(self) -> dict[str, tuple[int, int]]:
        return {"front": (32, 48), "wrist": (32, 48)}

    def array(self, i: int, key: str) -> np.ndarray:
        assert key in ("observation.state", "observation.images.front"), f"{key} is privileged, or was not asked for"
        return self.states[i] if key == "observation.state" else self.frames[i]


def index(store: Recorded) -> RelabelIndex:
    return RelabelIndex.of_store(store, SettlingConfig(source="images", images=ImagesConfig(("front",))))


@pytest.mark.parametrize("side", [1, 4])
def test_a_lamp_that_a_shut_hand_lights_in_passing_is_a_settled_moment(side: int) -> None:
    """Within half a second of 70; not where the hand opens, 50 steps later. Larger images are read as small ones."""
    table = index(Recorded(lamp_from=70, side=side))
    moments, ends = table.settled(0)
    assert len(moments) == 1
    assert abs(int(moments[0]) - 70) <= 10
    assert ends[0] >= moments[0]
    assert table.changed[0].tolist() == [False, False, True]


def test_what_is_carried_is_the_robots_whatever_the_images_show() -> None:
    """And of what they do not show the robot is believed: PASSES opens its hand elsewhere than it had closed."""
    table, alone = index(Recorded()), RelabelIndex.of_store(Recorded(), SettlingConfig(source="robot"))
    assert table.moments.tolist() == alone.moments.tolist()
    assert table.ends.tolist() == alone.ends.tolist()
    assert table.changed[:, :2].tolist() == alone.changed.tolist()


def test_an_arm_that_comes_and_goes_has_changed_nothing() -> None:
    """It stands still for 1.6 s beside the lamp; the lamp flashes for 0.4 s."""
    reader = ImageReader(None, FPS)  # type: ignore[arg-type] - pictures alone
    stays = robot((60, 0, SHUT), (8, 0.3, SHUT), (32, 0.3, SHUT), (8, 0, SHUT), (60, 0, SHUT))
    flashes = filmed(robot((160, 0, SHUT)), 80)
    flashes[88:] = flashes[0]
    assert reader.changes(flashes) == []
    assert reader.changes(filmed(robot((160, 0, SHUT)), 80)) != []
    assert reader.changes(filmed(PASSES)) == []
    assert len(reader.changes(filmed(stays))) <= 2 * 2  # its coming and its going, in the place it left and came to


def test_five_views_have_a_median() -> None:
    views = np.random.default_rng(0).integers(0, 256, (14, 3, 4, 3)).astype(np.uint8)
    expected = np.stack([np.median(views[i : i + 5], axis=0) for i in range(10)])
    before, after = _medians(views)
    np.testing.assert_array_equal(before, expected[:5])
    np.testing.assert_array_equal(after, expected[5:])


def test_cameras_are_asked_for_in_a_sentence() -> None:
    assert ImagesConfig().chosen(("top",)) == ("top",)
    with pytest.raises(UsageError, match=r"the store has front, wrist; name those that stand still"):
        ImagesConfig().chosen(("front", "wrist"))
    with pytest.raises(UsageError, match=r"the store has front, not top"):
        ImagesConfig(("top",)).chosen(("front",))
    with pytest.raises(UsageError, match=r"the store has no cameras; .*`data.settling.source: robot`"):
        ImagesConfig().chosen(())
