"""Film strips of play: an attempt in ten images, each with a stripe colored by the annotation of its steps."""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from playlearn.episode import IMAGES, Array
from playlearn.report.play import GAVE_UP, MISSED, SkillAttempt, attempts
from playlearn.store import Store

ImageSource = Callable[[int, int, str], Array]  # (episode, observation, camera) -> (h, w, 3) uint8
FRAMES = 10
GAP, STRIPE, LINE = 2, 5, 15  # pixels between images, of the stripe, of a line of text
# The first mark of a step is shown.
COLORS = {
    "slip": (200, 69, 59),
    "pause": (146, 72, 196),
    "mistake": (217, 138, 31),
    GAVE_UP: (29, 36, 51),
    "open_loop": (47, 107, 219),
    "": (176, 184, 197),
}
MARK_NAMES = {"": "closed loop", "open_loop": "open loop", GAVE_UP: "gave up", MISSED: "missed grasp"}


@dataclass(frozen=True, eq=False)
class Strip:
    """Film strip of one attempt.

    attempt: which.
    caption: text.
    steps: the observations that are shown.
    stripe: mark of each.
    rows: images of each, for each camera.
    """

    attempt: SkillAttempt
    caption: str
    steps: tuple[int, ...]
    stripe: tuple[str, ...]
    rows: tuple[tuple[Array, ...], ...]


def stored_images(store: Store) -> ImageSource:
    """The recorded images."""
    return lambda episode, t, camera: store.array(episode, IMAGES + camera)[t]


def strips(
    store: Store, image_of: ImageSource, cameras: Sequence[str], count: int, rng: np.random.Generator
) -> list[Strip]:
    """`count` attempts, with every mark that occurs as equally often as possible."""
    return [_strip(store, image_of, cameras, attempt) for attempt in choose(attempts(store), count, rng)]


def moments(store: Store, image_of: ImageSource, camera: str, count: int, rng: np.random.Generator) -> list[Array]:
    """Images of `count` random moments of the store."""
    rows = np.concatenate([[0], np.cumsum(store.lengths() + 1)])
    drawn = np.sort(rng.choice(rows[-1], min(count, int(rows[-1])), replace=False))
    episodes = np.searchsorted(rows, drawn, side="right") - 1
    return [image_of(int(i), int(row - rows[i]), camera) for i, row in zip(episodes, drawn, strict=True)]


def choose(skill_attempts: Sequence[SkillAttempt], count: int, rng: np.random.Generator) -> list[SkillAttempt]:
    """Attempts taken in turn from those with each mark and from those with none; in recorded order."""
    order = [
        skill_attempts[k]
        for k in rng.permutation(len(skill_attempts))
        if skill_attempts[k].end - skill_attempts[k].begin >= FRAMES
    ]
    order.sort(
        key=lambda attempt: (attempt.truncated, attempt.failed)
    )  # complete attempts first, and successful ones before failures
    kinds: list[Callable[[SkillAttempt], bool]] = [
        lambda attempt: MISSED in attempt.marks,
        lambda attempt: "slip" in attempt.marks,
        lambda attempt: "mistake" in attempt.marks,
        lambda attempt: "pause" in attempt.marks,
        lambda attempt: GAVE_UP in attempt.marks,
        lambda attempt: not attempt.marks - {"open_loop"},
    ]
    chosen: list[SkillAttempt] = []
    while len(chosen) < min(count, len(order)):
        before = len(chosen)
        for fits in kinds:
            attempt = next((attempt for attempt in order if attempt not in chosen and fits(attempt)), None)
            if attempt is not None and len(chosen) < count:
                chosen.append(attempt)
        if len(chosen) == before:
            break
    return sorted(chosen, key=lambda attempt: (attempt.episode, attempt.begin))


def picture(strip: Strip) -> Array:
    """(h, w, 3) uint8: a row for each camera, padded to the widest, and the stripe below."""
    width = max(row[0].shape[1] for row in strip.rows)
    columns = [
        [_as_wide(row[k], width) for row in strip.rows] + [_color(mark, width)] for k, mark in enumerate(strip.stripe)
    ]
    gap = np.full((sum(cell.shape[0] for cell in columns[0]), GAP, 3), 255, np.uint8)
    parts = [part for column in columns for part in (np.concatenate(column), gap)]
    return np.concatenate(parts[:-1], axis=1)


def sheet(strips: Sequence[Strip], title: str) -> bytes:
    """The strips below one another with captions and a legend, as PNG of 256 colors."""
    pictures = [picture(strip) for strip in strips]
    width = max(shown.shape[1] for shown in pictures)
    height = sum(shown.shape[0] + LINE + 8 for shown in pictures) + 2 * LINE + 8
    page = Image.new("RGB", (width + 16, height), "white")
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(12)
    draw.text((8, 4), title, "black", ImageFont.load_default(14))
    at = 8
    for mark, color in COLORS.items():
        draw.rectangle((at, LINE + 10, at + 10, LINE + 14), color)
        draw.text((at + 14, LINE + 4), mark_name(mark), (90, 98, 112), font)
        at += 30 + int(draw.textlength(mark_name(mark), font))
    y = 2 * LINE + 8
    for strip, shown in zip(strips, pictures, strict=True):
        draw.text((8, y), strip.caption, "black", font)
        page.paste(Image.fromarray(shown), (8, y + LINE))
        y += shown.shape[0] + LINE + 8
    buffer = io.BytesIO()
    page.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def mark_name(mark: str) -> str:
    """The display name of a mark."""
    return MARK_NAMES.get(mark, mark)


def _strip(store: Store, image_of: ImageSource, cameras: Sequence[str], attempt: SkillAttempt) -> Strip:
    steps = np.linspace(attempt.begin, attempt.end - 1, FRAMES).round().astype(int).tolist()
    annotations, numbers = store.meta(attempt.episode).annotations(), store.array(attempt.episode, "skill")
    marks = [annotations[numbers[t]][1] for t in range(attempt.begin, attempt.end)]
    # Each image stands for the steps up to the next one, so that short marks are not lost.
    stripe = [
        next((mark for mark in COLORS if any(mark in own for own in marks[a - attempt.begin : b - attempt.begin])), "")
        for a, b in pairwise([*steps, attempt.end])
    ]
    seconds = (attempt.end - attempt.begin) / store.spec.fps
    facts = [mark_name(mark) for mark in sorted(attempt.marks) if mark != GAVE_UP]
    known = "gave up" if attempt.failed else "succeeded"
    outcome = "truncated" if attempt.truncated else "ended" if attempt.unknown else known
    start = attempt.begin / store.spec.fps
    caption = f"{attempt.skill or 'play'}, episode {store.indices()[attempt.episode]} at {start:.1f} s: " + ", ".join(
        [*facts, f"{outcome} after {seconds:.1f} s"]
    )
    rows = tuple(tuple(image_of(attempt.episode, t, camera) for t in steps) for camera in cameras)
    return Strip(attempt, caption, tuple(steps), tuple(stripe), rows)


def _as_wide(image: Array, width: int) -> Array:
    """The image centered on a light background of that width."""
    height, own = image.shape[:2]
    cell = np.full((height, width, 3), 246, np.uint8)
    left = (width - own) // 2
    cell[:, left : left + own] = image
    return cell


def _color(mark: str, width: int) -> Array:
    return np.broadcast_to(np.array(COLORS[mark], np.uint8), (STRIPE, width, 3))
