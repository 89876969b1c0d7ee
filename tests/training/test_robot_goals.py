"""Training on goals that are the robot's own pose."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from playlearn.episode import Episode
from playlearn.errors import UsageError
from playlearn.policies import Policy
from playlearn.store import NativeStore, StoreSpec
from playlearn.training import train
from tests.synthetic import make_episode
from tests.training.test_train import config


@pytest.mark.parametrize("named", [False, True], ids=["no objects", "none wanted"])
def test_a_goal_may_be_the_robots_own_pose(named: bool, tmp_path: Path) -> None:
    """Of play without objects, or where a goal covers none of them: its settled moments are read from the robot."""
    robot = moving_robot(tmp_path / "robot", objects=named)
    settings = config(robot)
    if not named:
        with pytest.raises(UsageError, match=r"and .*robot records none: .*`policy.encoder.goal_proprio: true`"):
            train(settings, tmp_path / "run")
        assert not (tmp_path / "run").exists()
    encoder = dataclasses.replace(settings.policy.encoder, goal_proprio=True, goal_names=() if named else ("*",))
    train(dataclasses.replace(settings, policy=dataclasses.replace(settings.policy, encoder=encoder)), tmp_path / "run")
    assert Policy.load(tmp_path / "run" / "policy").config.encoder.uses_goal_proprio


def moving_robot(path: Path, *, objects: bool) -> Path:
    """Play whose gripper opens every 40 steps, and closes again after 20."""
    episodes = []
    for seed in range(3):
        episode = make_episode(np.random.default_rng(seed), 120, seed=seed)
        state = episode.state.copy()
        state[:, 3] = np.arange(len(state)) % 40 < 20
        bare = episode if objects else without_objects(episode)
        episodes.append(dataclasses.replace(bare, state=state))
    store = NativeStore.create(path, StoreSpec.of(episodes[0]))
    with store.writer() as writer:
        for episode in episodes:
            writer.append(episode)
    return path


def without_objects(episode: Episode) -> Episode:
    own = dataclasses.replace(episode.meta.quantities, achieved=())
    meta = dataclasses.replace(episode.meta, achieved_names=(), quantities=own)
    return dataclasses.replace(episode, meta=meta, achieved=episode.achieved[:, :0])
