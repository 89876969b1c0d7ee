"""robomimic's files as others write them: what is known is kept, what is not known is said, nothing ends in a trace."""

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from playlearn.cli import main
from playlearn.cli.import_recordings import FIELDS
from playlearn.episode import Array
from playlearn.errors import StoreError, UsageError
from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.store import NativeStore
from playlearn.store.importing import import_recordings
from playlearn.store.robomimic import RobomimicConfig, RobomimicFile
from playlearn.store.robomimic_export import export_robomimic
from playlearn.store.robosuite_demos import RobosuiteConfig
from tests.store.test_hand import STEPS, cube, hand

h5py = pytest.importorskip("h5py", reason="the extra `robomimic` is not installed")
QUIET: dict[str, Any] = {"say": lambda _: None}


def recorded(path: Path, task: str = "Lift", change: Callable[[Any], None] = lambda file: None, **kwargs: Any) -> Path:
    """A file of three demonstrations, of which each carries a cube once: `object` as Lift has it."""
    rng = np.random.default_rng(0)
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps({"env_name": task, "type": 1, "env_kwargs": {"control_freq": 20} | kwargs})
        for k in range(3):
            at = hand(rng)
            own, still = cube(rng, at), np.tile([0.0, 0, 0, 1], (STEPS, 1))
            demo = data.create_group(f"demo_{k}")
            demo["actions"] = rng.uniform(-0.5, 0.5, (STEPS, 7))
            demo["obs/robot0_eef_pos"], demo["obs/robot0_eef_quat"] = at, still
            demo["obs/robot0_gripper_qpos"] = np.tile([0.02, -0.02], (STEPS, 1))
            demo["obs/object"] = np.concatenate([own, still, own - at], 1)
        change(file)
    return path


def rewarded(*rewards: Array) -> Callable[[Any], None]:
    """Demonstration k with the rewards of that number."""

    def change(file: Any) -> None:
        for k, one in enumerate(rewards):
            file[f"data/demo_{k}/rewards"] = one
            file[f"data/demo_{k}/dones"] = (np.arange(STEPS) == STEPS - 1).astype(np.int64)

    return change


def opened(tmp_path: Path, source: Path, **options: Any) -> NativeStore:
    return import_recordings(RobomimicConfig(**options).build(source), tmp_path / "store", **QUIET)


# what depends on the hand ----------------------------------------------------------------------------


@pytest.mark.parametrize("task", ["Lift", "SomebodysLift"])
def test_goals_are_about_the_cube_and_not_about_where_it_is_from_the_hand(task: str, tmp_path: Path) -> None:
    """By the task's name, and by measurement: a demonstration has one settled moment, when the cube is let go."""
    store = opened(tmp_path, recorded(tmp_path / "a.hdf5", task))
    parts = ("x", "y", "z", "qx", "qy", "qz", "qw")
    assert store.spec.achieved_names == tuple(
        f"cube.{part}" if task == "Lift" else f"object.{k}" for k, part in enumerate(parts)
    )
    index = RelabelIndex.of_store(store, SettlingConfig())
    assert [len(index.settled(k)[0]) for k in range(3)] == [1, 1, 1]
    [(last, _), (named, why)] = store.remarks().items()
    assert last == "actions"  # of each the last one, after which nothing was observed
    named_as, because = (
        ("gripper_to_cube.x, gripper_to_cube.y, gripper_to_cube.z", "relative to the hand")
        if task == "Lift"
        else ("object.7, object.8, object.9", "changing with the hand while nothing else does")
    )
    assert named == named_as
    assert because in why


def test_goals_can_be_about_whatever_is_named(tmp_path: Path) -> None:
    source = recorded(tmp_path / "a.hdf5")
    store = opened(tmp_path, source, goal_names=("cube.?", "gripper_to_cube.z"))
    assert store.spec.achieved_names == ("cube.x", "cube.y", "cube.z", "gripper_to_cube.z")
    with pytest.raises(UsageError, match=r"'cubes\.\*' matches none of: cube\.x"):
        RobomimicFile(source, goal_names=("cubes.*",))


