"""Observation against state: what decides was to be seen some steps ago, and is no longer."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from playlearn.episode import Array
from playlearn.experiments.toy.base import Experiment, Rows
from playlearn.experiments.toy.tightrope_env import CUE, cloned, walk


@Experiment.register_subclass("occlusion")
@dataclass(frozen=True)
class OcclusionConfig(Experiment):
    """ago: how many steps ago the cue was shown. histories: observations that a policy sees, one policy each.

    labeled, walks: steps to learn from, walks of `steps` to be judged on. seeds: each trains anew.
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
                wrong = [self._wrong(history, occluded, seed) for seed in range(self.seeds)]
                rows.append(
                    {
                        "history": history,
                        "occluded": occluded,
                        "mistakes_a_step": round(float(np.mean(wrong)), 4),
                        "by_seed": np.round(wrong, 4).tolist(),
                    }
                )
        return rows

    def plot(self, rows: Rows, path: Path) -> None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(5.4, 3.6), layout="constrained")
        axes = figure.add_subplot()
        for occluded, color in ((True, "#d1495b"), (False, "#2a6f97")):
            mine = [row for row in rows if row["occluded"] == occluded]
            label = f"cue shown {self.ago} steps ago" if occluded else "cue in sight"
            axes.plot(
                [r["history"] for r in mine], [r["mistakes_a_step"] for r in mine], "o-", color=color, label=label
            )
        axes.axhline(2 / 3, color="0.6", ls=":", lw=1)
        axes.text(self.histories[-1], 2 / 3, "chance", ha="right", va="bottom", fontsize=8, color="0.4")
        axes.set(xlabel="observations in the history", ylabel="wrong turns a step", ylim=(0, None))
        axes.legend(fontsize=8, frameon=False)
        figure.savefig(path, dpi=130)

    def _wrong(self, history: int, occluded: bool, seed: int) -> float:
        walks = -(-self.labeled // self.steps)
        seen, right = self._shown(walks, history, occluded, np.random.default_rng((1, seed)))
        policy = cloned(seen, right, self.updates, seed)
        seen, right = self._shown(self.walks, history, occluded, np.random.default_rng((2, seed)))
        return float((policy(seen) != right).mean())

    def _shown(self, walks: int, history: int, occluded: bool, rng: np.random.Generator) -> tuple[Array, Array]:
        """(n, history CUE) what a policy sees of the expert's walks, and (n,) the right turns."""
        taken = walk(None, walks, self.steps + self.ago + history, rng)
        cues, first = taken.seen[..., :CUE], self.ago + history
        ahead = self.ago if occluded else 0
        last = cues.shape[1] - self.ago  # the cue of a step is shown `ahead` steps before it
        columns = [cues[:, first + ahead - back : last + ahead - back] for back in range(history)]
        return np.concatenate(columns, axis=-1).reshape(-1, history * CUE), taken.right[:, first:last].reshape(-1)
