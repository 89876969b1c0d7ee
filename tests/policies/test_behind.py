"""Laws of a state policy that acts behind the image encoder of another run."""

from pathlib import Path

import pytest
import torch

from playlearn.collection.scenes import render_scenes
from playlearn.config import from_dict, save_config
from playlearn.dagger import DaggerConfig, dagger
from playlearn.data import ScenesConfig
from playlearn.data.split import val_episodes
from playlearn.errors import CheckpointError, UsageError
from playlearn.evaluation import TrainedRecipe, evaluate, join_runs
from playlearn.policies import Policy
from playlearn.privileges import Privileges
from playlearn.store import NativeStore
from playlearn.training import TrainConfig, train
from tests.evaluation.parts import SUITE, play
from tests.fakes import point_expert

torch.set_num_threads(1)
SEEING = {
    "type": "keypoints",
    "channels": [4],
    "kernels": [4],
    "strides": [4],
    "features": 8,
    "hidden": 16,
    "heatmaps": 2,
    "fusion": "late",
    "state_supervision": 1.0,
    "use_estimated_state": True,
    "feed_cameras": [],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Play without images, a state policy and an image encoder that learned from it apart, a suite."""
    path = tmp_path_factory.mktemp("behind")
    store = play(path / "play")
    val_mask = val_episodes(store.indices(), 0.05)
    render_scenes(ScenesConfig(per_episode=6), store, val_mask, ("front", "wrist"), path / "scenes", workers=0)
    save_config(SUITE, path / "suite.yaml")
    train(config(path, {"type": "state", "hidden": 16}), path / "state")
    learned = ["encoder.front.*", "encoder.others.*", "encoder.estimate.*"]
    scenes = {"per_episode": 6, "folder": str(path / "scenes")}
    train(config(path, SEEING, trainable=learned, scenes=scenes), path / "encoder")
    return path


def config(path: Path, encoder: dict[str, object], **more: object) -> TrainConfig:
    fields = {
        "store": str(path / "play"),
        "policy": {"encoder": encoder, "trunk": {"type": "mlp", "width": 16}, "chunk": 4},
        "batch_size": 16,
        "steps": 20,
        "warmup": 2,
        "lr": 2e-3,
        "ema_decay": 0.9,
        "val_batches": 0,
        "cpu": True,
    }
    return from_dict(TrainConfig, fields | more)


@pytest.mark.slow
def test_it_is_the_state_policy_with_the_encoder_of_the_other(folder: Path, tmp_path: Path) -> None:
    state, encoder = (Policy.load(folder / name / "policy").state_dict() for name in ("state", "encoder"))
    join_runs(folder / "state", folder / "encoder", tmp_path / "joined")
    joined = Policy.load(tmp_path / "joined" / "policy")
    weights = joined.state_dict()
    assert all(torch.equal(weights[name], value) for name, value in state.items())
    rest = weights.keys() - state.keys()
    assert all(torch.equal(weights[name], encoder[name]) for name in rest)
    assert rest
    assert all(name.startswith(("encoder.front.", "encoder.others.", "encoder.estimate.")) for name in rest)
    assert joined.config.encoder.goals == ("image",)
    assert (tmp_path / "joined" / "config.yaml").is_file()
    used = Privileges.of_run(tmp_path / "joined")
    assert used.training == (Privileges.of_run(folder / "state") | Privileges.of_run(folder / "encoder")).training
    assert used.goal == ()


@pytest.mark.slow
def test_eval_looks_through_it(folder: Path, tmp_path: Path) -> None:
    """The same episodes come out the same as those of the two joined into one run."""
    join_runs(folder / "state", folder / "encoder", tmp_path / "joined")
    rows = []
    for name, run, encoder in (("apart", folder / "state", folder / "encoder"), ("one", tmp_path / "joined", None)):
        results = evaluate(
            folder / "suite.yaml",
            run=run,
            encoder=encoder,
            goal="image",
            out=tmp_path / name,
            episodes=4,
            workers=0,
            references=False,
            expert=point_expert,
        )
        rows.append((tmp_path / name / "episodes.parquet").read_bytes())
        assert results["goal_modality"] == "image"
    assert rows[0] == rows[1]


@pytest.mark.slow
def test_dagger_rolls_it_out_so_and_continues_training_on_states(folder: Path, tmp_path: Path) -> None:
    """What it met behind the encoder is kept without images, and teaches the state policy."""
    fields = {
        "rollout_suite": str(folder / "suite.yaml"),
        "goal": "image",
        "encoder": str(folder / "encoder"),
        "perceived_every": 0,
        "rounds": 1,
        "episodes": 4,
        "policy_steps": [5, 20],
        "finish_steps": 60,
        "success_hold_steps": 4,
        "updates": 3,
        "eval_episodes": 4,
        "cpu": True,
    }
    results = dagger(
        from_dict(DaggerConfig, fields), folder / "state", tmp_path / "out", workers=0, expert=point_expert
    )
    gathered = NativeStore.open(tmp_path / "out" / "rounds" / "1" / "play")
    assert len(gathered) > 0
    assert gathered.cameras() == {}
    assert results["rounds"][1]["frames"] == gathered.lengths().sum()
    after = Policy.load(tmp_path / "out" / "policy")
    assert after.config.encoder.goals == ("state",)
    assert not torch.equal(after.state_dict()["encoder.goal_flag"], _weights(folder / "state")["encoder.goal_flag"])
    join_runs(tmp_path / "out", folder / "encoder", tmp_path / "joined")


@pytest.mark.slow
def test_what_does_not_fit_together_is_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="no run at"):
        TrainedRecipe(folder / "state", "image", encoder=tmp_path / "none").check()
    other = play(tmp_path / "play", episodes=6)
    train(config(tmp_path, {"type": "state", "hidden": 16}), tmp_path / "state")
    with pytest.raises(UsageError, match="learned from other play"):
        TrainedRecipe(tmp_path / "state", "image", encoder=folder / "encoder").check()
    assert len(other) == 6
    train(config(folder, {"type": "state", "hidden": 8}), tmp_path / "narrow")
    with pytest.raises(UsageError, match="has another"):
        TrainedRecipe(tmp_path / "narrow", "image", encoder=folder / "encoder").check()


def _weights(run: Path) -> dict[str, torch.Tensor]:
    weights: dict[str, torch.Tensor] = Policy.load(run / "policy").state_dict()
    return weights
