"""Laws of DAgger's rounds, in an environment in which everything takes milliseconds."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from playlearn.collection import CollectConfig
from playlearn.config import from_dict, load_config, save_config
from playlearn.dagger import DaggerConfig, dagger
from playlearn.dagger import job as module
from playlearn.dagger import rollouts as rollouts_module
from playlearn.dagger.actor import InterventionRule
from playlearn.dagger.gate import NoGateConfig
from playlearn.dagger.gather import GatherPlayConfig
from playlearn.dagger.rollouts import RolloutSpec, collect_rollouts
from playlearn.data import DataConfig
from playlearn.envs import PlayTableConfig
from playlearn.errors import CheckpointError, PlaylearnError, UsageError
from playlearn.evaluation import TrainedRecipe
from playlearn.oracles import PlayConfig
from playlearn.policies import Policy
from playlearn.relabeling.final_settled import FinalSettledConfig
from playlearn.relabeling.uniform import FutureConfig
from playlearn.store import NativeStore
from playlearn.training import TrainConfig, train
from tests.evaluation.parts import SUITE, play
from tests.fakes import PointConfig, PointEnv, PointExpert, PointPlayPolicy, point_expert
from tests.shares import often

torch.set_num_threads(1)
CONFIGS = sorted((Path(__file__).parents[2] / "configs" / "dagger").glob("*.yaml"))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy that has seen little: 30 updates on some play."""
    folder = tmp_path_factory.mktemp("dagger")
    play(folder / "play")
    save_config(SUITE, folder / "suite.yaml")
    fields = {
        "store": str(folder / "play"),
        "policy": {"encoder": {"type": "state", "hidden": 32}, "trunk": {"type": "mlp", "width": 64}, "chunk": 4},
        "batch_size": 64,
        "steps": 30,
        "lr": 2e-3,
        "warmup": 5,
        "val_batches": 1,
        "ema_decay": 0.9,
        "trainable": ["encoder.*", "trunk.*", "head.*"],
        "cpu": True,
    }
    train(from_dict(TrainConfig, fields), folder / "run")
    return folder / "run"


def described(run: Path, **changes: Any) -> DaggerConfig:
    """Two rounds of a few episodes."""
    fields = {
        "rollout_suite": str(run.parent / "suite.yaml"),
        "rounds": 2,
        "episodes": 6,
        "policy_steps": [5, 20],
        "finish_steps": 60,
        "success_hold_steps": 4,
        "n_action_steps": 2,
        "updates": 3,
        "warmup": 2,
        "eval_episodes": 4,
        "cpu": True,
    }
    return from_dict(DaggerConfig, fields | changes)


def go(config: DaggerConfig, run: Path, out: Path, **more: Any) -> dict[str, Any]:
    return dagger(config, run, out, workers=0, expert=point_expert, **more)


def test_rollouts_are_relabeled_with_the_commanded_goal(run: Path, tmp_path: Path) -> None:
    """Every example's goal is the episode's, within what counts as reached, whatever the policy did on the way."""
    rule = InterventionRule(0.0, 8, NoGateConfig(), (5, 20))
    spec = RolloutSpec(
        SUITE, TrainedRecipe(run, "state", 2), point_expert, rule, seed=5, finish_steps=60, success_hold_steps=4
    )
    records = collect_rollouts(spec, range(10, 20), tmp_path, 0, "rollouts")
    store, env = NativeStore.open(tmp_path / "play"), PointEnv(PointConfig())
    assert store.indices().tolist() == [row.episode for row in records if row.kept]
    assert len(store) >= 8
    data = DataConfig(chunk=4, goals=FinalSettledConfig(), val_fraction=0.0).build(store, "train", 0)
    batch = data.batch(0, np.arange(len(data)))
    own, _ = data.where(np.arange(len(data)))
    for position, number in enumerate(store.indices().tolist()):
        setup = SUITE.kind.setup(PointEnv(PointConfig()), PointExpert(), number, 5, SUITE.max_steps, ())
        goals = batch.goal_achieved.numpy()[own == position]
        assert len(goals) == store.lengths()[position]
        assert all(env.reached(goal, setup.goal.achieved) for goal in goals)
        episode = store.read(position)
        np.testing.assert_array_equal(episode.sim_state[0], setup.start_sim_state)
        assert (episode.meta.task, episode.meta.actor) == (setup.task, "dagger")
    assert sum(row.labels for row in records if row.kept) == store.lengths().sum() == len(data)
    assert sum(row.expert_steps for row in records if row.kept) == sum(
        store.read(i).intervention.sum() for i in range(len(store))
    )


