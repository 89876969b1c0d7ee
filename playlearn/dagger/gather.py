"""What each round adds to learn from: rollouts of the policy, or what they are compared with.

A baseline adds as many steps as the DAgger run that it is compared with, of the play that the run learned from: plain,
or with noise injected as in DART (Laskey et al., 2017).
"""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import draccus

from playlearn.collection import CollectConfig, collect
from playlearn.collection.store import RESOLVED
from playlearn.config import load_config
from playlearn.dagger.results import gathered
from playlearn.dagger.rollouts import RolloutSpec, collect_rollouts
from playlearn.data import DataConfig
from playlearn.errors import UsageError
from playlearn.evaluation.suite import derived_seed
from playlearn.oracles import PlayPolicyConfig
from playlearn.relabeling import GoalSamplerConfig
from playlearn.sim import EnvironmentConfig
from playlearn.store import NativeStore, Store

_BASELINE = 0xC0472A1  # so that no seed of its play is one of the rollouts


@dataclass(frozen=True)
class GatherContext:
    """What a DAgger run hands to whatever gathers for its rounds.

    rounds: how many.
    episodes: rollouts attempted each round.
    rollout_spec: (round, run of the last policy) -> how its rollouts are made.
    goals: see `DaggerConfig.goals`.
    max_label_deviation: see `DaggerConfig.max_label_deviation`.
    store: the play that the policy learned from.
    environment: of the rollouts.
    cameras: what the policy sees.
    seed: of the DAgger run.
    workers: processes (None: one a core).
    """

    rounds: int
    episodes: int
    rollout_spec: Callable[[int, Path], RolloutSpec]
    goals: GoalSamplerConfig
    max_label_deviation: float
    store: Store
    environment: EnvironmentConfig
    cameras: tuple[str, ...]
    seed: int
    workers: int | None


@dataclass(frozen=True)
class GatherConfig(draccus.ChoiceRegistry):
    """The base of what can be gathered; `type:` in a YAML picks the kind."""

    def check(self, context: GatherContext) -> None:
        """Raises UsageError for what would go wrong later."""
        raise NotImplementedError

    def gather(self, context: GatherContext, number: int, last: Path, folder: Path) -> dict[str, Any]:
        """Put round `number`'s steps into the store `folder`/play. last: the run whose policy acts.

        Returns what the round's row says of it; see `playlearn.dagger.results.gathered`.
        """
        raise NotImplementedError

    def data(self, context: GatherContext, own: DataConfig) -> DataConfig:
        """How examples are cut from what was gathered: all of it. own: how the run cuts its play."""
        raise NotImplementedError


@GatherConfig.register_subclass("rollouts")
@dataclass(frozen=True)
class GatherRolloutsConfig(GatherConfig):
    """Rollouts of the policy, labeled by the expert: DAgger."""

    def check(self, context: GatherContext) -> None:
        pass

    def gather(self, context: GatherContext, number: int, last: Path, folder: Path) -> dict[str, Any]:
        numbers = range((number - 1) * context.episodes, number * context.episodes)
        spec, title = context.rollout_spec(number, last), f"round {number}, rollouts"
        return gathered(collect_rollouts(spec, numbers, folder, context.workers, title))

    def data(self, context: GatherContext, own: DataConfig) -> DataConfig:
        return replace(
            own,
            goals=context.goals,
            max_label_deviation=context.max_label_deviation,
            val_fraction=0.0,
            balance=0.0,
            failure_fraction=1.0,
            mask_after_goal=False,
        )


@GatherConfig.register_subclass("play")
@dataclass(frozen=True)
class GatherPlayConfig(GatherConfig):
    """A baseline: as many further steps of play.

    match_steps_of: the DAgger run whose rounds are matched in steps.
    collect: config of the play (null: as the play was made that the run learned from).
    """

    match_steps_of: Path
    collect: Path | None = None

    def check(self, context: GatherContext) -> None:
        self.steps(context.rounds)
        self.collection(context)

    def gather(self, context: GatherContext, number: int, last: Path, folder: Path) -> dict[str, Any]:
        steps, seed = self.steps(context.rounds)[number - 1], derived_seed(_BASELINE, context.seed, number)
        frames = collect_steps(self.collection(context), steps, seed, folder / "play", context.workers)
        nothing = ("attempted", "kept", "solved_without_expert", "labels", "expert_steps")
        return {**dict.fromkeys(nothing, 0), "frames": frames}

    def data(self, context: GatherContext, own: DataConfig) -> DataConfig:
        return replace(own, val_fraction=0.0)

    def steps(self, rounds: int) -> list[int]:
        """How many steps each round of the matched run added; raises UsageError where it has fewer rounds."""
        path = self.match_steps_of / "results.json"
        if not path.is_file():
            raise UsageError(
                f"gather.match_steps_of: there is no DAgger run at {self.match_steps_of} (no results.json)"
            )
        steps = [int(row["frames"]) for row in json.loads(path.read_text())["rounds"] if row["round"]]
        if len(steps) < rounds:
            raise UsageError(
                f"gather.match_steps_of: {self.match_steps_of} has {len(steps)} rounds, this baseline needs {rounds}"
            )
        return steps

    def collection(self, context: GatherContext) -> CollectConfig:
        """How it plays: in the environment of the rollouts, with the images that the policy sees.

        Raises:
            UsageError: no config says how the play was made.
        """
        path = self.collect or Path(context.store.name()) / RESOLVED
        if not path.is_file():
            raise UsageError(
                f"{context.store.name()} does not say how it was played (no {RESOLVED}): "
                "name a config with `--gather.collect FILE`"
            )
        made = load_config(CollectConfig, path)
        return replace(made, environment=context.environment, cameras=context.cameras, play=self.play(made.play))

    def play(self, recorded: PlayPolicyConfig) -> PlayPolicyConfig:
        """The play policy, from the one that played."""
        return recorded


@GatherConfig.register_subclass("noise")
@dataclass(frozen=True)
class GatherNoiseConfig(GatherPlayConfig):
    """A baseline: as many further steps of play with noise injected, executed noisy and labeled clean.

    match_steps_of: the DAgger run whose rounds are matched in steps.
    collect: config of the play (null: as the play was made that the run learned from).
    noise: its amplitude.
    """

    noise: float = 0.5

    def play(self, recorded: PlayPolicyConfig) -> PlayPolicyConfig:
        return recorded.noisier(self.noise)


def collect_steps(config: CollectConfig, steps: int, seed: int, out: Path, workers: int | None) -> int:
    """Play until the store at `out` holds `steps` steps or a little more, from where it stopped. Returns how many."""
    made = replace(config, seed=seed, episodes=math.ceil(steps / config.steps))
    while True:
        collect(made, out, workers=workers, resume=True)
        total = int(NativeStore.open(out).lengths().sum())
        if total >= steps:
            return total
        # Some episodes ended early.
        made = replace(made, episodes=made.episodes + math.ceil((steps - total) / config.steps))
