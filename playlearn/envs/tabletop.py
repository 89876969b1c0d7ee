"""What all of robosuite's own environments share: the scene by name, two cameras, robosuite's random starts.

The arena, the objects, the robot and its controller are robosuite's, unchanged; an environment's file adds the
achieved goal, when it is reached, the named tasks and the skill library.
"""

import contextlib
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
import robosuite
from robosuite.robots import ROBOT_CLASS_MAPPING, FixedBaseRobot

from playlearn.episode import Array
from playlearn.errors import UsageError
from playlearn.sim.environment import CameraConfig, EnvironmentConfig
from playlearn.sim.robosuite_env import RobosuiteEnv

UNFIT = ("Baxter", "PandaDexLH", "PandaDexRH")  # two arms; grippers that do not take one command
_ABOVE_GRIP = 0.097  # meters from the grip site back towards the wrist, where the wrist camera sits


@dataclass(frozen=True)
class View:
    """The front camera.

    eye: (3,) m, where it stands.
    at: (3,) m, what it is aimed at.
    fovy: vertical field of view in degrees.
    """

    eye: tuple[float, float, float]
    at: tuple[float, float, float]
    fovy: float


@dataclass(frozen=True)
class TabletopConfig(EnvironmentConfig):
    """Base of the configs of robosuite's own environments.

    robot: any single-arm robosuite robot.
    gripper: one of robosuite's; "default" is the robot's own.
    cameras: name -> size of the images.
    """

    robot: str = "Panda"
    gripper: str = "default"
    cameras: dict[str, CameraConfig] = field(
        default_factory=lambda: {"front": CameraConfig(84, 84), "wrist": CameraConfig(84, 84)}
    )


class TabletopEnv(RobosuiteEnv):
    """A robosuite environment behind the Environment contract; `robosuite` is that environment itself.

    name: what it is registered as; `options` go to its constructor.
    achieved_names: what `_achieved` returns.
    view: of the front camera.
    absent: names of objects that the scene has and the tasks do without; they hang far away.
    standing: names of objects without a free joint that robosuite places anew at every reset; their poses are kept
        in `extra`, seven numbers each.
    extra: how many numbers the subclass keeps after these.
    paint: as RobosuiteEnv has it.

    A subclass implements `_achieved`, `failure`, `reached` and `tasks`, and may override `_arrange`, which
    places everything as robosuite itself does.
    """

    def __init__(
        self,
        config: TabletopConfig,
        name: str,
        achieved_names: Sequence[str],
        view: View,
        *,
        absent: Sequence[str] = (),
        standing: Sequence[str] = (),
        extra: int = 0,
        paint: Callable[[mujoco.MjModel, Array], None] | None = None,
        **options: Any,
    ) -> None:
        self.config = config
        single = sorted({key for key, kind in ROBOT_CLASS_MAPPING.items() if kind is FixedBaseRobot} - set(UNFIT))
        if config.robot not in single:
            raise UsageError(f"robot: {config.robot!r} is not a robot with one arm; those are {', '.join(single)}")

        def build() -> Any:
            with numpy_seeded_from(
                np.random.default_rng(0)
            ):  # the scene itself (the cube's size) must not differ between builds
                self.robosuite = robosuite.make(
                    name,
                    robots=config.robot,
                    **({} if config.gripper == "default" else {"gripper_types": config.gripper}),
                    hard_reset=False,  # or it forgets what is added here
                    has_renderer=False,
                    has_offscreen_renderer=False,
                    use_camera_obs=False,
                    **options,
                )
            _add_cameras(self.robosuite, view)
            for absent_name in absent:
                _hang(self.robosuite, absent_name)
            return self.robosuite

        bodies = [f"{standing_name}_main" for standing_name in standing]

        def show(model: mujoco.MjModel, kept: Array) -> None:
            _stand(model, bodies, kept)
            if paint is not None:
                paint(model, kept[7 * len(bodies) :])

        super().__init__(build, achieved_names, config.cameras, extra + 7 * len(bodies), show)
        self._absent, self._standing, self._stands = tuple(absent), tuple(standing), bodies

    def achieved(self) -> Array:
        return self._achieved()

    def body(self, name: str) -> int:
        """The id of a body."""
        return int(self.model.body(name).id)

    def put(self, joint: str, position: Array | Sequence[float], quaternion: Array | Sequence[float]) -> None:
        """Place what hangs on a free joint at (3,) m, (4,) w x y z; for start states only."""
        start = int(self.model.joint(joint).qposadr[0])
        self.data.qpos[start : start + 7] = [*position, *quaternion]

    def refresh(self) -> None:
        """After a start state was changed from outside: let it come to rest."""
        self.settle()

    def step(self, action: Array) -> None:
        _stand(
            self.model, self._stands, self.extra
        )  # another environment on the same model may have placed them elsewhere
        super().step(action)

    def _refresh(self) -> None:
        _stand(self.model, self._stands, self.extra)
        super()._refresh()

    def _arrange(self, rng: np.random.Generator) -> None:
        with numpy_seeded_from(rng):
            drawn = self.robosuite.placement_initializer.sample()
        for position, quaternion, placed in drawn.values():
            if placed.name in self._standing:
                start = 7 * self._standing.index(placed.name)
                self.extra[start : start + 7] = [*position, *quaternion]
            elif placed.name not in self._absent and placed.joints:
                self.put(placed.joints[0], position, quaternion)


