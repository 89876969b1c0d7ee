"""A blind run learns from what a robot records alone, and refuses what needs more."""

import dataclasses
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from playlearn.config import from_dict
from playlearn.episode import EpisodeMeta
from playlearn.errors import StoreError, UsageError
from playlearn.policies import Policy
from playlearn.store import NativeStore, StoreSpec, episode_path, open_store
from playlearn.store.base import from_json, to_json
from playlearn.store.tensors import map_tensors, read_header, write_tensors
from playlearn.training import TrainConfig, train
from tests.synthetic import make_episode
from tests.training.test_train import config

CAMERAS = {"front": (16, 16), "wrist": (16, 16)}


@pytest.fixture(scope="module")
def play(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Play whose gripper opens every 40 steps and closes again, with all that a simulator knows."""
    path, made = tmp_path_factory.mktemp("blind") / "play", []
    for seed in range(3):
        episode = make_episode(np.random.default_rng(seed), 90, CAMERAS, seed=seed, reward=np.ones(90))
        state = episode.state.copy()
        state[:, 3] = np.arange(len(state)) % 40 < 20
        made.append(dataclasses.replace(episode, state=state))
    store = NativeStore.create(path, StoreSpec.of(made[0]))
    with store.writer() as writer:
        for episode in made:
            writer.append(episode)
    return path


def spoiled(play: Path, folder: Path) -> Path:
    """The same play with NaN or noise in everything that is hidden, written around Episode's checks."""
    store, rng = NativeStore.open(shutil.copytree(play, folder)), np.random.default_rng(7)
    for i in range(len(store)):
        path = episode_path(folder, i)
        header = read_header(path)
        arrays = {key: np.array(value) for key, value in map_tensors(path, header.layout).items()}
        for key in ("achieved", "sim.state", "expert_action", "reward"):
            arrays[key][:] = np.nan
        arrays["skill"][:] = rng.integers(0, 3, arrays["skill"].shape)
        meta = from_json(EpisodeMeta, header.metadata["meta"])
        told = dataclasses.replace(meta, seed=99, skills=("noise:slip",) * 3, success=True, ended="fell")
        write_tensors(path, arrays, {**header.metadata, "meta": to_json(told)})
    return folder


def blind(play: Path, encoder: str, **more: Any) -> TrainConfig:
    """State alone: the goal is where the robot is to be; or goal images."""
    made = config(play, encoder, **{"blind": True, "steps": 2, "val_batches": 0, **more})
    if encoder != "state":
        return made
    pose = dataclasses.replace(made.policy.encoder, goal_proprio=True)
    return dataclasses.replace(made, policy=dataclasses.replace(made.policy, encoder=pose))


@pytest.mark.parametrize("encoder", ["state", "cnn", pytest.param("hand", marks=pytest.mark.slow)])
def test_what_is_hidden_changes_no_bit_of_the_weights(
    encoder: str, play: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("playlearn.data.projection.FEWEST", 1)
    other, weights = spoiled(play, tmp_path / "spoiled"), []
    for number, store in enumerate((play, other)):
        extra = {"extra_datasets": [{"store": str(store), "fraction": 0.5}]}
        train(blind(store, encoder, **extra), tmp_path / str(number))
        weights.append(load_file(tmp_path / str(number) / "checkpoint" / "last.safetensors"))
    assert [name for name, value in weights[0].items() if not torch.equal(value, weights[1][name])] == []
    assert Policy.load(tmp_path / "0" / "policy").spec.achieved_names == ()
    with pytest.raises(StoreError, match="is nan"):  # else nothing was spoiled
        train(config(other), tmp_path / "seeing")


ASKED: Mapping[str, dict[str, Any]] = {
    "corrections": {"corrections": {}},
    "perceived": {"perceived": {"encoder": "run"}},
    "data.target": {"data": {"target": "next_settled_delta"}},
    "data.failure_fraction": {"data": {"failure_fraction": 0.5}},
    "extra_datasets.0.data.failure_fraction": {
        "extra_datasets": [{"store": "play", "fraction": 0.5, "data": {"failure_fraction": 0.5}}]
    },
}


@pytest.mark.parametrize("name", ASKED)
def test_what_needs_more_is_refused(name: str) -> None:
    with pytest.raises(UsageError, match=rf"^blind: .*{name}.*set blind to false"):
        from_dict(TrainConfig, {"blind": True, **ASKED[name]})


def test_image_encoders_are_not_supervised_with_what_is_hidden() -> None:
    images = {"policy": {"encoder": {"type": "cnn", "state_supervision": 1.0}}}
    with pytest.raises(UsageError, match=r"^blind: scenes, policy\.encoder\.state_supervision would read"):
        from_dict(TrainConfig, {"blind": True, "scenes": {}, **images})


def test_a_goal_that_is_hidden_is_missed_before_anything_is_written(play: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"play \(blind\) records none: .*goal_proprio"):
        train(config(play, blind=True), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_run_records_what_it_used_and_a_blind_one_starts_from_none_that_used_any(play: Path, tmp_path: Path) -> None:
    def record(run: str) -> Any:
        return json.loads((tmp_path / run / "run.json").read_text())["privileged"]

    train(config(play, steps=2), tmp_path / "seeing")
    poses = ["object poses"]
    assert record("seeing") == {"training": [*poses, "clean labels"], "relabeling": poses, "goal": poses}
    train(blind(play, "cnn"), tmp_path / "blind")
    assert record("blind") == {"training": [], "relabeling": [], "goal": []}
    train(config(play, "cnn", steps=2, init_from=str(tmp_path / "blind")), tmp_path / "images")
    assert record("images") == {"training": ["clean labels"], "relabeling": poses, "goal": []}
    by_robot = {"data": {"settling": {"source": "robot"}}, "init_from": str(tmp_path / "images")}
    train(config(play, "cnn", steps=2, **by_robot), tmp_path / "inherits")
    assert record("inherits") == record("images"), "its own goals are read from the robot, those before it were not"
    train(blind(play, "cnn", init_from=str(tmp_path / "blind")), tmp_path / "further")
    assert record("further") == record("blind")

    for run in ("images", "seeing"):
        with pytest.raises(UsageError, match=r"^blind: init_from is .*clean labels; relabeling: object poses.*start"):
            train(blind(play, "cnn", init_from=str(tmp_path / run)), tmp_path / "refused")
    (tmp_path / "blind" / "run.json").unlink()
    with pytest.raises(UsageError, match=r"^blind: init_from is .*whose privileged information is unknown"):
        train(blind(play, "cnn", init_from=str(tmp_path / "blind")), tmp_path / "refused")


def test_a_blind_policy_acts_where_there_are_objects(play: Path, tmp_path: Path) -> None:
    """It does not know them: nothing that it is shown of them changes what it does."""
    from playlearn.episode import Goal, Observation
    from playlearn.policies import PolicyActor

    train(blind(play, "cnn"), tmp_path / "run")
    policy, store = Policy.load(tmp_path / "run" / "policy"), open_store(play)
    policy.check(store.spec, store.cameras())
    episode, actions = store.read(0), []
    for shown in (episode.achieved, np.full_like(episode.achieved, 3.0)):
        actor = PolicyActor(policy, n_action_steps=1)
        images = {camera: episode.images[camera] for camera in CAMERAS}
        seen = [Observation(episode.state[t], shown[t], {c: own[t] for c, own in images.items()}) for t in (0, 60)]
        actor.reset([Goal(shown[60], seen[1].images, episode.state[60])], [0])
        actions.append(actor.act([seen[0]], [True])[0].action)
    np.testing.assert_array_equal(*actions)
