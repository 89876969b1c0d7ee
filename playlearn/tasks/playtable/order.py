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
from playlearn.tasks.playtable.fit import ACROSS, apart, footprint, spots, top
from playlearn.tasks.playtable.layout import (
    BLOCK_NAMES,
    BULB,
    COVERING,
    DRAWER,
    LANDING_Y,
    LED,
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
from playlearn.tasks.playtable.named import can_drop
from playlearn.tasks.playtable.skills import (
    HIGH,
    POSTS,
    Block,
    Flip,
    Press,
    PushIn,
    Slide,
    Tip,
    Withdraw,
    gripped,
    ways,
)
from playlearn.teleop.hand import Hand
from playlearn.teleop.skills import Carry, Reach, Skill

WIDE = 0.15  # metres of drawer opening at which all that lies in it can be got at
_ALL = range(len(BLOCK_NAMES))
_SWITCHES = {BULB: scene.LEVER_XY, LED: scene.BUTTON_XY}
Choice = tuple[int, Skill]  # the block (or, by its index in `achieved`, the fixture) and what to do with it
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
    thing = thing_towards(achieved, index, pose)
    drop = _HOLLOW if z < scene.TABLE_Z and y > scene.EDGE_Y else 0.002
    slack = 0.008 if thing.way(hand, achieved) == ACROSS else 0.003  # along, there are 5 mm on either side
    return Carry(name or f"carry_{BLOCK_NAMES[index]}", thing, (x, y, z), direction(pose), lasting, drop, slack=slack)


def thing_towards(achieved: Array, index: int, pose: Array) -> Block:
    """Block `index` as something to be carried over the others to where `pose` (5,) shows it."""
    x, y, z = map(float, pose[:3])
    return Block(index, (x, y, z, direction(pose)), max(top(achieved, j) for j in others(index)) + 0.035)


@dataclass(frozen=True, eq=False)
class _Order:
    hand: Hand
    achieved: Array
    goal: Array

    def next(self) -> Skill:
        subject, skill = self.choose()
        return self.withdrawal(subject) or skill

    def choose(self) -> Choice:
        wrong = [i for i in _ALL if not self.there(i)]
        resting = [i for i in wrong if rests(self.goal, i)]
        aloft = [i for i in _ALL if not rests(self.goal, i)]
        held = in_hand(self.hand, self.achieved)
        fixture = None if resting else self.fixture()
        if held is not None:
            return held, self.with_held(held, held in aloft, bool(set(resting) - {held}) or fixture is not None)
        if resting:
            return self.with_blocks(resting)
        if fixture is not None:
            return fixture
        if aloft:
            return aloft[0], self.carry(aloft[0], lasting=False)
        x, y, _ = map(float, self.hand.position)
        return -1, Reach("rest", (min(max(x, -0.1), 0.1), y, HIGH))

    def withdrawal(self, subject: int) -> Skill | None:
        """Up and away first, where the fingers are about something else than what comes next, or about it askew."""
        hand = self.hand
        for i in _ALL:
            off = hand.position - block(self.achieved, i)[:3]
            about = math.hypot(off[0], off[1]) < 0.03 and -0.03 < off[2] < 0.035
            if about and gripped(hand, self.achieved, i) is None:
                x, y = map(float, block(self.achieved, i)[:2])
                way = thing_towards(self.achieved, i, self.to(i)).way(hand, self.achieved)
                askew = hand.yaw_error(direction(block(self.achieved, i)) + way) > 0.5
                if i != subject or (askew and not upright(block(self.achieved, i))):
                    return Withdraw("withdraw", (x, y))
        for index, post in POSTS.items():
            x, y, z = post.at(float(self.achieved[index]))
            off = hand.position - (x, y, z)
            if index != subject and math.hypot(off[0], off[1]) < 0.03 and -0.04 < off[2] < 0.03:
                return Withdraw("withdraw", (x, y))
        return None

    # Where things are, and where they are to be ---------------------------------------------------------

    def to(self, index: int) -> Array:
        """(5,) the pose that a block is to have now: in the drawer it moves with it, and fingers must come out."""
        pose = block(self.goal, index).copy()
        if in_tray(self.goal, index):
            pose[1] += self.achieved[DRAWER] - self.goal[DRAWER]
            x, y, z, yaw = (*map(float, pose[:3]), direction(pose))
            out = (y, y + 0.01, y + 0.02, y + 0.03)
            pose[1] = next((y for y in out if ways(self.achieved, index, (x, y, z, yaw))), y)
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
        x, y, z = map(float, to[:3])
        fit = ways(self.achieved, index, (x, y, z, direction(to)))
        if fit and way not in fit and not aloft:
            return self.aside(index)  # to take it the other way round
        return self.carry(index, lasting=not aloft)

    def with_blocks(self, wrong: list[int]) -> Choice:
        """The nearest thing to do of those that can be done; where all wait for each other, something aside."""
        ready = [i for i in wrong if rider(self.achieved, i) is None and self.can_land(i, now=False)]
        if ready:
            return self.nearest([self.pushed(i) or self.fetch(i, landing=True) or (i, self.carry(i)) for i in ready])
        blockers = {j for i in wrong for j in (rider(self.achieved, i), *self.occupants(i), *self.riders_below(i))}
        tops = {self.topmost(j) for j in blockers if j is not None} or set(wrong)
        return self.nearest([self.fetch(i, landing=False) or (i, self.aside(i)) for i in sorted(tops)])

    def nearest(self, choices: list[Choice]) -> Choice:
        """On the way to what is nearest it stays nearest: so it is not thought better of."""
        return min(choices, key=lambda choice: self.away(self.place(choice[0])))

    def place(self, subject: int) -> Array | tuple[float, float]:
        if subject in POSTS:
            return POSTS[subject].at(float(self.achieved[subject]))
        return _SWITCHES[subject] if subject in _SWITCHES else block(self.achieved, subject)

    def away(self, place: Array | tuple[float, float]) -> float:
        return distance(self.hand.position, place)

    def topmost(self, index: int) -> int:
        above = rider(self.achieved, index)
        return index if above is None else self.topmost(above)

    def riders_below(self, index: int) -> list[int]:
        """What lies on the block that this one is to lie on."""
        under = supporter(self.goal, index)
        above = None if under is None else rider(self.achieved, under)
        return [] if above in (None, index) else [above]

    def pushed(self, index: int) -> Choice | None:
        """Over the edge into the drawer, where it lies ready for that and is to lie where it then falls."""
        to, same = block(self.goal, index), abs(self.goal[DRAWER] - self.achieved[DRAWER]) < 0.02
        near = abs(to[1] - LANDING_Y) < 0.03 and abs(to[0] - block(self.achieved, index)[0]) < 0.03
        if same and near and in_tray(self.goal, index) and can_drop(self.achieved, index):
            return index, PushIn(f"push_in_{BLOCK_NAMES[index]}", index)
        return None

    def fetch(self, index: int, landing: bool) -> Choice | None:
        """What has to be done before a block can be taken, and (landing) put where it belongs."""
        achieved, to = self.achieved, block(self.goal, index)
        if in_tray(achieved, index) or (landing and in_tray(self.goal, index)):
            opening = Slide("drawer", POSTS[DRAWER], POSTS[DRAWER].travel - 0.002)
            if achieved[DRAWER] < WIDE or opening.underway(self.hand, achieved):
                return DRAWER, opening
        for pose, near in ((block(achieved, index), covered(achieved, index)), (to, landing and self.covers(to))):
            away = 0.002 if pose[1] > scene.BAY_CENTRE[1] else POSTS[SLIDER].travel - 0.002
            uncovering = Slide("slider", POSTS[SLIDER], away)
            if near or (self.in_bay_region(pose) and uncovering.underway(self.hand, achieved)):
                return SLIDER, uncovering
        return (index, Tip(f"tip_{BLOCK_NAMES[index]}", index)) if upright(block(achieved, index)) else None

    def fixture(self) -> Choice | None:
        """The nearest of those that are not as they should be."""
        achieved, goal = self.achieved, self.goal
        left: list[Choice] = []
        for index, name in ((SLIDER, "slider"), (DRAWER, "drawer")):
            slide = Slide(name, POSTS[index], float(goal[index]))
            if abs(goal[index] - achieved[index]) > 0.02 or slide.underway(self.hand, achieved):
                left.append((index, slide))
        if (goal[BULB] > 0.5) != (achieved[BULB] > 0.5):
            left.append((BULB, Flip("flip", bool(goal[BULB] > 0.5))))
        if (goal[LED] > 0.5) != (achieved[LED] > 0.5):
            left.append((LED, Press("press", bool(goal[LED] > 0.5))))
        return self.nearest(left) if left else None

    def aside(self, index: int) -> Skill:
        """To the spot on the deck that is farthest from where others are or are to be."""
        away = [block(self.achieved, i)[:2] for i in others(index)] + [block(self.goal, i)[:2] for i in others(index)]
        far = np.minimum(np.hypot(*(_SPOTS[:, None] - np.array(away)[None]).transpose(2, 0, 1)).min(axis=1), 0.12)
        yaw = float(np.clip(direction(block(self.achieved, index)), -1.2, 1.2))
        best = [tuple(_SPOTS[k]) for k in np.argsort(-far, kind="stable")[:6]]  # where it can be taken either way
        x, y = next((spot for spot in best if len(ways(self.achieved, index, (*spot, LYING_Z, yaw))) == 2), best[0])
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
