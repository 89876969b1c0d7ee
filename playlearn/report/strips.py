"""Film strips of play: an attempt in ten pictures, each with a stripe that says what befell that step."""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from playlearn.episode import IMAGES, Array, read_annotation
from playlearn.report.play import GAVE_UP, MISSED, SkillAttempt, attempts
from playlearn.store import Store

Look = Callable[[int, int, str], Array]  # (episode, observation, camera) -> (h, w, 3) uint8
FRAMES = 10
GAP, STRIPE, LINE = 2, 5, 15  # pixels between pictures, of the stripe, of a line of text
# Of several that are true of a step the first is shown.
COLORS = {
    "slip": (200, 69, 59),
    "pause": (146, 72, 196),
    "mistake": (217, 138, 31),
    GAVE_UP: (29, 36, 51),
    "open_loop": (47, 107, 219),
    "": (176, 184, 197),
}
WORDS = {"": "looking", "open_loop": "open_loop", GAVE_UP: "gave up", MISSED: "missed grasp"}


@dataclass(frozen=True, eq=False)
class Strip:
    """One attempt. steps: the observations shown; rows: for each camera their pictures; stripe: mark of each."""

    attempt: SkillAttempt
    caption: str
    steps: tuple[int, ...]
    stripe: tuple[str, ...]
    rows: tuple[tuple[Array, ...], ...]


def stored_look(store: Store) -> Look:
    """Pictures as they were recorded."""
    return lambda episode, t, camera: store.array(episode, IMAGES + camera)[t]


def strips(store: Store, look: Look, cameras: Sequence[str], count: int, rng: np.random.Generator) -> list[Strip]:
    """`count` attempts, of which each mark that occurs has as near to the same share as may be."""
    return [_strip(store, look, cameras, attempt) for attempt in choose(attempts(store), count, rng)]


def moments(store: Store, look: Look, camera: str, count: int, rng: np.random.Generator) -> list[Array]:
    """Pictures of `count` random moments of the whole store."""
    rows = np.concatenate([[0], np.cumsum(store.lengths() + 1)])
    drawn = np.sort(rng.choice(rows[-1], min(count, int(rows[-1])), replace=False))
    episodes = np.searchsorted(rows, drawn, side="right") - 1
    return [look(int(i), int(row - rows[i]), camera) for i, row in zip(episodes, drawn, strict=True)]


def choose(tried: Sequence[SkillAttempt], count: int, rng: np.random.Generator) -> list[SkillAttempt]:
    """Attempts in turn from those with each mark and from those with none; in the order they were made."""
    order = [tried[k] for k in rng.permutation(len(tried)) if tried[k].end - tried[k].begin >= FRAMES]
    order.sort(key=lambda one: (one.cut, one.failed))  # how it ended is part of the story, and best that it was mended
    kinds: list[Callable[[SkillAttempt], bool]] = [
        lambda one: MISSED in one.marks,
        lambda one: "slip" in one.marks,
        lambda one: "mistake" in one.marks,
        lambda one: "pause" in one.marks,
        lambda one: GAVE_UP in one.marks,
        lambda one: not one.marks - {"open_loop"},
    ]
    chosen: list[SkillAttempt] = []
    while len(chosen) < min(count, len(order)):
        before = len(chosen)
        for fits in kinds:
            one = next((one for one in order if one not in chosen and fits(one)), None)
            if one is not None and len(chosen) < count:
                chosen.append(one)
        if len(chosen) == before:
            break
    return sorted(chosen, key=lambda one: (one.episode, one.begin))


def picture(strip: Strip) -> Array:
    """(h, w, 3) uint8: the cameras' rows one above the other, each as wide as the widest, the stripe below them."""
    width = max(row[0].shape[1] for row in strip.rows)
    columns = [
        [_as_wide(row[k], width) for row in strip.rows] + [_color(mark, width)] for k, mark in enumerate(strip.stripe)
    ]
    gap = np.full((sum(cell.shape[0] for cell in columns[0]), GAP, 3), 255, np.uint8)
    parts = [part for column in columns for part in (np.concatenate(column), gap)]
    return np.concatenate(parts[:-1], axis=1)


def sheet(strips: Sequence[Strip], title: str) -> bytes:
    """The strips under one another with captions and a legend, as PNG of 256 colors."""
    pictures = [picture(strip) for strip in strips]
    width = max(shown.shape[1] for shown in pictures)
    height = sum(shown.shape[0] + LINE + 8 for shown in pictures) + 2 * LINE + 8
    page = Image.new("RGB", (width + 16, height), "white")
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(12)
    draw.text((8, 4), title, "black", ImageFont.load_default(14))
    at = 8
    for mark, color in COLORS.items():
        draw.rectangle((at, LINE + 10, at + 10, LINE + 14), color)
        draw.text((at + 14, LINE + 4), said(mark), (90, 98, 112), font)
        at += 30 + int(draw.textlength(said(mark), font))
    y = 2 * LINE + 8
    for strip, shown in zip(strips, pictures, strict=True):
        draw.text((8, y), strip.caption, "black", font)
        page.paste(Image.fromarray(shown), (8, y + LINE))
        y += shown.shape[0] + LINE + 8
    buffer = io.BytesIO()
    page.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def said(mark: str) -> str:
    """A mark in words."""
    return WORDS.get(mark, mark)


def _strip(store: Store, look: Look, cameras: Sequence[str], one: SkillAttempt) -> Strip:
    steps = np.linspace(one.begin, one.end - 1, FRAMES).round().astype(int).tolist()
    skills, numbers = store.meta(one.episode).skills, store.array(one.episode, "skill")
    marks = [read_annotation(skills[numbers[t]])[1] if skills else () for t in range(one.begin, one.end)]
    # A mark that lasts less than the time between two pictures is not lost: each answers for the steps up to the next.
    stripe = [
        next((mark for mark in COLORS if any(mark in own for own in marks[a - one.begin : b - one.begin])), "")
        for a, b in pairwise([*steps, one.end])
    ]
    seconds = (one.end - one.begin) / store.spec.fps
    words = [said(mark) for mark in sorted(one.marks) if mark != GAVE_UP]
    outcome = "cut by the end" if one.cut else "gave up" if one.failed else "done"
    start = one.begin / store.spec.fps
    caption = f"{one.skill or 'play'}, episode {store.indices()[one.episode]} at {start:.1f} s: " + ", ".join(
        [*words, f"{outcome} after {seconds:.1f} s"]
    )
    rows = tuple(tuple(look(one.episode, t, camera) for t in steps) for camera in cameras)
    return Strip(one, caption, tuple(steps), tuple(stripe), rows)


def _as_wide(image: Array, width: int) -> Array:
    """Centerd on a light ground of that width."""
    height, own = image.shape[:2]
    cell = np.full((height, width, 3), 246, np.uint8)
    left = (width - own) // 2
    cell[:, left : left + own] = image
    return cell


def _color(mark: str, width: int) -> Array:
    return np.broadcast_to(np.array(COLORS[mark], np.uint8), (STRIPE, width, 3))
