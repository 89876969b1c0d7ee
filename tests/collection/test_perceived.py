"""Laws of play that is learned from as an image encoder perceives it."""

import dataclasses
import functools
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from playlearn.collection.perceived import make_perceived
from playlearn.config import from_dict
from playlearn.dagger import DaggerConfig, dagger
from playlearn.data import AugmentedDataset, DataConfig
from playlearn.data.perceived import Perceived, PerceivedConfig, nearest
from playlearn.errors import CheckpointError, UsageError
from playlearn.policies import Policy
from playlearn.store import NativeStore, episode_path
from playlearn.store.tensors import map_tensors, read_header
from playlearn.training import train
from tests.fakes import point_expert
from tests.policies.test_behind import config, folder, play  # noqa: F401 - `folder` is a fixture

STATE = {"type": "state", "hidden": 16}


def test_errors_hold_until_halfway_to_the_next_look() -> None:
    assert nearest(np.array([2, 6, 11]), 13).tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 1, 2, 2, 2, 2]
    assert nearest(np.array([0]), 3).tolist() == [0, 0, 0]


def test_an_episode_is_looked_at_every_so_many_steps_and_at_its_end(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    store = NativeStore.open(folder / "play")
    make_perceived(PerceivedConfig(folder / "encoder", every=10), store, tmp_path, workers=0)
    policy = Policy.load(folder / "encoder" / "policy")
    for position, number in enumerate(store.indices().tolist()):
        file = read(tmp_path, number)
        last = len(store.array(position, "sim.state")) - 1
        assert file["t"].tolist() == sorted({*range(5, last + 1, 10), last})
        assert file["observed"].shape == file["wanted"].shape == (len(file["t"]), len(policy.spec.achieved_names))


@pytest.mark.slow
def test_examples_carry_what_the_encoder_gets_wrong_and_the_labels_of_the_truth(
    folder: Path,  # noqa: F811
    tmp_path: Path,
) -> None:
    """At a moment that was looked at, an example's numbers are the estimates themselves."""
    store = NativeStore.open(folder / "play")
    make_perceived(PerceivedConfig(folder / "encoder", every=3), store, tmp_path, workers=0)
    plain = DataConfig(history=2, chunk=4, val_fraction=0.0).build(store, "train", 5)
    varied = AugmentedDataset(plain, Perceived(tmp_path, plain))
    indices = np.arange(0, len(plain), 7)
    before, after = plain.batch(3, indices), varied.batch(3, indices)
    for entry in dataclasses.fields(before):
        made = getattr(before, entry.name)
        if isinstance(made, torch.Tensor) and entry.name not in ("achieved", "goal_achieved"):
            assert torch.equal(made, getattr(after, entry.name)), entry.name
    episodes, t = plain.where(indices)
    goals = plain.goals(3, indices)
    looked = {"now": 0, "before": 0, "goal": 0}
    for row, (position, step, goal) in enumerate(zip(episodes.tolist(), t.tolist(), goals.tolist(), strict=True)):
        file = read(tmp_path, int(store.indices()[position]))
        true = store.array(position, "achieved")
        errors = {name: file[name] - true[file["t"]] for name in ("observed", "wanted")}
        near = nearest(file["t"], len(true))
        for place, moment in ((1, step), (0, max(step - 1, 0))):
            estimated = after.achieved[row, place].numpy()
            np.testing.assert_allclose(estimated, true[moment] + errors["observed"][near[moment]], atol=1e-6)
            if moment in file["t"]:
                looked["now" if place else "before"] += 1
                np.testing.assert_allclose(estimated, file["observed"][list(file["t"]).index(moment)], atol=1e-6)
        np.testing.assert_allclose(
            after.goal_achieved[row].numpy(), true[goal] + errors["wanted"][near[goal]], atol=1e-6
        )
        looked["goal"] += goal in file["t"]
    assert min(looked.values()) > 5, looked


def test_only_episodes_that_are_missing_are_looked_at_again(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    store, config_ = NativeStore.open(folder / "play"), PerceivedConfig(folder / "encoder", every=20)
    make_perceived(config_, store, tmp_path, workers=0)
    numbers = store.indices().tolist()
    first, second = (episode_path(tmp_path, number) for number in numbers[:2])
    before = second.read_bytes()
    first.unlink()
    second.write_bytes(b"untouched")
    make_perceived(config_, store, tmp_path, workers=0)
    assert second.read_bytes() == b"untouched"
    second.write_bytes(before)
    assert read(tmp_path, numbers[0])["t"].size
    with pytest.raises(UsageError, match=r"another every: give the same, or name another perceived\.folder"):
        make_perceived(dataclasses.replace(config_, every=5), store, tmp_path, workers=0)


@pytest.mark.slow
def test_training_learns_from_it_and_validates_on_it(
    folder: Path,  # noqa: F811
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Own play and further play alike, held-out play too; the numbers' scale stays that of the truth."""
    monkeypatch.setattr("playlearn.collection.perceived.make_perceived", functools.partial(make_perceived, workers=0))
    more = [{"store": str(folder / "play"), "fraction": 0.5}]
    perceived = {"encoder": str(folder / "encoder"), "every": 10}
    fields = {"val_batches": 2, "val_every": 20, "extra_datasets": more}
    train(config(folder, STATE, **fields), tmp_path / "plain")
    train(config(folder, STATE, **fields, perceived=perceived), tmp_path / "perceived")
    assert sorted(path.name for path in (tmp_path / "perceived" / "perceived").iterdir()) == ["0", "1"]
    plain, seeing = (Policy.load(tmp_path / name / "policy") for name in ("plain", "perceived"))
    assert torch.equal(plain.normalizer.achieved_mean, seeing.normalizer.achieved_mean)
    losses = [val_losses(tmp_path / name)[0] for name in ("plain", "perceived")]
    assert losses[0] != losses[1], "before the first update the weights are the same, so the examples are not"


@pytest.mark.slow
def test_rollouts_behind_an_encoder_are_learned_as_it_perceives_them(
    folder: Path,  # noqa: F811
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("playlearn.collection.perceived.make_perceived", functools.partial(make_perceived, workers=0))
    fields = {
        "rollout_suite": str(folder / "suite.yaml"),
        "goal": "image",
        "encoder": str(folder / "encoder"),
        "perceived_every": 6,
        "rounds": 2,
        "episodes": 4,
        "policy_steps": [5, 20],
        "finish_steps": 60,
        "success_hold_steps": 4,
        "updates": 3,
        "eval_episodes": 2,
        "cpu": True,
    }
    dagger(from_dict(DaggerConfig, fields), folder / "state", tmp_path / "out", workers=0, expert=point_expert)
    looked = tmp_path / "out" / "perceived"
    assert sorted(path.name for path in looked.iterdir()) == ["0", "1", "2"]
    for number in (1, 2):
        gathered = NativeStore.open(tmp_path / "out" / "rounds" / str(number) / "play")
        note = json.loads((looked / str(number) / "perceived.json").read_text())
        assert note["episodes"] == {part: one for part, one in gathered.digests().items() if part != "spec"}
        assert len(list((looked / str(number) / "episodes").iterdir())) == len(gathered)


@pytest.mark.slow
def test_what_cannot_be_perceived_is_refused(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    store = NativeStore.open(folder / "play")
    with pytest.raises(CheckpointError, match="no run at"):
        make_perceived(PerceivedConfig(tmp_path / "none"), store, tmp_path / "a", workers=0)
    with pytest.raises(UsageError, match="makes no pose estimates"):
        make_perceived(PerceivedConfig(folder / "state"), store, tmp_path / "b", workers=0)
    perceived = {"encoder": str(folder / "encoder")}
    with pytest.raises(UsageError, match="sees images itself"):
        config(folder, {"type": "cnn"}, perceived=perceived)
    with pytest.raises(UsageError, match="neither corrections nor scenes"):
        config(folder, STATE, perceived=perceived, corrections={})
    with pytest.raises(UsageError, match=r"perceived\.every must be at least 1"):
        PerceivedConfig(folder / "encoder", every=0)
    with pytest.raises(UsageError, match="perceived_every must be 0 or more"):
        DaggerConfig(perceived_every=-1)
    other = play(tmp_path / "play", episodes=6)
    train(config(tmp_path, STATE), tmp_path / "state")
    with pytest.raises(UsageError, match="learned from other play"):
        train(config(tmp_path, STATE, perceived=perceived, init_from=str(tmp_path / "state")), tmp_path / "out")
    assert len(other) == 6


def read(path: Path, number: int) -> dict[str, np.ndarray]:
    file = episode_path(path, number)
    return {name: np.array(value) for name, value in map_tensors(file, read_header(file).layout).items()}


def val_losses(run: Path) -> list[float]:
    rows = map(json.loads, (run / "metrics.jsonl").read_text().splitlines())
    return [row["val/loss"] for row in rows if "val/loss" in row]
