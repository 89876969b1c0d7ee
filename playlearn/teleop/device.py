"""A teleoperator with one of robosuite's own devices, as an Actor: real time, an image, and three keys.

robosuite's conventions hold (`Device.input2action`): motions are commands in [-1, 1] of the OSC controller, in
the frame of the robot's base, of which 1 asks for 0.05 m or 0.5 rad; the device's own reset ends an episode.
"""

import contextlib
import io
import time
from collections.abc import Mapping, Sequence
from enum import Enum
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

from playlearn.episode import Array, Decision, Goal, Observation
from playlearn.errors import UsageError
from playlearn.oracles.end_effector import CLOSE, OPEN
from playlearn.sim.environment import Environment

ACTIONS = 7  # three of position, three of rotation, the gripper
DEVICES = {"keyboard": ("Keyboard", "keyboard"), "spacemouse": ("SpaceMouse", "spacemouse")}  # class, module
TOUCH = 0.02  # what a SpaceMouse at rest stays below
SLOWEST = 0.2  # seconds between two images where rendering takes longer than a step


class Device(Protocol):
    """The part of `robosuite.devices.Device` that is used."""

    def start_control(self) -> None:
        """Forget what was pressed, and listen."""
        ...

    def get_controller_state(self) -> Mapping[str, Any]:
        """dpos (3,), raw_drotation (3,), grasp and reset, since the last call."""
        ...

    def _postprocess_device_outputs(self, dpos: Array, drotation: Array) -> tuple[Array, Array]:
        """The device's gains: both in [-1, 1]."""
        ...


class Wish(Enum):
    """What the teleoperator wants done with the present episode."""

    KEEP = "end it and keep it"
    DISCARD = "throw it away and begin again"
    LEAVE = "keep it and leave"


class Screen(Protocol):
    """Where the teleoperator sees the environment, and decides what becomes of an episode."""

    def show(self, image: Array, text: str) -> None:
        """Show an image (h, w, 3) uint8 and a line of text."""
        ...

    def wish(self) -> Wish | None:
        """What was asked for since the last call."""
        ...


class Clock:
    """The passing of real time, in seconds."""

    def now(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)


class DeviceActor:
    """Plays one environment with the device's present command, one step each 1 / fps seconds.

    kind: names the device in `name`, which is recorded.
    size: (height, width) in pixels of the image from the environment's first camera.
    """

    cameras: tuple[str, ...] = ()

    def __init__(
        self,
        device: Device,
        kind: str,
        environment: Environment,
        screen: Screen,
        *,
        clock: Clock | None = None,
        size: tuple[int, int] = (480, 480),
    ) -> None:
        if len(environment.spec.action_names) != ACTIONS:
            raise UsageError(
                f"a device moves an end effector with {ACTIONS} numbers; this environment's actions are "
                f"{', '.join(environment.spec.action_names)}"
            )
        self.name = f"human:{kind}"
        self.wish: Wish | None = None
        self._device, self._environment, self._screen = device, environment, screen
        self._clock = clock or Clock()
        self._camera = environment.spec.cameras[0]
        self._size = size
        self._action: Array = np.zeros(ACTIONS, np.float32)
        self._due = self._drawn = self._drawing = 0.0

    def ready(self, title: str) -> bool:
        """Show the environment until the teleoperator moves or grips; False where they leave instead."""
        self._begin()
        self._due, self._drawn = self._clock.now(), -np.inf
        while True:
            reset = self._tick(f"{title}: move to begin")
            if self.wish is Wish.LEAVE:
                return False
            if reset:
                self._begin()
            elif np.abs(self._action[:6]).max() > TOUCH or self._action[6] == CLOSE:
                self._title, self._began = title, self._clock.now()
                self.wish = None
                return True

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        if len(goals) != 1:
            raise ValueError(f"one teleoperator plays in one environment, not in {len(goals)}")

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> Sequence[Decision]:
        return [Decision(self._action)]

    def over(self, _k: int, _observation: Observation) -> bool:
        """The `stop` of `rollout`: asked after each step, it waits for the next; `wish` is then what is to be done."""
        reset = self._tick(f"{self._title}, {self._clock.now() - self._began:.0f} s")
        if reset and self.wish is None:
            self.wish = Wish.KEEP
        return self.wish is not None

    def _begin(self) -> None:
        self._device.start_control()
        self.wish = None

    def _tick(self, text: str) -> bool:
        """Draw, wait until the next step is due, look at device and keys. Whether the device asks for a reset."""
        now = self._clock.now()
        if now + self._drawing <= self._due or now - self._drawn >= SLOWEST:
            self._screen.show(self._environment.render(self._camera, *self._size), text)
            self._drawing, self._drawn = self._clock.now() - now, now
        if self._due > self._clock.now():
            self._clock.sleep(self._due - self._clock.now())
        self._due = max(self._due, self._clock.now()) + 1 / self._environment.spec.fps
        self.wish = self._screen.wish() or self.wish
        self._action, reset = read(self._device)
        return reset


def read(device: Device) -> tuple[Array, bool]:
    """(7,) float32 in [-1, 1], the device's present command, and whether it asks for a reset.

    The same numbers as robosuite's `Device.input2action` gives for one arm under OSC_POSE.
    """
    state = device.get_controller_state()
    turn = np.asarray(state["raw_drotation"], float)[[1, 0, 2]] * (1, 1, -1)
    shift, turn = device._postprocess_device_outputs(np.asarray(state["dpos"], float), turn)
    action = np.concatenate([shift, turn, [CLOSE if state["grasp"] else OPEN]])
    return action.clip(-1, 1).astype(np.float32), bool(state["reset"])


def open_device(kind: str, sensitivity: float = 1.0) -> Device:
    """robosuite's device of that kind, listening; it prints which key or axis does what.

    Raises:
        UsageError: its packages are not installed, there is no screen to listen at, or nothing is plugged in.
    """
    name, module = DEVICES[kind]
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # it prints what else could not be imported
            import importlib

            made = getattr(importlib.import_module(f"robosuite.devices.{module}"), name)
        arm = SimpleNamespace(robots=[SimpleNamespace(arms=("right",))])  # all a device asks of its environment
        device: Device = made(arm, pos_sensitivity=sensitivity, rot_sensitivity=sensitivity)
    except ModuleNotFoundError as error:
        raise UsageError(
            f"--device {kind} needs the package {error.name}: `pip install 'playlearn[devices]'` brings it"
        ) from error
    except ImportError as error:
        raise UsageError(f"--device {kind} cannot listen here: {' '.join(str(error).split())}") from error
    except OSError as error:
        raise UsageError(
            f"no {kind} can be opened ({error}): is it plugged in, may you read it (a udev rule for its hidraw), and "
            "are SPACEMOUSE_VENDOR_ID and SPACEMOUSE_PRODUCT_ID in robosuite's macros its own?"
        ) from error
    return device
