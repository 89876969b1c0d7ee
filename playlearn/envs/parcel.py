"""A parcel: one object that stands in a bin, or lies there after a fall, and how a gripper handles it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from playlearn.episode import Array
from playlearn.oracles.end_effector import EndEffector
from playlearn.oracles.skill_library import SkillOption
from playlearn.oracles.skills import NEAR, Carry, Reach, Skill, TiltedSkill, turn, up
from playlearn.sim.environment import Task

FLOOR, RIM = 0.82, 0.90  # meters: the bins' floor, and the top of their walls
SHOULDER, STRETCHED = (-0.5, -0.1), 0.71  # meters: where robosuite stands a robot at its bins; see `TiltedSkill`
_DEEP = 0.022  # meters below its top at which a parcel is gripped: deeper, and the palm would rest on it
PALM = 0.045  # meters below the walls' rim from which on a palm would rest on them before its fingers grip
_WIDEST = 0.066  # meters that a gripper can span
_TURNED = 1.0  # rad from across the arm's way that a wrist can surely turn what stands
_ROOM = 0.010
_WALLS_X, _WALLS_Y = (-0.1, 0.1, 0.3), (-0.5, 0.0, 0.03, 0.28, 0.53)  # meters: the middle lines of the walls
_FINGER, _CLEAR = 0.052, 0.025  # meters from the grip to an open finger, and from there to the middle of a wall
_WEIGHTS = {"lift": 0.6, "stow": 1.4, "take_out": 3.0}  # how often play tries each kind, where it can


@dataclass(frozen=True)
class Parcel:
    """A `GraspableObject`.

    half: meters, half of its thin and of its other side.
    below, above: meters from its center to its ends.
    thin: which of the body's axes (0 or 1) the thin side lies along; None of a can, which has no such side.
    spins: whether its yaw does not matter now, as that of a standing can.
    """

    name: str
    half: tuple[float, float]
    below: float
    above: float
    thin: int | None = None
    spins: bool = False

    @property
    def round(self) -> bool:
        return self.thin is None

    @property
    def names(self) -> tuple[str, ...]:
        parts = ("x", "y", "z", "up", "long.c", "long.s", *(() if self.round else ("thin.c", "thin.s")))
        return tuple(f"{self.name}.{part}" for part in parts)

    def achieved_of(self, position: Array, rotation: Array) -> Array:
        """(G,) the achieved goal of a body at (3,) m with rotation (3, 3)."""
        axes = rotation[0] + 1j * rotation[1]  # (3,) each body axis, in the plane; the last is the long one
        codes = [axes[2] ** 2] if self.thin is None else [axes[2] ** 2, axes[self.thin] ** 2]
        parts = [part for code in codes for part in (code.real, code.imag)]
        return np.array([*position, abs(rotation[2, 2]), *parts], np.float32)

    def standing(self, achieved: Array) -> bool:
        return bool(achieved[3] > 0.7)

    def rest(self, achieved: Array) -> float:
        """Height in meters of its center above what it stands or lies on."""
        if self.standing(achieved):
            return self.below
        return self.half[1] if self.round or np.hypot(*achieved[6:8]) > 0.5 else self.half[0]

    def lost(self, achieved: Array) -> str | None:
        """Why it can no longer be moved anywhere, or None."""
        x, y, z = achieved[:3]
        if z < FLOOR - 0.03 or not (-0.13 < x < 0.33 and -0.53 < y < 0.56):
            return f"the {self.name} fell out of the bins"
        if not self.standing(achieved) and z < RIM - 0.02 and 2 * self._width(achieved) > _WIDEST:
            return f"the {self.name} fell flat, too wide for a gripper to take it up"
        return None

    def sunk(self, achieved: Array) -> bool:
        """Whether it lies too low in a compartment for the gripper, which is wider than the compartment."""
        low = self.rest(achieved) + FLOOR < RIM - PALM and achieved[2] < RIM - PALM
        return bool(low and achieved[1] > _WALLS_Y[2])

    def _width(self, achieved: Array) -> float:
        """Half of what is between the fingers, m."""
        if self.round or self.standing(achieved):
            return self.half[0]  # or half[1], where the two are much alike
        return self.half[0] if np.hypot(*achieved[6:8]) > 0.5 else self.half[1]

    # GraspableObject ------------------------------------------------------------------------------------------

    @property
    def symmetry(self) -> float:
        return 0.0 if self.spins else np.pi

    def position(self, achieved: Array) -> Array:
        return achieved[:3].astype(float)

    def yaw(self, achieved: Array) -> float:
        c, s = achieved[4:6] if self.round or not self.standing(achieved) else achieved[6:8]
        return float(np.arctan2(s, c)) / 2

    def grasp(self, hand: EndEffector, achieved: Array) -> tuple[Array, float]:
        """Near its top if it stands, in its middle if it lies."""
        place = self.position(achieved)
        standing = self.standing(achieved)
        tall = self.above if standing else self.rest(achieved)
        place = place + up(max(0.0, tall - _DEEP))
        if not standing:
            return place, self.yaw(achieved) + np.pi / 2
        if self.round:
            ways = np.linspace(0, np.pi, 12, endpoint=False)
        else:
            ways = self.yaw(achieved) + np.array([0.0, np.pi / 2] if 2 * self.half[1] < _WIDEST else [0.0])
        return place, float(min(ways, key=lambda yaw: _cost(hand, place, yaw)))

    def held(self, hand: EndEffector, achieved: Array) -> bool:
        off = hand.position - self.grasp(hand, achieved)[0]
        width = 2 * self._width(achieved)
        between = width - 0.012 < hand.opening < width + 0.012
        return bool(between and np.hypot(*off[:2]) < 0.025 and abs(off[2]) < 0.03)

    def clearance(self, place: Array, height: float) -> float:
        """Over the walls."""
        return max(height, RIM - FLOOR + 0.04)

    def there(self, achieved: Array, goal: Array) -> bool:
        off = self.position(achieved) - self.target(achieved, goal)
        return bool(np.hypot(*off[:2]) < NEAR and abs(off[2]) < 0.015)

    def target(self, achieved: Array, goal: Array) -> Array:
        """(3,) where its center comes to be at the goal's place, standing or lying as it does now."""
        place = goal[:3].astype(float)
        if self.standing(achieved) != self.standing(goal):
            place[2] += self.rest(achieved) - self.rest(goal)
        return place

    def aloft(self, goal: Array) -> bool:
        """Whether it hangs in the air."""
        return bool(goal[2] > FLOOR + self.rest(goal) + 0.02)


