"""What every toy experiment offers: a config that measures and plots."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import draccus
import torch
from torch import Tensor, nn

from playlearn.config import atomic_write, git_revision, held, load_config, save_config, to_dict, versions
from playlearn.errors import UsageError
from playlearn.policies.heads import Head, HeadConfig
from playlearn.threads import limit

WIDTH = 64  # of the features that a head is given

Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class Experiment(draccus.ChoiceRegistry):
    """The base of every experiment's config; `type:` in a YAML picks the kind."""

    def measure(self, say: Callable[[str], None]) -> Rows:
        """Rows of results, JSON throughout; `say` is called with what is measured next."""
        raise NotImplementedError

    def plot(self, rows: Rows, path: Path) -> None:
        """Write a PNG of the results."""
        raise NotImplementedError


@dataclass(frozen=True)
class ToyExperiment:
    """The root of an experiment's YAML.

    experiment: which one, by its `type`.
    """

    experiment: Experiment


@dataclass(frozen=True)
class TrainingConfig:
    """How a head is trained, on fresh examples at every update: AdamW, cosine decay.

    updates: how many.
    batch: examples of an update.
    lr: learning rate, at its highest.
    """

    updates: int = 2000
    batch: int = 256
    lr: float = 2e-3


@dataclass(frozen=True)
class HeadsConfig:
    """What experiments that compare heads have in common.

    heads: name -> config of each head.
    training: of every head.
    samples: drawn of every head.
    seed: of weights, examples and samples.
    """

    heads: dict[str, HeadConfig] = field(default_factory=dict)
    training: TrainingConfig = field(default_factory=TrainingConfig)
    samples: int = 1000
    seed: int = 0


def load_experiment(path: Path, overrides: Sequence[str]) -> Experiment:
    """The experiment of a YAML file.

    overrides: `--field value` of the experiment.

    Raises:
        UsageError: the file, or an override, describes no experiment.
    """
    arguments = [f"--experiment.{one[2:]}" if one.startswith("--") else one for one in overrides]
    return load_config(ToyExperiment, path, arguments).experiment


def run(experiment: Experiment, out: Path, say: Callable[[str], None]) -> Rows:
    """Measure, and write results.json, plot.png and config.yaml to `out`.

    Raises:
        UsageError: `out` has results already.
    """
    limit()
    began = time.perf_counter()
    with held(out):
        if (out / "results.json").exists():
            raise UsageError(f"{out} has results already: remove them, or choose another --out")
        rows = experiment.measure(say)
        _write(experiment, rows, out, time.perf_counter() - began)
    return rows


def _write(experiment: Experiment, rows: Rows, out: Path, seconds: float) -> None:
    experiment.plot(rows, out / "plot.png")
    save_config(ToyExperiment(experiment), out / "config.yaml")
    results = {
        "experiment": type(experiment).get_choice_name(type(experiment)),
        "config": to_dict(experiment),
        "rows": rows,
        "seconds": round(seconds, 1),
        "versions": versions(),
        "git_revision": git_revision(),
        "threads": torch.get_num_threads(),
    }
    atomic_write(out / "results.json", json.dumps(results, indent=1).encode())


class ContextPolicy(nn.Module):
    """A head on the features of a small MLP: (B, C) contexts -> chunks.

    mean, std: of the examples' actions, which the head sees normalized.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, head: Head, contexts: int) -> None:
        super().__init__()
        self.head = head
        self.features = nn.Sequential(nn.Linear(contexts, WIDTH), nn.GELU(), nn.Linear(WIDTH, WIDTH))
        self.register_buffer("mean", torch.zeros(()))
        self.register_buffer("std", torch.ones(()))

    @torch.no_grad()
    def sample(self, contexts: Tensor, generator: torch.Generator) -> Tensor:
        """(B, H, A), in the units of the examples."""
        return self.head.sample(self.features(contexts), generator) * self.std + self.mean

    @torch.no_grad()
    def mode(self, contexts: Tensor) -> Tensor:
        """(B, H, A), in the units of the examples."""
        return self.head.mode(self.features(contexts)) * self.std + self.mean


def train_head(
    config: HeadConfig,
    training: TrainingConfig,
    examples: Callable[[int, torch.Generator], tuple[Tensor, Tensor]],
    seed: int,
) -> tuple[ContextPolicy, Mapping[str, float]]:
    """A head trained on `examples(n, generator) -> contexts (n, C), chunks (n, H, A)`, and what the training cost."""
    rng = torch.Generator().manual_seed(seed)
    contexts, chunks = examples(4096, rng)
    with torch.random.fork_rng(devices=[]):
        torch.random.manual_seed(seed)
        model = ContextPolicy(config.build(WIDTH, *chunks.shape[1:]), contexts.shape[1])
    model.mean.fill_(chunks.mean())
    model.std.fill_(chunks.std())
    model.head.fit_action_statistics((chunks - model.mean) / model.std)
    optimizer = torch.optim.AdamW(model.parameters(), lr=training.lr)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, training.updates)
    began = time.process_time()  # which other work on the machine does not add to
    for update in range(training.updates):
        contexts, chunks = examples(training.batch, rng)
        normal = (chunks - model.mean) / model.std
        mask = torch.ones(normal.shape[:2], dtype=torch.bool)
        loss, _ = model.head.loss(model.features(contexts), normal, mask, rng, update)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    seconds = time.process_time() - began
    return model.eval(), {
        "train_core_seconds": round(seconds, 1),
        "parameters": sum(p.numel() for p in model.parameters()),
    }
