"""Copying: how much of the next action the last ones already tell.

Play moves smoothly, so a policy that sees its own past can predict well, by any loss, without looking at the world or
the goal, and then stops for ever once it has stopped (de Haan et al. 2019). What the past alone tells, beside what
the present and the goal tell, says how tempting that is; what is told where the action turns, how dear.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from playlearn.data import DataConfig
from playlearn.episode import Array
from playlearn.errors import UsageError
from playlearn.experiments.toy.base import Experiment, Rows
from playlearn.store import Store, open_store

TURNS = 0.1  # the share of moments, those whose action differs most from the last, that count as turns


@Experiment.register_subclass("copying")
@dataclass(frozen=True)
class CopyingConfig(Experiment):
    """store: play. past: numbers of past actions that a predictor sees, one predictor each.

    data: how goals are drawn (the next settled moment) and what is held out. examples: of each split, at most.
    hidden, updates, lr: of the predictors, all alike. seeds: each trains anew.

    Raises:
        UsageError: a number of past actions, or of seeds, is below 1.
    """

    store: Path = Path("datasets/sample")
    past: tuple[int, ...] = (1, 2, 4, 8)
    data: DataConfig = field(default_factory=lambda: DataConfig(chunk=1, val_fraction=0.2))
    examples: int = 50_000
    hidden: int = 256
    updates: int = 2000
    batch: int = 256
    lr: float = 1e-3
    seeds: int = 3

    def __post_init__(self) -> None:
        if not self.past or min(self.past) < 1 or self.seeds < 1:
            raise UsageError(f"past must name numbers from 1 on, and seeds be 1 or more: {self.past}, {self.seeds}")

    def measure(self, say: Callable[[str], None]) -> Rows:
        store = open_store(self.store)
        known, asked = (self._examples(store, split) for split in ("train", "val"))
        last = [("repeating the last action", 0, False, [asked.past[:, -1]] * self.seeds)]
        sorts = [(f"{k} past actions", k, False) for k in self.past]
        sorts += [("observation and goal", 0, True)]
        sorts += [(f"observation, goal and {k} past actions", k, True) for k in self.past]
        rows: Rows = []
        for name, past, observed, answers in last + [(*sort, None) for sort in sorts]:
            say(name)
            if answers is None:
                answers = [self._answers(known, asked, past, observed, seed) for seed in range(self.seeds)]
            judged = [_judge(answer, known, asked) for answer in answers]
            figures = {figure: np.array([one[figure] for one in judged]) for figure in judged[0]}
            rows.append(
                {
                    "inputs": name,
                    "past": past,
                    "observed": observed,
                    **{figure: round(float(values.mean()), 4) for figure, values in figures.items()},
                    "r2_by_seed": np.round(figures["r2"], 4).tolist(),
                }
            )
        return rows

    def plot(self, rows: Rows, path: Path) -> None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(8.6, 3.4), layout="constrained")
        for axes, (key, label) in zip(
            figure.subplots(1, 2), (("r2", "everywhere"), ("r2_at_turns", "where the action turns most")), strict=True
        ):
            for observed, color, name in (
                (False, "#d1495b", "past actions alone"),
                (True, "#2a6f97", "with observation and goal"),
            ):
                mine = [row for row in rows[1:] if row["observed"] == observed]
                axes.plot([r["past"] for r in mine], [r[key] for r in mine], "o-", color=color, label=name)
            axes.axhline(rows[0][key], color="0.4", ls=":", lw=1, label="the last action again")
            axes.set(xlabel="past actions seen", ylabel="R2 of the next action", title=label)
            axes.set_xticks([0, *self.past])
            axes.set_ylim(min(-0.1, 1.1 * min(row[key] for row in rows[1:])), 1)
        axes.legend(fontsize=8, frameon=False)
        figure.savefig(path, dpi=130)

    def _examples(self, store: Store, split: str) -> "_Examples":
        """Of moments that have enough of a past, and whose label is no mistake's."""
        dataset, deepest = self.data.build(store, split, seed=0), max(self.past)
        order = dataset.epoch_indices(0)
        episodes, t = dataset.where(order)
        order = order[t >= deepest][: self.examples]
        batch = dataset.batch(0, order)
        order, whole = order[batch.action_mask[:, 0].numpy()], batch.action_mask[:, 0]
        episodes, t = dataset.where(order)
        if len(order) < 2:
            raise UsageError(
                f"{self.store} has no {split} moments with {deepest} actions before them: collect more play"
            )
        executed = {int(e): store.array(int(e), "action") for e in np.unique(episodes)}
        past = np.stack([executed[int(e)][at - deepest : at] for e, at in zip(episodes, t, strict=True)])
        seen = [batch.state[:, -1], batch.achieved[:, -1], batch.goal_achieved - batch.achieved[:, -1]]
        return _Examples(past=past, seen=torch.cat(seen, dim=1)[whole].numpy(), action=batch.action[whole, 0].numpy())

    def _answers(self, known: "_Examples", asked: "_Examples", past: int, observed: bool, seed: int) -> Array:
        """(n, A) what a small network, taught on `known`, says to what is asked."""
        given, questions = known.inputs(past, observed), asked.inputs(past, observed)
        middle, std = given.mean(0), given.std(0) + 1e-4
        with torch.random.fork_rng(devices=[]):
            torch.random.manual_seed(seed)
            net = nn.Sequential(
                *(nn.Linear(given.shape[1], self.hidden), nn.GELU(), nn.Linear(self.hidden, self.hidden), nn.GELU()),
                nn.Linear(self.hidden, known.action.shape[1]),
            )
        x, y = (torch.from_numpy(a) for a in ((given - middle) / std, known.action / known.std))
        rng = torch.Generator().manual_seed(seed)
        optimizer = torch.optim.AdamW(net.parameters(), lr=self.lr, weight_decay=1e-2)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, self.updates)
        for _ in range(self.updates):
            rows = torch.randint(len(x), (self.batch,), generator=rng)
            loss = nn.functional.mse_loss(net(x[rows]), y[rows])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
        with torch.no_grad():
            said: Tensor = net(torch.from_numpy((questions - middle) / std))
        answers: Array = said.numpy() * known.std
        return answers


@dataclass(frozen=True, eq=False)
class _Examples:
    """past (n, K, A) executed before, seen (n, F) observation and what is left to the goal, action (n, A) the label."""

    past: Array
    seen: Array
    action: Array

    @property
    def std(self) -> Array:
        """(A,) of the actions; 1 where they never differ."""
        std: Array = self.action.std(0)
        return np.where(std > 1e-4, std, 1.0).astype(np.float32)

    def inputs(self, past: int, observed: bool) -> Array:
        recent: Array = self.past[:, self.past.shape[1] - past :].reshape(len(self.past), -1)
        return np.concatenate([recent, self.seen], axis=1) if observed else recent


def _judge(answers: Array, known: _Examples, asked: _Examples) -> dict[str, float]:
    """R2 against always saying the mean that was taught, each action in units of its spread; error as it comes."""
    off = np.square((answers - asked.action) / known.std).sum(1)
    mean = np.square((known.action.mean(0) - asked.action) / known.std).sum(1)
    turned = np.abs(asked.action - asked.past[:, -1]).max(1)
    turns = turned >= np.quantile(turned, 1 - TURNS)
    wrong = np.abs(answers - asked.action).mean(1)
    return {
        "r2": float(1 - off.sum() / mean.sum()),
        "mean_error": float(wrong.mean()),
        "r2_at_turns": float(1 - off[turns].sum() / mean[turns].sum()),
        "mean_error_at_turns": float(wrong[turns].mean()),
    }
