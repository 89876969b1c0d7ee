"""robosuite's Wipe: a line of dirt on a table, and a tool without fingers that takes it up.

Dirt never comes back, so a goal is what is left of it. `achieved` (60,), of each of the 20 pieces that the line
falls into, 2 cm long:

    dirt0.x dirt0.y dirt0.left     meters, its middle; the fraction of its five marks that is left, 1 .. 0
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np

from playlearn.envs.tabletop import TabletopConfig, TabletopEnv, View, numpy_seeded_from
from playlearn.episode import Array
from playlearn.oracles import register_skill_library
from playlearn.oracles.end_effector import OPEN, REST_YAW, EndEffector, Style
from playlearn.oracles.skill_library import SkillOption
from playlearn.oracles.skills import Skill, Waypoint
from playlearn.sim.environment import EnvironmentConfig, Task

MARKS, PIECES = 100, 20  # robosuite's marks, and the pieces that `achieved` tells
EACH = MARKS // PIECES
NAMES = tuple(f"dirt{i}.{part}" for i in range(PIECES) for part in ("x", "y", "left"))
TABLE_Z = 0.9
TOLERANCE = 0.25  # fraction of a piece: one mark of five
_HALF, _DEEP = (0.06, 0.025), 0.02  # meters: robosuite's reach of the tool about its middle, and above its face
_PRESSED, _HIGH, _AWAY = -0.012, 0.10, 0.25  # meters above the table at which the tool wipes, travels, and rests


@EnvironmentConfig.register_subclass("wipe")
@dataclass(frozen=True)
class WipeConfig(TabletopConfig):
    """robosuite's Wipe.

    wiped: fraction of random starts in which a part of the line is already wiped.
    """

    wiped: float = 0.5

    def build(self) -> "WipeEnv":
        return WipeEnv(self)


class WipeEnv(TabletopEnv):
    """See the module's docstring; `extra` is x y of each mark, then whether it is left."""

    config: WipeConfig

    def __init__(self, config: WipeConfig) -> None:
        view = View(eye=(0.85, 0.0, 1.65), at=(0.10, 0.0, 0.90), fovy=38)

        def paint(model: mujoco.MjModel, kept: Array) -> None:
            for i, (x, y) in enumerate(kept[: 2 * MARKS].reshape(-1, 2)):
                model.body(f"contact{i}_main").pos[:2] = np.array([x, y]) - self._table
                model.geom(f"contact{i}_g0_vis").rgba[3] = kept[2 * MARKS + i]

        super().__init__(config, "Wipe", NAMES, view, extra=3 * MARKS, paint=paint)
        self._table = self.model.body("table").pos[:2].copy()
        self.tasks = wipe_tasks()

    @property
    def marks(self) -> Array:
        """(MARKS, 2) m, where the marks are."""
        return self.extra[: 2 * MARKS].reshape(-1, 2)

    @property
    def left(self) -> Array:
        """(MARKS,) 1 where a mark is left, else 0."""
        return self.extra[2 * MARKS :]

    def _achieved(self) -> Array:
        middle = self.marks.reshape(PIECES, EACH, 2).mean(axis=1)
        left = self.left.reshape(PIECES, EACH).mean(axis=1)
        return np.column_stack([middle, left]).ravel().astype(np.float32)

    def failure(self) -> str | None:
        lifted = self.data.site_xpos[self._site, 2] > TABLE_Z + _AWAY - 0.05
        return "there is nothing left to wipe" if lifted and not self.left.any() else None

    def reached(self, achieved: Array, goal: Array) -> bool:
        return bool((np.abs(left(achieved) - left(goal)) < TOLERANCE).all())

    def _arrange(self, rng: np.random.Generator) -> None:
        arena = self.robosuite.model.mujoco_arena
        with numpy_seeded_from(rng):
            place = arena.sample_start_pos()
            for i in range(MARKS):
                self.marks[i] = place + self._table
                place = arena.sample_path_pos(place)
        self.left[:] = 1.0
        if rng.random() < self.config.wiped:
            first, last = sorted(rng.integers(0, PIECES + 1, 2))
            if last - first < PIECES - 4:
                self.left[EACH * first : EACH * last] = 0.0

    def _after_step(self) -> None:
        """robosuite's rule: what lies under the tool's face, or up to 2 cm above it, is taken up in contact."""
        if self.data.ncon == 0:
            return
        away = np.column_stack([self.marks, np.full(MARKS, TABLE_Z)]) - self.data.site_xpos[self._site]
        along, aside, below = (away @ self.data.site_xmat[self._site].reshape(3, 3)).T
        under = (np.abs(along) < _HALF[0]) & (np.abs(aside) < _HALF[1]) & (below < 0) & (below > -_DEEP)
        self.left[under] = 0.0


