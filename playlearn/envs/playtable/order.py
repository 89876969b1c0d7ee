"""Which skill comes next to bring the table from one state to another; it has no memory, so it can begin anywhere.

A block in the gripper comes first: to its goal if it can be let go there now, else aside. Then the blocks, those
first that can go to their goals now: nothing on them, nothing in their place, what they are to lie on in its
place. Where all wait for each other, one is laid aside. Drawer and slider are moved out of the way when the next
block needs it, and to their own goals after the blocks; what the goal shows in the air comes last.

Each of these conditions is met by the skill that it asks for, and undone by no later one: so the order never loops,
though it has no memory.
"""

import math
from dataclasses import dataclass

import numpy as np

from playlearn.envs.playtable import scene
from playlearn.envs.playtable.fit import ACROSS, apart, footprint, spots, top
from playlearn.envs.playtable.grasp import Block, gripped, ways
from playlearn.envs.playtable.layout import (
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
    direction,
    distance,
    in_bay,
    in_tray,
    others,
    rider,
    slider_y,
    supporter,
    tray_y,
    upright,
)
from playlearn.envs.playtable.skills import HIGH, POSTS, Flip, Press, PushIn, Slide, Tip, Withdraw
from playlearn.envs.playtable.tasks import can_drop
from playlearn.episode import Array
from playlearn.oracles.end_effector import EndEffector
from playlearn.oracles.skills import Carry, Reach, Skill

WIDE = 0.15  # meters of drawer opening at which all that lies in it can be got at
_ALL = range(len(BLOCK_NAMES))
_SWITCHES = {BULB: scene.LEVER_XY, LED: scene.BUTTON_XY}
_SPOTS = spots()
_HOLLOW = 0.01  # meters above its place at which a block is let go in the drawer


def in_hand(hand: EndEffector, achieved: Array) -> int | None:
    return next((i for i in _ALL if gripped(hand, achieved, i) is not None), None)


def next_skill(hand: EndEffector, achieved: Array, goal: Array) -> Skill:
    """The skill that is due now, from `achieved` (G,) towards `goal` (G,)."""
    return _Order(hand, achieved.astype(float), goal.astype(float)).next()


def carry(
    hand: EndEffector, achieved: Array, index: int, pose: Array, name: str | None = None, lasting: bool = True
) -> Carry:
    """Carry block `index` to where `pose` (5,) shows it."""
    x, y, z = map(float, pose[:3])
    grasped = block_towards(achieved, index, pose)
    drop = _HOLLOW if z < scene.TABLE_Z and y > scene.EDGE_Y else 0.002
    slack = 0.008 if grasped.way(hand, achieved) == ACROSS else 0.003  # along, there are 5 mm on either side
    return Carry(name or f"carry_{BLOCK_NAMES[index]}", grasped, (x, y, z), direction(pose), lasting, drop, slack=slack)


def block_towards(achieved: Array, index: int, pose: Array) -> Block:
    """Block `index` as something to be carried over the others to where `pose` (5,) shows it."""
    x, y, z = map(float, pose[:3])
    return Block(index, (x, y, z, direction(pose)), max(top(achieved, j) for j in others(index)) + 0.035)


@dataclass(frozen=True)
class Choice:
    """What to do next.

    subject: with which block, or fixture by its index in `achieved`; -1 with none.
    skill: that does it.
    grasped: the block as it is to be taken.
    """

    subject: int
    skill: Skill
    grasped: Block | None = None