def test_the_import_asks_where_goals_have_nothing_to_be_about(tmp_path: Path) -> None:
    def relative_only(file: Any) -> None:
        for demo in file["data"].values():
            rows = demo["obs/object"][:, 7:]
            del demo["obs/object"]
            demo["obs/object"] = rows

    source = recorded(tmp_path / "a.hdf5", change=relative_only)
    with pytest.raises(UsageError, match=r"goal_names: .*object\.0, object\.1, object\.2 are measured"):
        RobomimicFile(source)
    assert opened(tmp_path, source, achieved=()).spec.achieved_names == ()


def test_a_real_robots_own_numbers_are_not_objects(tmp_path: Path) -> None:
    """Keys as robomimic's real-robot datasets have them; none begins with `robot`."""

    def renamed(file: Any) -> None:
        for demo in file["data"].values():
            for old, new in {"robot0_eef_pos": "ee_pos", "robot0_eef_quat": "ee_quat", "object": "marker"}.items():
                demo.move(f"obs/{old}", f"obs/{new}")
            demo.move("obs/robot0_gripper_qpos", "obs/gripper_position")

    source = recorded(tmp_path / "a.hdf5", "real", renamed)
    spec = RobomimicFile(source).spec
    assert {name.partition(".")[0] for name in spec.state_names} == {"ee_pos", "ee_quat", "gripper_position"}
    assert spec.achieved_names == tuple(f"marker.{k}" for k in range(7))

    def nameless(file: Any) -> None:
        for demo in file["data"].values():
            demo.move("obs", "seen")
            demo["obs/a"], demo["obs/b"] = demo["seen/robot0_eef_pos"][()], demo["seen/object"][()]

    source = recorded(tmp_path / "b.hdf5", "real", nameless)
    with pytest.raises(UsageError, match=r"state: .* no key of obs is known to be the robot's; .* of a, b"):
        RobomimicFile(source)
    assert RobomimicFile(source, state=("a",), achieved=("b",)).spec.achieved_names == tuple(f"b.{k}" for k in range(7))


# success ---------------------------------------------------------------------------------------------

LAST, NEVER, ALWAYS = (np.arange(STEPS) == STEPS - 1) * 1.0, np.zeros(STEPS), np.ones(STEPS)
REWARDS = {
    "robomimic's": ((LAST, NEVER, LAST), {}, None, [True, False, True]),
    "a shaped one": ((np.linspace(0, 0.3, STEPS),) * 3, {}, None, [None] * 3),
    "shaped, says the file": ((LAST, NEVER, LAST), {"reward_shaping": True}, None, [None] * 3),
    "a cost": ((LAST - 1, NEVER - 1, LAST - 1), {}, None, [None] * 3),
    "zeros, as where none was computed": ((NEVER,) * 3, {}, None, [None] * 3),
    "a cost, and the user": ((LAST - 1, NEVER - 1, LAST - 1), {}, "last_reward>=0", [True, False, True]),
    "a threshold": ((np.linspace(0, 0.3, STEPS), NEVER, ALWAYS), {}, "reward > 0.25", [True, False, True]),
    "done": ((NEVER,) * 3, {}, "dones", [True] * 3),
    "all": ((NEVER,) * 3, {}, "all", [True] * 3),
    "none": ((LAST,) * 3, {}, "none", [False] * 3),
}


@pytest.mark.parametrize("what", REWARDS)
def test_a_reward_is_a_success_only_where_that_is_known(what: str, tmp_path: Path) -> None:
    rewards, kwargs, rule, success = REWARDS[what]
    source = recorded(tmp_path / "a.hdf5", change=rewarded(*rewards), **kwargs)
    store = opened(tmp_path, source, success=rule)
    assert [store.meta(i).success for i in range(3)] == success
    assert store.info()["success"] == {
        "success": success.count(True),
        "failure": success.count(False),
        "unknown": success.count(None),
    }
    export_robomimic(store, tmp_path / "back.hdf5", {})
    with h5py.File(tmp_path / "back.hdf5") as file:
        for k, own in enumerate(rewards):  # that of the last action, which no observation follows, among them
            np.testing.assert_array_equal(file[f"data/demo_{k}/rewards"], own)
    again = import_recordings(RobomimicFile(tmp_path / "back.hdf5"), tmp_path / "again", **QUIET)
    assert [again.meta(i).success for i in range(3)] == success


