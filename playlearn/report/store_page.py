"""A store of play as one self-contained page: positions of objects, changes, mistakes, pictures."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

from playlearn.episode import Array
from playlearn.report.pictures import encode_still
from playlearn.report.strips import COLORS, Strip, mark_name, picture
from playlearn.report.template import template

WIDTH, HEIGHT = 300, 64  # of a histogram, in its own units
_DARK = np.array([[246, 247, 249], [158, 190, 245], [47, 107, 219], [16, 42, 110]], float)  # never ... most often


@dataclass(frozen=True, eq=False)
class Shown:
    """The pictures of a page.

    strips: of attempts.
    moments: random images (h, w, 3) uint8.
    note: why there are none.
    """

    strips: Sequence[Strip] = ()
    moments: Sequence[Array] = ()
    note: str = ""


def store_page(play: Mapping[str, Any], title: str, shown: Shown) -> str:
    """The page as HTML. play: the result of `playlearn.report.play.figures`."""
    return template("store_page.html.j2").render(
        play=play,
        title=title,
        note=shown.note,
        maps={
            name: (heat_map(row["counts"]), row["coverage"]) for name, row in play["heat_maps"].get("maps", {}).items()
        },
        strips=[(strip.caption, encode_still(picture(strip))) for strip in shown.strips],
        moments=[encode_still(image) for image in shown.moments],
        legend={mark_name(mark): f"rgb{color}" for mark, color in COLORS.items()},
        outline=outline,
        most=max((row["count"] for row in play["skills"].values()), default=1),
        width=WIDTH,
        height=HEIGHT,
    )


def heat_map(counts: Sequence[Sequence[int]]) -> bytes:
    """One pixel a cell as PNG, darker where visited more often; by the square root, so that rare cells show."""
    level = np.sqrt(np.asarray(counts, float))
    level /= max(float(level.max()), 1.0)
    at = level * (len(_DARK) - 1)
    below = np.minimum(at.astype(int), len(_DARK) - 2)
    # Cells that were visited at all stand out from the others.
    color = _DARK[below] + (at - below)[..., None] * (_DARK[below + 1] - _DARK[below])
    color[(level > 0) & (level < 0.15)] = _DARK[0] + 0.45 * (_DARK[1] - _DARK[0])
    buffer = io.BytesIO()
    Image.fromarray(color.round().astype(np.uint8)).save(buffer, "PNG")
    return buffer.getvalue()


def outline(counts: Sequence[int], most: int | None = None) -> str:
    """The points of a histogram's outline in a box of WIDTH x HEIGHT. most: the count that reaches the top."""
    top, bar = max(most or max(counts), 1), WIDTH / len(counts)
    points = [(0.0, float(HEIGHT))]
    for k, count in enumerate(counts):
        y = HEIGHT * (1 - min(1.0, count / top))
        points += [(k * bar, y), ((k + 1) * bar, y)]
    points.append((WIDTH, HEIGHT))
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
