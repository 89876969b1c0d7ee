"""robosuite's raw demonstrations: observations are computed with each one's own model."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import robosuite

from playlearn.envs import LiftConfig
from playlearn.errors import StoreError, UsageError
from playlearn.store.hdf5 import LAST
from playlearn.store.importing import import_recordings
from playlearn.store.robosuite_demos import RobosuiteConfig, RobosuiteFile, Scene

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
    np.testing.assert_allclose(episode.meta.unobserved_step["action"], 0.2)  # the fifth
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


TWO_HANDS = """<mujoco><worldbody>
  <body name="mobilebase0"><freejoint name="mobilebase0_wheels"/><geom size="0.1"/>
    <body name="robot0_base"><joint name="torso"/><geom size="0.1"/>
      <body pos="1 0 0"><site name="gripper0_right_grip_site"/><geom size="0.1"/>
        <body><joint name="gripper0_right_finger" type="slide"/><geom size="0.1"/></body></body></body></body>
  <body name="robot1_base"><geom size="0.1"/>
    <body pos="0 2 0"><site name="gripper1_right_grip_site"/><geom size="0.1"/>
      <body><joint name="gripper1_right_finger" type="slide"/><geom size="0.1"/></body></body></body>
  <body><freejoint/><geom size="0.1"/></body>
  <body><joint name="lid"/><geom size="0.1"/></body>
</worldbody></mujoco>"""


def plain(path: Path, change: Any = lambda data: None) -> Path:
    """Two demonstrations of a scene without robosuite: hands of two robots, one of which drives."""
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env"] = b"TwoHands"
        for k in (1, 2):
            group = data.create_group(f"demo_{k}")
            group.attrs["model_file"] = TWO_HANDS
            states = np.zeros((4, 1 + 7 + 1 + 1 + 1 + 7 + 1 + 6 + 1 + 1 + 1 + 6 + 1))
            states[:, [4, 14]] = 1  # of two quaternions
            states[:, 9], states[:, 10], states[:, 18] = 0.1, 0.2, 0.3
            group["states"], group["actions"] = states, np.zeros((4, 14))
        file["mask/first"] = np.array([b"demo_1"])
        change(data)
    return path


def test_every_hand_is_seen_and_no_wheel_is_an_object(tmp_path: Path) -> None:
    source = RobosuiteFile(plain(tmp_path / "demo.hdf5"), mask="first")
    hands = [f"eef{k}.{part}" for k in (0, 1) for part in ("x", "y", "z", "r00", "r10", "r20", "r01", "r11", "r21")]
    assert source.spec.state_names == (*hands, "gripper0.q0", "gripper1.q0")
    names = [f"joint4.{part}" for part in ("x", "y", "z", "qw", "qx", "qy", "qz")]  # without a name of its own
    assert source.spec.achieved_names == (*names, "lid.pos")
    assert source.spec.environment["type"] == "robosuite:TwoHands"
    assert source.remarks == {**LAST, "demonstrations": "left out: 1 of 2, as they are not in mask 'first'"}
    store = import_recordings(source, tmp_path / "out", say=lambda _: None)
    episode = store.read(0)
    np.testing.assert_allclose(episode.state[0, [0, 9, 10, 18, 19]], [1, 0, 2, 0.1, 0.2], atol=1e-6)
    np.testing.assert_allclose(episode.achieved[0], [0, 0, 0, 1, 0, 0, 0, 0.3], atol=1e-6)
    assert (episode.meta.success, episode.meta.ended) == (None, "unknown")


def test_goals_and_success_are_what_the_user_says(tmp_path: Path) -> None:
    source = plain(tmp_path / "demo.hdf5", lambda data: data["demo_2"].create_dataset("reward_terms", data=np.zeros(4)))
    found = RobosuiteConfig(goal_names=("lid.*",), success="all").build(source)
    store = import_recordings(found, tmp_path / "out", say=lambda _: None)
    assert store.spec.achieved_names == ("lid.pos",)
    assert store.info()["success"] == {"success": 2, "failure": 0, "unknown": 0}
    assert store.remarks()["reward_terms"] == "left out: playlearn has no place for it"
    with pytest.raises(UsageError, match=r"asks for rewards, and .* has none"):
        RobosuiteConfig(success="reward>=1").build(source)


def _instead(key: str, value: Any) -> Any:
    def change(data: Any) -> None:
        del data[key]
        data[key] = value

    return change


def _without_model(data: Any) -> None:
    data["demo_1"].attrs["model_file"] = h5py.Empty("S1")


ODD = {
    "a number": (_instead("demo_1/states", 3.0), r"demo_1 has states of \(\), which are not rows"),
    "text": (_instead("demo_1/actions", np.full((4, 14), b"x")), "demo_1: actions is of .*, not of numbers"),
    "an array": (_instead("demo_1", np.zeros(3)), "demo_1 is an array, not a group"),
    "an empty model": (_without_model, "demo_1: its model cannot be compiled"),
    "a frequency of nothing": (
        lambda data: data.attrs.update(env_info='{"control_freq": -1}'),
        "states control_freq -1, which is no frequency",
    ),
}


@pytest.mark.parametrize("what", ODD)
def test_odd_data_is_told_in_one_message(what: str, tmp_path: Path) -> None:
    change, message = ODD[what]
    source = plain(tmp_path / "demo.hdf5", change)
    with pytest.raises(StoreError, match=message):
        import_recordings(RobosuiteFile(source), tmp_path / "out", say=lambda _: None)


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