def test_a_rule_that_cannot_be_followed_is_refused(tmp_path: Path) -> None:
    source = recorded(tmp_path / "a.hdf5")
    with pytest.raises(UsageError, match=r"success: 'reward>=1' asks for rewards, and .*demo_0 has none"):
        RobomimicFile(source, success="reward>=1")
    for wrong in ("reward>=", "reward>=1e", "rewards>1", "some"):
        with pytest.raises(UsageError, match="is none of all, none, dones"):
            RobomimicFile(source, success=wrong)


def test_the_import_says_how_many_succeeded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = str(recorded(tmp_path / "a.hdf5", change=rewarded(LAST - 1)))
    assert main(["import", "robomimic", source, str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "success 0, failure 0, unknown 3" in said
    assert "--success" in said
    assert main(["import", "robomimic", source, str(tmp_path / "out"), "--success", "all"]) == 2
    assert "begun with another success" in capsys.readouterr().err


def test_the_help_names_every_field() -> None:
    """Written down there, since reading them from the configs would make every command import HDF5 and MuJoCo."""
    robomimic, rest = FIELDS.split("of robosuite:")
    for config, said in ((RobomimicConfig, robomimic), (RobosuiteConfig, rest)):
        assert {entry.name for entry in dataclasses.fields(config)} == set(re.findall(r"--(\w+)", said))


# what is left out ------------------------------------------------------------------------------------


def _more(file: Any) -> None:
    for k, demo in enumerate(file["data"].values()):
        demo["obs/robot0_joint_pos"] = np.zeros((STEPS, 7))
        demo["obs/agentview_depth"] = np.zeros((STEPS, 6, 8, 1), np.float32)
        demo["obs/poses"] = np.zeros((STEPS, 4, 4))
        demo["obs/words"] = np.full((STEPS, 1), b"pick")
        demo["obs/camera/intrinsics"] = np.zeros((STEPS, 9))
        for camera in ("front", "front_image"):
            demo[f"obs/{camera}"] = np.full((STEPS, 2, 2, 3), camera == "front", np.uint8)
        demo["actions_abs"] = np.zeros((STEPS, 7))
        if k:
            demo["obs/late"] = np.zeros((STEPS, 2))
    file["data/trial_7/actions"] = np.zeros((3, 7))
    file["notes"] = 1
    file["mask/train"] = np.array([b"demo_0", b"demo_2"])
    file["mask/valid"] = np.array([b"demo_1"])


def test_what_is_left_out_is_named_at_import_and_in_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = recorded(tmp_path / "a.hdf5", change=_more), tmp_path / "out"
    assert main(["import", "robomimic", str(source), str(out), "--mask", "train"]) == 0
    at_import = capsys.readouterr()
    assert main(["info", str(out)]) == 0
    info = capsys.readouterr().out
    for line in (
        "obs/robot0_joint_pos: left out: none of `state`",
        "obs/agentview_depth: left out: float32 of shape (120, 6, 8, 1)",
        "obs/poses: left out: float64 of shape (120, 4, 4)",
        "obs/words: left out: |S4 of shape (120, 1)",
        "obs/camera: left out: ",
        "obs/late: left out: not every demonstration has it",
        "obs/front_image: called front_image: two cameras are 'front'",
        "data/trial_7: left out: it is not named like a demonstration",
        "notes, actions_abs: left out: playlearn has no place for it",
        "demonstrations: left out: 1 of 3, as they are not in mask 'train'",
    ):
        assert line in at_import.err, line
        assert line in info, line
    assert "mask train: 2 of its 2 episodes\nmask valid: 0 of its 1 episodes" in at_import.out
    frames = NativeStore.open(out).read(0).images
    assert {name: int(own.max()) for name, own in frames.items()} == {"front": 1, "front_image": 0}  # both are there
    with pytest.raises(UsageError, match=r"state: .*obs/poses cannot be read, float64 of shape \(120, 4, 4\)"):
        RobomimicFile(source, state=("poses",))


# no traceback ----------------------------------------------------------------------------------------


def _data(key: str, value: Any) -> Callable[[Any], None]:
    """The second demonstration with something else under a key."""

    def change(file: Any) -> None:
        if key in file["data/demo_1"]:
            del file[f"data/demo_1/{key}"]
        file[f"data/demo_1/{key}"] = value

    return change


def _replaced(key: str, value: Any) -> Callable[[Any], None]:
    def change(file: Any) -> None:
        if key in file:
            del file[key]
        file[key] = value

    return change


def _arguments(value: Any) -> Callable[[Any], None]:
    def change(file: Any) -> None:
        file["data"].attrs["env_args"] = value

    return change


def _observe_next(file: Any, rows: int) -> None:
    for demo in file["data"].values():
        for key, value in demo["obs"].items():
            demo[f"next_obs/{key}"] = value[:rows]


def _twice(file: Any) -> None:
    file.copy("data/demo_1", "data/demo_01")


ODD = {
    "complex actions": (_data("actions", np.zeros((STEPS, 7), np.complex64)), "demo_1: actions is of complex64"),
    "a number": (_data("actions", 3.0), r"demo_1: it has 0 actions \(of shape \(\)\)"),
    "an empty array": (_data("actions", h5py.Empty("f")), "demo_1/actions is empty"),
    "records": (_data("obs/object", np.zeros((STEPS, 10), [("x", "f4")])), "demo_1: obs/object is of "),
    "rows of rows": (_data("obs/object", np.zeros((STEPS, 1, 10))), r"demo_1: obs/object has shape \(120, 1, 10\)"),
    "states as text": (_data("states", np.full((STEPS, 3), b"x")), "demo_1: states is of "),
    "next observations, too few": (
        lambda file: _observe_next(file, 4),
        r"demo_0: next_obs/robot0_eef_pos has shape \(4, 3\), not \(120, 3\)",
    ),
    "states, too few": (_data("states", np.zeros((4, 3))), r"demo_1: states has shape \(4, 3\), not \(120, 3\)"),
    "rewards as text": (_data("rewards", np.full(STEPS, b"x")), "demo_1: rewards is of "),
    "rewards, too many": (_data("rewards", np.zeros(STEPS + 1)), r"demo_1: rewards has shape \(121,\), not \(120,\)"),
    "rewards that are none": (_data("rewards", np.full(STEPS, np.nan)), "demo_1: reward is not finite at step 0"),
    "an array as demonstration": (_replaced("data/demo_1", np.zeros(3)), "demo_1 is an array, not a group"),
    "a link as demonstration": (_replaced("data/demo_1", h5py.SoftLink("/data/demo_0")), "demo_1 is a link"),
    "two of one number": (_twice, "demo_01 and demo_1 are of one number"),
    "an array as mask": (_replaced("mask", np.zeros(3)), "mask is an array, not a group"),
    "a list for arguments": (_arguments("[1]"), "env_args of /data is no JSON object"),
    "a word for frequency": (
        _arguments('{"env_kwargs": {"control_freq": "fast"}}'),
        "states control_freq 'fast', which is no frequency: say --fps",
    ),
    "zero for frequency": (_arguments('{"env_kwargs": {"control_freq": 0}}'), "control_freq 0"),
}


@pytest.mark.parametrize("what", ODD)
def test_odd_data_is_told_in_one_message(what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change, message = ODD[what]
    source = recorded(tmp_path / "a.hdf5", change=change)
    with pytest.raises(StoreError, match=message):
        import_recordings(RobomimicFile(source), tmp_path / "out", **QUIET)
    assert main(["import", "robomimic", str(source), str(tmp_path / "again")]) == 1
    assert str(source) in capsys.readouterr().err


def test_numbers_of_any_real_type_are_read(tmp_path: Path) -> None:
    def change(file: Any) -> None:
        for demo in file["data"].values():
            demo["obs/robot0_contact"] = np.ones((STEPS, 2), np.bool_)
            demo["obs/robot0_count"] = np.full(STEPS, 7, np.int8)
            demo["rewards"] = np.zeros((STEPS, 1), np.float16)

    source = recorded(tmp_path / "a.hdf5", change=change)
    store = opened(tmp_path, source, state=("robot0_contact", "robot0_count"))
    np.testing.assert_array_equal(store.read(0).state[5], [1, 1, 7])
    assert store.read(0).reward is not None
