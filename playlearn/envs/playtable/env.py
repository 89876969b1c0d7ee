"""PlayTable behind the Environment contract: three blocks, a drawer, a slider, a button and a lever with their lamps.

`achieved` (20,), meters unless noted:

    0..4    red.x red.y red.z red.c red.s      position of the block's center; direction of its long
    5..9    blue.*                             axis a as (c, s) = (ax^2 - ay^2, 2 ax ay), which is the
    10..14  pink.*                             same for a and -a, as the block looks the same, and
                                               (cos 2 yaw, sin 2 yaw) while it lies flat
    15      drawer.opening                     0 closed .. 0.17 open
    16      slider.position                    0 nearest to the robot .. 0.18 farthest from it
    17      lever.angle                        -0.45 (to the robot's right) .. 0.45 rad (to its left)
    18      led.on                             0 or 1, toggled by the button
    19      bulb.on                            0 or 1, whether the lever leans to the left
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
from robosuite.robots import ROBOT_CLASS_MAPPING, FixedBaseRobot

from playlearn.envs.playtable import scene
from playlearn.envs.playtable.layout import (
    ACHIEVED_NAMES,
    BLOCK_NAMES,
    BULB,
    DRAWER,
    LED,
    LEVER,
    SLIDER,
    block,
    direction,
    free_spot,
    in_bay,
    in_tray,
    others,
    tray_y,
)
from playlearn.envs.playtable.tasks import playtable_tasks
from playlearn.episode import Array
from playlearn.errors import UsageError
from playlearn.sim.environment import CameraConfig, EnvironmentConfig, Task
from playlearn.sim.robosuite_env import RobosuiteEnv

POSITION_TOLERANCE = 0.04  # meters, in the plane
HEIGHT_TOLERANCE = 0.02
DIRECTION_TOLERANCE = 2 * np.sin(np.deg2rad(20.0))  # the chord of 2 * yaw that is 20 degrees of yaw
FIXTURE_TOLERANCES = {
    DRAWER: 0.03,
    SLIDER: 0.03,
    LED: 0.5,
    BULB: 0.5,
}  # meters, lit or not; the bulb stands for the lever
_REACH = ((-0.25, -0.40), (0.19, 0.42))  # where a block can be fetched from, (x, y) in meters
_PRESSED, _RELEASED = 0.007, 0.004  # meters of button travel at which the lamp toggles and re-arms
_UNFIT = ("Baxter", "PandaDexLH", "PandaDexRH")  # two arms; grippers that do not take one command
_LAMPS = {  # unlit and lit
    scene.LED_GEOM: ((0.16, 0.22, 0.24, 1.0), (0.55, 1.0, 1.0, 1.0)),
    scene.BULB_GEOM: ((0.25, 0.25, 0.22, 1.0), (1.0, 0.9, 0.25, 1.0)),
}


@EnvironmentConfig.register_subclass("playtable")
@dataclass(frozen=True)
class PlayTableConfig(EnvironmentConfig):
    """PlayTable.

    robot: any single-arm robosuite robot.
    cameras: name -> size of the images.
    stacked: fraction of random starts with one block on another.
    stowed: fraction with one in the drawer.
    shelved: fraction with one in the slider's bay.
    """

    robot: str = "Panda"
    cameras: dict[str, CameraConfig] = field(
        default_factory=lambda: {"front": CameraConfig(64, 96), "wrist": CameraConfig(64, 64)}
    )
    stacked: float = 0.2
    stowed: float = 0.2
    shelved: float = 0.25

    def build(self) -> "PlayTableEnv":
        return PlayTableEnv(self)


class PlayTableEnv(RobosuiteEnv):
    """See the module's docstring; `extra` is [led, armed]: what physics does not keep."""

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

        super().__init__(build, ACHIEVED_NAMES, config.cameras, 2, _paint)
        self.tasks: Mapping[str, Task] = playtable_tasks()
        joint = {name: self.model.joint(f"{name}_joint0") for name in BLOCK_NAMES}
        self._block_qpos = {name: int(joint[name].qposadr[0]) for name in BLOCK_NAMES}
        self._block_body = [int(self.model.jnt_bodyid[joint[name].id]) for name in BLOCK_NAMES]
        joints = {DRAWER: "drawer_slide", SLIDER: "slider_slide", LEVER: "lever_hinge"}
        self._fixture_qpos = {index: int(self.model.joint(name).qposadr[0]) for index, name in joints.items()}
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
        for index, qpos in self._fixture_qpos.items():
            value[index] = self.data.qpos[qpos]
        value[LED], value[BULB] = self._shown()
        return value

    def _shown(self) -> Array:
        return np.array([self.extra[0], float(self.data.qpos[self._fixture_qpos[LEVER]] > 0)])

    def failure(self) -> str | None:
        (x0, y0), (x1, y1) = _REACH
        for name, body in zip(BLOCK_NAMES, self._block_body, strict=True):
            x, y, z = self.data.xpos[body]
            if z < scene.TRAY_FLOOR + 0.01:  # lower than where one in the drawer lies
                return f"the {name} block fell off the table"
            if z < scene.TABLE_Z + 0.05 and not (x0 < x < x1 and y0 < y < y1):
                return f"the {name} block went out of reach"
        return None

    def reached(self, achieved: Array, goal: Array) -> bool:
        for i in range(len(BLOCK_NAMES)):
            at, to = block(achieved, i), block(goal, i)
            if np.hypot(*(at[:2] - to[:2])) > POSITION_TOLERANCE or abs(at[2] - to[2]) > HEIGHT_TOLERANCE:
                return False
            if np.hypot(*(at[3:] - to[3:])) > DIRECTION_TOLERANCE:
                return False
        return all(abs(achieved[index] - goal[index]) <= within for index, within in FIXTURE_TOLERANCES.items())

    # Start states -----------------------------------------------------------------------------------

    def _arrange(self, rng: np.random.Generator) -> None:
        self.extra[:] = (float(rng.random() < 0.5), 1.0)
        for index, travel in ((DRAWER, scene.DRAWER_TRAVEL), (SLIDER, scene.SLIDER_TRAVEL)):
            self.data.qpos[self._fixture_qpos[index]] = rng.choice([0.0, travel, rng.uniform(0, travel)])
        self.data.qpos[self._fixture_qpos[LEVER]] = rng.choice([-1.0, 1.0]) * scene.LEVER_RANGE
        lying = np.full((len(BLOCK_NAMES), 2), 9.0)
        for i in rng.permutation(len(BLOCK_NAMES)):
            lying[i] = free_spot(np.delete(lying, i, 0), rng)
            self.lay(int(i), lying[i], rng.uniform(-np.pi / 3, np.pi / 3))
        one, two, three = (int(i) for i in rng.permutation(len(BLOCK_NAMES)))
        stacked, stowed, shelved = rng.random(3) < (self.config.stacked, self.config.stowed, self.config.shelved)
        if stowed:
            self.stow(one, rng)
        if shelved:
            self.shelve(two, rng)
        if stacked and not (stowed and shelved):
            self.stack(three, two if stowed else one, rng)

    def put(self, index: int, position: Array | list[float], yaw: float) -> None:
        """Put block `index` at (x, y, z) m with its long axis at `yaw` rad; like all below for start states only."""
        start = self._block_qpos[BLOCK_NAMES[index]]
        self.data.qpos[start : start + 3] = position
        self.data.qpos[start + 3 : start + 7] = (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))

    def lay(self, index: int, xy: Array | tuple[float, float], yaw: float) -> None:
        """Lay block `index` on the deck."""
        self.put(index, [xy[0], xy[1], scene.TABLE_Z + scene.BLOCK_HALF[2] + 0.0005], yaw)

    def stack(self, top: int, below: int, rng: np.random.Generator) -> None:
        """Put block `top` on block `below`."""
        under = block(self._now(), below)
        x, y = under[:2] + rng.uniform(-0.006, 0.006, 2)
        self.put(top, [x, y, under[2] + 0.0405], direction(under) + rng.uniform(-0.3, 0.3))

    def stow(self, index: int, rng: np.random.Generator) -> None:
        """Put block `index` in the drawer, which is emptied before."""
        self.vacate(in_tray, rng, index)
        x, y = scene.TRAY_X, tray_y(self._now())
        where = [x + rng.uniform(-0.025, 0.025), y + rng.uniform(-0.01, 0.03)]
        self.put(index, [*where, scene.TRAY_FLOOR + scene.BLOCK_HALF[2] + 0.0005], np.pi / 2 + rng.uniform(-0.3, 0.3))

    def shelve(self, index: int, rng: np.random.Generator) -> None:
        """Lay block `index` in a half of the slider's bay, which is emptied before."""
        self.vacate(in_bay, rng, index)
        x, y = scene.BAY_CENTER
        where = (x + rng.uniform(-0.01, 0.015), y + rng.choice([-0.07, 0.07]) + rng.uniform(-0.015, 0.015))
        self.lay(index, where, np.pi / 2 + rng.uniform(-0.2, 0.2))

    def slide_drawer(self, opening: float) -> None:
        """Set the drawer's opening in meters, with what lies in it."""
        achieved = self._now()
        for i, name in enumerate(BLOCK_NAMES):
            if in_tray(achieved, i):
                self.data.qpos[self._block_qpos[name] + 1] += opening - achieved[DRAWER]
        self.data.qpos[self._fixture_qpos[DRAWER]] = opening

    def slide_slider(self, position: float) -> None:
        """Set the slider's position in meters."""
        self.data.qpos[self._fixture_qpos[SLIDER]] = position

    def switch(self, lamp: bool | None = None, lever: bool | None = None) -> None:
        """Set the LED, or the lever and with it the bulb."""
        if lamp is not None:
            self.extra[0] = float(lamp)
        if lever is not None:
            self.data.qpos[self._fixture_qpos[LEVER]] = scene.LEVER_RANGE * (1 if lever else -1)

    def refresh(self) -> None:
        """After a start state was changed from outside: let it come to rest."""
        self.settle()

    def vacate(self, inside: Callable[[Array, int], bool], rng: np.random.Generator, keep: int | None = None) -> None:
        """Lay the blocks that are inside on the deck, all but `keep`."""
        achieved = self._now()
        for i in range(len(BLOCK_NAMES)):
            if i != keep and inside(achieved, i):
                spot = free_spot(np.stack([block(self._now(), other)[:2] for other in others(i)]), rng)
                self.lay(i, spot, rng.uniform(-1.0, 1.0))

    def _now(self) -> Array:
        mujoco.mj_kinematics(self.model, self.data)
        return self._achieved()

    def _after_step(self) -> None:
        depth = self.data.qpos[self._button_qpos]
        if depth > _PRESSED and self.extra[1]:
            self.extra[:] = (1.0 - self.extra[0], 0.0)
        elif depth < _RELEASED:
            self.extra[1] = 1.0


def _paint(model: mujoco.MjModel, shown: Array) -> None:
    for (name, colors), lit in zip(_LAMPS.items(), shown, strict=True):
        model.geom(name).rgba = colors[int(lit)]
