"""What a proposer of subgoals learns from: the change up to the next settled moment."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from playlearn.data import DataConfig, statistics
from playlearn.errors import UsageError
from playlearn.relabeling import SettledConfig, SettlingConfig
from playlearn.store import NativeStore, StoreSpec
from tests.synthetic import make_episode, red_then_lamp


def test_a_change_is_what_the_next_settled_moment_will_differ_in(tmp_path: Path) -> None:
    """Red has moved by observation 50 and settles at 56, the lamp goes on at 100 and settles at 106."""
    store = red_then_lamp(tmp_path / "play")
    config = DataConfig(goals=SettledConfig(ahead=3), chunk=1, target="next_settled_delta", val_fraction=0.0)
    data = config.build(store, "train", 0)
    expected = np.zeros((106, 7), np.float32)
    expected[:50, 0] = 0.1  # from observation 50 on nothing of that change is left
    expected[56:100, 6] = 1.0
    batch = data.batch(0, np.arange(106))
    np.testing.assert_allclose(batch.action[:, 0].numpy(), expected)
    assert batch.action_mask.all()
    np.testing.assert_allclose(data.targets(), expected)
    shown = statistics(data)
    np.testing.assert_allclose(shown["action"].std, shown["achieved"].std)
    assert not shown["action"].mean.any()
    with pytest.raises(UsageError, match=r"a change is one label, so set policy\.chunk to 1"):
        dataclasses.replace(config, chunk=8).build(store, "train", 0)


def test_a_detour_is_no_target_of_a_high_level_policy(tmp_path: Path) -> None:
    """Red goes away (settled at 56) and comes back (106), then the lamp goes on (156).

    Of the goals one to three settled moments ahead, those of the time before 50 are: red away (nearer: counts), red
    back (nothing differs: a detour) and red back with the lamp on (as much differs after the change as before it).
    """
    achieved = np.zeros((201, 7), np.float32)
    achieved[50:100, 0], achieved[150:, 6] = 0.1, 1.0
    episode = dataclasses.replace(make_episode(np.random.default_rng(0), 200), achieved=achieved)
    store = NativeStore.create(tmp_path / "play", StoreSpec.of(episode))
    with store.writer() as writer:
        writer.append(episode)
    config = DataConfig(
        goals=SettledConfig(ahead=3), chunk=1, target="next_settled_delta", allow_detours=False, val_fraction=0.0
    )
    data = config.build(store, "train", 0)
    seen = np.arange(50)
    for epoch in range(5):
        goal = np.searchsorted([56, 106, 156], data.goals(epoch, seen), side="right")
        counts = data.batch(epoch, seen).action_mask[:, 0].numpy()
        np.testing.assert_array_equal(counts, goal == 1)
        assert {1, 2, 3} == set(goal.tolist())
    back = data.batch(0, np.arange(56, 100))  # from there on every goal is nearer once red is back
    assert back.action_mask.all()


def test_without_achieved_there_is_no_change_to_learn(tmp_path: Path) -> None:
    episode = make_episode(np.random.default_rng(0), 200)
    store = NativeStore.create(tmp_path / "play", StoreSpec.of(episode))
    with store.writer() as writer:
        writer.append(episode)
    config = DataConfig(settling=SettlingConfig(source="robot"), chunk=1, target="next_settled_delta", val_fraction=0.0)
    with pytest.raises(UsageError, match=r"data\.target: .* no change to learn; leave target at actions"):
        config.build(store, "train", 0)
