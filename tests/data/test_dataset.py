"""What a batch holds, and that it is a pure function of (seed, epoch, index)."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from playlearn.data import DataConfig, PlayDataset, statistics
from playlearn.data.split import val_episodes
from playlearn.errors import StoreError, UsageError
from playlearn.quantity import Quantities
from playlearn.relabeling import (
    FinalConfig,
    FixedConfig,
    GoalSamplerConfig,
    RelabelIndex,
    SettlingConfig,
    UniformConfig,
    counter_uniforms,
)
from playlearn.store import NativeStore, StoreSpec
from tests.data.parts import fields
from tests.synthetic import make_episode, make_store, red_then_lamp

torch.set_num_threads(1)
CAMERAS = {"front": (8, 10), "wrist": (6, 6)}
SEEN = DataConfig(cameras=("front", "wrist"), goal_cameras=("front",), history=3, chunk=8, val_fraction=0.0)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> NativeStore:
    return make_store(tmp_path_factory.mktemp("data") / "play", np.random.default_rng(0), 5, 120, CAMERAS)


@pytest.mark.parametrize("kind", sorted(GoalSamplerConfig.get_known_choices()))
@pytest.mark.parametrize("mask_after_goal", [False, True])
def test_every_example_says_what_the_episode_says(store: NativeStore, kind: str, mask_after_goal: bool) -> None:
    goals = GoalSamplerConfig.get_choice_class(kind)()
    config = dataclasses.replace(SEEN, goals=goals, mask_after_goal=mask_after_goal)
    data = config.build(store, "train", 3)
    indices = np.concatenate([[0, len(data) - 1], data.epoch_indices(2)[:40]])
    batch, goal = data.batch(2, indices), data.goals(2, indices)
    for b, (e, t, g) in enumerate(zip(*data.where(indices), goal, strict=True)):
        episode = store.read(int(e))
        past = [max(0, t - 2), max(0, t - 1), t]
        np.testing.assert_array_equal(batch.state[b], episode.state[past])
        np.testing.assert_array_equal(batch.achieved[b], episode.achieved[past])
        assert batch.history_mask[b].tolist() == [t >= 2, t >= 1, True]
        leads = t < g <= len(episode)
        shown, there = episode, g
        if not 0 <= g <= len(episode):  # another episode of the split, as the flat numbering goes on
            row = data.table.rows[np.flatnonzero(data.episodes == e)[0]] + g
            place = int(np.searchsorted(data.table.rows, row, side="right")) - 1
            shown, there = store.read(int(data.episodes[place])), int(row - data.table.rows[place])
        np.testing.assert_array_equal(batch.goal_achieved[b], shown.achieved[there])
        np.testing.assert_array_equal(batch.goal_proprio[b], shown.state[there])
        np.testing.assert_array_equal(batch.goal_images["front"][b], shown.images["front"][there])
        for camera in CAMERAS:
            np.testing.assert_array_equal(batch.images[camera][b], episode.images[camera][past])
        limit = g if mask_after_goal and leads else len(episode)
        for h in range(8):
            assert bool(batch.action_mask[b, h]) == (t + h < limit)
            if t + h < len(episode):
                np.testing.assert_array_equal(batch.action[b, h], episode.expert_action[t + h])
        assert batch.steps_to_goal[b] == (g - t if leads else 0)
    assert bool(batch.action_mask[:, 0].all())  # at least one action leads to a goal


def test_shapes_and_types(store: NativeStore) -> None:
    batch = SEEN.build(store, "train", 0).batch(0, np.arange(4))
    assert {name: (tuple(value.shape), value.dtype) for name, value in fields(batch).items()} == {
        "state": ((4, 3, 4), torch.float32),
        "achieved": ((4, 3, 7), torch.float32),
        "images.front": ((4, 3, 8, 10, 3), torch.uint8),
        "images.wrist": ((4, 3, 6, 6, 3), torch.uint8),
        "history_mask": ((4, 3), torch.bool),
        "goal_achieved": ((4, 7), torch.float32),
        "goal_proprio": ((4, 4), torch.float32),
        "goal_images.front": ((4, 8, 10, 3), torch.uint8),
        "action": ((4, 8, 4), torch.float32),
        "action_mask": ((4, 8), torch.bool),
        "steps_to_goal": ((4,), torch.int64),
    }
    assert len(batch) == 4
    moved = batch.to("meta")
    assert {value.device.type for value in fields(moved).values()} == {"meta"}


def test_an_example_depends_only_on_seed_epoch_and_index(store: NativeStore) -> None:
    data = DataConfig(val_fraction=0.0).build(store, "train", 1)
    indices = np.arange(60)
    whole = data.goals(4, indices)
    assert [int(data.goals(4, np.array([i]))[0]) for i in indices] == whole.tolist()
    np.testing.assert_array_equal(data.goals(4, indices[::-1]), whole[::-1])
    np.testing.assert_array_equal(DataConfig(val_fraction=0.0).build(store, "train", 1).goals(4, indices), whole)
    # Goals are drawn from intervals of 20 and more steps: two draws of 60 are never alike throughout.
    assert (data.goals(5, indices) != whole).any()
    assert (DataConfig(val_fraction=0.0).build(store, "train", 2).goals(4, indices) != whole).any()


def test_an_epoch_has_each_example_once(store: NativeStore) -> None:
    data = DataConfig(val_fraction=0.0).build(store, "train", 0)
    orders = [data.epoch_indices(epoch) for epoch in range(2)]
    for order in orders:
        assert sorted(order.tolist()) == list(range(len(data)))
    assert orders[0].tolist() != orders[1].tolist()
    assert orders[0].tolist() == data.epoch_indices(0).tolist()


def test_the_splits_share_no_episode(store: NativeStore) -> None:
    train, val = (DataConfig(val_fraction=0.25).build(store, split, 0) for split in ("train", "val"))
    assert sorted([*train.episodes, *val.episodes]) == [0, 1, 2, 3, 4]
    assert set(train.where(np.arange(len(train)))[0].tolist()) <= set(train.episodes.tolist())
    assert set(val.where(np.arange(len(val)))[0].tolist()) <= set(val.episodes.tolist())


@pytest.mark.parametrize("kind", sorted(GoalSamplerConfig.get_known_choices()))
@pytest.mark.parametrize("split", ["train", "val"])
def test_no_goal_is_of_the_other_split(store: NativeStore, kind: str, split: str) -> None:
    """A synthetic picture's first pixel names the episode it is of."""
    goals = GoalSamplerConfig.get_choice_class(kind)()
    data = dataclasses.replace(SEEN, goals=goals, val_fraction=0.5).build(store, split, 0)
    assert 0 < len(data.episodes) < len(store)
    shown = data.batch(np.arange(200), data.epoch_indices(0)[np.arange(200) % len(data)]).goal_images["front"]
    assert set(shown[:, 0, 0, 1].tolist()) <= set(data.episodes.tolist())