@dataclass(frozen=True, eq=False)
class _Order:
    hand: EndEffector
    achieved: Array
    goal: Array

    def next(self) -> Skill:
        choice = self.choose()
        return self.withdrawal(choice) or choice.skill

    def choose(self) -> Choice:
        aloft = [i for i in _ALL if not rests(self.goal, i)]
        wrong = [i for i in _ALL if i not in aloft and not self.there(i)]
        held = in_hand(self.hand, self.achieved)
        fixture = None if wrong else self.fixture()
        if held is not None:
            return self.with_held(held, held in aloft, bool(set(wrong) - {held}) or fixture is not None)
        if wrong:
            return self.with_blocks(wrong)
        shut = next((i for i in aloft if self.shut_in(i)), None)
        if shut is not None:
            return self.fetch(shut, landing=False) or self.aside(shut)
        if fixture is not None:
            return fixture
        if aloft:
            return self.carry(aloft[0], lasting=False)
        x, y, _ = map(float, self.hand.position)
        return Choice(-1, Reach("rest", (min(max(x, -0.1), 0.1), y, HIGH)))

    def withdrawal(self, choice: Choice) -> Skill | None:
        """Up and away first, where the fingers enclose another object than the next one, or enclose it askew."""
        hand = self.hand
        for i in _ALL:
            pose = block(self.achieved, i)
            off = hand.position - pose[:3]
            about = math.hypot(off[0], off[1]) < 0.03 and -0.03 < off[2] < 0.035
            if not about or gripped(hand, self.achieved, i) is not None:
                continue
            if i == choice.subject:
                grasped = None if upright(pose) else choice.grasped
                if grasped is None or hand.yaw_error(direction(pose) + grasped.way(hand, self.achieved)) < 0.5:
                    continue
            return Withdraw("withdraw", (float(pose[0]), float(pose[1])))
        for index, post in POSTS.items():
            x, y, z = post.at(float(self.achieved[index]))
            off = hand.position - (x, y, z)
            if index != choice.subject and math.hypot(off[0], off[1]) < 0.03 and -0.04 < off[2] < 0.03:
                return Withdraw("withdraw", (x, y))
        return None

    # Where blocks are, and where they are to be ---------------------------------------------------------

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

    def with_held(self, index: int, aloft: bool, more: bool) -> Choice:
        if (aloft and more) or (not aloft and not self.can_land(index)):
            return self.aside(index)
        x, y, z, *_ = map(float, self.to(index))
        fit = ways(self.achieved, index, (x, y, z, direction(self.to(index))))
        if fit and gripped(self.hand, self.achieved, index) not in fit and not aloft:
            return self.aside(index)  # to take it the other way round
        return self.carry(index, lasting=not aloft)

    def with_blocks(self, wrong: list[int]) -> Choice:
        """The nearest of what can be done; where all wait for each other, one block is laid aside."""
        ready = [i for i in wrong if rider(self.achieved, i) is None and self.can_land(i, now=False)]
        if ready:
            return self.nearest([self.pushed(i) or self.fetch(i, landing=True) or self.carry(i) for i in ready])
        blockers = {j for i in wrong for j in (rider(self.achieved, i), *self.occupants(i), *self.riders_below(i))}
        tops = {self.topmost(j) for j in blockers if j is not None} or set(wrong)
        return self.nearest([self.fetch(i, landing=False) or self.aside(i) for i in sorted(tops)])

    def pushed(self, index: int) -> Choice | None:
        """Over the edge into the drawer, where it lies ready for that and is to lie where it then falls."""
        to, same = block(self.goal, index), abs(self.goal[DRAWER] - self.achieved[DRAWER]) < 0.02
        near = abs(to[1] - LANDING_Y) < 0.03 and abs(to[0] - block(self.achieved, index)[0]) < 0.03
        if same and near and in_tray(self.goal, index) and can_drop(self.achieved, index):
            return Choice(index, PushIn(f"push_in_{BLOCK_NAMES[index]}", index))
        return None

    def fetch(self, index: int, landing: bool) -> Choice | None:
        """What has to be done before a block can be taken, and (landing) put where it belongs."""
        here, to = block(self.achieved, index), block(self.goal, index)
        stowed, stow = in_tray(self.achieved, index), landing and in_tray(self.goal, index)
        if stowed or stow:
            opening = Slide("drawer", POSTS[DRAWER], POSTS[DRAWER].travel - 0.002)
            drawn_in = (stowed and self.under_deck(index, here)) or (stow and self.under_deck(index, self.to(index)))
            if drawn_in or opening.underway(self.hand, self.achieved):
                return Choice(DRAWER, opening)
        uncovering = self.uncovering(here)
        if uncovering is None and landing:
            uncovering = self.uncovering(to)
            if uncovering is not None and self.covers(here, at=uncovering.value):
                uncovering = None  # taken first, then laid aside: it cannot be free at both ends
        if uncovering is not None:
            return Choice(SLIDER, uncovering)
        return Choice(index, Tip(f"tip_{BLOCK_NAMES[index]}", index)) if upright(here) else None

    def fixture(self) -> Choice | None:
        """The nearest of those that are not as they should be."""
        achieved, goal = self.achieved, self.goal
        left: list[Choice] = []
        for index, name in ((SLIDER, "slider"), (DRAWER, "drawer")):
            slide = Slide(name, POSTS[index], float(goal[index]))
            if abs(goal[index] - achieved[index]) > 0.02 or slide.underway(self.hand, achieved):
                left.append(Choice(index, slide))
        if (goal[BULB] > 0.5) != (achieved[BULB] > 0.5):
            left.append(Choice(BULB, Flip("flip", bool(goal[BULB] > 0.5))))
        if (goal[LED] > 0.5) != (achieved[LED] > 0.5):
            left.append(Choice(LED, Press("press", bool(goal[LED] > 0.5))))
        return min(left, key=lambda one: distance(self.hand.position, self.place(one.subject))) if left else None

    def aside(self, index: int) -> Choice:
        """To a spot on the deck that is far from where others are or are to be."""
        taken = np.array([block(where, i)[:2] for where in (self.achieved, self.goal) for i in others(index)])
        far = np.minimum(np.hypot(*(_SPOTS[:, None] - taken[None]).transpose(2, 0, 1)).min(axis=1), 0.12)
        yaw = float(np.clip(direction(block(self.achieved, index)), -1.2, 1.2))
        best = [(float(x), float(y)) for x, y in _SPOTS[np.argsort(-far, kind="stable")[:6]]]
        either = (spot for spot in best if len(ways(self.achieved, index, (*spot, LYING_Z, yaw))) == 2)
        x, y = next(either, best[0])  # from where it can be taken either way
        pose = np.array([x, y, LYING_Z, math.cos(2 * yaw), math.sin(2 * yaw)])
        return self.carry(index, pose, f"park_{BLOCK_NAMES[index]}")

    def carry(self, index: int, pose: Array | None = None, name: str | None = None, lasting: bool = True) -> Choice:
        pose = self.to(index) if pose is None else pose
        here = block(self.achieved, index)
        if gripped(self.hand, self.achieved, index) is not None:
            away, above = distance(here, pose), here[2] - pose[2]
            if math.hypot(here[3], here[4]) < 0.85 and away < 0.02 and above < 0.035 and lasting:
                return Choice(index, Withdraw("drop", (float(here[0]), float(here[1]))))  # askew it comes no lower
            if away > 0.03 and here[1] > scene.EDGE_Y - 0.02 and here[2] < scene.TABLE_Z + 0.025:
                pose = np.array([*here[:2], scene.TABLE_Z + 0.12, *here[3:]])  # out of the drawer straight up
        skill = carry(self.hand, self.achieved, index, pose, name, lasting)
        return Choice(index, skill, block_towards(self.achieved, index, pose))

    def nearest(self, choices: list[Choice]) -> Choice:
        """Blocks that can be taken now before fixtures in the way of others, which might cover them again.

        Of these the nearest: on the way there it stays the nearest, so the choice does not change.
        """
        away = [distance(self.hand.position, self.place(choice.subject)) for choice in choices]
        return choices[min(range(len(choices)), key=lambda k: (choices[k].subject in POSTS, away[k]))]

    def place(self, subject: int) -> Array | tuple[float, float]:
        if subject in POSTS:
            return POSTS[subject].at(float(self.achieved[subject]))
        return _SWITCHES[subject] if subject in _SWITCHES else block(self.achieved, subject)

    # Whether it can ---------------------------------------------------------------------------------------

    def can_land(self, index: int, now: bool = True) -> bool:
        """Whether a block can be let go at its goal. now: as drawer and slider are, or if they made way."""
        to, under = block(self.goal, index), supporter(self.goal, index)
        if under is not None and (not self.there(under) or rider(self.achieved, under) not in (None, index)):
            return False
        if now and (self.covers(to) or (in_tray(self.goal, index) and self.under_deck(index, self.to(index)))):
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

    def under_deck(self, index: int, pose: Array) -> bool:
        """Whether the drawer would have to be opened further for a block to be gripped at `pose` (5,)."""
        if self.achieved[DRAWER] > WIDE:
            return False
        x, y, z, yaw = (*map(float, pose[:3]), direction(pose))
        deep = scene.BLOCK_HALF[0] * abs(math.sin(yaw)) + scene.BLOCK_HALF[1] * abs(
            math.cos(yaw)
        )  # half of it, along y
        front = tray_y(self.achieved) + scene.TRAY_HALF[1]
        room = y - deep > scene.EDGE_Y - 0.005 and y + deep < front
        return not room or not ways(self.achieved, index, (x, y, z, yaw))

    def topmost(self, index: int) -> int:
        above = rider(self.achieved, index)
        return index if above is None else self.topmost(above)

    def riders_below(self, index: int) -> list[int]:
        """What lies on the block that this one is to lie on."""
        under = supporter(self.goal, index)
        above = None if under is None else rider(self.achieved, under)
        return [] if above is None or above == index else [above]

    def shut_in(self, index: int) -> bool:
        """Whether a block lies where drawer and slider, as the goal shows them, would not let it out."""
        drawn = in_tray(self.achieved, index) and self.goal[DRAWER] < WIDE
        return bool(drawn or self.covers(block(self.achieved, index), at=float(self.goal[SLIDER])))

    def uncovering(self, pose: Array) -> Slide | None:
        """The slider moved away from over a place, to the end that is farther from it, if it has to be."""
        away = 0.002 if pose[1] > scene.BAY_CENTER[1] else POSTS[SLIDER].travel - 0.002
        slide = Slide("slider", POSTS[SLIDER], away, near=0.01)
        going = slide.underway(self.hand, self.achieved) and self.covers(pose, margin=COVERING + 0.03)
        return slide if going or self.covers(pose) else None

    def covers(self, pose: Array, at: float | None = None, margin: float = COVERING) -> bool:
        """Whether the slider, where it is or `at` m, stands over a place in the bay."""
        x, y, z = map(float, pose[:3])
        slider = slider_y(self.achieved) if at is None else scene.SLIDER_Y + at
        inside = abs(x - scene.BAY_CENTER[0]) < scene.BAY_HALF[0] + 0.03 and z < scene.SLIDER_ROOF + 0.02
        return inside and abs(y - slider) < margin


def rests(goal: Array, index: int) -> bool:
    """Whether a block lies on something, rather than being carried."""
    pose = block(goal, index)
    low = pose[2] < LYING_Z + 0.012 + (0.015 if upright(pose) else 0.0)
    return bool(low or in_bay(goal, index) or supporter(goal, index) is not None)
