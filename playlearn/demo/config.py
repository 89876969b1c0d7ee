"""The stages of the demo, and what each of them costs."""

from dataclasses import dataclass, field
from pathlib import Path

from playlearn.errors import UsageError


@dataclass(frozen=True)
class Cost:
    """Core seconds of a stage, as multiples of the reference workload's (see `playlearn.demo.reference`).

    simulation: multiple of its simulation part.
    learning: multiple of its learning part.
    cores: how many the stage keeps busy where there are so many.
    """

    simulation: float = 0.0
    learning: float = 0.0
    cores: float = 2.0


@dataclass(frozen=True)
class DemoConfig:
    """The demo's stages; each is a config of its own, budgeted in episodes and updates, not in minutes.

    collect: config of the play.
    state: config of the state policy, which learns from it.
    encoder: config of the image encoder, which learns from it at the same time.
    dagger: config of the state policy's DAgger run behind that encoder.
    suite: what the result is evaluated on.
    episodes: of that evaluation.
    preview: the run of a shipped policy that is shown while play is collected.
    preview_task: the task that it shows.
    state_loss: held-out loss of the state policy's head above which the demo stops; measured, see
        eval/results/notebook.md.
    encoder_loss: the same for the encoder's estimates of where objects are.
    costs: stage -> what it costs, for the estimate of time.
    seed: of play and training.
    """

    collect: Path = Path("configs/collect/demo.yaml")
    state: Path = Path("configs/train/demo_state.yaml")
    encoder: Path = Path("configs/train/playtable_encoder.yaml")
    dagger: Path = Path("configs/dagger/demo.yaml")
    suite: Path = Path("eval/suites/playtable_tasks.yaml")
    episodes: int = 102
    preview: Path = Path("eval/pretrained/image")
    preview_task: str = "place_in_drawer"
    state_loss: float = 1.0
    encoder_loss: float = 1.0
    costs: dict[str, Cost] = field(default_factory=dict)
    seed: int = 0

    def __post_init__(self) -> None:
        """Raises UsageError where a number is out of range."""
        if self.episodes < 1:
            raise UsageError(f"episodes must be at least 1, got {self.episodes}")
