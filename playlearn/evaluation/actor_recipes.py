"""Who is judged: a trained policy, the scripted expert (an upper bound) and chance (what luck gives).

A contender is a recipe that travels to a worker process and builds its actor there.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, Protocol

from playlearn.config import atomic_write, to_dict
from playlearn.errors import CheckpointError, UsageError
from playlearn.evaluation.suite import SuiteConfig
from playlearn.policies import Policy
from playlearn.policies.execution import PolicyActor
from playlearn.policies.hierarchical import SubgoalActor
from playlearn.rollout import Actor, RandomActor
from playlearn.sim.environment import Environment


class ActorRecipe(Protocol):
    """name: its row in the report."""

    @property
    def name(self) -> str: ...

    def cameras(self) -> tuple[str, ...]:
        """What the goal must be shown through."""
        ...

    def build(self, environment: Environment) -> Actor:
        """Raises PlaylearnError where it cannot act in this environment."""
        ...

    def describe(self) -> dict[str, Any]:
        """For results.json."""
        ...


def scripted(environment: Environment) -> Actor:
    """The environment's own scripted expert; raises UsageError where it has none."""
    # Seconds to import: only who asks it pays.
    from playlearn.oracles import expert_for

    return expert_for(environment)


@dataclass(frozen=True)
class ExpertRecipe:
    """The environment's scripted expert, as `make(environment)` builds it."""

    make: Callable[[Environment], Actor]
    name: str = "expert"

    def cameras(self) -> tuple[str, ...]:
        return ()

    def build(self, environment: Environment) -> Actor:
        return self.make(environment)

    def describe(self) -> dict[str, Any]:
        return {"type": self.name}


@dataclass(frozen=True)
class RandomRecipe:
    """Smooth random actions."""

    name: str = "random"

    def cameras(self) -> tuple[str, ...]:
        return ()

    def build(self, environment: Environment) -> Actor:
        return RandomActor(len(environment.spec.action_names))

    def describe(self) -> dict[str, Any]:
        return {"type": self.name}


