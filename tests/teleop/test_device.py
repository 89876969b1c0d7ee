"""A teleoperator: robosuite's own devices, real time, and a store that holds what was played."""

import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from playlearn.collection import CollectConfig, collect, record_teleoperation
from playlearn.episode import Array, Goal
from playlearn.errors import UsageError
from playlearn.process_cache import cached_env
from playlearn.sim import Environment
from playlearn.store import NativeStore
from playlearn.teleop.device import Clock, DeviceActor, Wish, open_device, read

STILL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Scripted:
    """Follows robosuite's `Device`: what it gives next stands in a list, (motion (6,), grasp, reset); then it rests."""

    def __init__(self, inputs: list[tuple[tuple[float, ...], bool, bool]]) -> None:
        self._inputs, self.started = iter(inputs), 0

    def start_control(self) -> None:
        self.started += 1

    def get_controller_state(self) -> Mapping[str, Any]:
        motion, grasp, reset = next(self._inputs, (STILL, False, False))
        # raw_drotation's order and signs are undone by `read`: see robosuite's `Device.input2action`.
        turn = np.array([motion[4], motion[3], -motion[5]])
        return {"dpos": np.array(motion[:3]), "raw_drotation": turn, "grasp": int(grasp), "reset": int(reset)}

    def _postprocess_device_outputs(self, dpos: Array, drotation: Array) -> tuple[Array, Array]:
        return dpos, drotation


class Looking:
    """A screen that notes what it is shown; `wishes` gives a wish at the n-th look."""

    def __init__(self, wishes: Mapping[int, Wish] | None = None, look: Callable[[], None] = lambda: None) -> None:
        self._wishes, self._look = dict(wishes or {}), look
        self.looks = 0
        self.shown: list[tuple[tuple[int, ...], str]] = []

    def show(self, image: Array, text: str) -> None:
        self.shown.append((image.shape, text))
        self._look()

    def wish(self) -> Wish | None:
        self.looks += 1
        assert self.looks < 1000, "the teleoperator is gone"
        return self._wishes.get(self.looks)


class Ticking(Clock):
    """Time passes only where somebody waits, or where `busy` seconds are said to go by."""

    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.time += seconds


class Blind:
    """An environment without OpenGL, so that these tests need none."""

    def __init__(self, environment: Environment) -> None:
        self._environment = environment

    def __getattr__(self, name: str) -> Any:
        return getattr(self._environment, name)

    def render(self, _camera: str, height: int = 48, width: int = 48) -> Array:
        return np.zeros((height, width, 3), np.uint8)


CONFIG = CollectConfig(episodes=2, steps=8)


@pytest.fixture
def playtable() -> Any:
    return Blind(cached_env(CONFIG.environment))


