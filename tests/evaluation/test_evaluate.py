"""Laws of evaluation, in a world in which everything takes milliseconds."""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
import yaml

from playlearn.config import save_config, to_dict
from playlearn.data.split import val_episodes
from playlearn.episode import Decision, Goal, Observation
from playlearn.errors import CheckpointError, PlaylearnError, UsageError
from playlearn.evaluation import (
    EvalEpisode,
    ExpertRecipe,
    RandomRecipe,
    SuiteConfig,
    TasksConfig,
    TrainedRecipe,
    ValPlayConfig,
    evaluate,
)
from playlearn.evaluation.job import _evaluate
from playlearn.evaluation.results import curve, summary
from playlearn.evaluation.worker import BatchResult, run_batch
from playlearn.executor import InProcessExecutor, Job, LostError, Result
from playlearn.policies import PolicyActor, PolicyConfig, PolicySpec
from playlearn.policies.encoders import CNNConfig
from playlearn.policies.trunks import MLPConfig
from playlearn.rollout import Actor, rollout
from playlearn.sim.environment import Environment
from playlearn.store import NativeStore, StoreSpec
from tests.fakes import PointConfig, PointEnv, PointExpert, PointPlayPolicy, point_expert

torch.set_num_threads(1)

SUITE = SuiteConfig(
    name="point_tasks",
    environment=PointConfig(),
    kind=TasksConfig(),
    episodes=10,
    max_steps=50,
    success_hold_steps=3,
    num_envs=4,
)
EXPERT = ExpertRecipe(point_expert)


def fumbling(_environment: Environment) -> PointExpert:
    return PointExpert(fumble=0.5)


def useless(_environment: Environment) -> PointExpert:
    return PointExpert(fumble=1.0)


def write(suite: SuiteConfig, folder: Path) -> Path:
    path = folder / f"{suite.name}.yaml"
    raw = {**to_dict(suite)}
    path.write_text(yaml.safe_dump(raw))
    return path


def spec(env: type[PointEnv] = PointEnv) -> PolicySpec:
    names = env.spec
    sizes = {"front": (24, 32), "wrist": (16, 16)}
    return PolicySpec(names.state_names, names.achieved_names, names.action_names, names.fps, sizes)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An untrained policy that reads goal states."""
    folder = tmp_path_factory.mktemp("runs") / "state"
    PolicyConfig(chunk=8).build(spec(), None, seed=0).save(folder / "policy")
    return folder


@pytest.fixture(scope="module")
def image_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One that reads goal images."""
    folder = tmp_path_factory.mktemp("runs") / "image"
    encoder = CNNConfig(cameras=("front",), goal_camera="front")
    trunk = MLPConfig(width=64)  # unlike a Transformer it imports nothing that each worker would have to import too
    PolicyConfig(encoder=encoder, trunk=trunk, chunk=8).build(spec(), None, seed=0).save(folder / "policy")
    return folder


def judged(suite: SuiteConfig, contenders: Sequence[Any], expert: ExpertRecipe = EXPERT) -> list[BatchResult]:
    return [run_batch(suite, cohort, contenders, expert) for cohort in suite.batches()]


def test_the_expert_can_and_chance_cannot(tmp_path: Path) -> None:
    """The proof that a suite can be solved, and not by luck; with every file that design.md names."""
    out = tmp_path / "out"
    results = evaluate(write(SUITE, tmp_path), policy="expert", goal="state", out=out, workers=0, expert=point_expert)
    assert results["success_rate"] == 1.0
    assert results["references"]["random"]["success_rate"] < 0.5
    assert results["references"]["expert"]["success_rate"] == results["success_rate"]
    assert json.loads((out / "results.json").read_text()) == results
    assert results["achieved_names"] == ["puck.x", "puck.y", "lamp"]
    assert {name: row["episodes"] for name, row in results["tasks"].items()} == {"move_puck": 5, "lamp_on": 5}
    assert (results["suite"], results["goal_modality"], results["episodes"]) == ("point_tasks", "state", 10)
    assert results["renderer"] == "numpy"
    assert results["ci95"] == pytest.approx([0.722, 1.0], abs=1e-3)  # Wilson, 10 of 10: 10 / (10 + 1.96^2)
    rows = pq.read_table(out / "episodes.parquet").to_pylist()
    assert [(row["policy"], row["episode"]) for row in rows] == [
        (p, e) for p in ("expert", "random") for e in range(10)
    ]
    assert sum(row["success"] for row in rows if row["policy"] == "expert") == 10


