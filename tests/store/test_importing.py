"""Import of other formats: every value is kept, no episode comes twice, broken recordings are named."""

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from playlearn.cli import main
from playlearn.episode import Array
from playlearn.errors import StoreError, UsageError
from playlearn.quantity import Quantities
from playlearn.store import NativeStore
from playlearn.store import npz as npz_module
from playlearn.store.importing import import_recordings
from playlearn.store.npz import Rows
from playlearn.store.ogbench import OgbenchFile
from playlearn.store.robomimic import RobomimicConfig, RobomimicFile

h5py = pytest.importorskip("h5py", reason="the extra `robomimic` is not installed")
ENV_ARGS = json.dumps({"env_name": "Lift", "type": 1, "env_kwargs": {"control_freq": 10}})


def robomimic(path: Path, demos: int = 12, change: Callable[[Any], None] = lambda data: None) -> Path:
    """A file as robomimic writes it: demo k has k + 3 actions, all values computed from (k, t)."""
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = ENV_ARGS
        for k in range(demos):
            group, rows = data.create_group(f"demo_{k}"), k + 3
            t = np.arange(rows, dtype=np.float64)[:, None]
            group["actions"] = np.repeat(t / 100, 7, axis=1)
            group["states"] = t + 1000 * k + np.arange(5)
            group["rewards"] = np.arange(rows) == (rows - 1 if k % 2 else -1)
            obs = group.create_group("obs")
            obs["robot0_eef_pos"] = t + np.array([0.1, 0.2, 0.3])
            obs["robot0_eef_quat"] = t + np.array([0.0, 0.0, 0.0, 1.0])
            obs["robot0_gripper_qpos"] = t + np.array([0.5, 0.6])
            obs["robot0_joint_pos"] = t + np.zeros(7)
            obs["object"] = 10 * k + t + np.zeros(10)
            obs["agentview_image"] = np.full((rows, 6, 8, 3), k, np.uint8)
            obs["agentview_depth"] = np.zeros((rows, 6, 8, 1), np.float32)
        file["mask/train"] = np.array([f"demo_{k}" for k in range(demos) if k % 3], dtype="S8")
        file["mask/valid"] = np.array([f"demo_{k}" for k in range(demos) if not k % 3], dtype="S8")
        change(data)
    return path


def test_robomimic_values_are_kept(tmp_path: Path) -> None:
    source = robomimic(tmp_path / "low_dim.hdf5")
    store = import_recordings(RobomimicFile(source), tmp_path / "store")
    assert store.indices().tolist() == list(range(12))  # demo_2 before demo_10
    assert store.lengths().tolist() == [k + 2 for k in range(12)]  # what the last action led to is not there
    assert store.spec.fps == 10
    assert store.spec.environment["env_args"]["env_name"] == "Lift"
    assert store.spec.state_names[:3] == ("robot0_eef_pos.x", "robot0_eef_pos.y", "robot0_eef_pos.z")
    assert store.spec.state_names[7:] == ("robot0_gripper_qpos.0", "robot0_gripper_qpos.1")
    assert store.spec.achieved_names == tuple(f"cube.{part}" for part in ("x", "y", "z", "qx", "qy", "qz", "qw"))
    assert store.cameras() == {"agentview": (6, 8)}
    episode = store.read(10)
    assert episode.meta.ended == "length"
    assert store.read(11).meta.ended == "success"
    np.testing.assert_allclose(episode.state[3, :3], [3.1, 3.2, 3.3], rtol=1e-6)
    np.testing.assert_allclose(episode.achieved[:, 0], 100 + np.arange(13))
    np.testing.assert_allclose(episode.action[:, 0], np.arange(12) / 100)
    np.testing.assert_array_equal(episode.sim_state[2], 10_002 + np.arange(5))
    assert (episode.images["agentview"] == 10).all()
    assert store.verify() == []
    note = json.loads((tmp_path / "store" / "import.json").read_text())
    assert note["splits"] == {"train": [k for k in range(12) if k % 3], "valid": [0, 3, 6, 9]}


OSC = {"type": "OSC_POSE", "input_max": 1, "input_min": -1, "control_delta": True}