def upright(yaw: float) -> tuple[float, float, float, float]:
    """The quaternion (w, x, y, z) of something that stands as it was made, turned by `yaw` rad."""
    return float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))


@contextlib.contextmanager
def numpy_seeded_from(rng: np.random.Generator) -> Iterator[None]:
    """Let libraries that draw from numpy's global state draw from `rng`; the global state is restored."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(int(rng.integers(2**32)))  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002


def _add_cameras(env: Any, view: View) -> None:
    eye, at = np.array(view.eye), np.array(view.at)
    back = (eye - at) / np.linalg.norm(eye - at)
    right = np.cross([0.0, 0.0, 1.0], back)
    right = right / np.linalg.norm(right)
    front = {"pos": _xml_numbers(eye), "xyaxes": _xml_numbers([*right, *np.cross(back, right)]), "fovy": str(view.fovy)}
    ElementTree.SubElement(env.model.worldbody, "camera", {"name": "front", "mode": "fixed", **front})
    site = env.robots[0].gripper["right"].important_sites["grip_site"]
    hand = env.model.worldbody.find(f".//site[@name='{site}']/..")
    wrist = {"pos": _xml_numbers([0, 0.075, -_ABOVE_GRIP]), "xyaxes": "1 0 0 0 -1 -0.30", "fovy": "70"}
    ElementTree.SubElement(hand, "camera", {"name": "wrist", "mode": "fixed", **wrist})


def _hang(env: Any, name: str) -> None:
    """Let an object that robosuite has cleared away stay there, where it would fall for ever."""
    body = env.model.worldbody.find(f".//body[@name='{name}_main']")
    for part in body.iter("body"):
        part.set("gravcomp", "1")
    for geom in body.iter("geom"):
        geom.set("contype", "0")
        geom.set("conaffinity", "0")


def _stand(model: mujoco.MjModel, bodies: Sequence[str], kept: Array) -> None:
    """Place each body at its pose in the first numbers that an environment keeps."""
    for body, where in zip(bodies, kept[: 7 * len(bodies)].reshape(-1, 7), strict=True):
        if where.any():  # not before the first start
            model.body(body).pos[:] = where[:3]
            model.body(body).quat[:] = where[3:]


def _xml_numbers(numbers: Array | Sequence[float]) -> str:
    return " ".join(f"{number:.6g}" for number in numbers)