@pytest.mark.slow
def test_an_expert_that_does_not_finish_is_counted_and_leaves_nothing(run: Path, tmp_path: Path) -> None:
    rule = InterventionRule(0.0, 8, NoGateConfig(), (1, 1))
    spec = RolloutSpec(
        SUITE, TrainedRecipe(run, "state", 2), point_expert, rule, seed=5, finish_steps=3, success_hold_steps=4
    )
    records = collect_rollouts(spec, range(4), tmp_path, 0, "rollouts")
    assert [(row.kept, row.ended, row.labels) for row in records] == [(False, "length", 4)] * 4
    assert len(NativeStore.open(tmp_path / "play")) == 0
    with pytest.raises(PlaylearnError, match="none of 6 episodes"):
        go(described(run, policy_steps=[1, 1], finish_steps=3), run, tmp_path / "out")


def test_a_blind_run_is_refused(run: Path, tmp_path: Path) -> None:
    config = load_config(TrainConfig, run / "config.yaml")
    pose = replace(config.policy, encoder=replace(config.policy.encoder, goal_proprio=True))
    goals = replace(config.data, goals=FutureConfig())
    train(replace(config, blind=True, policy=pose, data=goals, steps=1, val_batches=0), tmp_path / "run")
    with pytest.raises(UsageError, match=r"without object poses .*cannot be improved by DAgger"):
        go(described(run), tmp_path / "run", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_extra_datasets_of_the_run_keep_their_fractions(run: Path, tmp_path: Path) -> None:
    go(described(run, rounds=1), run, tmp_path / "first")
    go(described(run, rounds=1, fraction=0.2), tmp_path / "first", tmp_path / "second")
    before, gathered = load_config(TrainConfig, tmp_path / "second/config.yaml").extra_datasets
    assert (before.store, before.fraction) == (tmp_path / "first/rounds/1/play", pytest.approx(0.8 * 0.5))
    assert (gathered.store, gathered.fraction) == (tmp_path / "second/rounds/1/play", pytest.approx(0.2))


@pytest.mark.slow
def test_rounds(run: Path, tmp_path: Path) -> None:
    """Every round's row adds up, and OUT is a run like any other."""
    out = tmp_path / "out"
    config = described(run, beta={"type": "exponential"})
    results = go(config, run, out)
    assert json.loads((out / "results.json").read_text()) == results
    start, *rounds = results["rounds"]
    assert (start["round"], start["episodes"]) == (0, 4)
    for number, row in enumerate(rounds, 1):
        store = NativeStore.open(out / "rounds" / str(number) / "play")
        assert row["frames"] == store.lengths().sum()
        assert row["kept"] == len(store) <= row["attempted"] == 6
        assert store.indices().min() >= 6 * (number - 1)
        assert row["frames"] <= row["labels"]
        assert row["beta"] == 0.5 ** (number - 1)
        assert len(row["ci95"]) == 2
    assert (out / "plot.png").read_bytes()[:4] == b"\x89PNG"
    written = load_config(TrainConfig, out / "config.yaml")
    assert written.trainable == ("*",)  # all of the policy, whichever part its run trained
    assert sum(source.fraction for source in written.extra_datasets) == pytest.approx(0.5)
    assert [source.fraction for source in written.extra_datasets] == pytest.approx(
        [0.5 * row["frames"] / sum(row["frames"] for row in rounds) for row in rounds]
    )
    before, after = Policy.load(run / "policy").state_dict(), Policy.load(out / "policy").state_dict()
    same = {name: torch.equal(before[name], after[name]) for name in before}
    assert all(kept for name, kept in same.items() if name.startswith("normalizer"))
    assert not all(same.values())
    TrainedRecipe(out, "state").check()
    used = json.loads((out / "run.json").read_text())["privileged"]["training"]
    assert sorted(used) == ["clean labels", "expert", "object poses"]
    assert results["rounds"][-1]["privileged"]["training"] == used
    assert "expert" not in start["privileged"]["training"]

    with pytest.raises(UsageError, match="--resume"):
        go(config, run, out)
    with pytest.raises(UsageError, match="another fraction"):
        go(replace(config, fraction=0.3), run, out, resume=True)


@pytest.mark.slow
def test_a_killed_round_is_resumed_and_those_before_it_are_not_repeated(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed in round 2, once in its rollouts and once before its evaluation; the result is the same."""
    config, broken = described(run), tmp_path / "broken"
    whole = go(config, run, tmp_path / "whole")

    class Killed(BaseException):
        pass

    def evaluate(*arguments: Any, **more: Any) -> Any:
        if more["out"].parts[-2] == "2":
            raise Killed
        return plain(*arguments, **more)

    def set_up(spec: Any, numbers: Any, *others: Any) -> Any:
        if numbers[0] == 10:  # the second batch of round 2
            raise Killed
        return drawn(spec, numbers, *others)

    plain, drawn = module.evaluate, rollouts_module._set_up
    for place, name, strikes in ((rollouts_module, "_set_up", set_up), (module, "evaluate", evaluate)):
        with monkeypatch.context() as patch:
            patch.setattr(place, name, strikes)
            with pytest.raises(Killed):
                go(config, run, broken, resume=broken.exists())
    first = (broken / "rounds" / "1" / "round.json").stat().st_mtime_ns
    resumed = go(config, run, broken, resume=True)
    assert (broken / "rounds" / "1" / "round.json").stat().st_mtime_ns == first

    def rows(results: dict[str, Any]) -> list[dict[str, Any]]:
        return [{name: value for name, value in row.items() if name != "seconds"} for row in results["rounds"]]

    assert rows(resumed) == rows(whole)
    one, other = Policy.load(broken / "policy").state_dict(), Policy.load(tmp_path / "whole" / "policy").state_dict()
    assert all(torch.equal(one[name], other[name]) for name in one)


@pytest.mark.slow
@pytest.mark.parametrize("baseline", [pytest.param("play", marks=pytest.mark.slow), "noise"])
def test_a_baseline_adds_as_many_steps_of_play(
    baseline: str, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At least those of the matched run, less than an episode more; its play is that of the run but for noise."""
    played: list[PlayConfig] = []

    def play_policy(_env: Any, config: PlayConfig) -> PointPlayPolicy:
        played.append(config)
        return PointPlayPolicy()  # without noise: with it, it would grasp nothing

    monkeypatch.setattr("playlearn.collection.job.play_policy_for", play_policy)
    save_config(CollectConfig(environment=PointConfig(), steps=150, seed=3), run.parent / "play" / "collect.yaml")
    (tmp_path / "matched").mkdir()
    rows = [{"round": 0}, {"round": 1, "frames": 500}, {"round": 2, "frames": 160}]
    (tmp_path / "matched" / "results.json").write_text(json.dumps({"rounds": rows}))
    out = tmp_path / "out"
    results = go(described(run, gather={"type": baseline, "match_steps_of": str(tmp_path / "matched")}), run, out)
    assert [row["labels"] for row in results["rounds"][1:]] == [0, 0]
    for row, wanted in zip(results["rounds"][1:], (500, 160), strict=True):
        assert wanted <= row["frames"] < wanted + 150
    assert {config.noise for config in played} == {0.5 if baseline == "noise" else PlayConfig().noise}
    stores = [NativeStore.open(out / "rounds" / str(number) / "play") for number in (1, 2)]
    firsts = {tuple(store.array(0, "sim.state")[0]) for store in stores}
    assert len(firsts) == 2, "each round plays anew"
    assert [
        source.fraction for source in load_config(TrainConfig, out / "config.yaml").extra_datasets
    ] == pytest.approx(
        [0.5 * row["frames"] / sum(row["frames"] for row in results["rounds"][1:]) for row in results["rounds"][1:]]
    )
    with pytest.raises(UsageError, match="has 2 rounds"):
        go(
            described(run, gather={"type": baseline, "match_steps_of": str(tmp_path / "matched")}, rounds=3),
            run,
            tmp_path / "more",
        )


def test_mistakes_are_found_before_anything_runs(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(UsageError, match="no run at"):
        go(described(run), tmp_path / "nowhere", out)
    with pytest.raises(UsageError, match="'point' has no skill library"):
        dagger(described(run), run, out, workers=0)
    with pytest.raises(UsageError, match="seed of the rollouts"):
        go(described(run, eval_seed=module.derived_seed(module._ROLLOUTS, 0)), run, out)
    with pytest.raises(UsageError, match="never uncertain"):
        go(described(run, gate={"type": "uncertainty"}), run, out)
    with pytest.raises(UsageError, match=r"`gather\.match_steps_of` is missing"):
        described(run, gather={"type": "play"})
    with pytest.raises(UsageError, match="no DAgger run at"):
        go(described(run, gather={"type": "play", "match_steps_of": str(tmp_path)}), run, out)
    for wrong in (
        {"fraction": 1.0},
        {"fraction": 0},
        {"rounds": 0},
        {"policy_steps": [9, 3]},
        {"gate": {"type": "maybe"}},
    ):
        with pytest.raises(UsageError):
            described(run, **wrong)
    with pytest.raises(UsageError, match="use --goal state"):
        go(described(run, goal="image"), run, out)
    save_config(replace(SUITE, environment=PlayTableConfig()), tmp_path / "other.yaml")
    with pytest.raises(CheckpointError, match="another state"):
        go(described(run, rollout_suite=str(tmp_path / "other.yaml")), run, out)
    with pytest.raises(CheckpointError, match="another state"):
        go(described(run, suite=str(tmp_path / "other.yaml")), run, out)
    assert not out.exists()
    out.mkdir()
    (out / "mine").touch()
    with pytest.raises(UsageError, match="no DAgger run"):
        go(described(run), run, out)
    with pytest.raises(UsageError, match="to resume"):
        go(described(run), run, tmp_path / "none", resume=True)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_shipped_configs_are_whole(path: Path) -> None:
    config = load_config(DaggerConfig, path)
    assert config.rollout_suite.is_file()
    baseline = load_config(DaggerConfig, path, ["--gather.type=play", "--gather.match_steps_of=runs/x"])
    assert baseline.gather == GatherPlayConfig(Path("runs/x"))


def gained(run: Path, out: Path, seed: int) -> float:
    """By how much two rounds of DAgger raise the success rate, on 20 goals, of a policy of 30 updates."""
    out.mkdir()
    save_config(replace(SUITE, episodes=20, num_envs=20), out / "suite.yaml")
    config = described(
        run,
        rollout_suite=str(out / "suite.yaml"),
        episodes=20,
        policy_steps=[10, 50],
        n_action_steps=1,
        updates=150,
        lr=2e-3,
        warmup=10,
        eval_episodes=20,
        eval_seed=1,
        seed=seed,
    )
    start, *_, end = [row["success_rate"] for row in go(config, run, out / "run")["rounds"]]
    return float(end - start)


@pytest.mark.slow
def test_a_policy_that_can_do_next_to_nothing_gets_better(run: Path, tmp_path: Path) -> None:
    """By at least 4 of 20 goals in two rounds; tried beforehand, three longer rounds took it from 2 to 60 %."""
    assert often((gained(run, tmp_path / str(seed), seed) >= 0.2 for seed in range(4)), done=1)
