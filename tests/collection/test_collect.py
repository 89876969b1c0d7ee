"""Collecting: the same episodes however they came about, and images that can be drawn later."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from playlearn.collection import CollectConfig, collect, play, render_store
from playlearn.envs import PlayTableConfig
from playlearn.errors import RenderError, StoreError, UsageError
from playlearn.process_cache import cached_env
from playlearn.sim import CameraConfig
from playlearn.store import NativeStore

SMALL = CollectConfig(
    environment=PlayTableConfig(cameras={"front": CameraConfig(32, 48), "wrist": CameraConfig(24, 24)}),
    episodes=3,
    steps=12,
)


def same(a: NativeStore, b: NativeStore) -> None:
    np.testing.assert_array_equal(a.indices(), b.indices())
    for i in range(len(a)):
        one, other = a.read(i), b.read(i)
        assert one.meta == other.meta
        for name, value in one.arrays().items():
            np.testing.assert_array_equal(value, other.arrays()[name], err_msg=name)


@pytest.mark.slow
def test_play_replays_bit_for_bit() -> None:
    """From any recorded state the recorded action leads to the next one: what was executed is what is on record."""
    config = dataclasses.replace(SMALL, steps=60)
    episode, environment = play(config, 0), cached_env(config.environment)
    environment.set_state(np.array(episode.sim_state[0]))
    for t, action in enumerate(episode.action):
        environment.step(action)
        np.testing.assert_array_equal(environment.sim_state(), episode.sim_state[t + 1])
    environment.reset(1)
    environment.set_state(np.array(episode.sim_state[31]))
    environment.step(episode.action[31])
    np.testing.assert_array_equal(environment.sim_state(), episode.sim_state[32])


@pytest.mark.slow
def test_images_drawn_afterwards_equal_those_drawn_live(tmp_path: Path) -> None:
    live = dataclasses.replace(SMALL, episodes=1, cameras=("front", "wrist"))
    try:
        collect(live, tmp_path / "live", workers=0)
    except RenderError as error:
        pytest.skip(str(error))
    collect(dataclasses.replace(SMALL, episodes=1), tmp_path / "blind", workers=0)
    sizes = {"front": CameraConfig(32, 48), "wrist": CameraConfig(24, 24)}
    render_store(tmp_path / "blind", tmp_path / "drawn", sizes, workers=0)
    same(NativeStore.open(tmp_path / "live"), NativeStore.open(tmp_path / "drawn"))
    render_store(tmp_path / "live", tmp_path / "other", {"front": CameraConfig(16, 16)}, workers=0)
    assert NativeStore.open(tmp_path / "other").cameras() == {"front": (16, 16)}


def test_a_part_of_the_play_is_drawn_and_more_of_it_later(tmp_path: Path) -> None:
    collect(dataclasses.replace(SMALL, episodes=3), tmp_path / "blind", workers=0)
    sizes = {"front": CameraConfig(16, 16)}
    for episodes, drawn in ((1, [0]), (2, [0, 1]), (None, [0, 1, 2])):
        try:
            render_store(tmp_path / "blind", tmp_path / "drawn", sizes, workers=0, episodes=episodes)
        except RenderError as error:
            pytest.skip(str(error))
        assert NativeStore.open(tmp_path / "drawn").indices().tolist() == drawn
    with pytest.raises(UsageError, match="1 to 3"):
        render_store(tmp_path / "blind", tmp_path / "drawn", sizes, workers=0, episodes=4)


def test_what_is_there_is_not_overwritten(tmp_path: Path) -> None:
    config = dataclasses.replace(SMALL, episodes=1)
    collect(config, tmp_path / "play", workers=0)
    with pytest.raises(StoreError, match="--resume"):
        collect(config, tmp_path / "play", workers=0)
    with pytest.raises(UsageError, match="another seed"):
        collect(dataclasses.replace(config, seed=1), tmp_path / "play", resume=True)


def test_an_unknown_camera_is_named_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"'side'.*front"):
        collect(dataclasses.replace(SMALL, cameras=("side",)), tmp_path / "play")
    assert not (tmp_path / "play").exists()
