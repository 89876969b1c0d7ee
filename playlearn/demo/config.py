"""What the demo is made of, and what each of its stages costs."""

from dataclasses import dataclass, field
from pathlib import Path

from playlearn.errors import UsageError


@dataclass(frozen=True)
class Cost:
    """Core seconds of a stage, as multiples of the reference workload's (see `playlearn.demo.reference`).

    simulation, learning: multiples of its two parts. cores: how many the stage keeps busy where there are so many.
    """

    simulation: float = 0.0
    learning: float = 0.0
    cores: float = 2.0


@dataclass(frozen=True)
class DemoConfig:
    """The demo's stages; each is a config of its own, budgeted in episodes and updates, not in minutes.

    collect, state, encoder, dagger: configs of the play, of the state policy and the image encoder that learn from it
        side by side, and of the policy's practice behind that encoder.
    suite, episodes: what is evaluated in the end.
    preview: the run of a shipped policy that shows, while play is collected, what this will come to.
    preview_task: the task that it shows.
    state_loss, encoder_loss: held-out losses, of the head and of where things are, above which a training has taught
        too little to go on; measured, see eval/results/notebook.md.
    costs: stage -> what it costs, for the estimate of time.
    seed: of play and trainings.
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
