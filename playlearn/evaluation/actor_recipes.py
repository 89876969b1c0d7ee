"""What is evaluated: a trained policy, the scripted expert (an upper bound) and the random policy (a lower bound).

A recipe is sent to a worker process and builds its actor there.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, Protocol

from playlearn.config import atomic_write, copy_config, held, to_dict
from playlearn.errors import CheckpointError, MissingRunError, UsageError
from playlearn.evaluation.suite import SuiteConfig
from playlearn.policies import Policy
from playlearn.policies.execution import PolicyActor
from playlearn.policies.hierarchical import SubgoalActor
from playlearn.privileges import KEY as PRIVILEGED
from playlearn.privileges import SIMULATOR, Privileges
from playlearn.rollout import Actor, RandomActor
from playlearn.sim.environment import Environment


class ActorRecipe(Protocol):
    """Builds an actor.

    name: its row in the report.
    """

    @property
    def name(self) -> str: ...

    def cameras(self) -> tuple[str, ...]:
        """The cameras that the goal must be shown through."""
        ...

    def build(self, environment: Environment) -> Actor:
        """The actor; raises PlaylearnError if it cannot act in this environment."""
        ...

    def describe(self) -> dict[str, Any]:
        """For results.json."""
        ...

    def privileges(self) -> Privileges:
        """What privileged information it comes by."""
        ...


def scripted(environment: Environment) -> Actor:
    """The environment's scripted expert; raises UsageError if it has none."""
    # Slow to import.
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

    def privileges(self) -> Privileges:
        return Privileges(training=(SIMULATOR,))


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

    def privileges(self) -> Privileges:
        return Privileges()


@dataclass(frozen=True)
class TrainedRecipe:
    """A trained policy.

    run: output folder of `playlearn train`.
    goal: how the goal is shown, "image" or "state".
    n_action_steps: actions of a chunk that are executed before the next plan (None: half of the chunk).
    guidance: weight of the goal (None: the policy's default).
    name: its row in the report.
    predicts: what the policy must predict.
    encoder: run whose image encoder estimates the state for a state policy (None: its own encoder).
    """

    run: Path
    goal: str
    n_action_steps: int | None = None
    guidance: float | None = None
    name: str = "policy"
    predicts: Literal["actions", "next_settled_delta"] = "actions"
    encoder: Path | None = None

    def policy(self) -> Policy:
        """The policy, loaded once in each process."""
        return load_policy(self.run / "policy", None if self.encoder is None else self.encoder / "policy")

    def check(self) -> None:
        """Check what can be checked without a simulator.

        Raises:
            CheckpointError: there is no policy, or it is incomplete.
            UsageError: it predicts something else, or does not read goals of this modality.
        """
        if not self.run.is_dir():
            raise MissingRunError(f"there is no run at {self.run}; make one with: playlearn train --out {self.run}")
        if self.encoder is not None and not self.encoder.is_dir():
            raise MissingRunError(f"there is no run at {self.encoder} whose image encoder could be used")
        policy = self.policy()
        if policy.spec.predicts != self.predicts:
            raise UsageError(f"{self.run} {_WRONG_PREDICTION[self.predicts]}")
        modalities = policy.config.encoder.goals
        if self.goal not in modalities:
            raise UsageError(f"{self.run} reads its goal from {_ARTICLE[modalities[0]]}: use --goal {modalities[0]}")

    def cameras(self) -> tuple[str, ...]:
        return self.policy().cameras

    def build(self, environment: Environment) -> PolicyActor:
        policy = self.policy()
        missing = [camera for camera in policy.cameras if camera not in environment.spec.cameras]
        images = {} if missing else environment.observe(policy.cameras).images
        policy.check(environment.spec, {camera: (image.shape[0], image.shape[1]) for camera, image in images.items()})
        _check_controller(policy.spec.controller, environment.spec.controller)
        return PolicyActor(
            policy,
            n_action_steps=self._n_action_steps(policy),
            guidance=self.guidance,
            name=self.name,
            goal=self.goal,
            bounds=environment.spec.quantities.action_bounds if self.predicts == "actions" else (),
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

    def privileges(self) -> Privileges:
        """As the runs recorded it; a goal image holds no poses, whatever a state would."""
        used = Privileges.of_run(self.run)
        used |= Privileges() if self.encoder is None else Privileges.of_run(self.encoder)
        return used if self.goal == "state" else replace(used, goal=())

    def _n_action_steps(self, policy: Policy) -> int:
        return max(1, policy.config.chunk // 2) if self.n_action_steps is None else self.n_action_steps


_WRONG_PREDICTION = {
    "actions": "proposes subgoals and does not act: name it as --subgoals, beside a --run that acts",
    "next_settled_delta": "acts and proposes no subgoals: train one that does by "
    "configs/train/playtable_state_subgoals.yaml",
}


@dataclass(frozen=True)
class HierarchicalRecipe:
    """A low-level policy that pursues the subgoals of a high-level policy (see `SubgoalActor`).

    low_level: acts; reads goal states.
    high_level: is shown the goal and proposes subgoals.
    seconds: at most so long is each subgoal pursued.
    name: its row in the report.
    """

    low_level: TrainedRecipe
    high_level: TrainedRecipe
    seconds: float
    name: str = "policy"

    def check(self) -> None:
        """See `TrainedRecipe.check`; subgoals are states, so the low-level policy must read those."""
        if self.low_level.run.is_dir() and "state" not in self.low_level.policy().config.encoder.goals:
            raise UsageError(
                f"{self.low_level.run} reads its goal from an image, and subgoals are states: leave --subgoals out, "
                "or name a --run that reads states"
            )
        self.low_level.check()
        self.high_level.check()

    def cameras(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.low_level.cameras(), *self.high_level.cameras())))

    def build(self, environment: Environment) -> SubgoalActor:
        steps = max(1, round(self.seconds * environment.spec.fps))
        return SubgoalActor(
            self.low_level.build(environment), self.high_level.build(environment), environment.reached, steps
        )

    def describe(self) -> dict[str, Any]:
        return {**self.low_level.describe(), "subgoals": self.high_level.describe(), "subgoal_seconds": self.seconds}

    def privileges(self) -> Privileges:
        """Subgoals are the high-level policy's own; the goal is what that one is shown."""
        high = self.high_level.privileges()
        return replace(self.low_level.privileges() | high, goal=high.goal)


