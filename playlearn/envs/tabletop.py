"""What every task that robosuite has registered shares: its scene by name, two cameras, its own random starts.

The arena, the objects, the robot and its controller are robosuite's, untouched; a task's file says what its
goals speak of, when they are reached and who drives.
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

UNFIT = ("Baxter", "PandaDexLH", "PandaDexRH")  # two arms; hands that do not take one command
_ABOVE_GRIP = 0.097  # meters from the grip site back towards the wrist, where the wrist camera sits


@dataclass(frozen=True)
class View:
    """Where the front camera stands and what it is aimed at: (3,) m each; fovy: its opening in degrees."""

    eye: tuple[float, float, float]
    at: tuple[float, float, float]
    fovy: float


@dataclass(frozen=True)
class TabletopConfig(EnvironmentConfig):
    """robot: any single-arm robosuite robot. gripper: one of robosuite's; "default" is the robot's own.

    cameras: name -> size of the images.
    """

    robot: str = "Panda"
    gripper: str = "default"
    cameras: dict[str, CameraConfig] = field(
        default_factory=lambda: {"front": CameraConfig(84, 84), "wrist": CameraConfig(84, 84)}
    )


class TabletopEnv(RobosuiteEnv):
    """A robosuite environment behind the Environment contract; `robosuite` is that environment itself.

    name: what it is registered as; options go to its constructor. view: of the front camera.
    absent: names of objects that the scene has and the task does without; they hang far away.
    standing: names of objects without a free joint that robosuite stands elsewhere at every reset; where they
    stand is kept in `extra`, seven numbers each. extra: how many numbers the subclass keeps after these.
    paint: as RobosuiteEnv has it.

    A subclass offers `_achieved`, `failure`, `reached` and `tasks`, and may override `_arrange`, which
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
            with chance(np.random.default_rng(0)):  # the scene itself (the cube's size) must not differ between builds
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
            for thing in absent:
                _hang(self.robosuite, thing)
            return self.robosuite

        bodies = [f"{thing}_main" for thing in standing]

        def show(model: mujoco.MjModel, kept: Array) -> None:
            _stand(model, bodies, kept)
            if paint is not None:
                paint(model, kept[7 * len(bodies) :])

        super().__init__(build, achieved_names, config.cameras, extra + 7 * len(bodies), show)
        self._absent, self._standing, self._stands = tuple(absent), tuple(standing), bodies

    def achieved(self) -> Array:
        return self._achieved()

    def body(self, name: str) -> int:
        """The index of a body."""
        return int(self.model.body(name).id)

    def put(self, joint: str, position: Array | Sequence[float], quaternion: Array | Sequence[float]) -> None:
        """Place what hangs on a free joint at (3,) m, (4,) w x y z; for start states only."""
        start = int(self.model.joint(joint).qposadr[0])
        self.data.qpos[start : start + 7] = [*position, *quaternion]

    def refresh(self) -> None:
        """After changing a start state by hand: let it come to rest and observe it anew."""
        self.settle()

    def step(self, action: Array) -> None:
        _stand(self.model, self._stands, self.extra)  # another world on the same model may have stood them elsewhere
        super().step(action)

    def _refresh(self) -> None:
        _stand(self.model, self._stands, self.extra)
        super()._refresh()

    def _arrange(self, rng: np.random.Generator) -> None:
        with chance(rng):
            drawn = self.robosuite.placement_initializer.sample()
        for position, quaternion, thing in drawn.values():
            if thing.name in self._standing:
                start = 7 * self._standing.index(thing.name)
                self.extra[start : start + 7] = [*position, *quaternion]
            elif thing.name not in self._absent and thing.joints:
                self.put(thing.joints[0], position, quaternion)


def upright(yaw: float) -> tuple[float, float, float, float]:
    """The quaternion (w, x, y, z) of something that stands as it was made, turned by `yaw` rad."""
    return float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))


@contextlib.contextmanager
def chance(rng: np.random.Generator) -> Iterator[None]:
    """Let robosuite, which knows only numpy's global randomness, draw from `rng`; what was global is put back."""
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
    front = {"pos": _words(eye), "xyaxes": _words([*right, *np.cross(back, right)]), "fovy": str(view.fovy)}
    ElementTree.SubElement(env.model.worldbody, "camera", {"name": "front", "mode": "fixed", **front})
    site = env.robots[0].gripper["right"].important_sites["grip_site"]
    hand = env.model.worldbody.find(f".//site[@name='{site}']/..")
    wrist = {"pos": _words([0, 0.075, -_ABOVE_GRIP]), "xyaxes": "1 0 0 0 -1 -0.30", "fovy": "70"}
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
    """Stand each body where the first numbers that a world keeps say."""
    for body, where in zip(bodies, kept[: 7 * len(bodies)].reshape(-1, 7), strict=True):
        if where.any():  # not before the first start
            model.body(body).pos[:] = where[:3]
            model.body(body).quat[:] = where[3:]


def _words(numbers: Array | Sequence[float]) -> str:
    return " ".join(f"{number:.6g}" for number in numbers)