@pytest.mark.slow
def test_the_same_for_any_number_of_workers(tmp_path: Path, image_run: Path) -> None:
    """Cohorts are fixed by the suite, so two processes and none write the same rows, bit for bit."""
    suite = write(replace(SUITE, episodes=6, max_steps=20), tmp_path)
    tables, rates = [], []
    for workers in (0, 2):
        out = tmp_path / str(workers)
        rates.append(evaluate(suite, run=image_run, out=out, workers=workers, expert=point_expert))
        tables.append((out / "episodes.parquet").read_bytes())
    assert tables[0] == tables[1]
    assert {**rates[0], "seconds": 0} == {**rates[1], "seconds": 0}


def test_goals_are_what_was_really_reached() -> None:
    """From the recorded states: the goal's shows the goal, the judge accepts it, and the start is not there yet."""
    env = PointEnv(PointConfig())
    for result in judged(SUITE, [RandomRecipe()]):
        for episode_result in result.episode_results:
            env.set_state(np.array(episode_result.start_sim_state))
            start = env.observe().achieved
            env.set_state(np.array(episode_result.goal_sim_state))
            goal = env.observe().achieved
            np.testing.assert_array_equal(start, np.array(episode_result.start_achieved, np.float32))
            np.testing.assert_array_equal(goal, np.array(episode_result.goal_achieved, np.float32))
            judge = env.tasks[episode_result.task].judge
            assert judge(start, goal, goal)
            assert not judge(start, start, goal)
            assert env.tasks[episode_result.task].precondition(start)


def test_an_episode_is_the_same_whatever_is_beside_it() -> None:
    """Episode 5 in its cohort, alone, and beside fewer contenders."""
    beside = {
        a.policy: a
        for result in judged(SUITE, [EXPERT, RandomRecipe()])
        for a in result.episode_results
        if a.episode == 5
    }
    alone = run_batch(SUITE, [5], [RandomRecipe()], EXPERT).episode_results
    assert alone == (beside["random"],)


def test_where_the_expert_fumbles_another_start_is_drawn() -> None:
    """An expert that idles every other time: about one redraw an episode, and every goal still reached."""
    suite = replace(SUITE, episodes=24)
    episode_results = [a for result in judged(suite, [EXPERT], ExpertRecipe(fumbling)) for a in result.episode_results]
    assert 6 < sum(episode_result.redraws for episode_result in episode_results) < 96
    assert all(episode_result.success for episode_result in episode_results)


def test_a_task_that_the_expert_cannot_do_is_named() -> None:
    with pytest.raises(PlaylearnError, match=r"did not do task 'lamp_on' in 20 draws of episode 1 .*Leave it out"):
        run_batch(SUITE, [1], [RandomRecipe()], ExpertRecipe(useless))


def test_success_must_hold() -> None:
    """The expert stays where it arrived, so holding for 4 steps takes it 3 more than holding for 1."""
    short, long = (
        [a for result in judged(replace(SUITE, success_hold_steps=hold), [EXPERT]) for a in result.episode_results]
        for hold in (1, 4)
    )
    assert [b.steps - a.steps for a, b in zip(short, long, strict=True)] == [3] * 10
    suite = replace(SUITE, max_steps=20, success_hold_steps=20)
    assert not any(a.success for result in judged(suite, [EXPERT]) for a in result.episode_results if a.start_sim_state)


@dataclass(frozen=True)
class Crasher:
    """Fails in the middle of an episode."""

    name: str = "crasher"

    def cameras(self) -> tuple[str, ...]:
        return ()

    def describe(self) -> dict[str, Any]:
        return {}

    def build(self, environment: Environment) -> Actor:
        return _CrashingActor()


class _CrashingActor(PointExpert):
    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        if observations[0].time > 0.25:
            raise ZeroDivisionError("division by zero")
        return super().act(observations, active)


def test_a_crashed_rollout_is_a_failure_with_its_reason() -> None:
    """It never disappears, and those that come after it are judged as ever."""
    results = judged(SUITE, [Crasher(), EXPERT])
    crashed = [a for result in results for a in result.episode_results if a.policy == "crasher"]
    assert [a.episode for a in crashed] == list(range(10))
    assert {a.reason for a in crashed} == {"crashed: ZeroDivisionError: division by zero"}
    numbers = summary(crashed)
    assert (numbers["episodes"], numbers["crashed"], numbers["success_rate"]) == (10, 10, 0.0)
    assert all(a.success for result in results for a in result.episode_results if a.policy == "expert")


class LosesTheFirst(InProcessExecutor):
    """An executor whose first job's worker dies again and again."""

    def run(self, jobs: Iterable[Job], *, keep_going: bool = False) -> Iterator[Result]:
        first, *others = jobs
        yield Result(first.key, None, 0.0, tries=3, error=LostError(first, 3, "was killed"))
        yield from super().run(others, keep_going=keep_going)


