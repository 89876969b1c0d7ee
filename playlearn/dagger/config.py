"""What a DAgger run is made from."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from playlearn.dagger.gate import GateConfig, NoGateConfig
from playlearn.dagger.gather import GatherConfig, GatherRolloutsConfig
from playlearn.dagger.schedule import BetaConfig, ZeroConfig
from playlearn.errors import UsageError
from playlearn.relabeling import GoalSamplerConfig
from playlearn.relabeling.final_settled import FinalSettledConfig

ADJUSTABLE = ("rounds",)  # what a resumed run may change


@dataclass(frozen=True)
class DaggerConfig:
    """Rounds of rollouts, training and evaluation.

    rollout_suite: start states and goals of the rollouts, under seeds that are no evaluation's. Not a suite whose
        starts are held-out play: training would see what is evaluated later.
    suite: what each round is evaluated on (null: `rollout_suite`, under its own seed).
    goal: how goals are shown.
    encoder: a run whose image encoder a state policy looks through, in rollouts and evaluation.
    perceived_every: with `encoder`, training continues on states as that encoder perceives them, looking at play and
        rollouts every so many steps (see PerceivedConfig); 0: on true states.
    rounds: how many.
    episodes: rollouts attempted each round.
    policy_steps: range from which each episode draws how many steps the policy acts before the expert takes over.
    finish_steps: steps that the expert then has to reach the goal.
    success_hold_steps: steps for which everything must be where the goal shows it before an episode ends; an episode
        that never gets there is counted and discarded.
    beta: in each round, the fraction of stretches in which the expert acts.
    switch_every: steps of such a stretch.
    gate: when else the expert takes over.
    goals: which moment of a rollout becomes its goal. The labels answer to the commanded goal, which is where an
        episode ends, so it must be one of its end.
    max_label_deviation: of rollouts; see DataConfig.
    fraction: of every batch, what all rounds gathered; the rest is the play that the run learned from.
    updates: of each round's training, which continues from the last round's weights.
    lr: of each round's training.
    warmup: updates over which the learning rate rises.
    eval_episodes: episodes of each evaluation (null: the suite's own).
    eval_seed: of each evaluation (null: the suite's own).
    n_action_steps: actions of a chunk that are executed before the next plan (null: the suite's).
    guidance: weight of the goal (null: the suite's).
    gather: what each round adds: `rollouts`, or a baseline (`play`, `noise`) that adds as many steps of play.
    seed: of starts, goals and training.
    cpu: train on the CPU even where there is a GPU.
    """

    rollout_suite: Path = Path("eval/suites/playtable_tasks.yaml")
    suite: Path | None = None
    goal: Literal["image", "state"] = "state"
    encoder: Path | None = None
    perceived_every: int = 8
    rounds: int = 5
    episodes: int = 102
    policy_steps: tuple[int, int] = (40, 160)
    finish_steps: int = 200
    success_hold_steps: int = 12
    beta: BetaConfig = field(default_factory=ZeroConfig)
    switch_every: int = 8
    gate: GateConfig = field(default_factory=NoGateConfig)
    goals: GoalSamplerConfig = field(default_factory=FinalSettledConfig)
    max_label_deviation: float = 0.5
    fraction: float = 0.5
    updates: int = 1500
    lr: float = 3e-4
    warmup: int = 100
    eval_episodes: int | None = None
    eval_seed: int | None = None
    n_action_steps: int | None = None
    guidance: float | None = None
    gather: GatherConfig = field(default_factory=GatherRolloutsConfig)
    seed: int = 0
    cpu: bool = False

    def __post_init__(self) -> None:
        """Raises UsageError where a value is out of range."""
        for name in (
            "rounds",
            "episodes",
            "finish_steps",
            "success_hold_steps",
            "switch_every",
            "updates",
            "lr",
            "max_label_deviation",
        ):
            if getattr(self, name) <= 0:
                raise UsageError(f"{name} must be above 0, got {getattr(self, name):g}")
        if self.perceived_every < 0:
            raise UsageError(f"perceived_every must be 0 or more, got {self.perceived_every}")
        low, high = self.policy_steps
        if not 0 <= low <= high:
            raise UsageError(f"policy_steps is a range [low, high], got [{low}, {high}]")
        if not 0 < self.fraction < 1:
            raise UsageError(f"fraction must lie between 0 and 1, both left out, got {self.fraction:g}")
