"""Laws of actor recipes: what a policy is shown, and which policies are refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import torch

from playlearn.episode import Goal
from playlearn.errors import CheckpointError, UsageError
from playlearn.evaluation import (
    TrainedRecipe,
    evaluate,
)
from playlearn.evaluation.worker import run_batch
from playlearn.policies import PolicyActor, PolicyConfig
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment
from tests.evaluation.parts import EXPERT, SUITE, spec, write
from tests.fakes import PointConfig, PointEnv, point_expert

torch.set_num_threads(1)


def test_the_policy_gets_the_goal_in_its_modality(image_run: Path) -> None:
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


@pytest.mark.slow
def test_a_policy_of_another_environment_is_refused(tmp_path: Path) -> None:
    """Its achieved goal has a drawer, this environment has none; nothing is simulated."""
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


@pytest.mark.slow
def test_subgoals_lead_a_policy(tmp_path: Path, run: Path, image_run: Path) -> None:
    """A high-level policy that proposes no change gives the low-level policy the goal itself; the results name both."""
    proposes = replace(spec(), action_names=spec().achieved_names, predicts="next_settled_delta")
    high_level = PolicyConfig(chunk=1).build(proposes, None, seed=0)
    for parameter in high_level.head.parameters():
        parameter.data.zero_()
    high_level.save(tmp_path / "proposer" / "policy")
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
