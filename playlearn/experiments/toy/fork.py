"""The fork: two equally good ways round an obstacle, and what every head makes of them.

The demonstrator goes from (0, 0) to (1, 0), left or right of a disc in the middle. The disc's height varies a little
and is the context. A chunk is the whole way: H displacements.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from playlearn.episode import Array
from playlearn.experiments.toy.base import Experiment, HeadsConfig, Rows, train_head
from playlearn.report.figure import save_figure

STEPS = 16
RADIUS, DISC_RANGE = 0.2, 0.1
CLEARANCE = (0.3, 0.4)  # range of the distance from the disc's center at which the demonstrator passes
SHOWN = 40  # ways of each head in the plot


@Experiment.register_subclass("fork")
@dataclass(frozen=True)
class ForkConfig(HeadsConfig, Experiment):
    """Heads on two ways round an obstacle.

    heads: name -> config of each head.
    training: of every head.
    samples: drawn of every head.
    seed: of weights, examples and samples.
    left: fraction of the demonstrations that pass on the left.
    """

    left: float = 0.5

    def measure(self, say: Callable[[str], None]) -> Rows:
        rows: Rows = []
        disc = torch.linspace(-DISC_RANGE, DISC_RANGE, self.samples).unsqueeze(1)
        for name, head in self.heads.items():
            say(name)
            model, cost = train_head(head, self.training, self._examples, self.seed)
            ways = _ways(model.sample(disc, torch.Generator().manual_seed(self.seed)).numpy())
            valid, side = _check(ways, disc.numpy())
            left = float((side[valid] > 0).mean()) if valid.any() else 0.0
            mode, _ = _check(_ways(model.mode(disc).numpy()), disc.numpy())
            rows.append(
                {
                    "head": name,
                    "valid": float(valid.mean()),
                    "left_of_valid": left,
                    "coverage": float(min(left, 1 - left) / min(self.left, 1 - self.left)) if valid.any() else 0.0,
                    "mode_valid": float(mode.mean()),
                    **cost,
                    "ways": ways[:: max(1, len(ways) // SHOWN)].astype(float).round(3).tolist(),
                    "discs": disc[:: max(1, len(ways) // SHOWN), 0].double().numpy().round(4).tolist(),
                }
            )
        return rows

    def plot(self, rows: Rows, path: Path) -> None:
        from matplotlib.figure import Figure

        columns = 5
        lines = -(-len(rows) // columns)
        figure = Figure(figsize=(2.5 * columns, 2.3 * lines), layout="constrained")
        for number, row in enumerate(rows):
            axes = figure.add_subplot(lines, columns, number + 1)
            ways, discs = np.array(row["ways"]), np.array(row["discs"])
            valid, _ = _check(ways, discs[:, None])
            for way, arrives in zip(ways, valid, strict=True):
                axes.plot(*way.T, color="#2a6f97" if arrives else "#d1495b", lw=0.7, alpha=0.6)
            circle = np.linspace(0, 2 * np.pi, 60)
            axes.fill(0.5 + RADIUS * np.cos(circle), RADIUS * np.sin(circle), color="0.75", zorder=3)
            axes.set_title(f"{row['head']}\nvalid {row['valid']:.0%}, both ways {row['coverage']:.0%}", fontsize=8)
            axes.set(xlim=(-0.1, 1.1), ylim=(-0.65, 0.65), xticks=[], yticks=[], aspect="equal")
        save_figure(figure, path, dpi=110)

    def _examples(self, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        def uniform(low: float, high: float) -> Tensor:
            return low + (high - low) * torch.rand(count, 1, generator=generator)

        disc = uniform(-DISC_RANGE, DISC_RANGE)
        side = torch.where(torch.rand(count, 1, generator=generator) < self.left, 1.0, -1.0)
        along = torch.linspace(0, 1, STEPS + 1)
        away = (disc + side * uniform(*CLEARANCE)) * torch.sin(torch.pi * along)
        way = torch.stack([along.expand_as(away), away], dim=-1)  # (n, H + 1, 2)
        chunk = way.diff(dim=1) + 0.003 * torch.randn(count, STEPS, 2, generator=generator)
        return disc, chunk


def _ways(chunks: Array) -> Array:
    """(n, H, 2) displacements -> (n, H + 1, 2) positions."""
    ways: Array = np.concatenate([np.zeros_like(chunks[:, :1]), chunks.cumsum(1)], axis=1)
    return ways


def _check(ways: Array, disc: Array) -> tuple[Array, Array]:
    """(n,) whether a way arrives without touching the disc; (n,) the side on which it passes: 1 left, -1 right."""
    along = np.linspace(0, 1, 5)[:, None]
    between = ways[:, :-1, None] * (1 - along) + ways[:, 1:, None] * along  # (n, H, 5, 2)
    center = np.stack([np.full(len(ways), 0.5), disc[:, 0]], axis=1)[:, None, None]
    clear = np.linalg.norm(between - center, axis=-1).min(axis=(1, 2)) > RADIUS
    arrived = np.linalg.norm(ways[:, -1] - (1.0, 0.0), axis=-1) < 0.1
    middle = ways[np.arange(len(ways)), np.abs(ways[..., 0] - 0.5).argmin(axis=1), 1]
    return clear & arrived, np.sign(middle - disc[:, 0])
