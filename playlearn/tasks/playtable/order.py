"""What to do next to bring the table from one state to another; it remembers nothing, so it can begin anywhere.

What is in the hand comes first: to its goal if it can be let go there now, else aside. Then the blocks, those
first that can go to their goals now: nothing on them, nothing in their place, what they are to lie on in its
place. Where all wait for each other, one is laid aside. Drawer and slider are moved out of the way when the next
block needs it, and to their own goals after the blocks; what the goal shows in the air comes last.

Each of these conditions is settled by the step that it asks for, and by no later one undone: so it cannot turn
in circles, though it forgets.
"""

import math
from dataclasses import dataclass

import numpy as np

from playlearn.episode import Array
from playlearn.tasks.playtable import scene
from playlearn.tasks.playtable.fit import ACROSS, ALONG, apart, fits, footprint, spots
from playlearn.tasks.playtable.layout import (
    BLOCK_NAMES,
    BULB,
    COVERING,
    DRAWER,
    LED,
    LEVER,
    LYING_Z,
    SLIDER,
    between,
    block,
    covered,
    direction,
    distance,
    in_bay,
    in_tray,
    others,
    rider,
    slider_y,
    supporter,
    upright,
)
from playlearn.tasks.playtable.skills import HIGH, POSTS, Block, Flip, Press, Slide, Tip, gripped
from playlearn.teleop.hand import Hand
from playlearn.teleop.skills import Carry, Reach, Skill

WIDE = 0.15  # metres of drawer opening at which all that lies in it can be got at
_ALL = range(len(BLOCK_NAMES))
_SPOTS = spots()
_HOLLOW = 0.01  # metres above its place at which a block is let go in the drawer


def in_hand(hand: Hand, achieved: Array) -> int | None:
    return next((i for i in _ALL if gripped(hand, achieved, i) is not None), None)


def next_skill(hand: Hand, achieved: Array, goal: Array) -> Skill:
    """The skill that is to be carried on now, from `achieved` (G,) towards `goal` (G,)."""
    return _Order(hand, achieved.astype(float), goal.astype(float)).next()


def carry(hand: Hand, achieved: Array, index: int, pose: Array, name: str | None = None, lasting: bool = True) -> Carry:
    """Carry block `index` to where `pose` (5,) shows it."""
    x, y, z = map(float, pose[:3])
    thing = Block(index, (x, y, z, direction(pose)))
    drop = _HOLLOW if z < scene.TABLE_Z and y > scene.EDGE_Y else 0.002
    slack = 0.008 if thing.way(hand, achieved) == ACROSS else 0.003  # along, there are 5 mm on either side
    return Carry(name or f"carry_{BLOCK_NAMES[index]}", thing, (x, y, z), direction(pose), lasting, drop, slack=slack)