def test_more_play_moves_no_episode_across() -> None:
    all_of_them = val_episodes(np.arange(2000), 0.05)
    assert all_of_them.sum() == 100  # one of each block of 20
    np.testing.assert_array_equal(val_episodes(np.arange(700), 0.05), all_of_them[:700])
    assert val_episodes(np.arange(3), 0.05).tolist() == [True, False, False]
    # Not every 20th: what goes round with the number (who plays, say) is on both sides.
    assert len(set((np.flatnonzero(all_of_them) % 20).tolist())) > 10
    assert not val_episodes(np.arange(50), 0.0).any()


def test_balance_draws_rare_changes_as_often_as_common_ones(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    steps = 300
    # The lamp changes in 1 episode of 10, red in the others: nothing else ever does.
    episodes = []
    for index in range(10):
        achieved = np.zeros((steps + 1, 7), np.float32)
        achieved[150:, 6 if index == 4 else 0] = 1.0
        episodes.append(dataclasses.replace(make_episode(rng, steps), achieved=achieved))
    store = NativeStore.create(tmp_path / "play", StoreSpec.of(episodes[0]))
    with store.writer() as writer:
        for episode in episodes:
            writer.append(episode)
    for balance, share in ((0.0, 1 / 10), (0.5, 1 / (1 + 3)), (1.0, 1 / 2)):  # counts 1 : 9, to the power 1 - balance
        data = DataConfig(val_fraction=0.0, balance=balance).build(store, "train", 0)
        drawn = data.epoch_indices(0)
        assert len(drawn) == len(data)
        assert abs((data.where(drawn)[0] == 4).mean() - share) < 2 / len(data)


def test_only_what_the_goal_speaks_of_settles_and_is_balanced(tmp_path: Path) -> None:
    """Red moves at observation 50 and the lamp goes on at 100, each at rest 6 steps (0.3 s) later."""
    store = red_then_lamp(tmp_path / "play")
    for names, moments in ((("*",), [56, 106]), (("red.*",), [56]), (("*.x", "lamp.on"), [56, 106]), (("l*",), [106])):
        data = DataConfig(goal_names=names, val_fraction=0.0, balance=1.0).build(store, "train", 0)
        assert data.table.moments.tolist() == moments
        assert len(data) == moments[-1]  # every step before the last settled moment has a goal
        # The kinds of change that are left share the epoch: one of them alone has all of it.
        kinds = data.where(data.epoch_indices(0))[1] < 56
        assert abs(kinds.mean() - {(56, 106): 0.5, (56,): 1.0, (106,): 56 / 106}[tuple(moments)]) < 2 / len(data)
        assert data.batch(0, np.arange(2)).goal_achieved.shape == (2, 7)  # the batch says everything, as ever
    with pytest.raises(UsageError, match=r"goal_names: 'green\.\*' matches none of: red\.x"):
        DataConfig(goal_names=("green.*",), val_fraction=0.0).build(store, "train", 0)


def test_both_splits_have_the_thresholds_of_what_is_trained_on(tmp_path: Path) -> None:
    """Red moves 0.1 m in the episode that is trained on, 0.012 m in the held-out one: a change there, were it alone."""
    moved = [np.zeros((201, 7), np.float32) for _ in range(2)]
    moved[0][50:, 0], moved[1][50:, 0] = 0.012, 0.1
    first = make_episode(np.random.default_rng(0), 200)
    store = NativeStore.create(tmp_path / "play", StoreSpec.of(first))
    with store.writer() as writer:
        for achieved in moved:
            writer.append(dataclasses.replace(first, achieved=achieved))
    measured = SettlingConfig(change={"default": None}, rest={"default": None})
    config = DataConfig(goals=FinalConfig(), settling=measured, val_fraction=0.5)
    splits = {split: config.build(store, split, 0) for split in ("train", "val")}
    assert splits["val"].episodes.tolist() == [0]
    assert len(splits["train"].table.moments) == 1
    assert len(splits["val"].table.moments) == 0  # 0.012 is less than a seventh of 0.1


def test_a_recording_without_achieved_has_goals_from_the_robot(tmp_path: Path) -> None:
    """As a real robot's: the hand shuts at 40 and opens at 100; goals are images, and nothing is achieved (G = 0)."""
    made = make_episode(np.random.default_rng(0), 200, ("front",))
    state = np.zeros((201, 4), np.float32)
    state[:, 3] = 0.08
    state[40:100, 3] = 0.0
    episode = dataclasses.replace(
        made,
        meta=dataclasses.replace(made.meta, achieved_names=(), quantities=Quantities()),
        state=state,
        achieved=np.zeros((201, 0), np.float32),
        sim_state=np.zeros((201, 0)),
    )
    store = NativeStore.create(tmp_path / "real", StoreSpec.of(episode))
    with store.writer() as writer:
        writer.append(episode)
    assert store.verify() == []
    data = DataConfig(cameras=("front",), goal_cameras=("front",), val_fraction=0.0).build(store, "train", 0)
    assert data.table.moments.tolist() == [100]
    batch = data.batch(0, np.arange(100))
    assert batch.achieved.shape == (100, 1, 0)
    assert batch.goal_achieved.shape == (100, 0)
    assert set(batch.goal_images["front"][:, 0, 0, 0].tolist()) <= set(range(100, 201))  # the observation's number
    assert (batch.goal_proprio[:, 3] == np.float32(0.08)).all()
    assert statistics(data)["achieved"].mean.shape == (0,)
    # The same may be asked of a store that has it.
    settling = SettlingConfig(source="robot")
    assert RelabelIndex.of_store(make_store(tmp_path / "play", np.random.default_rng(0), 1, 60), settling).names == (
        "gripper.opened",
        "arm.stopped",
    )


def test_a_fraction_of_the_failing_examples_is_kept(tmp_path: Path) -> None:
    """In each of 10 episodes: pushes with a slip at 40 ... 43, then opens with nothing amiss: 44 of 200 steps fail."""
    rng = np.random.default_rng(0)
    numbers = np.zeros(200, np.int16)
    numbers[40:44], numbers[100:] = 1, 2
    store = None
    for _ in range(10):
        made = make_episode(rng, 200)
        meta = dataclasses.replace(made.meta, skills=("push", "push:slip", "open"))
        episode = dataclasses.replace(made, meta=meta, skill=numbers.copy())
        store = store or NativeStore.create(tmp_path / "play", StoreSpec.of(episode))
        with store.writer() as writer:
            writer.append(episode)
    kept = {}
    for share in (1.0, 0.5, 0.0):
        config = DataConfig(goals=FinalConfig(), val_fraction=0.0, failure_fraction=share)
        data = config.build(store, "train", int(10 * share))  # whatever the seed
        episodes, t = data.where(np.arange(len(data)))
        assert (t >= 44).sum() == 10 * 156  # the recovery and what comes later are all there
        kept[share] = set(zip(episodes.tolist(), t.tolist(), strict=True))
        assert len(data) == len(kept[share])
    assert len(kept[1.0]) == 2000
    assert len(kept[0.0]) == 1560
    # Of 440 half: standard deviation 10.5. Those kept stay so at a larger share, and beside other episodes.
    assert abs(len(kept[0.5]) - 1560 - 220) < 5 * 10.5
    assert kept[0.0] < kept[0.5] < kept[1.0]
    parted = DataConfig(goals=FinalConfig(), val_fraction=0.5, failure_fraction=0.5).build(store, "train", 0)
    some = set(zip(*(part.tolist() for part in parted.where(np.arange(len(parted)))), strict=True))
    assert some == {(e, t) for e, t in kept[0.5] if e in parted.episodes}


def test_counter_uniforms_are_even_and_independent() -> None:
    drawn = counter_uniforms(5, 0, np.arange(100_000), 2)
    assert drawn.min() >= 0
    assert drawn.max() < 1
    # Standard errors: of a mean 0.289 / sqrt(100,000) = 0.0009, of a correlation 0.0032.
    assert (np.abs(drawn.mean(axis=0) - 0.5) < 0.004).all()
    assert (np.abs(np.histogram(drawn[:, 0], 10, (0, 1))[0] - 10_000) < 5 * 95).all()
    neighbors = np.stack([drawn[:-1, 0], drawn[1:, 0], drawn[:-1, 1]])
    assert np.abs(np.corrcoef(neighbors) - np.eye(3)).max() < 0.016
    later = counter_uniforms(5, 1, np.arange(100_000), 2)
    assert abs(np.corrcoef(drawn[:, 0], later[:, 0])[0, 1]) < 0.016
    # One epoch for all, or the same one each: no difference.
    np.testing.assert_array_equal(counter_uniforms(5, np.ones(100_000, np.int64), np.arange(100_000), 2), later)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"history": 0}, r"data\.history"),
        ({"chunk": 0}, r"data\.chunk"),
        ({"val_fraction": 1.5}, r"data\.val_fraction"),
        ({"balance": -0.5}, r"data\.balance"),
        ({"failure_fraction": 2.0}, r"data\.failure_fraction"),
        ({"goals": UniformConfig(horizon=0.0)}, r"uniform\.horizon"),
    ],
)
def test_a_setting_out_of_range_is_named(store: NativeStore, change: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        PlayDataset(store, dataclasses.replace(DataConfig(), **change))


def test_what_the_store_lacks_is_said_before_anything_is_read(store: NativeStore, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no images of side \(it has: front 8x10, wrist 6x6\).*playlearn render"):
        DataConfig(goal_cameras=("side",)).build(store, "train", 0)
    with pytest.raises(UsageError, match="train or val"):
        DataConfig().build(store, "test", 0)
    with pytest.raises(StoreError, match="no val episodes"):
        DataConfig(val_fraction=0.0).build(store, "val", 0)
    short = make_store(tmp_path / "short", np.random.default_rng(0), 2, 5)
    with pytest.raises(StoreError, match=r"no train step has a goal.*`goals`"):
        DataConfig(goals=FixedConfig(seconds=10.0)).build(short, "train", 0)


def test_a_chunk_ends_with_the_step_that_deviates_from_its_label(store: NativeStore) -> None:
    """Written out step by step: label h counts while no step before it deviates by more than the threshold."""
    config = dataclasses.replace(
        SEEN, max_label_deviation=0.12
    )  # synthetic play errs with a spread of 0.05: some 1 in 15 steps
    data = config.build(store, "train", 0)
    indices = data.epoch_indices(0)[:60]
    masks, ended = data.batch(0, indices).action_mask, 0
    for (e, t), mask in zip(zip(*data.where(indices), strict=True), masks, strict=True):
        episode = store.read(int(e))
        counts = True
        for h in range(8):
            counts = counts and t + h < len(episode)
            assert bool(mask[h]) == counts
            if counts and np.abs(episode.action[t + h] - episode.expert_action[t + h]).max() > 0.12:
                counts, ended = False, ended + 1
    assert ended > 10
    with pytest.raises(UsageError, match="max_label_deviation"):
        dataclasses.replace(SEEN, max_label_deviation=0.0).build(store, "train", 0)


def test_only_what_an_expert_corrected_is_learned(tmp_path: Path) -> None:
    """Steps 20 to 29 and 50 to 52 are corrections: no label outside of them counts, no example begins there."""
    took_over = np.zeros(80, np.bool_)
    took_over[[*range(20, 30), *range(50, 53)]] = True
    own = make_episode(np.random.default_rng(0), 80)
    corrected = dataclasses.replace(own, intervention=took_over, action=own.expert_action)
    store = NativeStore.create(tmp_path / "rollouts", StoreSpec.of(own))
    with store.writer() as writer:
        for episode in (corrected, dataclasses.replace(corrected, intervention=~took_over)):
            writer.append(episode)
    config = DataConfig(chunk=8, val_fraction=0.0, goals=FinalConfig(), interventions_only=True)
    data = config.build(store, "train", 0)
    assert len(data) == 80  # what is a correction in one of the two is none in the other
    places = np.arange(len(data))
    masks = data.batch(0, places).action_mask.numpy()
    for e, t, mask in zip(*data.where(places), masks, strict=True):
        counts = np.append(store.array(int(e), "intervention")[t : t + 8], np.zeros(8, np.bool_))[:8]
        assert counts[0]
        assert mask.tolist() == np.logical_and.accumulate(counts).tolist()
    with pytest.raises(StoreError, match=r"nobody took over at any step \(`intervention`\): set it to false"):
        config.build(make_store(tmp_path / "play", np.random.default_rng(0), 1, 60), "train", 0)
