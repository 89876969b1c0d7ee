"""Compounding error: mistakes against the length of the walk (Ross and Bagnell 2010; Ross et al. 2011).

A clone that makes one mistake is beside the rope, where it was never trained, and makes mistakes from then on: they
grow as T squared. A policy that has learned to step back makes each mistake once: they grow as T. All methods train on
the same number of labeled steps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from playlearn.episode import Array
from playlearn.experiments.toy.base import Experiment, Rows
from playlearn.experiments.toy.tightrope_env import CUE, FURTHEST, Policy, clone, turn_back, walk
from playlearn.report.figure import save_figure

THEORY = {"cloning": 2, "noise injection": 1, "corrective augmentation": 1, "DAgger": 1}


@Experiment.register_subclass("tightrope")
@dataclass(frozen=True)
class TightropeConfig(Experiment):
    """Methods of imitation on the tightrope.

    labeled: steps that the expert labels for each method.
    updates: of each training.
    lengths: T of the walks to evaluate on.
    walks: of each length.
    stumble: fraction of the turns that are random in noise injection.
    rounds: of DAgger.
    seeds: policies trained with each method.
    """

    labeled: int = 2000
    updates: int = 600
    lengths: tuple[int, ...] = (10, 20, 40, 80, 160)
    walks: int = 2000
    stumble: float = 0.1
    rounds: int = 4
    seeds: int = 5

    def measure(self, say: Callable[[str], None]) -> Rows:
        rows: Rows = []
        for name, train in self._methods().items():
            say(name)
            policies = [train(seed) for seed in range(self.seeds)]
            mistakes = [
                [walk(policy, self.walks, steps, np.random.default_rng((9, seed))).mistakes for steps in self.lengths]
                for seed, policy in enumerate(policies)
            ]
            mean = np.mean(mistakes, axis=0)
            exponent = float(np.polyfit(np.log(self.lengths), np.log(np.maximum(mean, 1e-9)), 1)[0])
            rows.append(
                {
                    "method": name,
                    "exponent": round(exponent, 2),
                    "theory": THEORY[name],
                    "lengths": list(self.lengths),
                    "mistakes": mean.round(4).tolist(),
                    "by_seed": np.round(mistakes, 4).tolist(),
                }
            )
        return rows

    def plot(self, rows: Rows, path: Path) -> None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(5.4, 4), layout="constrained")
        axes = figure.add_subplot()
        for row, color in zip(rows, ("#d1495b", "#edae49", "#66a182", "#2a6f97"), strict=False):
            label = f"{row['method']}: T^{row['exponent']:.2f} (theory {row['theory']})"
            axes.loglog(row["lengths"], row["mistakes"], "o-", color=color, label=label)
        axes.set(xlabel="length T of the walk, steps", ylabel="mistakes per walk")
        axes.legend(fontsize=8, frameon=False)
        save_figure(figure, path, dpi=130)

    def _methods(self) -> dict[str, Callable[[int], Policy]]:
        return {
            "cloning": lambda seed: self._clone(*self._expert(seed, 0.0), seed),
            "noise injection": lambda seed: self._clone(*self._expert(seed, self.stumble), seed),
            "corrective augmentation": self._corrected,
            "DAgger": self._dagger,
        }

    def _expert(self, seed: int, stumble: float) -> tuple[Array, Array]:
        """(labeled, F) observations, (labeled,) the expert's turns, on walks of the greatest length."""
        steps = max(self.lengths)
        taken = walk(None, -(-self.labeled // steps), steps, np.random.default_rng((1, seed)), stumble)
        return taken.observed.reshape(-1, CUE + 2)[: self.labeled], taken.label.reshape(-1)[: self.labeled]

    def _clone(self, observed: Array, labels: Array, seed: int) -> Policy:
        return clone(observed, labels, self.updates, seed)

    def _corrected(self, seed: int) -> Policy:
        """Half of the expert's steps are moved beside the rope, with the turn that leads back as the label."""
        observed, labels = self._expert(seed, 0.0)
        rng = np.random.default_rng((2, seed))
        off = np.where(rng.random(len(observed)) < 0.5, rng.integers(-FURTHEST, FURTHEST + 1, len(observed)), 0)
        moved = observed.copy()
        moved[:, CUE:] = np.stack([np.maximum(off, 0), np.maximum(-off, 0)], axis=1)
        return self._clone(moved, turn_back(labels, off), seed)

    def _dagger(self, seed: int) -> Policy:
        """Some of the labels are on the expert's walks, as many on the learner's own in each round."""
        count = self.labeled // (self.rounds + 1)
        observed, labels = (column[:count] for column in self._expert(seed, 0.0))
        steps = max(self.lengths)
        for number in range(self.rounds):
            learner = self._clone(observed, labels, seed)
            taken = walk(learner, -(-count // steps), steps, np.random.default_rng((3, seed, number)))
            observed = np.concatenate([observed, taken.observed.reshape(-1, CUE + 2)[:count]])
            labels = np.concatenate([labels, taken.label.reshape(-1)[:count]])
        return self._clone(observed, labels, seed)
