"""What a training run is made from, and which folder it may go into."""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from playlearn.config import Digests, RunFolder, load_config, to_dict
from playlearn.data import CorrectionsConfig, DataConfig, PerceivedConfig, ScenesConfig
from playlearn.data.mixture import DatasetSource
from playlearn.errors import UsageError
from playlearn.policies import PolicyConfig, policy_digests
from playlearn.store import Store, StoreConfig, open_store

# What may differ between a run and its resumption: how long it is, and what it logs.
ADJUSTABLE = ("steps", "max_minutes", "val_every", "checkpoint_every", "log_every", "tracker")


@dataclass(frozen=True)
class TrainConfig:
    """A training run.

    store: the play, a folder or a kind with its settings (`{type: lerobot, repo_id: user/name}`).
    data: how examples are cut from it; its history, chunk, cameras and goal_names are the policy's.
    policy: what is trained.
    corrections: displaced moments of play, labeled with the way back, made before the first update and mixed into the
        recorded ones (see CorrectionsConfig); null for none.
    scenes: images rendered from the store's recorded states and from rearranged ones, with the true state, that an
        image encoder learns from (see ScenesConfig); null for none.
    perceived: play as an image encoder perceives it, for a state policy that is to act behind that encoder (see
        PerceivedConfig); null for true states.
    extra_datasets: further stores of play, each with its fraction of every batch.
    blind: every store of the run is read as a robot would have recorded it, without object poses, simulator states,
        skills, rewards and clean labels (see `store.BlindStore`); what needs them is refused.
    init_from: a run whose policy training starts from, weights and normalization; null for a fresh one. It may be a
        state policy: its trunk and head are loaded, the image encoder starts fresh (needs `use_estimated_state`).
    trainable: shell-style patterns of the parameters that are trained; all others stay as they are.
    batch_size: examples for each update and process.
    steps: updates.
    max_minutes: of wall clock, after which training ends even if `steps` are not done (null: no limit). The learning
        rate then follows whichever is further on, and a resumed run is not bit for bit an unbroken one.
    lr: peak learning rate, after `warmup` updates; then a cosine to zero.
    warmup: updates over which the learning rate rises.
    weight_decay: of AdamW, on matrices only, not on biases and norms.
    grad_clip: largest norm of the gradient.
    ema_decay: of the averaged weights, which are evaluated and saved.
    val_every: updates between two evaluations on held-out play.
    val_batches: batches of held-out play, always the same.
    checkpoint_every: updates between two checkpoints.
    log_every: updates between two lines of `metrics.jsonl`.
    seed: of initial weights, examples and noise.
    tracker: where metrics go besides `metrics.jsonl`.
    precision: float32, or bf16 where the device supports it well.
    cpu: train on the CPU even where there is an accelerator.
    threads: CPU threads of each process, whatever a launcher sets. On two cores, two threads are 1.3 times as fast as
        one on an idle machine, and a quarter as fast beside a busy process.
    """

    store: Path | StoreConfig = Path("datasets/play")
    data: DataConfig = field(default_factory=DataConfig)
    policy: PolicyConfig = field(default_factory=PolicyConfig)
    corrections: CorrectionsConfig | None = None
    scenes: ScenesConfig | None = None
    perceived: PerceivedConfig | None = None
    extra_datasets: tuple[DatasetSource, ...] = ()
    blind: bool = False
    init_from: Path | None = None
    trainable: tuple[str, ...] = ("*",)
    batch_size: int = 256
    steps: int = 20_000
    max_minutes: float | None = None
    lr: float = 5e-4
    warmup: int = 200
    weight_decay: float = 1e-3
    grad_clip: float = 1.0
    ema_decay: float = 0.999
    val_every: int = 1000
    val_batches: int = 4
    checkpoint_every: int = 1000
    log_every: int = 100
    seed: int = 0
    tracker: Literal["tensorboard", "wandb"] | None = None
    precision: Literal["float32", "bf16"] = "float32"
    cpu: bool = False
    threads: int = 1

    def __post_init__(self) -> None:
        """Raises UsageError where a number is out of range."""
        for name in (
            "batch_size",
            "steps",
            "lr",
            "val_every",
            "checkpoint_every",
            "log_every",
            "grad_clip",
            "threads",
        ):
            if getattr(self, name) <= 0:
                raise UsageError(f"{name} must be above 0, got {getattr(self, name)}")
        if self.max_minutes is not None and self.max_minutes <= 0:
            raise UsageError(f"max_minutes must be above 0 or null, got {self.max_minutes}")
        if self.corrections is not None and self.data.target == "next_settled_delta":
            raise UsageError(
                "corrections are labels of actions: leave them out where data.target is next_settled_delta"
            )
        if self.perceived is not None:
            if self.policy.encoder.observation_cameras:
                raise UsageError(
                    "perceived: this policy sees images itself; only a state policy acts on an encoder's estimates"
                )
            if self.corrections is not None or self.scenes is not None:
                raise UsageError("perceived goes with neither corrections nor scenes: leave those out")
        if self.scenes is not None:
            if self.policy.history > 1:
                raise UsageError("scenes are single moments: leave policy.history at 1")
            rest = 1 - self.scenes.fraction - sum(source.fraction for source in self.extra_datasets)
            if rest <= 0 and not (self.scenes.fraction == 1 and not self.extra_datasets):
                raise UsageError(
                    "scenes.fraction and the fractions of `extra_datasets` leave nothing for the play: "
                    "let them add up to less than 1"
                )
        if not 0 <= self.ema_decay < 1:
            raise UsageError(f"ema_decay must be in [0, 1), got {self.ema_decay}")
        self._check_blind()

    def _check_blind(self) -> None:
        """Raises UsageError where a blind run asks for what is hidden."""
        if not self.blind:
            return
        asked = {
            "corrections": self.corrections is not None,
            "scenes": self.scenes is not None,
            "perceived": self.perceived is not None,
            "policy.encoder.state_supervision": self.policy.encoder.supervised,
            "data.target: next_settled_delta": self.data.target != "actions",
        }
        parts = {"data": self.data} | {
            f"extra_datasets.{k}.data": source.data for k, source in enumerate(self.extra_datasets) if source.data
        }
        asked |= {f"{name}.failure_fraction": data.failure_fraction < 1 for name, data in parts.items()}
        wrong = [name for name, is_asked in asked.items() if is_asked]
        if wrong:
            raise UsageError(
                f"blind: {', '.join(wrong)} would read what a robot does not record (object poses, simulator states, "
                "skills): leave it out, or set blind to false"
            )

    def resolved(self) -> "TrainConfig":
        """With the fields of `data` that the policy decides."""
        encoder = self.policy.encoder
        of_play = self.scenes is None or self.scenes.fraction < 1  # else no images of the play are read
        decided: dict[str, Any] = {
            "history": self.policy.history,
            "chunk": self.policy.chunk,
            "cameras": encoder.observation_cameras if of_play else (),
            "goal_cameras": encoder.goal_cameras if of_play else (),
            "goal_names": encoder.goal_names,
            "events": encoder.uses_events,
        }
        extra_datasets = [
            dataclasses.replace(source, data=dataclasses.replace(source.data or self.data, **decided))
            for source in self.extra_datasets
        ]
        return dataclasses.replace(
            self, data=dataclasses.replace(self.data, **decided), extra_datasets=tuple(extra_datasets)
        )