def test_episodes_of_a_lost_worker_are_failures() -> None:
    gathered = _evaluate(SUITE, [EXPERT, RandomRecipe()], EXPERT, LosesTheFirst())
    assert sorted((a.episode, a.policy) for a in gathered.episode_results) == sorted(
        (e, policy) for e in range(10) for policy in ("expert", "random")
    )
    mine = [a for a in gathered.episode_results if a.policy == "expert"]
    assert sorted(a.episode for a in mine if not a.success) == [0, 1, 2, 3]
    assert summary(mine)["crashed"] == 4


def test_the_curve_ends_at_the_success_rate() -> None:
    episode_results = [a for result in judged(SUITE, [EXPERT]) for a in result.episode_results]
    shares = curve(episode_results, SUITE.max_steps)
    assert len(shares) == SUITE.max_steps + 1
    assert shares[0] == 0.0
    assert shares == sorted(shares)
    assert shares[-1] == summary(episode_results)["success_rate"]


def play(folder: Path, episodes: int = 12) -> NativeStore:
    envs = [PointEnv(PointConfig()) for _ in range(episodes)]
    for seed, env in enumerate(envs):
        env.reset(seed)
    outcomes = rollout(envs, PointPlayPolicy(), [None] * episodes, seeds=range(episodes), max_steps=300)
    made = [outcome.episode for outcome in outcomes if outcome.episode is not None]
    store = NativeStore.create(folder, StoreSpec.of(made[0]))
    with store.writer() as writer:
        for episode in made:
            writer.append(episode)
    return NativeStore.open(folder)


def test_heldout_play_gives_starts_and_goals(tmp_path: Path, run: Path) -> None:
    """Both are recorded moments of the same held-out episode, 1 to 2 s apart, and differ."""
    store = play(tmp_path / "play")
    kind = ValPlayConfig(store=tmp_path / "play", val_fraction=0.25, seconds=(1.0, 2.0))
    env = PointEnv(PointConfig())
    out = np.flatnonzero(val_episodes(store.indices(), 0.25))
    recorded = {tuple(state): (int(i), t) for i in out for t, state in enumerate(store.array(int(i), "sim.state"))}
    for e in range(20):
        setup: EvalEpisode = kind.setup(env, PointExpert(), e, 0, 50, ("front",))
        (i, t), (j, g) = recorded[tuple(setup.start)], recorded[tuple(setup.goal_sim_state)]
        assert i == j
        assert 10 <= g - t <= 20
        assert not env.reached(setup.start_achieved, setup.goal.achieved)
        np.testing.assert_array_equal(setup.goal.achieved, store.array(i, "achieved")[g])
        env.set_state(setup.goal_sim_state)
        np.testing.assert_array_equal(setup.goal.images["front"], env.render("front"))
        assert set(setup.task.split(" + ")) <= {"puck", "lamp"}


@pytest.mark.slow
def test_heldout_play_of_the_run_itself(tmp_path: Path, run: Path) -> None:
    """Store and share are read from the run's own config where the suite leaves them open."""
    play(tmp_path / "play")
    folder = tmp_path / "run"
    PolicyConfig(chunk=8).build(spec(), None, seed=0).save(folder / "policy")
    (folder / "config.yaml").write_text(
        yaml.safe_dump({"store": str(tmp_path / "play"), "data": {"val_fraction": 0.5}})
    )
    kind = ValPlayConfig(seconds=(1.0, 2.0))
    assert kind.prepare(folder) == replace(kind, store=tmp_path / "play", val_fraction=0.5)
    suite = write(replace(SUITE, name="val", kind=kind, episodes=6), tmp_path)
    results = evaluate(suite, run=folder, goal="state", out=tmp_path / "out", workers=0, expert=point_expert)
    assert results["references"]["expert"]["success_rate"] > 0.6
    assert results["strict_rate"] == results["success_rate"], "here success is that everything is where it is shown"
    with pytest.raises(UsageError, match="name its store"):
        kind.prepare(None)


def test_the_policy_is_shown_the_goal_its_way(image_run: Path) -> None:
    """A policy that reads images gets the goal's image in the size of its own camera."""
    seen: list[Goal] = []

    class Spy(TrainedRecipe):
        def build(self, environment: Environment) -> Actor:
            actor = super().build(environment)
            reset = actor.reset
            actor.reset = lambda goals, seeds: (seen.extend(g for g in goals if g), reset(goals, seeds))  # type: ignore[method-assign,assignment,func-returns-value]
            return actor

    run_batch(replace(SUITE, max_steps=30), [0], [Spy(image_run, "image")], EXPERT)
    assert [goal.images["front"].shape for goal in seen] == [(24, 32, 3)]


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"goal": "picture"}, UsageError, "--goal is 'picture'"),
        ({"goal": "image"}, UsageError, "reads its goal from a state: use --goal state"),
        ({"policy": "expert"}, UsageError, "either --run RUN"),
        ({"run": None}, UsageError, "either --run RUN"),
        ({"run": None, "policy": "exprt"}, UsageError, "did you mean `expert`"),
        ({"run": Path("nowhere")}, CheckpointError, "there is no run at nowhere; make one with"),
        ({"suite": Path("nowhere.yaml")}, UsageError, r"nowhere\.yaml"),
        ({"episodes": 0}, UsageError, "episodes must be 1 or more"),
        ({"workers": -1}, UsageError, "workers is -1"),
        ({"overrides": ("--kind.tasks", "[lamp_of]")}, UsageError, "did you mean `lamp_on`"),
        ({"overrides": ("--max_step", "9")}, UsageError, "max_steps"),
    ],
)
def test_mistakes_end_before_anything_is_written(
    tmp_path: Path, run: Path, change: dict[str, Any], error: type[PlaylearnError], message: str
) -> None:
    out = tmp_path / "out"
    arguments: dict[str, Any] = {"suite": write(SUITE, tmp_path), "run": run, "goal": "state", "out": out, "workers": 0}
    with pytest.raises(error, match=message):
        evaluate(**{**arguments, "expert": point_expert, **change})
    assert not out.exists() or not list(out.iterdir())