@pytest.mark.parametrize(
    ("controller", "bounded"),
    [
        (OSC, True),
        ([OSC, OSC], True),
        ({"type": "BASIC", "body_parts": {"right": {**OSC, "input_type": "delta", "gripper": {"type": "GRIP"}}}}, True),
        ({**OSC, "input_max": [1] * 6, "input_min": [-1] * 6}, True),
        ({**OSC, "control_delta": False}, False),
        ({"type": "BASIC", "body_parts": {"right": {**OSC, "input_type": "absolute"}}}, False),
        ({**OSC, "input_max": [1, 1, 1, 0.5, 0.5, 0.5]}, False),
        (None, False),
    ],
)
def test_robosuites_controllers_say_what_bounds_their_actions(controller: Any, bounded: bool, tmp_path: Path) -> None:
    def change(data: Any) -> None:
        kwargs = {"control_freq": 20, "controller_configs": controller}
        data.attrs["env_args"] = json.dumps({"env_name": "Lift", "type": 1, "env_kwargs": kwargs})

    given = RobomimicFile(robomimic(tmp_path / "a.hdf5", demos=2, change=change)).spec.quantities
    assert given.action_bounds == (((-1.0, 1.0),) * 7 if bounded else ())
    assert given.state[:4] == ("length x", "length y", "length z", "quaternion robot0_eef_quat")
    assert given.state[7:] == ("", "")


def test_of_another_simulators_numbers_nothing_is_known(tmp_path: Path) -> None:
    def change(data: Any) -> None:
        data.attrs["env_args"] = json.dumps({"env_name": "Reach", "type": 2, "env_kwargs": {"controller_configs": OSC}})

    assert RobomimicFile(robomimic(tmp_path / "a.hdf5", demos=2, change=change)).spec.quantities == Quantities()


def test_keys_and_masks_can_be_selected(tmp_path: Path) -> None:
    source = robomimic(tmp_path / "image.hdf5")
    config = RobomimicConfig(state=("robot0_joint_pos",), achieved=(), cameras=(), mask="valid", fps=5)
    store = import_recordings(config.build(source), tmp_path / "store")
    assert store.indices().tolist() == [0, 3, 6, 9]
    assert store.spec.state_names == tuple(f"robot0_joint_pos.{k}" for k in range(7))
    assert (store.spec.achieved_names, store.cameras(), store.spec.fps) == ((), {}, 5)
    for wrong, message in (
        (RobomimicConfig(mask="vald"), "no mask 'vald'; did you mean `valid`"),
        (RobomimicConfig(state=("robot0_eef_poss",)), "did you mean `robot0_eef_pos`"),
        (RobomimicConfig(cameras=("front",)), "cameras: .* has no 'front'"),
    ):
        with pytest.raises(UsageError, match=message):
            wrong.build(source)


def test_an_interrupted_import_resumes_without_duplicates(tmp_path: Path) -> None:
    source, out = robomimic(tmp_path / "low_dim.hdf5"), tmp_path / "store"

    def stop(done: int) -> None:
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_recordings(RobomimicFile(source), out, progress=stop)
    assert len(NativeStore.open(out)) == 5
    inodes = {path.name: path.stat().st_ino for path in (out / "episodes").iterdir()}
    store = import_recordings(RobomimicFile(source), out)
    assert len(store) == 12
    assert inodes.items() <= {path.name: path.stat().st_ino for path in (out / "episodes").iterdir()}.items()
    with pytest.raises(UsageError, match="begun with another mask"):
        import_recordings(RobomimicFile(source, mask="train"), out)
    (out / "import.json").unlink()
    with pytest.raises(UsageError, match=r"not made by `playlearn import`"):
        import_recordings(RobomimicFile(source), out)


def _without(key: str) -> Callable[[Any], None]:
    def change(data: Any) -> None:
        del data[key]

    return change


def _replaced(key: str, value: Any) -> Callable[[Any], None]:
    def change(data: Any) -> None:
        del data[key]
        data[key] = value

    return change


