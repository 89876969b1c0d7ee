"""Many modes in many dimensions: where each head begins to lose some, or to sample between them.

A chunk goes out and back in one of `modes` directions in A dimensions.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from playlearn.experiments.toy.base import Experiment, HeadsConfig, Rows, train_head
from playlearn.report.figure import save_figure

STEPS, STD = 8, 0.05
NEAR = 3.0  # stds, root mean square over the chunk, within which a sample belongs to a mode


@Experiment.register_subclass("modes")
@dataclass(frozen=True)
class ModesConfig(HeadsConfig, Experiment):
    """Heads on data of many modes, for every pair of `dimensions` and `modes`.

    heads: name -> config of each head.
    training: of every head.
    samples: drawn of every head.
    seed: of weights, examples and samples.
    dimensions: A, of the action.
    modes: of the data.
    """

    dimensions: tuple[int, ...] = (2, 7, 14)
    modes: tuple[int, ...] = (2, 4, 8)

    def measure(self, say: Callable[[str], None]) -> Rows:
        rows: Rows = []
        for name, head in self.heads.items():
            for dimensions in self.dimensions:
                for modes in self.modes:
                    say(f"{name}: {modes} modes in {dimensions} dimensions")
                    centers = _centers(dimensions, modes)
                    model, cost = train_head(head, self.training, _examples(centers), self.seed)
                    rng = torch.Generator().manual_seed(self.seed)
                    valid, coverage = _score(model.sample(torch.ones(self.samples, 1), rng), centers)
                    rows.append(
                        {
                            "head": name,
                            "dimensions": dimensions,
                            "modes": modes,
                            "valid": valid,
                            "coverage": coverage,
                            **cost,
                        }
                    )
        return rows

    def plot(self, rows: Rows, path: Path) -> None:
        from matplotlib.figure import Figure

        names = list(dict.fromkeys(row["head"] for row in rows))
        cells = [(d, m) for d in self.dimensions for m in self.modes]
        figure = Figure(figsize=(9, 0.42 * len(names) + 1.6), layout="constrained")
        for number, column_of in enumerate(("valid", "coverage")):
            values = {(row["head"], row["dimensions"], row["modes"]): row[column_of] for row in rows}
            table = np.array([[values[name, d, m] for d, m in cells] for name in names])
            axes = figure.add_subplot(1, 2, number + 1)
            axes.imshow(table, vmin=0, vmax=1, cmap="Blues", aspect="auto")
            for (line, column), value in np.ndenumerate(table):
                color = "white" if value > 0.6 else "black"
                axes.text(column, line, f"{value:.2f}", ha="center", va="center", fontsize=7, color=color)
            axes.set_xticks(range(len(cells)), [f"{m} modes\n{d}-D" for d, m in cells], fontsize=6)
            axes.set_yticks(range(len(names)), names if number == 0 else [""] * len(names), fontsize=8)
            title = "fraction of samples near a mode" if column_of == "valid" else "evenness over the modes"
            axes.set_title(title, fontsize=9)
        save_figure(figure, path, dpi=130)


def _centers(dimensions: int, modes: int) -> Tensor:
    """(K, H, A) the modes: evenly spaced directions in a plane, or axes and their opposites in more dimensions."""
    if dimensions == 2:
        angle = torch.arange(modes) * (2 * torch.pi / modes)
        directions = torch.stack([angle.cos(), angle.sin()], dim=1)
    else:
        axes = torch.eye(dimensions)
        directions = torch.stack([axes, -axes], dim=1).flatten(0, 1)[:modes]
    bump = torch.sin(torch.pi * (torch.arange(STEPS) + 0.5) / STEPS)
    return directions[:, None] * bump[None, :, None]


def _examples(centers: Tensor) -> Callable[[int, torch.Generator], tuple[Tensor, Tensor]]:
    def draw(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        which = torch.randint(len(centers), (count,), generator=generator)
        noise = STD * torch.randn(count, *centers.shape[1:], generator=generator)
        return torch.ones(count, 1), centers[which] + noise

    return draw


def _score(samples: Tensor, centers: Tensor) -> tuple[float, float]:
    """Fraction of samples near a mode; how even those are: exp(entropy) / K, 1 where all modes are equally likely."""
    off = (samples[:, None] - centers).square().mean((-2, -1)).sqrt()  # (n, K)
    nearest, which = off.min(dim=1)
    near = nearest < NEAR * STD
    if not near.any():
        return 0.0, 0.0
    weight = torch.bincount(which[near], minlength=len(centers)) / near.sum()
    entropy = -(weight * weight.clamp(min=1e-12).log()).sum()
    return float(near.float().mean()), float(entropy.exp() / len(centers))
