"""Settled moments of the robot and the images: what a picture shows differently for good, and the hand did not carry.

The gripper tells when an object that it held was let go (`robot.py`). It does not tell whether a shut gripper pressed,
turned or pushed something, so there the images of cameras that stand still decide. A pixel has changed between two
views if the medians of the five views before and after differ. An arm that passes is in no median. One that stays for
longer is in some, so the pixels of a change have to lie together, change together, and show the same for 0.8 s before
and after. Left out is what changes when the gripper closes on an object, opens again, or the arm stops with it: that is
what the gripper did. Each other change while a shut gripper is at work is a settled moment: at the moment that the
robot tells if one is within 0.5 s, else at the first view that shows it. Where the images show none, the robot's count.

Models of what the arm hides, learned from proprioception, were tried and left out: they found no more than these
medians do. See eval/results/settled.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from playlearn.episode import Array
from playlearn.errors import UsageError
from playlearn.relabeling.robot import NAMES as ROBOT_NAMES
from playlearn.relabeling.robot import Grasp, RobotReader

Moments = tuple[list[int], list[int], list[list[bool]]]
NAMES = (*ROBOT_NAMES, "image.changed")
VIEW_SECONDS = 0.2  # between two views
VIEWS = 5  # on either side, of which a median is taken
SAME_VIEWS = 4  # for which a cluster shows the same before its change and after it
LEVELS = 25  # of 255 by which a pixel differs
CLUSTER = 0.002  # of the image: the fewest pixels that lie together
TOGETHER = 0.8  # the fraction of a cluster that has changed at once
SIDE = 96  # pixels: of a larger image, means over squares are compared
EXPLAINED_SECONDS = 0.2  # from what the gripper did
NEAR_SECONDS = 0.5  # from the robot's moment, which then is the date


@dataclass(frozen=True)
class ImagesConfig:
    """Which cameras show what has changed.

    cameras: those that stand still; () where the store has one camera alone.
    """

    cameras: tuple[str, ...] = ()

    def chosen(self, recorded: Sequence[str]) -> tuple[str, ...]:
        """The cameras, among those that a store has recorded.

        Raises:
            UsageError: none is given though there are several, or the store lacks one.
        """
        cameras = self.cameras or tuple(recorded)
        have = ", ".join(recorded) or "no cameras"
        if not self.cameras and len(recorded) != 1:
            raise UsageError(
                f"data.settling.images.cameras: the store has {have}; name those that stand still, or set "
                "`data.settling.source: robot`"
            )
        missing = [camera for camera in cameras if camera not in recorded]
        if missing:
            raise UsageError(f"data.settling.images.cameras: the store has {have}, not {', '.join(missing)}")
        return cameras


@dataclass(frozen=True)
class ImageReader:
    """Finds the moments of the robot and the images.

    robot: what the gripper did.
    fps: observations a second.
    """

    robot: RobotReader
    fps: float

    def __call__(self, state: Array, images: Sequence[Array]) -> Moments:
        """The moments (m), the last observation each holds to, and which of `NAMES` each is (m, 3).

        state: (T+1, S).
        images: of each camera, (T+1, h, w, 3) uint8.
        """
        grasps = self.robot.grasps(state)
        carried = [t for grasp in grasps if grasp.holds for t in (grasp.closed, *grasp.moments())]
        slack = round(EXPLAINED_SECONDS * self.fps)
        seen = [
            change
            for change in sorted(
                {change for frames in images for change in self.changes(frames)}, key=lambda c: c[::-1]
            )
            if not any(change[0] - slack <= t <= change[1] + slack for t in carried)
        ]
        moments: set[int] = set()
        for grasp in grasps:
            own = [c for c in seen if not grasp.holds and c[0] <= grasp.until + slack and grasp.closed - slack <= c[1]]
            moments.update(self._dated(_merged(own, slack), grasp.moments()) if own else grasp.moments())
        return self._described(state, grasps, sorted(moments))

    def _dated(self, shown: Sequence[int], moments: Sequence[int]) -> list[int]:
        """When what the images show happened: at the robot's moment, if one is near."""
        near = round(NEAR_SECONDS * self.fps)
        return [
            min((t for t in moments if abs(t - first) <= near), key=lambda t: abs(t - first), default=first)
            for first in shown
        ]

    def _described(self, state: Array, grasps: Sequence[Grasp], moments: list[int]) -> Moments:
        opened, stopped = {grasp.opened for grasp in grasps}, {t for grasp in grasps for t in grasp.stops}
        ends = self.robot.ends(state, moments)
        return moments, ends, [[t in opened, t in stopped, t not in opened and t not in stopped] for t in moments]

    def changes(self, frames: Array) -> list[tuple[int, int]]:
        """The last observation before each change of (T+1, h, w, 3), and the first that shows it."""
        step = max(1, round(VIEW_SECONDS * self.fps))
        views = _small(frames[::step])
        if len(views) < 2 * VIEWS:
            return []
        changed = _differ(*_medians(views))  # (n, h, w), between view VIEWS - 1 + i and the next
        labels, _ = ndimage.label(changed, structure=np.ones((3, 3, 3)))
        fewest = max(2, round(CLUSTER * changed[0].size))
        found = []
        for number, place in enumerate(ndimage.find_objects(labels), 1):
            own = labels[place] == number
            pixels = own.any(axis=0)
            share = own.sum(axis=(1, 2)) / pixels.sum()
            if pixels.sum() < fewest or share.max() < TOGETHER:
                continue
            at = place[0].start + np.flatnonzero(share >= 0.5) + VIEWS - 1
            before, after = int(at[0]), int(at[-1]) + 1
            if _is_change(views[:, place[1], place[2]][:, pixels], before, after):
                found.append((before * step, after * step))
        return found


