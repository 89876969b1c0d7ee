"""A picture of where a policy sees the hand go: what it estimates beside what happened, on held-out play."""

import io

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from playlearn.batch import Batch
from playlearn.policies import Policy
from playlearn.policies.encoders import HandEncoder

SCALE, COLUMNS, ROWS = 3, 4, 6
COLORS = {"hand": "magenta", "grasp": "yellow", "settled": "lime"}


@torch.inference_mode()
def events_picture(policy: Policy, batch: Batch) -> bytes | None:
    """A PNG, of each example the observation and beside it the goal; None for a policy that estimates no events.

    In the observation a magenta dot is where the hand is, by which the calibration is checked: it lies on the gripper.
    In both, a square is where the hand is estimated to close (yellow) and to be once the world has settled (green), and
    a dot is where that was.
    """
    encoder = policy.encoder
    if not isinstance(encoder, HandEncoder):
        return None
    normal = policy.normalized(batch)
    estimated = {name: encoder.seen(states).numpy() for name, states in encoder.events_ahead(normal).items()}
    true = {name: encoder.seen(states).numpy() for name, states in normal.events.items()}
    hand = encoder.seen(normal.state[:, -1]).numpy()
    camera = encoder.config.goal_camera
    chosen = np.linspace(0, len(batch) - 1, min(len(batch), COLUMNS * ROWS)).astype(int)
    tiles = []
    for k in chosen.tolist():
        views = []
        for frame in (batch.images[camera][k, -1], batch.goal_images[camera][k]):
            view = _enlarged(frame.numpy())
            for name in true:
                _mark(view, true[name][k], COLORS[name], filled=True)
                _mark(view, estimated[name][k], COLORS[name], filled=False)
            views.append(view)
        _mark(views[0], hand[k], COLORS["hand"], filled=True)
        tiles.append(np.concatenate([np.asarray(view) for view in views], axis=1))
    blank = np.zeros_like(tiles[0])
    tiles += [blank] * (-len(tiles) % COLUMNS)
    rows = [np.concatenate(tiles[i : i + COLUMNS], axis=1) for i in range(0, len(tiles), COLUMNS)]
    file = io.BytesIO()
    Image.fromarray(np.concatenate(rows)).save(file, "PNG")
    return file.getvalue()


def _enlarged(frame: NDArray[np.uint8]) -> Image.Image:
    return Image.fromarray(frame.repeat(SCALE, 0).repeat(SCALE, 1))


def _mark(view: Image.Image, at: NDArray[np.float32], color: str, *, filled: bool) -> None:
    """A dot or a square at a point, x and y in [-1, 1]; nothing where it is unknown."""
    if not np.isfinite(at).all():
        return
    x, y = (at + 1) / 2 * view.size
    size = 2 if filled else 6
    box = (x - size, y - size, x + size, y + size)
    draw = ImageDraw.Draw(view)
    if filled:
        draw.ellipse(box, fill=color)
    else:
        draw.rectangle(box, outline=color, width=2)
