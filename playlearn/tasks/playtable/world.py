"""PlayTable behind the Environment contract: three blocks, a drawer, a button that toggles a lamp.

`achieved` (17,), metres unless noted:

    0..4    red.x red.y red.z red.c red.s      position of the block's centre; direction of its long
    5..9    blue.*                             axis a as (c, s) = (ax^2 - ay^2, 2 ax ay), which is the
    10..14  pink.*                             same for a and -a, as the block looks the same, and
                                               (cos 2 yaw, sin 2 yaw) while it lies flat
    15      drawer.opening                     0 closed .. 0.16 open
    16      lamp.on                            0 or 1
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
from robosuite.robots import ROBOT_CLASS_MAPPING, FixedBaseRobot

from playlearn.episode import Array
from playlearn.errors import UsageError
from playlearn.sim.environment import CameraConfig, EnvironmentConfig, Task
from playlearn.sim.robosuite_world import RobosuiteWorld
from playlearn.tasks.playtable import scene
from playlearn.tasks.playtable.named import (
    BLOCK_NAMES,
    DRAWER,
    LAMP,
    block,
    direction,
    free_spot,
    playtable_tasks,
)

ACHIEVED_NAMES = (
    *(f"{name}.{part}" for name in BLOCK_NAMES for part in ("x", "y", "z", "c", "s")),
    "drawer.opening",
    "lamp.on",
)
POSITION_TOLERANCE = 0.04  # metres, in the plane
HEIGHT_TOLERANCE = 0.02
DIRECTION_TOLERANCE = 2 * np.sin(np.deg2rad(20.0))  # the chord of 2 * yaw that is 20 degrees of yaw
DRAWER_TOLERANCE = 0.03
_PRESSED, _RELEASED = 0.007, 0.004  # metres of button travel at which the lamp toggles and re-arms
_UNFIT = ("Baxter", "PandaDexLH", "PandaDexRH")  # two arms; hands that do not take one command
_LIT, _UNLIT = (1.0, 0.9, 0.25, 1.0), (0.25, 0.25, 0.22, 1.0)


@EnvironmentConfig.register_subclass("playtable")
@dataclass(frozen=True)
class PlayTableConfig(EnvironmentConfig):
    """robot: any single-arm robosuite robot. cameras: name -> size of the images.

    faces: visual meshes are simplified to about so many triangles in all.
    stacked, stowed: share of random starts with one block on another, or in the drawer.
    """

    robot: str = "Panda"
    cameras: dict[str, CameraConfig] = field(
        default_factory=lambda: {"front": CameraConfig(64, 96), "wrist": CameraConfig(64, 64)}
    )
    faces: int = 12_000
    stacked: float = 0.2
    stowed: float = 0.15

    def build(self) -> "PlayTableWorld":
        return PlayTableWorld(self)


class PlayTableWorld(RobosuiteWorld):
    """See the module's docstring; `extra` is [lamp, armed]."""

    def __init__(self, config: PlayTableConfig) -> None:
        self.config = config

        def build() -> scene.PlayTable:
            fixed = {name for name, kind in ROBOT_CLASS_MAPPING.items() if kind is FixedBaseRobot}
            single = sorted(fixed - set(_UNFIT))
            if config.robot not in single:
                raise UsageError(f"robot: {config.robot!r} is not a robot with one arm; those are {', '.join(single)}")
            return scene.PlayTable(
                robots=config.robot, has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False
            )

        super().__init__(build, ACHIEVED_NAMES, config.cameras, config.faces, 2, _paint)
        self.tasks: Mapping[str, Task] = playtable_tasks()
        joint = {name: self.model.joint(f"{name}_joint0") for name in BLOCK_NAMES}
        self._block_qpos = {name: int(joint[name].qposadr[0]) for name in BLOCK_NAMES}
        self._block_body = [int(self.model.jnt_bodyid[joint[name].id]) for name in BLOCK_NAMES]
        self._drawer_qpos = int(self.model.joint("drawer_slide").qposadr[0])
        self._button_qpos = int(self.model.joint("button_press").qposadr[0])

    def achieved(self) -> Array:
        return self._achieved()

    def _achieved(self) -> Array:
        value = np.empty(len(ACHIEVED_NAMES), np.float32)
        for i, body in enumerate(self._block_body):
            axis = self.data.xmat[body].reshape(3, 3)[:, 0]
            value[5 * i : 5 * i + 3] = self.data.xpos[body]
            value[5 * i + 3] = axis[0] ** 2 - axis[1] ** 2
            value[5 * i + 4] = 2 * axis[0] * axis[1]
        value[DRAWER] = self.data.qpos[self._drawer_qpos]
        value[LAMP] = self.extra[0]
        return value

    def failure(self) -> str | None:
        for name, body in zip(BLOCK_NAMES, self._block_body, strict=True):
            if self.data.xpos[body, 2] < scene.TABLE_Z - 0.03:
                return f"the {name} block fell off the table"
        return None

    def reached(self, achieved: Array, goal: Array) -> bool:
        for i in range(len(BLOCK_NAMES)):
            at, to = block(achieved, i), block(goal, i)
            if np.hypot(*(at[:2] - to[:2])) > POSITION_TOLERANCE or abs(at[2] - to[2]) > HEIGHT_TOLERANCE:
                return False
            if np.hypot(*(at[3:] - to[3:])) > DIRECTION_TOLERANCE:
                return False
        near = abs(achieved[DRAWER] - goal[DRAWER]) <= DRAWER_TOLERANCE
        return bool(near and abs(achieved[LAMP] - goal[LAMP]) < 0.5)

    # Start states -----------------------------------------------------------------------------------

    def _arrange(self, rng: np.random.Generator) -> None:
        self.extra[:] = (float(rng.random() < 0.5), 1.0)
        self.data.qpos[self._drawer_qpos] = rng.choice([0.0, scene.DRAWER_TRAVEL, rng.uniform(0, scene.DRAWER_TRAVEL)])
        lying = np.full((len(BLOCK_NAMES), 2), 9.0)
        for i in rng.permutation(len(BLOCK_NAMES)):
            lying[i] = free_spot(np.delete(lying, i, 0), rng)
            self.put(int(i), [*lying[i], scene.TABLE_Z + 0.0205], rng.uniform(-np.pi / 3, np.pi / 3))
        draw = rng.random()
        if draw < self.config.stacked:
            top, below = rng.permutation(len(BLOCK_NAMES))[:2]
            self.stack(int(top), int(below), rng)
        elif draw < self.config.stacked + self.config.stowed and self.data.qpos[self._drawer_qpos] > 0.1:
            self.stow(int(rng.integers(len(BLOCK_NAMES))), rng)

    def put(self, index: int, position: Array | list[float], yaw: float) -> None:
        """Lay block `index` at (x, y, z) m with its long axis at `yaw` rad; for start states only."""
        start = self._block_qpos[BLOCK_NAMES[index]]
        self.data.qpos[start : start + 3] = position
        self.data.qpos[start + 3 : start + 7] = (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))

    def stack(self, top: int, below: int, rng: np.random.Generator) -> None:
        """Put block `top` on block `below`."""
        mujoco.mj_kinematics(self.model, self.data)
        under = block(self._achieved(), below)
        x, y = under[:2] + rng.uniform(-0.006, 0.006, 2)
        self.put(top, [x, y, under[2] + 0.0405], direction(under) + rng.uniform(-0.3, 0.3))

    def stow(self, index: int, rng: np.random.Generator) -> None:
        """Put block `index` in the drawer."""
        x, y = scene.tray_centre(float(self.data.qpos[self._drawer_qpos])) + rng.uniform(-0.02, 0.02, 2)
        self.put(index, [x, y, scene.TRAY_FLOOR + 0.0205], rng.uniform(-0.3, 0.3))

    def slide_drawer(self, opening: float) -> None:
        """Set the drawer's opening in metres, with what lies in it; for start states only."""
        moved = opening - self.data.qpos[self._drawer_qpos]
        achieved = self._achieved()
        centre = scene.tray_centre(float(self.data.qpos[self._drawer_qpos]))
        for i, name in enumerate(BLOCK_NAMES):
            if (np.abs(block(achieved, i)[:2] - centre) < scene.TRAY_HALF).all():
                self.data.qpos[self._block_qpos[name] + 1] -= moved
        self.data.qpos[self._drawer_qpos] = opening

    def switch(self, lamp: bool) -> None:
        """Set the lamp; for start states only."""
        self.extra[0] = float(lamp)

    def refresh(self) -> None:
        """After changing a start state by hand: let it come to rest and observe it anew."""
        self.settle()

    def _after_step(self) -> None:
        depth = self.data.qpos[self._button_qpos]
        if depth > _PRESSED and self.extra[1]:
            self.extra[:] = (1.0 - self.extra[0], 0.0)
        elif depth < _RELEASED:
            self.extra[1] = 1.0


def _paint(model: mujoco.MjModel, extra: Array) -> None:
    bulb = model.geom(scene.LAMP_GEOM)
    bulb.rgba = _LIT if extra[0] else _UNLIT
