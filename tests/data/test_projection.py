"""Where images show the hand, on drawn play of a camera that is known."""

import numpy as np
import torch

from playlearn.batch import Statistics
from playlearn.data.projection import hand_projection
from playlearn.policies.encoders.hand import hand_terms
from playlearn.policies.normalize import Normalizer

HEIGHT, WIDTH, STEPS = 48, 64, 60
CAMERA = np.array([[0.1, 0.0], [0.35, 0.05], [-0.04, 0.3], [0.02, -0.35]])  # of 1, x, y, z in units of the spread


class Drawn:
    """Play of one gripper, seen as a pale square, and a dark block that it carries from place to place."""

    def __init__(self, episodes: int) -> None:
        rng = np.random.default_rng(0)
        self.episodes, self.store = np.arange(episodes), self
        self.arrays = [self._episode(rng) for _ in range(episodes)]

    def array(self, i: int, key: str) -> np.ndarray:
        return self.arrays[i]["state" if key == "observation.state" else "frames"]

    def segments(self, _: int) -> list[tuple[int, int, int]]:
        return [(40, STEPS, 20)]

    def _episode(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """The hand goes to the block (20), carries it (40), leaves; it begins and ends somewhere above."""
        ends = rng.uniform(-1.5, 1.5, (4, 3)) * [1, 1, 0.3]
        ends[[0, 3], 2] += 1.0
        state = np.stack([np.interp(np.arange(STEPS + 1), [0, 20, 40, STEPS], ends[:, k]) for k in range(3)], 1)
        block = np.where(
            np.arange(STEPS + 1)[:, None] < 20, ends[1], np.where(np.arange(STEPS + 1)[:, None] > 40, ends[2], state)
        )
        frames = np.full((STEPS + 1, HEIGHT, WIDTH, 3), 128, np.uint8)
        for t in range(STEPS + 1):
            for place, shade, size in ((block[t], 10, 3), (state[t] + [0, 0, 0.5], 240, 5)):
                x, y = pixel(place)
                frames[t, max(0, y - size) : max(0, y + size), max(0, x - size) : max(0, x + size)] = shade
        return {"state": state.astype(np.float32), "frames": frames}


def pixel(place: np.ndarray) -> tuple[int, int]:
    x, y = (np.concatenate([[1.0], place]) @ CAMERA + 1) / 2 * [WIDTH, HEIGHT]
    return int(x), int(y)


def test_it_is_found_where_the_scene_changes() -> None:
    """Within a cell of four pixels for nine of ten states, though the arm is larger and hides what it holds."""
    play = Drawn(150)
    normalizer = Normalizer({"state": Statistics(np.zeros(3), np.ones(3))})
    weights = hand_projection(play, normalizer, "front", [0, 1, 2])
    state = np.random.default_rng(1).uniform(-1.3, 1.3, (200, 3)) * [1, 1, 0.3]
    true = np.concatenate([np.ones((200, 1)), state], 1) @ CAMERA
    found = (hand_terms(torch.as_tensor(state, dtype=torch.float32)) @ weights).numpy()
    apart = np.abs(found - true) * [WIDTH / 2, HEIGHT / 2]
    assert np.quantile(apart.max(1), 0.9) < 4
