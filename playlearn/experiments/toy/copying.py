"""Copying: how well past actions predict the next one.

Play moves smoothly, so a policy that sees its own past can predict well, by any loss, without looking at the scene or
the goal. Such a policy never moves again once it has stopped (de Haan et al. 2019). Here the past is compared with the
present and the goal as a predictor, everywhere and at the moments where the action turns.
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
from playlearn.report.figure import save_figure
from playlearn.store import Store, open_store

TURNS = 0.1  # fraction of the moments that count as turns: those whose action differs most from the last


@Experiment.register_subclass("copying")
@dataclass(frozen=True)
class CopyingConfig(Experiment):
    """Predictors of the next action, from past actions, from observation and goal, and from both.

    store: play.
    past: numbers of past actions that a predictor sees, one predictor each.
    data: how goals are drawn (the next settled moment) and what is held out.
    examples: of each split, at most.
    hidden: units of a predictor's two hidden layers.
    updates: of a predictor.
    batch: examples of an update.
    lr: learning rate, at its highest.
    seeds: predictors trained for each input.

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
            raise UsageError(
                f"past must list numbers from 1 on, and seeds be 1 or more: got {self.past} and {self.seeds}"
            )

    def measure(self, say: Callable[[str], None]) -> Rows:
        store = open_store(self.store)
        train, val = (self._examples(store, split) for split in ("train", "val"))
        last = [("repeating the last action", 0, False, [val.past[:, -1]] * self.seeds)]
        inputs = [(f"{k} past actions", k, False) for k in self.past]
        inputs += [("observation and goal", 0, True)]
        inputs += [(f"observation, goal and {k} past actions", k, True) for k in self.past]
        rows: Rows = []
        for name, past, observed, predictions in last + [(*one, None) for one in inputs]:
            say(name)
            if predictions is None:
                predictions = [self._predict(train, val, past, observed, seed) for seed in range(self.seeds)]
            scores = [_score(prediction, train, val) for prediction in predictions]
            figures = {figure: np.array([score[figure] for score in scores]) for figure in scores[0]}
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
                (False, "#d1495b", "past actions only"),
                (True, "#2a6f97", "with observation and goal"),
            ):
                mine = [row for row in rows[1:] if row["observed"] == observed]
                axes.plot([r["past"] for r in mine], [r[key] for r in mine], "o-", color=color, label=name)
            axes.axhline(rows[0][key], color="0.4", ls=":", lw=1, label="last action repeated")
            axes.set(xlabel="past actions in the input", ylabel="R2 of the next action", title=label)
            axes.set_xticks([0, *self.past])
            axes.set_ylim(min(-0.1, 1.1 * min(row[key] for row in rows[1:])), 1)
        axes.legend(fontsize=8, frameon=False)
        save_figure(figure, path, dpi=130)

    def _examples(self, store: Store, split: str) -> "_Examples":
        """Of moments with enough actions before them and a label that is not masked."""
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
        actions = {int(e): store.array(int(e), "action") for e in np.unique(episodes)}
        past = np.stack([actions[int(e)][at - deepest : at] for e, at in zip(episodes, t, strict=True)])
        parts = [batch.state[:, -1], batch.achieved[:, -1], batch.goal_achieved - batch.achieved[:, -1]]
        observation = torch.cat(parts, dim=1)[whole].numpy()
        return _Examples(past=past, observation=observation, action=batch.action[whole, 0].numpy())

    def _predict(self, train: "_Examples", val: "_Examples", past: int, observed: bool, seed: int) -> Array:
        """(n, A) what a small network, trained on `train`, predicts for `val`."""
        inputs, queries = train.inputs(past, observed), val.inputs(past, observed)
        mean, std = inputs.mean(0), inputs.std(0) + 1e-4
        with torch.random.fork_rng(devices=[]):
            torch.random.manual_seed(seed)
            net = nn.Sequential(
                *(nn.Linear(inputs.shape[1], self.hidden), nn.GELU(), nn.Linear(self.hidden, self.hidden), nn.GELU()),
                nn.Linear(self.hidden, train.action.shape[1]),
            )
        x, y = (torch.from_numpy(a) for a in ((inputs - mean) / std, train.action / train.std))
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
            normalized: Tensor = net(torch.from_numpy((queries - mean) / std))
        predictions: Array = normalized.numpy() * train.std
        return predictions


@dataclass(frozen=True, eq=False)
class _Examples:
    """Inputs and labels of the predictors.

    past: (n, K, A), executed before.
    observation: (n, F), state, achieved, and what of the goal is left.
    action: (n, A), the label.
    """

    past: Array
    observation: Array
    action: Array

    @property
    def std(self) -> Array:
        """(A,) of the actions; 1 where they are constant."""
        std: Array = self.action.std(0)
        return np.where(std > 1e-4, std, 1.0).astype(np.float32)

    def inputs(self, past: int, observed: bool) -> Array:
        recent: Array = self.past[:, self.past.shape[1] - past :].reshape(len(self.past), -1)
        return np.concatenate([recent, self.observation], axis=1) if observed else recent


def _score(predictions: Array, train: _Examples, val: _Examples) -> dict[str, float]:
    """R2 against the mean action of `train`, each action in units of its std; the error as it is."""
    squares = np.square((predictions - val.action) / train.std).sum(1)
    baseline = np.square((train.action.mean(0) - val.action) / train.std).sum(1)
    change = np.abs(val.action - val.past[:, -1]).max(1)
    turns = change >= np.quantile(change, 1 - TURNS)
    error = np.abs(predictions - val.action).mean(1)
    return {
        "r2": float(1 - squares.sum() / baseline.sum()),
        "mean_error": float(error.mean()),
        "r2_at_turns": float(1 - squares[turns].sum() / baseline[turns].sum()),
        "mean_error_at_turns": float(error[turns].mean()),
    }