def left(achieved: Array) -> Array:
    """(PIECES,) what is left of each piece: a view."""
    return achieved[2::3]


def middles(achieved: Array) -> Array:
    """(PIECES, 2) m."""
    return achieved.reshape(-1, 3)[:, :2].astype(float)


def wipe_tasks() -> Mapping[str, Task]:
    """Name -> task."""

    def dirty(achieved: Array) -> bool:
        return bool(left(achieved).any())

    def without(achieved: Array, gone: Any) -> Array:
        goal = achieved.copy()
        left(goal)[gone] = 0.0
        return goal

    def one(achieved: Array, rng: np.random.Generator) -> Array:
        return without(achieved, int(rng.choice(np.flatnonzero(left(achieved)))))

    def some(achieved: Array, rng: np.random.Generator) -> Array:
        """From one end of what is left, a third to two thirds of it."""
        there = np.flatnonzero(left(achieved))
        count = int(np.ceil(len(there) * rng.uniform(0.33, 0.67)))
        return without(achieved, there[:count] if rng.random() < 0.5 else there[-count:])

    def everything(achieved: Array, rng: np.random.Generator) -> Array:
        return without(achieved, slice(None))

    def gone(start: Array, achieved: Array, goal: Array) -> bool:
        asked = left(goal) < left(start) - 0.1
        return bool((left(achieved) <= left(goal) + 0.1)[asked].all())

    def clean(start: Array, achieved: Array, goal: Array) -> bool:
        return not left(achieved).any()

    def as_it_comes(env: WipeEnv, rng: np.random.Generator) -> None:
        """Most random starts suit."""

    tasks = (
        Task("wipe_one", "wipe_one", dirty, as_it_comes, one, gone),
        Task("wipe_some", "wipe_some", dirty, as_it_comes, some, gone),
        Task("wipe_all", "wipe_all", dirty, as_it_comes, everything, clean),
    )
    return MappingProxyType({task.name: task for task in tasks})


@dataclass(frozen=True)
class Rub:
    """Wipe the nearest of the pieces (their numbers) that are not gone, one after the other."""

    name: str
    pieces: tuple[int, ...]
    lasting: bool = True

    def act(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        return self._move(hand, achieved, style)[:6]  # a tool has no fingers to command

    def done(self, hand: EndEffector, achieved: Array) -> bool:
        return not self._open(achieved) and bool(hand.position[2] > TABLE_Z + 0.06)

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        return ()

    def _open(self, achieved: Array) -> list[int]:
        return [i for i in self.pieces if left(achieved)[i] > 0]

    def _move(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        open_to = middles(achieved)[self._open(achieved)]
        if not len(open_to):
            high = np.array([*hand.position[:2], TABLE_Z + _AWAY])
            return hand.move(high, REST_YAW, OPEN, style.speed)
        off = np.hypot(*(open_to - hand.position[:2]).T)
        nearest = open_to[int(np.argmin(off))]
        away = float(off.min())
        level = _PRESSED if away < 0.05 else min(_HIGH, 0.03 + away)  # only what is asked for is wiped on the way
        return hand.move(np.array([*nearest, TABLE_Z + level]), REST_YAW, OPEN, style.speed)


class WipeSkillLibrary:
    """The `SkillLibrary` of wiping."""

    idle = None  # an idle tool stays where it is

    def __init__(self) -> None:
        self._tasks = wipe_tasks()

    def options(self) -> Sequence[SkillOption]:
        weights = {"wipe_all": 0.1}

        def option(task: Task) -> SkillOption:
            def skill(hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
                return _towards(achieved, task.command(achieved, rng), task.name)

            return SkillOption(task.name, task.kind, task.precondition, skill, weights.get(task.kind, 1.0))

        return [option(task) for task in self._tasks.values()]

    def holding(self, hand: EndEffector, achieved: Array) -> bool:
        return False

    def put_down(self, hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
        return self.towards(hand, achieved, achieved)

    def towards(self, hand: EndEffector, achieved: Array, goal: Array) -> Skill:
        return _towards(achieved, goal, "rub")


def _towards(achieved: Array, goal: Array, name: str) -> Rub:
    return Rub(name, tuple(np.flatnonzero(left(goal) < left(achieved) - 0.1).tolist()))


register_skill_library("wipe", lambda _: WipeSkillLibrary())