def moving(steps: int, seed: int = 0) -> list[tuple[tuple[float, ...], bool, bool]]:
    rng = np.random.default_rng(seed)
    return [(tuple(rng.uniform(-1, 1, 6).tolist()), bool(t > steps // 2), False) for t in range(steps)]


def actor(device: Scripted, environment: Environment, screen: Looking, clock: Clock | None = None) -> DeviceActor:
    return DeviceActor(device, "keyboard", environment, screen, clock=clock or Ticking(), size=(48, 64))


def test_what_a_teleoperator_played_is_stored_and_replays_bit_for_bit(tmp_path: Path, playtable: Any) -> None:
    """Two episodes of 8 steps: executed is recorded and is the label; from the first state on they come out again."""
    inputs = [(STILL, False, False)] * 3 + moving(40)
    record_teleoperation(CONFIG, tmp_path / "play", playtable, actor(Scripted(inputs), playtable, Looking()))
    store = NativeStore.open(tmp_path / "play")
    assert store.indices().tolist() == [0, 1]
    assert store.verify() == []
    for i in range(2):
        episode = store.read(i)
        assert (episode.meta.actor, len(episode)) == ("human:keyboard", 8)
        assert not episode.intervention.any()
        np.testing.assert_array_equal(episode.action, episode.expert_action)
        playtable.set_state(np.array(episode.sim_state[0]))
        for t, action in enumerate(episode.action):
            playtable.step(action)
            np.testing.assert_array_equal(playtable.sim_state(), episode.sim_state[t + 1])
    first = store.read(0)
    expected = [(*motion, 1.0 if grasp else -1.0) for motion, grasp, _ in inputs[3:11]]
    np.testing.assert_array_equal(first.action, np.array(expected, np.float32))  # the pause before it is no play
    scripted = CollectConfig(episodes=1, steps=2)
    collect(scripted, tmp_path / "scripted", workers=0)
    start = NativeStore.open(tmp_path / "scripted").array(0, "sim.state")[0]
    np.testing.assert_array_equal(first.sim_state[0], start)  # the same number has the same start, whoever plays


def test_keys_keep_throw_away_and_leave(tmp_path: Path, playtable: Any) -> None:
    """Enter after 3 steps; Backspace after 2, and the same number again; the device's reset after 4; Esc before more.

    A look is a tick: one that begins an episode, then one after each step.
    """
    keys = {4: Wish.KEEP, 7: Wish.DISCARD}
    inputs = [*moving(11), (STILL, False, True)]
    committed: list[int] = []
    out = tmp_path / "play"
    screen = Looking(keys, lambda: committed.append(len(list(out.glob("episodes/*.safetensors")))))
    record_teleoperation(CONFIG, out, playtable, actor(Scripted(inputs), playtable, screen))
    store = NativeStore.open(out)
    assert store.lengths().tolist() == [3, 4]
    assert [store.meta(i).ended for i in range(2)] == ["stopped", "stopped"]
    assert committed[4] == 1, "the first is safe before the second begins"


def test_leaving_keeps_what_was_begun_and_resume_goes_on(tmp_path: Path, playtable: Any) -> None:
    out = tmp_path / "play"
    record_teleoperation(CONFIG, out, playtable, actor(Scripted(moving(9)), playtable, Looking({4: Wish.LEAVE})))
    assert NativeStore.open(out).lengths().tolist() == [3]
    record_teleoperation(CONFIG, out, playtable, actor(Scripted([]), playtable, Looking({5: Wish.LEAVE})), resume=True)
    assert len(NativeStore.open(out)) == 1, "nothing had been moved"
    record_teleoperation(CONFIG, out, playtable, actor(Scripted(moving(20)), playtable, Looking()), resume=True)
    assert NativeStore.open(out).lengths().tolist() == [3, 8]


def test_steps_come_in_real_time_even_where_drawing_is_slow(tmp_path: Path, playtable: Any) -> None:
    """At 20 Hz, 40 steps take 2 s. With pictures of 0.12 s each, 40 of them would take 4.8 s: some are left out."""
    for drawing, most in ((0.0, 2.06), (0.12, 3.2)):
        clock = Ticking()
        looks: list[float] = []

        def look(clock: Ticking = clock, drawing: float = drawing, looks: list[float] = looks) -> None:
            clock.time += drawing
            looks.append(clock.time)

        config = CollectConfig(episodes=1, steps=40)
        device = Scripted(moving(60))
        record_teleoperation(
            config, tmp_path / str(drawing), playtable, actor(device, playtable, Looking({}, look), clock)
        )
        assert 2.0 <= clock.time <= most
        assert np.diff(looks).max() < 0.5, "the picture stays fresh"


def test_one_teleoperator_plays_in_one_environment_with_an_arm(playtable: Any) -> None:
    from tests.fakes import PointConfig, PointEnv

    with pytest.raises(ValueError, match="one teleoperator"):
        actor(Scripted([]), playtable, Looking()).reset([None, None], [0, 1])
    with pytest.raises(UsageError, match="7 numbers"):
        actor(Scripted([]), PointEnv(PointConfig()), Looking())
    assert actor(Scripted([]), playtable, Looking()).reset([Goal(np.zeros(1))], [0]) is None


# robosuite's own devices, with stand-ins for what listens to the hardware ---------------------------------


class Key(Enum):
    up = 1
    down = 2
    left = 3
    right = 4
    space = 5


class Letter:
    def __init__(self, char: str) -> None:
        self.char = char


class Listener:
    def __init__(self, **_: Any) -> None: ...

    def start(self) -> None: ...


class Hid:
    """A SpaceMouse that sends one reading, pushed and twisted, and then nothing more."""

    def __init__(self) -> None:
        self._readings = iter([[1, 100, 0, 206, 255, 50, 0, 30, 0, 0, 0, 226, 255], [3, 1] + [0] * 11])

    def open(self, *_: int) -> None: ...

    def get_manufacturer_string(self) -> str:
        return "maker"

    get_product_string = get_manufacturer_string

    def read(self, _: int) -> list[int] | None:
        import time

        time.sleep(0.01)
        return next(self._readings, None)


@pytest.fixture
def hardware(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    keyboard = ModuleType("pynput.keyboard")
    vars(keyboard).update(Key=Key, Listener=Listener, Controller=object)
    hid = ModuleType("hid")
    vars(hid).update(device=Hid)
    stand_ins = {"pynput": ModuleType("pynput"), "pynput.keyboard": keyboard, "hid": hid}
    loaded = [name for name in sys.modules if name.startswith("robosuite.devices")]
    for name in loaded:
        monkeypatch.delitem(sys.modules, name)
    for name, module in stand_ins.items():
        monkeypatch.setitem(sys.modules, name, module)
    yield
    for name in [name for name in sys.modules if name.startswith("robosuite.devices")]:
        del sys.modules[name]


@pytest.fixture(scope="module")
def lift() -> Any:
    import robosuite

    return robosuite.make(
        "Lift", robots="Panda", has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False
    )


PRESSES: list[list[Any]] = [
    [Key.up],
    [Key.right, Letter("."), Letter("e")],
    [Letter("y"), Letter("o"), Letter(";")],
    [Key.space, Key.left, Letter("p"), Letter("p"), Letter("r")],
    [],
]


@pytest.mark.usefixtures("hardware")
def test_a_keyboard_means_what_it_means_in_robosuite(lift: Any) -> None:
    """The same keys to the same device: our action is robosuite's own `input2action`, number for number."""
    from robosuite.devices.keyboard import Keyboard

    ours: Any = open_device("keyboard", sensitivity=0.2)
    theirs = Keyboard(lift, pos_sensitivity=0.2, rot_sensitivity=0.2)
    for device in (ours, theirs):
        device.start_control()
    for presses in PRESSES:
        for device in (ours, theirs):
            for key in presses:
                device.on_press(key)
                device.on_release(key)
        wanted = theirs.input2action()
        action, reset = read(ours)
        assert not reset
        np.testing.assert_allclose(action, np.concatenate([wanted["right_delta"], wanted["right_gripper"]]), atol=1e-7)
    ours.on_release(Letter("q"))
    assert read(ours)[1], "its reset ends an episode"
    ours.start_control()
    assert not read(ours)[1]


@pytest.mark.usefixtures("hardware")
def test_a_spacemouse_means_what_it_means_in_robosuite(lift: Any) -> None:
    from robosuite.devices.spacemouse import SpaceMouse

    ours: Any = open_device("spacemouse")
    theirs = SpaceMouse(lift)
    for device in (ours, theirs):
        device.start_control()
        # What the reading 100, -50, 50, 30, 0, -30 of its six axes is, of 350 at most; the thread may have read it.
        device._control, device.single_click_and_hold = [-50 / 350, 100 / 350, -50 / 350, 30 / 350, 0, -30 / 350], True
    wanted = theirs.input2action()
    action, reset = read(ours)
    assert not reset
    np.testing.assert_allclose(action, np.concatenate([wanted["right_delta"], wanted["right_gripper"]]), atol=1e-7)
    assert (np.abs(action) > 0).sum() == 6
    assert action[6] == 1.0


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("robosuite.devices")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pynput.keyboard", None)
    monkeypatch.setitem(sys.modules, "pynput", None)
    with pytest.raises(UsageError, match=r"needs the package pynput.*playlearn\[devices\]"):
        open_device("keyboard")


def test_without_a_screen_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    if sys.platform != "linux":
        pytest.skip("a desktop always has one")
    from playlearn.teleop.window import Window

    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(UsageError, match=r"no window can be opened here .*DISPLAY.*where there is a screen"):
        Window("nothing", 48, 64)


SHOWN = """
import numpy as np
from playlearn.sim import CameraConfig
from playlearn.envs import PlayTableConfig
from playlearn.teleop.device import Wish
from playlearn.teleop.window import Window
import glfw
env = PlayTableConfig().build()
with Window("test", 96, 128) as window:
    for _ in range(3):  # two contexts in one thread, by turns
        window.show(env.render("front", 96, 128), "hello")
        assert window.wish() is None
    for key, wish in ((glfw.KEY_ENTER, Wish.KEEP), (glfw.KEY_BACKSPACE, Wish.DISCARD), (glfw.KEY_ESCAPE, Wish.LEAVE)):
        window._pressed(None, key, 0, glfw.PRESS, 0)
        assert window.wish() is wish and window.wish() is None
    glfw.set_window_should_close(window._window, True)
    assert window.wish() is Wish.LEAVE
print("shown")
"""


@pytest.mark.skipif(not shutil.which("xvfb-run"), reason="no Xvfb here")
def test_a_window_shows_pictures_and_takes_keys() -> None:
    command = ["xvfb-run", "-a", sys.executable, "-c", SHOWN]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1200, check=False)
    assert done.stdout.strip() == "shown", done.stderr
