"""robosuite's raw demonstrations: observations are computed with each one's own model."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import robosuite

from playlearn.envs import LiftConfig
from playlearn.errors import StoreError
from playlearn.store.importing import import_recordings
from playlearn.store.robosuite_demos import RobosuiteFile, Scene

h5py = pytest.importorskip("h5py", reason="the extra `robomimic` is not installed")
HOME = str(Path(robosuite.__file__).resolve().parent)


@pytest.fixture(scope="module")
def lift() -> Any:
    return LiftConfig().build()


def raw(path: Path, env: Any, demos: int = 3, xml: str | None = None) -> Path:
    """A file as `collect_human_demonstrations` writes it, on another machine."""
    elsewhere = (env._xml if xml is None else xml).replace(HOME, "/opt/somebody/robosuite")
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env"], data.attrs["env_info"] = "Lift", '{"control_freq": 20, "robots": "Panda"}'
        for k in range(1, demos + 1):
            group = data.create_group(f"demo_{k}")
            group.attrs["model_file"] = elsewhere
            env.reset(k)
            rows = []
            for _ in range(5):
                rows.append(np.concatenate([[env.data.time], env.data.qpos, env.data.qvel]))
                env.step(np.array([0.3, 0.1 * k, -0.2, 0, 0, 0, 1.0]))
            group["states"], group["actions"] = np.array(rows), np.full((5, 7), 0.1 * k)
    return path


def test_end_effector_and_cube_have_their_simulated_positions(lift: Any, tmp_path: Path) -> None:
    store = import_recordings(RobosuiteFile(raw(tmp_path / "demo.hdf5", lift)), tmp_path / "out")
    assert store.indices().tolist() == [1, 2, 3]
    assert store.spec.environment["type"] == "robosuite:Lift"
    assert store.spec.fps == 20
    assert store.spec.achieved_names == tuple(f"cube_joint0.{p}" for p in ("x", "y", "z", "qw", "qx", "qy", "qz"))
    assert store.spec.quantities.achieved[2:] == ("length z", *("quaternion cube_joint0",) * 4)
    assert store.spec.quantities.state[-1] == "plain q1"
    assert store.spec.quantities.action_bounds == ()  # its `env_info` names no controller
    lift.reset(2)
    for _ in range(3):
        lift.step(np.array([0.3, 0.2, -0.2, 0, 0, 0, 1.0]))
    seen, episode = lift.observe(), store.read(1)
    assert len(episode) == 4
    np.testing.assert_allclose(episode.state[3, :9], seen.state[:9], atol=1e-6)
    np.testing.assert_allclose(episode.achieved[3, :3], seen.achieved[:3], atol=1e-6)
    np.testing.assert_allclose(episode.action, 0.2)
    assert store.verify() == []


def test_other_files_are_refused(lift: Any, tmp_path: Path) -> None:
    source = raw(tmp_path / "demo.hdf5", lift)
    with h5py.File(source, "a") as file:
        del file["data/demo_2/states"]
        file["data/demo_2/states"] = np.zeros((4, 9))
        del file["data/demo_3"].attrs["model_file"]
    found = RobosuiteFile(source)
    assert "demo_2 has 4 states and 5 actions" in found.problems()[2]
    assert "demo_3 has no model" in found.problems()[3]
    with pytest.raises(StoreError, match="2 of 3 recordings are broken"):
        import_recordings(found, tmp_path / "out")
    store = import_recordings(found, tmp_path / "out", skip_broken=True, say=lambda _: None)
    assert store.indices().tolist() == [1]
    with h5py.File(source, "a") as file:
        del file["data/demo_1/states"]
        file["data/demo_1/states"] = np.zeros((5, 9))
    [(_, got)] = list(RobosuiteFile(source).read([1]))
    assert "demo_1: states of (5, 9) do not fit its model" in str(got)


@pytest.mark.parametrize(
    ("xml", "message"),
    [
        ('<mujoco><asset><mesh name="a" file="/etc/passwd"/></asset></mujoco>', "which is not robosuite's"),
        (
            '<mujoco><asset><mesh name="a" file="/x/robosuite/../../secret.obj"/></asset></mujoco>',
            "which is not robosuite's",
        ),
        ('<mujoco><include file="/etc/passwd"/></mujoco>', "includes other files"),
        ("<mujoco><worldbody></mujoco>", "cannot be compiled"),
        ("<mujoco><worldbody/></mujoco>", "has no end effector"),
    ],
)
def test_a_model_reads_nothing_but_robosuites_files(xml: str, message: str) -> None:
    with pytest.raises(StoreError, match=message):
        Scene(xml, "demo_1")
