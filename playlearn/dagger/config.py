"""What a DAgger run is made from."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from playlearn.dagger.gate import GateConfig, NoGateConfig
from playlearn.dagger.schedule import BetaConfig, ZeroConfig
from playlearn.errors import UsageError
from playlearn.relabel import GoalSamplerConfig
from playlearn.relabel.ending import EndingConfig

ADJUSTABLE = ("rounds",)  # what a run that goes on may change


@dataclass(frozen=True)
class DaggerConfig:
    """Rounds of practice, training and evaluation.

    practice: suite that start states and goals are drawn from, under seeds that are no evaluation's. Not one whose
        starts are held-out play: it would teach what is later judged. episodes: attempted each round.
    suite: what each round is judged on (null: `practice`, under its own seed); judged: episodes of it; judged_seed:
        instead of the suite's own. goal: how goals are shown. execute, guidance: how the policy acts, in practice and
        judged (null: as its suite says).
    encoder: a run whose image encoder a state policy looks through, in practice and judged. perceived_every: its
        training goes on from states as that encoder perceives them, looking at play and practice every so many steps
        (see PerceivedConfig); 0: from true states.
    policy_steps: range in which it is drawn, for each episode, for how many steps the policy acts before the expert
        brings the episode to its goal, for which it has finish_steps. settle: for how many steps everything must be
        where the goal shows it for an episode to end; one that does not get there is counted and thrown away.
    beta, stretch: in each round, the share of stretches of so many steps in which the expert acts. gate: when it takes
        over besides.
    goals: which moment of a practised episode becomes its goal. The labels answer to the goal that was commanded, and
        that is where an episode ends, so it must be one of its end. stray: see DataConfig; of practised episodes.
    share: of every batch, what all rounds gathered; the rest is the play that the run learned from, in its shares.
    updates, lr, warmup: of each round's training, which goes on from the last round's weights.
    control: `play` or `noise` instead of practice as many steps of the collector's play, plain or with `noise` on what
        is executed, in each round as many as the DAgger run `like` gathered in it. collect: the config of that play
        (null: as the run's own play was made).
    """

    practice: Path = Path("eval/suites/playtable_tasks.yaml")
    suite: Path | None = None
    goal: Literal["image", "state"] = "state"
    encoder: Path | None = None
    perceived_every: int = 8
    rounds: int = 5
    episodes: int = 102
    policy_steps: tuple[int, int] = (40, 160)
    finish_steps: int = 200
    settle: int = 12
    beta: BetaConfig = field(default_factory=ZeroConfig)
    stretch: int = 8
    gate: GateConfig = field(default_factory=NoGateConfig)
    goals: GoalSamplerConfig = field(default_factory=EndingConfig)
    stray: float = 0.5
    share: float = 0.5
    updates: int = 1500
    lr: float = 3e-4
    warmup: int = 100
    judged: int | None = None
    judged_seed: int | None = None
    execute: int | None = None
    guidance: float | None = None
    control: Literal["none", "play", "noise"] = "none"
    like: Path | None = None
    collect: Path | None = None
    noise: float = 0.5
    seed: int = 0
    cpu: bool = False

    def __post_init__(self) -> None:
        """Raises UsageError where a value is out of range."""
        for name in ("rounds", "episodes", "finish_steps", "settle", "stretch", "updates", "lr", "stray"):
            if getattr(self, name) <= 0:
                raise UsageError(f"{name} must be above 0, got {getattr(self, name):g}")
        if self.perceived_every < 0:
            raise UsageError(f"perceived_every must be 0 or more, got {self.perceived_every}")
        low, high = self.policy_steps
        if not 0 <= low <= high:
            raise UsageError(f"policy_steps is a range [low, high], got [{low}, {high}]")
        if not 0 < self.share < 1:
            raise UsageError(f"share must lie between 0 and 1, both left out, got {self.share:g}")
        if (self.control != "none") != (self.like is not None):
            raise UsageError(
                "`control: play` and `control: noise` need `like: OUT`, the DAgger run whose steps they match, and "
                "only they do"
            )