def run_folder(out: Path) -> RunFolder:
    """The folder of a training run."""
    return RunFolder(out, "config.yaml", "training run", adjustable=ADJUSTABLE)


def check_out(config: TrainConfig, out: Path, *, resume: bool) -> None:
    """Raises UsageError where `out` is taken or, with resume, holds no run of this config."""
    folder = run_folder(out)
    if folder.begun(resume=resume):
        folder.check_same(to_dict(load_config(TrainConfig, folder.file), out), to_dict(config, out))


def training_inputs(config: TrainConfig, store: Store) -> Digests:
    """What a training on a store reads, by digest; raises StoreError where another store is missing."""
    inputs: dict[str, Mapping[str, str]] = {"store": store.digests()}
    for number, source in enumerate(config.extra_datasets):
        inputs[f"extra_datasets.{number}.store"] = open_store(source.store, blind=config.blind).digests()
    encoder = None if config.perceived is None else config.perceived.encoder
    runs = {"init_from": config.init_from, "perceived.encoder": encoder}
    return inputs | {name: policy_digests(run) for name, run in runs.items() if run is not None}


def stored_threads(config: TrainConfig, out: Path, *, resume: bool) -> int:
    """The threads that the run began with: before `threads` was a setting, torch chose."""
    record = out / "run.json"
    if resume and record.is_file():
        return int(json.loads(record.read_text(encoding="utf-8")).get("threads", config.threads))
    return config.threads


def flattened(nested: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """{"a": {"b": 1}} -> {"a.b": 1}; what is neither number nor text is written as text."""
    flat: dict[str, Any] = {}
    for name, value in nested.items():
        if isinstance(value, Mapping):
            flat |= flattened(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value if isinstance(value, bool | int | float | str) else str(value)
    return flat