def _cost(hand: EndEffector, place: Array, yaw: float) -> float:
    """Cost of gripping at `yaw`: fingers must fit between walls, best across the arm, along which the gripper leans."""
    x, y = place[:2] - SHOULDER
    reach = _FINGER * np.array([np.cos(yaw), np.sin(yaw)])
    free = min(_free(place[:2] + reach), _free(place[:2] - reach))
    return abs(turn(float(np.arctan2(y, x) + np.pi / 2), yaw, np.pi)) + 0.3 * hand.yaw_error(yaw) - 200.0 * min(0, free)


def _free(place: Array) -> float:
    """Meters by which a finger at (2,) m is clear of the nearest wall."""
    x, y = place
    walls_x, walls_y = (_WALLS_X, _WALLS_Y) if y > 0.02 else (_WALLS_X[::2], _WALLS_Y[:2])
    return float(min(*(abs(x - wall) for wall in walls_x), *(abs(y - wall) for wall in walls_y)) - _CLEAR)


class ParcelSkillLibrary:
    """The `SkillLibrary` of one parcel."""

    idle = ((0.0, -0.35, FLOOR + 0.16), (0.2, 0.2, FLOOR + 0.28))

    def __init__(self, parcel: Parcel, tasks: Mapping[str, Task]) -> None:
        self._parcel, self._tasks = parcel, tasks

    def options(self) -> Sequence[SkillOption]:
        return [self._option(task) for task in self._tasks.values()]

    def holding(self, hand: EndEffector, achieved: Array) -> bool:
        return self._parcel.held(hand, achieved)

    def put_down(self, hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
        lasting = [task for task in self._tasks.values() if task.kind in ("place", "stow", "misplace")]
        task = lasting[int(rng.integers(len(lasting)))]
        return self._carry(achieved, task.command(achieved, rng), task.name)

    def towards(self, hand: EndEffector, achieved: Array, goal: Array) -> Skill:
        parcel = self._parcel
        if not parcel.there(achieved, goal) or parcel.aloft(goal) or parcel.held(hand, achieved):
            return self._carry(achieved, goal, f"carry_{parcel.name}")
        x, y, _ = hand.position
        return Reach("rest", (float(x), float(y), FLOOR + 0.22))

    def _carry(self, achieved: Array, goal: Array, name: str) -> Skill:
        parcel = self._parcel
        x, y, z = map(float, parcel.target(achieved, goal))
        yaw = parcel.yaw(achieved)
        if parcel.standing(achieved) and not parcel.round:
            natural = float(np.arctan2(y - SHOULDER[1], x - SHOULDER[0]) + np.pi / 2)
            yaw = natural + float(np.clip(turn(natural, yaw, np.pi), -_TURNED, _TURNED))
        elif not parcel.standing(goal):
            yaw = parcel.yaw(goal)
        width = 2 * parcel._width(achieved)
        grasped = replace(parcel, spins=parcel.round and parcel.standing(achieved))
        carry = Carry(name, grasped, (x, y, z), yaw, not parcel.aloft(goal), room=width + _ROOM)
        return TiltedSkill(carry, SHOULDER, STRETCHED)

    def _option(self, task: Task) -> SkillOption:
        def skill(hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
            return self._carry(achieved, task.command(achieved, rng), task.name)

        return SkillOption(task.name, task.kind, task.precondition, skill, _WEIGHTS.get(task.kind, 1.0))