BROKEN = {
    "missing key": (_without("demo_4/obs/object"), "obs/object is missing"),
    "missing actions": (_without("demo_4/actions"), "actions is missing"),
    "other rows": (_replaced("demo_4/obs/object", np.zeros((3, 10))), r"shape \(3, 10\), not \(7, 10\)"),
    "other width": (_replaced("demo_4/obs/object", np.zeros((7, 4))), r"shape \(7, 4\), not \(7, 10\)"),
    "no action": (_replaced("demo_4/actions", np.zeros((0, 7))), "has 0 actions"),
    "one action": (_replaced("demo_4/actions", np.zeros((1, 7))), "has 1 actions"),
    "text": (_replaced("demo_4/obs/object", np.full((7, 10), b"x")), "not of numbers"),
    "not a number": (_replaced("demo_4/actions", np.full((7, 7), np.nan)), "action is not finite at step 0"),
    "elsewhere": (
        _replaced("demo_4/obs/object", h5py.ExternalLink("/etc/hostname", "/x")),
        "a link, which is not followed",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_demonstration_is_named_and_can_be_left_out(what: str, tmp_path: Path) -> None:
    change, message = BROKEN[what]
    source, out, messages = robomimic(tmp_path / "a.hdf5", change=change), tmp_path / "store", []
    with pytest.raises(StoreError, match=rf"demo_4.*{message}"):
        import_recordings(RobomimicFile(source), out)
    store = import_recordings(RobomimicFile(source), out, skip_broken=True, say=messages.append)
    assert store.indices().tolist() == [k for k in range(12) if k != 4]
    assert sum("demo_4" in line for line in messages) == 1


def test_files_of_other_formats_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "text.hdf5").write_text("hello")
    whole = robomimic(tmp_path / "whole.hdf5").read_bytes()
    (tmp_path / "half.hdf5").write_bytes(whole[: len(whole) // 2])
    with h5py.File(tmp_path / "empty.hdf5", "w") as file:
        file.create_group("data")
    with h5py.File(tmp_path / "other.hdf5", "w") as file:
        file["x"] = 1
    robomimic(tmp_path / "mask.hdf5", demos=2, change=_without("demo_1"))
    robomimic(tmp_path / "raw.hdf5", demos=1, change=_without("demo_0/obs"))
    for name, message in (
        ("missing", "there is no file"),
        ("text", "is not an HDF5 file"),
        ("half", "is incomplete"),
        ("empty", "holds no demonstration"),
        ("other", "has no group `data`"),
        ("mask", "mask 'train' names demo_1, and there is no such demonstration"),
        ("raw", "playlearn import robosuite"),
    ):
        code = 2 if name == "missing" else 1
        assert main(["import", "robomimic", str(tmp_path / f"{name}.hdf5"), str(tmp_path / "out")]) == code
        assert message in capsys.readouterr().err
        assert not (tmp_path / "out").exists()


def test_the_command_prints_a_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = robomimic(tmp_path / "a.hdf5")
    assert main(["import", "robomimic", str(source), str(tmp_path / "out"), "--mask", "train"]) == 0
    assert "8 episodes, " in capsys.readouterr().out
    assert main(["import", "ogbench", str(source), str(tmp_path / "out2"), "--mask", "train"]) == 2


# OGBench ---------------------------------------------------------------------------------------------


def ogbench(path: Path, lengths: tuple[int, ...] = (4, 6, 3), **other: Array) -> Path:
    """A file as OGBench's generator writes it, of cube-single: rows, not actions, an episode."""
    rows = sum(lengths)
    row = np.arange(rows)[:, None]
    seen = np.zeros((rows, 28), np.float32)
    seen[:, 12:15] = (np.array([0.5, 0.1, 0.2]) - [0.425, 0, 0]) * 10 + row / 100
    seen[:, 15:19] = (0.0, 1.0, 1.5, 0.25)
    seen[:, 19:22] = (np.array([0.4, -0.1, 0.02]) - [0.425, 0, 0]) * 10
    seen[:, 22:26] = (np.cos(0.15), 0, 0, np.sin(0.15))  # turned by 0.3 rad
    arrays = {
        "observations": seen,
        "actions": np.tile(row / 100, 5).astype(np.float32),
        "terminals": np.isin(np.arange(1, rows + 1), np.cumsum(lengths)),
        "qpos": np.tile(row, 21).astype(np.float32),
        "qvel": np.tile(row, 20).astype(np.float32),
    }
    np.savez_compressed(path, **{**arrays, **other})
    return path


def test_ogbench_rows_become_episodes(tmp_path: Path) -> None:
    store = import_recordings(OgbenchFile(ogbench(tmp_path / "cube-single-play-v0.npz")), tmp_path / "store")
    assert store.lengths().tolist() == [3, 5, 2]  # the action at an episode's last row leads nowhere
    assert store.spec.environment == {"type": "ogbench_cube", "cubes": 1}
    second = store.read(1)
    np.testing.assert_allclose(second.action[:, 0], np.arange(4, 9) / 100, rtol=1e-6)
    np.testing.assert_allclose(second.state[0, :7], [0.504, 0.104, 0.204, 0, 1, 0.0425, 0.25], rtol=1e-5)
    np.testing.assert_allclose(second.achieved[0], [0.4, -0.1, 0.02, np.cos(1.2), np.sin(1.2)], rtol=1e-4)
    assert second.sim_state.shape == (6, 41)
    assert store.verify() == []


def test_a_resumed_import_skips_rows(tmp_path: Path) -> None:
    source = ogbench(tmp_path / "a.npz")
    found = dict(OgbenchFile(source).read([0, 1, 2]))
    [(_, last)] = list(OgbenchFile(source).read([2]))
    np.testing.assert_array_equal(last.action, found[2].action)
    np.testing.assert_array_equal(last.state, found[2].state)


def test_memory_is_bounded_by_the_rows_that_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stream reads no more bytes at once than the rows taken, or `at_once` while skipping."""
    source, asked = ogbench(tmp_path / "a.npz"), []
    begin = npz_module._begin

    class Counted:
        def __init__(self, stream: Any) -> None:
            self._stream = stream

        def read(self, count: int) -> bytes:
            asked.append(count)
            return bytes(self._stream.read(count))

    def counted(*arguments: Any) -> Any:
        stream, shape, dtype = begin(*arguments)
        return Counted(stream), shape, dtype

    monkeypatch.setattr(npz_module, "_begin", counted)
    with Rows(source, ["observations"]) as rows:
        rows.skip(10, at_once=64)
        taken = rows.take(2)["observations"]
    assert max(asked) == 2 * 28 * 4
    np.testing.assert_array_equal(taken, np.load(source)["observations"][10:12])


def test_arrays_of_an_npz_that_are_left_out_are_named(tmp_path: Path) -> None:
    lines: list[str] = []
    made = OgbenchFile(ogbench(tmp_path / "more.npz", rewards=np.zeros(13)))
    store = import_recordings(made, tmp_path / "store", say=lines.append)
    assert lines == ["rewards: left out: playlearn has no place for it"]
    assert NativeStore.open(store.path).info()["remarks"] == made.remarks


def test_broken_npz_is_refused(tmp_path: Path) -> None:
    rows = 13
    objects = np.array([{"a": 1}] * rows, dtype=object)
    for name, other, message in (
        ("objects", {"actions": objects}, "holds Python objects, which are not read"),
        ("short", {"actions": np.zeros((rows - 1, 5), np.float32)}, "differ in their number of rows"),
        ("open", {"terminals": np.zeros(rows, bool)}, "last row does not end an episode"),
        ("images", {"observations": np.zeros((rows, 8, 8, 3), np.uint8)}, "holds images"),
        ("maze", {"observations": np.zeros((rows, 29), np.float32)}, "neither a cube environment"),
        ("ant", {"actions": np.zeros((rows, 8), np.float32)}, "not those of a manipulation environment"),
        ("texts", {"actions": np.full((rows, 5), "a")}, "texts.npz: actions is of <U1, not of numbers"),
        (
            "ends",
            {"terminals": np.zeros((rows, 2), bool)},
            r"ends.npz: terminals of the shape \(13, 2\), not one for each row",
        ),
        ("columns", {"observations": np.asfortranarray(np.zeros((rows, 28), np.float32))}, "column by column"),
    ):
        with pytest.raises(StoreError, match=message):
            OgbenchFile(ogbench(tmp_path / f"{name}.npz", **other))
    nan = np.zeros((rows, 5), np.float32)
    nan[5] = np.nan
    with pytest.raises(StoreError, match="rows 4 to 9: action is not finite at step 1"):
        import_recordings(OgbenchFile(ogbench(tmp_path / "nan.npz", actions=nan)), tmp_path / "out")
    alone = OgbenchFile(ogbench(tmp_path / "alone.npz", lengths=(4, 1, 3)))
    assert list(alone.problems()) == [1]
    whole = (tmp_path / "nan.npz").read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(StoreError, match="is incomplete"):
        OgbenchFile(tmp_path / "half.npz")
    with zipfile.ZipFile(tmp_path / "few.npz", "w") as archive, archive.open("terminals.npy", "w") as stream:
        np.lib.format.write_array(stream, np.array([False, True]))
    with pytest.raises(StoreError, match="no array 'observations'"):
        OgbenchFile(tmp_path / "few.npz")