def trained(
    run: Path, goal: str, suite: SuiteConfig, encoder: Path | None = None
) -> TrainedRecipe | HierarchicalRecipe:
    """The recipe of a run's policy under a suite's settings."""
    if suite.subgoals is None:
        return TrainedRecipe(run, goal, suite.n_action_steps, suite.guidance, encoder=encoder)
    high_level = TrainedRecipe(suite.subgoals, goal, guidance=suite.guidance, predicts="next_settled_delta")
    return HierarchicalRecipe(TrainedRecipe(run, "state", suite.n_action_steps), high_level, suite.subgoal_seconds)


def _check_controller(trained: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    """Raises CheckpointError if the same action would move another robot, or move it differently."""
    own, other = (json.loads(json.dumps(facts, default=list)) for facts in (dict(trained), dict(here)))
    for name in sorted(own.keys() & other.keys()):
        if own[name] != other[name]:
            raise CheckpointError(
                f"the policy was trained with controller {name} {own[name]}, this suite's environment has "
                f"{other[name]}; evaluate it on a suite of its own environment"
            )


_ARTICLE = {"image": "an image", "state": "a state"}


def join_runs(run: Path, encoder: Path, out: Path) -> None:
    """Merge the run of a state policy and the run of its image encoder into one run."""
    with held(out):
        load_policy(run / "policy", encoder / "policy").save(out / "policy")
        if (encoder / "config.yaml").is_file():
            copy_config(encoder / "config.yaml", out / "config.yaml")
        if (encoder / "run.json").is_file():
            record = json.loads((encoder / "run.json").read_text(encoding="utf-8"))
            own = Privileges.of_run(encoder)
            used = replace(Privileges.of_run(run) | own, goal=own.goal)
            atomic_write(out / "run.json", json.dumps({**record, PRIVILEGED: used.to_dict()}, indent=2).encode())


@cache
def load_policy(path: Path, encoder: Path | None = None) -> Policy:
    """The policy at `path`, behind the image encoder of the policy at `encoder`; loaded once in each process."""
    policy = Policy.load(path)
    return policy if encoder is None else policy.behind(load_policy(encoder), encoder)