@dataclass(frozen=True, eq=False)
class _Order:
    hand: Hand
    achieved: Array
    goal: Array

    def next(self) -> Skill:
        wrong = [i for i in _ALL if not self.there(i)]
        resting = [i for i in wrong if rests(self.goal, i)]
        aloft = [i for i in _ALL if not rests(self.goal, i)]
        held = in_hand(self.hand, self.achieved)
        fixture = None if resting else self.fixture()
        if held is not None:
            return self.with_held(held, held in aloft, bool(set(resting) - {held}) or fixture is not None)
        return (
            self.with_blocks(resting)
            or fixture
            or next((self.carry(i, lasting=False) for i in aloft), None)
            or Reach("rest", (float(self.hand.position[0]), float(self.hand.position[1]), HIGH))
        )

    # Where things are, and where they are to be ---------------------------------------------------------

    def to(self, index: int) -> Array:
        """(5,) the pose that a block is to have now: in the drawer it moves with it, and fingers must come out."""
        pose = block(self.goal, index).copy()
        if in_tray(self.goal, index):
            pose[1] += self.achieved[DRAWER] - self.goal[DRAWER]
            yaw = direction(pose)
            for _ in range(3):
                if any(fits(self.achieved, index, pose[:3], yaw + way) for way in (ACROSS, ALONG)):
                    break
                pose[1] += 0.01
        return pose

    def there(self, index: int) -> bool:
        at, to = block(self.achieved, index), block(self.goal, index).copy()
        if in_tray(self.goal, index) and in_tray(self.achieved, index):
            to[1] += self.achieved[DRAWER] - self.goal[DRAWER]
        near = distance(at, to) < 0.026 and abs(at[2] - to[2]) < 0.015
        return near and upright(at) == upright(to) and (upright(to) or abs(between(direction(at), direction(to))) < 0.3)

    # What comes next ------------------------------------------------------------------------------------

    def with_held(self, index: int, aloft: bool, more: bool) -> Skill:
        if (aloft and more) or (not aloft and not self.can_land(index)):
            return self.aside(index)
        way = gripped(self.hand, self.achieved, index)
        to = self.to(index)
        fit = [w for w in (ACROSS, ALONG) if fits(self.achieved, index, to[:3], direction(to) + w)]
        if fit and way not in fit and not aloft:
            return self.aside(index)  # to take it the other way round
        return self.carry(index, lasting=not aloft)

    def with_blocks(self, wrong: list[int]) -> Skill | None:
        if not wrong:
            return None
        wrong = sorted(wrong, key=lambda i: self.goal[5 * i + 2])
        ready = [i for i in wrong if rider(self.achieved, i) is None and self.can_land(i, now=False)]
        for index in ready:
            return self.fetch(index, self.carry(index), landing=True)
        first = wrong[0]
        blocker = rider(self.achieved, first)
        if blocker is None:
            blocker = next((j for j in self.occupants(first)), first)
        above = rider(self.achieved, blocker)
        blocker = blocker if above is None else above
        return self.fetch(blocker, self.aside(blocker), landing=False)

    def fetch(self, index: int, then: Skill, landing: bool) -> Skill:
        """`then`, once the drawer is open and the slider away where that is needed."""
        achieved, to = self.achieved, block(self.goal, index)
        if in_tray(achieved, index) or (landing and in_tray(self.goal, index)):
            opening = Slide("drawer", POSTS[DRAWER], scene.DRAWER_TRAVEL - 0.002)
            if achieved[DRAWER] < WIDE or opening.underway(self.hand, achieved):
                return opening
        for pose, near in ((block(achieved, index), covered(achieved, index)), (to, landing and self.covers(to))):
            away = 0.002 if pose[1] > scene.BAY_CENTRE[1] else scene.SLIDER_TRAVEL - 0.002
            uncovering = Slide("slider", POSTS[SLIDER], away)
            if near or (self.in_bay_region(pose) and uncovering.underway(self.hand, achieved)):
                return uncovering
        if upright(block(achieved, index)):
            return Tip(f"tip_{BLOCK_NAMES[index]}", index)
        return then

    def fixture(self) -> Skill | None:
        achieved, goal = self.achieved, self.goal
        if abs(goal[SLIDER] - achieved[SLIDER]) > 0.02:
            return Slide("slider", POSTS[SLIDER], float(goal[SLIDER]))
        if abs(goal[DRAWER] - achieved[DRAWER]) > 0.02:
            return Slide("drawer", POSTS[DRAWER], float(goal[DRAWER]))
        if (goal[BULB] > 0.5) != (achieved[BULB] > 0.5) or abs(goal[LEVER] - achieved[LEVER]) > 0.3:
            return Flip("flip", bool(goal[BULB] > 0.5))
        if (goal[LED] > 0.5) != (achieved[LED] > 0.5):
            return Press("press", bool(goal[LED] > 0.5))
        return None

    def aside(self, index: int) -> Skill:
        """To the spot on the deck that is farthest from where others are or are to be."""
        away = [block(self.achieved, i)[:2] for i in others(index)] + [block(self.goal, i)[:2] for i in others(index)]
        far = np.minimum(np.hypot(*(_SPOTS[:, None] - np.array(away)[None]).transpose(2, 0, 1)).min(axis=1), 0.12)
        x, y = _SPOTS[int(np.argmax(far))]
        yaw = float(np.clip(direction(block(self.achieved, index)), -1.2, 1.2))
        pose = np.array([x, y, LYING_Z, math.cos(2 * yaw), math.sin(2 * yaw)])
        return carry(self.hand, self.achieved, index, pose, f"park_{BLOCK_NAMES[index]}")

    def carry(self, index: int, lasting: bool = True) -> Skill:
        return carry(self.hand, self.achieved, index, self.to(index), lasting=lasting)

    # Whether it can ---------------------------------------------------------------------------------------

    def can_land(self, index: int, now: bool = True) -> bool:
        """Whether a block can be let go at its goal. now: as drawer and slider are, or if they made way."""
        to, under = block(self.goal, index), supporter(self.goal, index)
        if under is not None and (not self.there(under) or rider(self.achieved, under) not in (None, index)):
            return False
        if now and (self.covers(to) or (in_tray(self.goal, index) and self.achieved[DRAWER] < WIDE - 0.02)):
            return False
        return not self.occupants(index)

    def occupants(self, index: int) -> list[int]:
        """The blocks that stand where it is to come."""
        to = self.to(index)
        x, y, z = map(float, to[:3])
        length, width, _ = scene.BLOCK_HALF
        place = (x, y, direction(to), length, width)
        level = [j for j in others(index) if abs(block(self.achieved, j)[2] - z) < 0.035]
        return [j for j in level if apart(place, footprint(self.achieved, j)) < 0.0 and not self.there(j)]

    def covers(self, pose: Array) -> bool:
        """Whether the slider stands over a place in the bay."""
        return bool(self.in_bay_region(pose) and abs(pose[1] - slider_y(self.achieved)) < COVERING)

    @staticmethod
    def in_bay_region(pose: Array) -> bool:
        return bool(abs(pose[0] - scene.BAY_CENTRE[0]) < scene.BAY_HALF[0] + 0.02 and pose[2] < scene.SLIDER_ROOF)


def rests(goal: Array, index: int) -> bool:
    """Whether a block lies on something, rather than being carried."""
    pose = block(goal, index)
    low = pose[2] < LYING_Z + 0.012 + (0.015 if upright(pose) else 0.0)
    return bool(low or in_bay(goal, index) or supporter(goal, index) is not None)
