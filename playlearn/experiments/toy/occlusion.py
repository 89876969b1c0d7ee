"""Observation against state: the cue for an action was visible some steps ago, and no longer is."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from playlearn.episode import Array
from playlearn.experiments.toy.base import Experiment, Rows
from playlearn.experiments.toy.tightrope_env import CUE, clone, walk
from playlearn.report.figure import save_figure


@Experiment.register_subclass("occlusion")
@dataclass(frozen=True)
class OcclusionConfig(Experiment):
    """Policies of several histories, with the cue visible now or only some steps ago.

    ago: steps ago at which the occluded cue was visible.
    histories: numbers of observations that a policy sees, one policy each.
    labeled: steps of the expert to train on.
    updates: of each policy.
    walks: of the expert to evaluate on.
    steps: of a walk.
    seeds: policies trained for each history.
    """

    ago: int = 2
    histories: tuple[int, ...] = (1, 2, 3, 4, 6)
    labeled: int = 4000
    updates: int = 800
    walks: int = 500
    steps: int = 40
    seeds: int = 3

    def measure(self, say: Callable[[str], None]) -> Rows:
        rows: Rows = []
        for history in self.histories:
            for occluded in (False, True):
                say(f"history {history}, {'occluded' if occluded else 'full state'}")
                errors = [self._error_rate(history, occluded, seed) for seed in range(self.seeds)]
                rows.append(
                    {
                        "history": history,
                        "occluded": occluded,
                        "mistakes_a_step": round(float(np.mean(errors)), 4),
                        "by_seed": np.round(errors, 4).tolist(),
                    }
                )
        return rows

    def plot(self, rows: Rows, path: Path) -> None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(5.4, 3.6), layout="constrained")
        axes = figure.add_subplot()
        for occluded, color in ((True, "#d1495b"), (False, "#2a6f97")):
            mine = [row for row in rows if row["occluded"] == occluded]
            label = f"cue visible {self.ago} steps ago" if occluded else "cue visible now"
            axes.plot(
                [r["history"] for r in mine], [r["mistakes_a_step"] for r in mine], "o-", color=color, label=label
            )
        axes.axhline(2 / 3, color="0.6", ls=":", lw=1)
        axes.text(self.histories[-1], 2 / 3, "random turns", ha="right", va="bottom", fontsize=8, color="0.4")
        axes.set(xlabel="observations in the history", ylabel="mistakes per step", ylim=(0, None))
        axes.legend(fontsize=8, frameon=False)
        save_figure(figure, path, dpi=130)

    def _error_rate(self, history: int, occluded: bool, seed: int) -> float:
        walks = -(-self.labeled // self.steps)
        observed, labels = self._examples(walks, history, occluded, np.random.default_rng((1, seed)))
        policy = clone(observed, labels, self.updates, seed)
        observed, labels = self._examples(self.walks, history, occluded, np.random.default_rng((2, seed)))
        return float((policy(observed) != labels).mean())

    def _examples(self, walks: int, history: int, occluded: bool, rng: np.random.Generator) -> tuple[Array, Array]:
        """(n, history CUE) observations on the expert's walks, and (n,) the expert's turns."""
        walks_taken = walk(None, walks, self.steps + self.ago + history, rng)
        cues, first = walks_taken.observed[..., :CUE], self.ago + history
        ahead = self.ago if occluded else 0
        last = cues.shape[1] - self.ago  # the cue of a step is visible `ahead` steps before it
        columns = [cues[:, first + ahead - back : last + ahead - back] for back in range(history)]
        return np.concatenate(columns, axis=-1).reshape(-1, history * CUE), walks_taken.label[:, first:last].reshape(-1)