def test_a_policy_of_another_scene_is_refused(tmp_path: Path) -> None:
    """Its achieved goal has a drawer, this world has none; nothing is simulated."""
    other = replace(spec(), achieved_names=("puck.x", "puck.y", "drawer"))
    PolicyConfig(chunk=8).build(other, None, seed=0).save(tmp_path / "run" / "policy")
    arguments: dict[str, Any] = {"run": tmp_path / "run", "goal": "state", "out": tmp_path / "out", "workers": 0}
    with pytest.raises(CheckpointError, match="drawer"):
        evaluate(write(SUITE, tmp_path), **arguments, expert=point_expert)


def test_a_policy_of_another_robot_is_refused(tmp_path: Path) -> None:
    """The numbers have the same names, but the same action would move something else."""
    other = replace(spec(), controller={"type": "OSC_POSE"})
    PolicyConfig(chunk=8).build(other, None, seed=0).save(tmp_path / "run" / "policy")
    with pytest.raises(CheckpointError, match="controller type OSC_POSE, this suite's environment has VELOCITY"):
        TrainedRecipe(tmp_path / "run", "state").build(PointEnv(PointConfig()))


def test_subgoals_lead_a_policy(tmp_path: Path, run: Path, image_run: Path) -> None:
    """A proposer of no change has the policy shown the goal itself, time and again; the results name both."""
    proposes = replace(spec(), action_names=spec().achieved_names, predicts="next_settled_delta")
    proposer = PolicyConfig(chunk=1).build(proposes, None, seed=0)
    for parameter in proposer.head.parameters():
        parameter.data.zero_()
    proposer.save(tmp_path / "proposer" / "policy")
    shown: list[Goal] = []
    arguments: dict[str, Any] = {"goal": "state", "workers": 0, "expert": point_expert, "references": False}
    suite, given = write(SUITE, tmp_path), [f"--subgoals={tmp_path / 'proposer'}"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PolicyActor, "show", lambda self, row, goal: shown.append(goal))
        results = evaluate(suite, run=run, out=tmp_path / "out", episodes=2, overrides=given, **arguments)
    assert results["policy"]["subgoals"]["run"] == str(tmp_path / "proposer")
    table = pq.read_table(tmp_path / "out" / "episodes.parquet").to_pylist()
    assert len(shown) > 2
    assert {tuple(goal.achieved.tolist()) for goal in shown} == {tuple(row["goal_achieved"]) for row in table}
    with pytest.raises(UsageError, match="proposes subgoals and does not act: name it as --subgoals"):
        evaluate(suite, run=tmp_path / "proposer", out=tmp_path / "no", **arguments)
    with pytest.raises(UsageError, match="acts and proposes no subgoals"):
        evaluate(suite, run=run, out=tmp_path / "no", overrides=[f"--subgoals={run}"], **arguments)
    for goal in ("image", "state"):  # whichever is asked for, the message must not send one to the other
        with pytest.raises(UsageError, match="reads its goal from an image, and subgoals are states"):
            evaluate(suite, run=image_run, out=tmp_path / "no", overrides=given, **{**arguments, "goal": goal})


@pytest.mark.parametrize("name", ["playtable_tasks", "playtable_val"])
def test_the_suites_that_come_along_are_sound(name: str) -> None:
    from playlearn.evaluation import load_suite

    suite = load_suite(Path(__file__).parents[2] / "eval" / "suites" / f"{name}.yaml")
    assert suite.name == name
    assert to_dict(suite)["environment"]["type"] == "playtable"


def test_a_suite_is_the_same_after_writing_and_reading(tmp_path: Path) -> None:
    from playlearn.evaluation import load_suite

    save_config(SUITE, tmp_path / "suite.yaml")
    assert load_suite(tmp_path / "suite.yaml") == SUITE
