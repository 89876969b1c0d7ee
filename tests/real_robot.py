"""LeRobot datasets as a real arm records them: joints in degrees, a gripper, cameras, no objects, nothing labeled."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.episode import Array
from tests.lerobot_dataset import encoded, image, vector, write_dataset

JOINTS = ("shoulder_pan.pos", "shoulder_lift.pos", "elbow_flex.pos", "wrist_flex.pos", "wrist_roll.pos")
NAMES = (*JOINTS, "gripper.pos")
CYCLE = (1.2, 0.6, 1.2, 0.6)  # seconds: to an object, close, carry it, open


def arm(seconds: float, fps: float, seed: int = 0, *, gripper: Sequence[float] = (5.0, 60.0)) -> Array:
    """(n, 6) degrees, and the gripper between `closed` and `opened`: picks and places without end.

    gripper: what it reads when it is closed and when it is open.
    """
    rng = np.random.default_rng(seed)
    count = round(seconds * fps) + 1
    rows, at, place = np.zeros((count, 6)), 0, rng.uniform(-40, 40, 5)
    closed, opened = gripper
    wide = opened
    while at < count:
        for phase, took in enumerate(CYCLE):
            steps = max(2, round(took * fps))
            ramp = (1 - np.cos(np.linspace(0, np.pi, steps)))[:, None] / 2
            there = rng.uniform(-40, 40, 5) if phase in (0, 2) else place
            wanted = (opened, closed, closed, opened)[phase]
            part = np.concatenate([place + ramp * (there - place), wide + ramp * (wanted - wide)], axis=1)[: count - at]
            rows[at : at + len(part)] = part
            at, place, wide = at + len(part), there, wanted
    rows += rng.normal(0, 0.02, rows.shape) * np.array([*[1.0] * 5, abs(opened - closed) / 100])
    return rows.astype(np.float32)


def recorded(
    root: Path,
    episodes: Sequence[Array],
    *,
    names: Sequence[str] = NAMES,
    fps: int = 30,
    cameras: Mapping[str, tuple[int, int]] | None = None,
    **more: Any,
) -> Path:
    """A dataset of these states (n, S); an action is the next state, as a leader arm commands it.

    cameras: name -> (height, width) of its color images.
    """
    rows = np.concatenate(episodes)
    commands = np.concatenate([np.concatenate([one[1:], one[-1:]]) for one in episodes])
    features: dict[str, Any] = {"observation.state": vector(list(names)), "action": vector(list(names))}
    columns: dict[str, Any] = {"observation.state": rows.tolist(), "action": commands.tolist()}
    for camera, (height, width) in (cameras or {}).items():
        features[f"observation.images.{camera}"] = image(height, width, 3)
        columns[f"observation.images.{camera}"] = encoded(pictures(rows, height, width))
    return write_dataset(root, features, columns, [len(one) for one in episodes], fps=fps, **more)


def pictures(rows: Array, height: int, width: int) -> Array:
    """(n, h, w, 3) uint8: a bright square where the first two joints point."""
    frames = np.full((len(rows), height, width, 3), 90, np.uint8)
    x = np.clip((rows[:, 0] + 45) / 90 * width, 1, width - 2).astype(int)
    y = np.clip((rows[:, 1] + 45) / 90 * height, 1, height - 2).astype(int)
    for frame, across, down in zip(frames, x, y, strict=True):
        frame[down - 1 : down + 2, across - 1 : across + 2] = 250
    return frames
