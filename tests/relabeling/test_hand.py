"""Where the hand closes and where it is once the world has settled, on motions that are known."""

import numpy as np

from playlearn.batch import EVENTS
from playlearn.quantity import Quantities
from playlearn.relabeling import RelabelIndex, SettlingConfig, events_ahead, grasps, robot_reader

NAMES = ("eef.x", "gripper.opening")
OPEN, SHUT = 0.08, 0.0


class Spec:
    achieved_names: tuple[str, ...] = ()
    state_names = NAMES
    quantities = Quantities(state=("length x", "length opening"))
    fps = 20.0


class Play:
    """One episode: shut at 20, carried, open at 30; shut at 40, carried, open at 70; still, and away."""

    spec = Spec()

    def __init__(self) -> None:
        opening = np.full(121, OPEN)
        opening[20:30] = opening[40:70] = SHUT
        x = np.interp(np.arange(121), [0, 20, 30, 40, 70, 80, 110], [0, 0.2, 0.4, 0.3, 0.6, 0.6, 0.0])
        self.state = np.stack([x, opening], 1).astype(np.float32)

    def __len__(self) -> int:
        return 1

    def array(self, _: int, key: str) -> np.ndarray:
        return self.state if key == "observation.state" else np.zeros((121, 0), np.float32)


def test_the_last_closing_before_a_settled_moment_is_its_grasp() -> None:
    play, settling = Play(), SettlingConfig(source="robot")
    table = RelabelIndex.of_store(play, settling)
    assert table.moments.tolist() == [30, 70]
    closed = grasps(table, robot_reader(play, settling, [0]), [play.state])
    assert closed.tolist() == [20, 40]
    t = np.array([0, 19, 20, 29, 30, 39, 40, 69, 70, 119])
    ahead = events_ahead(table, closed, np.zeros(len(t), np.int64), t)
    assert EVENTS == ("grasp", "settled")
    assert ahead.tolist() == [[20, 30]] * 2 + [[-1, 30]] * 2 + [[40, 70]] * 2 + [[-1, 70]] * 2 + [[-1, -1]] * 2


def test_of_two_closings_the_one_that_held_counts() -> None:
    """With the moment of the first, empty grasp left out, as one that images show to have changed nothing."""
    play, settling = Play(), SettlingConfig(source="robot")
    reader = robot_reader(play, settling, [0])
    table = RelabelIndex._of([120], [([70], [120], [[True, False]])], ("a", "b"), ("", ""), 20.0, np.zeros(0))
    assert grasps(table, reader, [play.state]).tolist() == [40]
    never = RelabelIndex._of([120], [([10], [15], [[True, False]])], ("a", "b"), ("", ""), 20.0, np.zeros(0))
    assert grasps(never, reader, [play.state]).tolist() == [-1]
