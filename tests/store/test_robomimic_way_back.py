"""robomimic's files through import and export: nothing is lost, with `next_obs` or without."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from playlearn.episode import Array
from playlearn.errors import EpisodeError
from playlearn.store import NativeStore, StoreSpec
from playlearn.store.importing import import_recordings
from playlearn.store.robomimic import RobomimicFile
from playlearn.store.robomimic_export import export_robomimic
from tests.synthetic import make_episode

h5py = pytest.importorskip("h5py", reason="the extra `robomimic` is not installed")
STEPS = 30
KEYS = ("robot0_eef_pos", "robot0_gripper_qpos", "object", "front_image")
COST = np.where(np.arange(STEPS) == STEPS - 1, 0.0, -1.0)  # solved by its last action
SOLVED = COST + 1


def recorded(path: Path, rewards: Array, *, whole: bool, change: Callable[[Any], None] = lambda demo: None) -> Path:
    """Two demonstrations of STEPS actions, as dataset_states_to_obs.py writes them; whole: with `next_obs`."""
    rng = np.random.default_rng(0)
    with h5py.File(path, "w") as file:
        file.create_group("data").attrs["env_args"] = '{"env_name": "Mine", "type": 1}'
        for k in range(2):
            demo = file.create_group(f"data/demo_{k}")
            demo["actions"] = rng.uniform(-1, 1, (STEPS, 7)).astype(np.float32)
            demo["rewards"], demo["dones"] = rewards, (np.arange(STEPS) == STEPS - 1).astype(np.int64)
            demo["states"] = rng.normal(size=(STEPS, 5))
            for key in KEYS:
                width = (4, 6, 3) if key == "front_image" else (3,)
                seen = rng.integers(0, 255, (STEPS + 1, *width))
                seen = seen.astype(np.uint8 if key == "front_image" else np.float32)
                demo[f"obs/{key}"] = seen[:-1]
                if whole:
                    demo[f"next_obs/{key}"] = seen[1:]
            change(demo)
    return path


def there_and_back(source: Path, tmp_path: Path) -> tuple[NativeStore, Path]:
    store = import_recordings(RobomimicFile(source), tmp_path / "store", say=lambda _: None)
    export_robomimic(store, tmp_path / "back.hdf5", {})
    return store, tmp_path / "back.hdf5"


def observed(demo: Any, group: str) -> Array:
    """(T, n) all vectors and the first pixels, side by side, whichever keys they have."""
    parts = [demo[group][key][()] for key in sorted(demo[group], key=lambda key: ("image" in key, key == "object"))]
    return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)


@pytest.mark.parametrize("rewards", [COST, SOLVED], ids=["cost", "solved"])
@pytest.mark.parametrize("whole", [True, False], ids=["next_obs", "obs alone"])
def test_nothing_is_lost_on_the_way_back(whole: bool, rewards: Array, tmp_path: Path) -> None:
    source = recorded(tmp_path / "a.hdf5", rewards, whole=whole)
    store, back = there_and_back(source, tmp_path)
    # Without `next_obs` nobody saw where the last action led: then nothing is learned from it.
    assert store.lengths().tolist() == [STEPS if whole else STEPS - 1] * 2
    assert ("actions" in store.remarks()) is not whole
    with h5py.File(source) as before, h5py.File(back) as after:
        for k in range(2):
            theirs, ours = before[f"data/demo_{k}"], after[f"data/demo_{k}"]
            for key in ("actions", "rewards", "dones"):
                np.testing.assert_array_equal(ours[key], theirs[key])
            for group in ("obs", "next_obs") if whole else ("obs",):
                np.testing.assert_array_equal(observed(ours, group), observed(theirs, group))
            assert ("next_obs" in ours) is whole
            assert ours.attrs["num_samples"] == STEPS
        assert after["data"].attrs["total"] == 2 * STEPS
    again, _ = there_and_back(back, tmp_path / "again")
    for name in ("state", "achieved", "action", "reward", "sim_state"):
        np.testing.assert_array_equal(getattr(again.read(1), name), getattr(store.read(1), name))
    assert again.meta(1).unobserved_step == store.meta(1).unobserved_step


def test_simulator_states_are_kept_where_there_is_one_of_each_moment(tmp_path: Path) -> None:
    """robomimic has none after the last action: an episode with that action is one without states, and it is said."""
    store, _ = there_and_back(recorded(tmp_path / "a.hdf5", COST, whole=True), tmp_path / "whole")
    assert store.read(0).sim_state.shape == (STEPS + 1, 0)
    assert list(store.remarks().values()) == ["left out: the one after the last action is missing (`next_states`)"]

    def last_state(demo: Any) -> None:
        demo["next_states"] = np.roll(demo["states"], -1, 0)

    source = recorded(tmp_path / "b.hdf5", COST, whole=True, change=last_state)
    for name, path in {"own": source, "obs alone": recorded(tmp_path / "c.hdf5", COST, whole=False)}.items():
        store, back = there_and_back(path, tmp_path / name)
        assert "states" not in store.remarks()
        with h5py.File(path) as before, h5py.File(back) as after:
            np.testing.assert_array_equal(after["data/demo_1/states"], before["data/demo_1/states"])


def test_an_incomplete_next_obs_is_as_none(tmp_path: Path) -> None:
    def without_cube(demo: Any) -> None:
        del demo["next_obs/object"]

    store, _ = there_and_back(recorded(tmp_path / "a.hdf5", COST, whole=True, change=without_cube), tmp_path)
    assert store.lengths().tolist() == [STEPS - 1] * 2
    assert "actions" in store.remarks()


def test_marks_within_a_demonstration_are_said_to_be_left_out(tmp_path: Path) -> None:
    def early(demo: Any) -> None:
        demo["dones"][STEPS // 2] = 1

    store, _ = there_and_back(recorded(tmp_path / "a.hdf5", COST, whole=True, change=early), tmp_path)
    assert "dones" in store.remarks()


def test_one_action_is_an_episode_where_it_is_seen_to_lead_somewhere(tmp_path: Path) -> None:
    play = make_episode(np.random.default_rng(0), 1)
    store = NativeStore.create(tmp_path / "play", StoreSpec.of(play))
    with store.writer() as writer:
        writer.append(play)
    export_robomimic(store, tmp_path / "a.hdf5", {})
    back = import_recordings(RobomimicFile(tmp_path / "a.hdf5"), tmp_path / "back")
    np.testing.assert_array_equal(back.read(0).achieved, play.achieved)


@pytest.mark.parametrize("step", [{"action": [0.0]}, {"action": [0, 0, 0, float("nan")]}, {"reward": 1.0}, {"done": 1}])
def test_an_unobserved_step_is_like_the_others(step: dict[str, Any]) -> None:
    episode = make_episode(np.random.default_rng(0), 5)
    dataclasses.replace(episode, meta=dataclasses.replace(episode.meta, unobserved_step={"action": [0, 0, 0, 1.0]}))
    with pytest.raises(EpisodeError, match="of the step after the last observation"):
        dataclasses.replace(episode, meta=dataclasses.replace(episode.meta, unobserved_step=step))