@dataclass(frozen=True)
class TrainedRecipe:
    """A policy that `playlearn train` left in `run`, shown its goal as `goal` ("image" or "state").

    encoder: a run whose image encoder a state policy looks through.
    n_action_steps: actions of a chunk carried out before it plans again (null: half of them).
    guidance: weight of the goal.
    predicts: what it must have learned to say.
    """

    run: Path
    goal: str
    n_action_steps: int | None = None
    guidance: float | None = None
    name: str = "policy"
    predicts: Literal["actions", "next_settled_delta"] = "actions"
    encoder: Path | None = None

    def policy(self) -> Policy:
        """The policy itself, read once a process."""
        return load_policy(self.run / "policy", None if self.encoder is None else self.encoder / "policy")

    def check(self) -> None:
        """What can be checked without a simulator.

        Raises:
            CheckpointError: no policy there, or not a whole one.
            UsageError: it says something else, or does not read goals of this modality.
        """
        if not self.run.is_dir():
            raise CheckpointError(f"there is no run at {self.run}; make one with: playlearn train --out {self.run}")
        if self.encoder is not None and not self.encoder.is_dir():
            raise CheckpointError(f"there is no run at {self.encoder} whose image encoder could be used")
        policy = self.policy()
        if policy.spec.predicts != self.predicts:
            raise UsageError(f"{self.run} {_OTHERWISE[self.predicts]}")
        reads = policy.config.encoder.goals
        if self.goal not in reads:
            raise UsageError(f"{self.run} reads its goal from {_ARTICLE[reads[0]]}: use --goal {reads[0]}")

    def cameras(self) -> tuple[str, ...]:
        return self.policy().cameras

    def build(self, environment: Environment) -> PolicyActor:
        policy = self.policy()
        missing = [camera for camera in policy.cameras if camera not in environment.spec.cameras]
        seen = {} if missing else environment.observe(policy.cameras).images
        policy.check(environment.spec, {camera: (image.shape[0], image.shape[1]) for camera, image in seen.items()})
        _check_controller(policy.spec.controller, environment.spec.controller)
        return PolicyActor(
            policy, n_action_steps=self._n_action_steps(policy), guidance=self.guidance, name=self.name, goal=self.goal
        )

    def describe(self) -> dict[str, Any]:
        policy = self.policy()
        return {
            "type": "trained",
            "run": str(self.run),
            **({} if self.encoder is None else {"encoder": str(self.encoder)}),
            "n_action_steps": self._n_action_steps(policy),
            "guidance": self.guidance,
            "config": to_dict(policy.config),
        }

    def _n_action_steps(self, policy: Policy) -> int:
        return max(1, policy.config.chunk // 2) if self.n_action_steps is None else self.n_action_steps


_OTHERWISE = {
    "actions": "proposes subgoals and does not act: name it as --subgoals, beside a --run that acts",
    "next_settled_delta": "acts and proposes no subgoals: train one that does by "
    "configs/train/playtable_state_subgoals.yaml",
}


@dataclass(frozen=True)
class HierarchicalRecipe:
    """A trained policy that is led to its goal by subgoals, each for `seconds` at most (see `SubgoalActor`).

    worker: reads states. proposer: is shown the goal.
    """

    worker: TrainedRecipe
    proposer: TrainedRecipe
    seconds: float
    name: str = "policy"

    def check(self) -> None:
        """See `TrainedRecipe.check`; subgoals are states, so the worker must read those."""
        if self.worker.run.is_dir() and "state" not in self.worker.policy().config.encoder.goals:
            raise UsageError(
                f"{self.worker.run} reads its goal from an image, and subgoals are states: leave --subgoals out, "
                "or name a --run that reads states"
            )
        self.worker.check()
        self.proposer.check()

    def cameras(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.worker.cameras(), *self.proposer.cameras())))

    def build(self, environment: Environment) -> SubgoalActor:
        steps = max(1, round(self.seconds * environment.spec.fps))
        return SubgoalActor(
            self.worker.build(environment), self.proposer.build(environment), environment.reached, steps
        )

    def describe(self) -> dict[str, Any]:
        return {**self.worker.describe(), "subgoals": self.proposer.describe(), "subgoal_seconds": self.seconds}


def trained(
    run: Path, goal: str, suite: SuiteConfig, encoder: Path | None = None
) -> TrainedRecipe | HierarchicalRecipe:
    """A run's policy as a suite's settings let it act."""
    if suite.subgoals is None:
        return TrainedRecipe(run, goal, suite.n_action_steps, suite.guidance, encoder=encoder)
    proposer = TrainedRecipe(suite.subgoals, goal, guidance=suite.guidance, predicts="next_settled_delta")
    return HierarchicalRecipe(TrainedRecipe(run, "state", suite.n_action_steps), proposer, suite.subgoal_seconds)


def _check_controller(trained: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    """Raises CheckpointError where the same action would move another robot, or move it otherwise."""
    mine, its = (json.loads(json.dumps(facts, default=list)) for facts in (dict(trained), dict(here)))
    for name in sorted(mine.keys() & its.keys()):
        if mine[name] != its[name]:
            raise CheckpointError(
                f"the policy learned with controller {name} {mine[name]}, this suite's environment has {its[name]}; "
                "evaluate it on a suite of its own environment"
            )


_ARTICLE = {"image": "an image", "state": "a state"}


def join_runs(run: Path, encoder: Path, out: Path) -> None:
    """Make one run of a state policy's and of the image encoder that it looks through."""
    load_policy(run / "policy", encoder / "policy").save(out / "policy")
    for name in ("config.yaml", "run.json"):
        if (encoder / name).is_file():
            atomic_write(out / name, (encoder / name).read_bytes())


@cache
def load_policy(path: Path, encoder: Path | None = None) -> Policy:
    """The policy at `path`, behind the image encoder of that at `encoder`, read once a process."""
    policy = Policy.load(path)
    return policy if encoder is None else policy.behind(load_policy(encoder), encoder)