def _small(frames: Array) -> Array:
    """(n, h, w, 3) uint8 with no side above `SIDE`, by means over squares."""
    square = -(-max(frames.shape[1:3]) // SIDE)
    if square == 1:
        return np.asarray(frames)
    height, width = (side // square for side in frames.shape[1:3])
    cut = frames[:, : height * square, : width * square]
    squares = cut.reshape(len(frames), height, square, width, square, 3)
    return np.stack([one.mean(axis=(1, 3)) for one in squares]).astype(np.uint8)


def _medians(views: Array) -> tuple[Array, Array]:
    """(n-9, h, w, 3) each: the medians of the five views up to each view, and of the five after it."""
    one, two, three, four, five = (views[i : len(views) - VIEWS + 1 + i] for i in range(VIEWS))
    low = np.maximum(np.minimum(one, two), np.minimum(three, four))
    high = np.minimum(np.maximum(one, two), np.maximum(three, four))  # the median lies between them, or is the fifth
    medians = np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), five))
    return medians[:-VIEWS], medians[VIEWS:]


def _differ(one: Array, other: Array) -> NDArray[np.bool_]:
    """Whether colors (..., 3) uint8 differ."""
    apart: NDArray[np.bool_] = (np.maximum(one, other) - np.minimum(one, other)).max(axis=-1) > LEVELS
    return apart


def _is_change(pixels: Array, before: int, after: int) -> bool:
    """Whether most pixels (n, p, 3) differ between two views, and show the same for a while before and after."""
    first, last = before - SAME_VIEWS + 1, after + SAME_VIEWS
    if first < 0 or last > len(pixels) or _differ(pixels[before], pixels[after]).mean() <= 0.5:
        return False
    same_before = _differ(pixels[first:before], pixels[before]).mean(axis=1) <= 0.5
    same_after = _differ(pixels[after + 1 : last], pixels[after]).mean(axis=1) <= 0.5
    return bool(same_before.all() and same_after.all())


def _merged(changes: Sequence[tuple[int, int]], slack: int) -> list[int]:
    """One moment for changes that overlap: when the first of them is shown."""
    moments: list[tuple[int, int]] = []
    for before, after in changes:
        for i, (latest, earliest) in enumerate(moments):
            if before - slack <= earliest and latest <= after + slack:
                moments[i] = max(before, latest), min(after, earliest)
                break
        else:
            moments.append((before, after))
    return [max(pair) for pair in moments]
