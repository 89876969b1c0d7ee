"""A store and a way of relabeling, turned into batches: a pure function of (seed, epoch, index)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from playlearn.batch import EVENTS, Batch
from playlearn.data.cameras import check_cameras
from playlearn.data.finite import check_finite
from playlearn.data.split import val_mask
from playlearn.data.stream import Examples, Indices
from playlearn.episode import IMAGES, Array
from playlearn.errors import StoreError, UsageError
from playlearn.layout import ObjectLayout
from playlearn.quantity import difference
from playlearn.relabeling import (
    UNIFORMS,
    GoalSamplerConfig,
    RelabelIndex,
    SettledConfig,
    SettlingConfig,
    counter_uniforms,
    events_ahead,
    grasps,
    leads_to_failure,
    robot_reader,
)
from playlearn.store import Store


@dataclass(frozen=True)
class DataConfig:
    """How examples are cut from play.

    goals: the goal sampler.
    settling: when the achieved goal counts as settled.
    goal_names: shell-style patterns of the achieved dimensions that a goal covers; what else changes is neither a
        settled moment nor balanced; where they choose none, settled moments are read from the robot. A run takes it
        from the policy's encoder.
    history: observations that a policy reads, the present one included (T). A run takes it from the policy.
    chunk: actions that a policy predicts (H). A run takes it from the policy.
    cameras: whose images an observation holds. A run takes them from the policy's encoder.
    goal_cameras: whose images a goal holds. A run takes them from the policy's encoder.
    events: whether examples hold the robot's own state at events ahead (see `relabeling.hand`). A run takes it from the
        policy's encoder.
    val_fraction: fraction of the episodes that is held out and never trained on; above 0, an import's own validation
        split counts instead where there is one.
    mask_after_goal: whether labels past the goal are masked.
    balance: 0 draws each example once an epoch; 1 draws each kind of change (which objects change at the next settled
        moment) equally often; between them, in proportion to count ** (1 - balance).
    failure_fraction: fraction that is kept of the examples whose attempt (see `relabeling.failures`) is yet to fail:
        even a failure shows how to get to somewhere. Always the same ones, however much play there is.
    max_label_deviation: a chunk ends with the first step at which the executed action differs from its label by more
        than this in some dimension (a mistake, a pause, a slip): later labels are conditioned on a state that the
        labeled actions would not have led to, so they are masked.
    interventions_only: whether only steps at which an expert took over are learned from (HG-DAgger): a chunk ends with
        the last of them in a row. For recordings of a policy and who corrected it, whose other actions are the
        policy's own; goals are drawn from the whole episode.
    target: `actions`, the recorded labels; `next_settled_delta`, the change of `achieved` up to the next settled
        moment, as a chunk of 1: what a high-level policy learns, which proposes subgoals.
    allow_detours: whether a change counts after which no fewer objects differ from the goal (`next_settled_delta`
        only); play wanders, and so would a policy that learned every change.
    """

    goals: GoalSamplerConfig = field(default_factory=SettledConfig)
    settling: SettlingConfig = field(default_factory=SettlingConfig)
    goal_names: tuple[str, ...] = ("*",)
    history: int = 1
    chunk: int = 8
    cameras: tuple[str, ...] = ()
    goal_cameras: tuple[str, ...] = ()
    events: bool = False
    val_fraction: float = 0.05
    mask_after_goal: bool = False
    balance: float = 0.0
    failure_fraction: float = 1.0
    max_label_deviation: float = 0.5
    interventions_only: bool = False
    target: Literal["actions", "next_settled_delta"] = "actions"
    allow_detours: bool = True

    def build(self, store: Store, split: str, seed: int) -> "PlayDataset":
        """The dataset of one split, "train" or "val"."""
        return PlayDataset(store, self, split, seed)


class PlayDataset(Examples):
    """Every step of a store's play from which a goal can be drawn; safe to share between threads.

    State, `achieved` and actions are held in memory; images stay in the store and are read as needed.
    """

    def __init__(self, store: Store, config: DataConfig, split: str = "train", seed: int = 0) -> None:
        """See `DataConfig`.

        Raises:
            StoreError: the store holds no step from which a goal can be drawn, or a number that is not finite.
            UsageError: a setting is out of range, or the store lacks a camera.
        """
        _check(config, split)
        check_cameras(store, (*config.cameras, *config.goal_cameras))
        out = val_mask(store, config.val_fraction)
        self.episodes: Indices = np.flatnonzero(out if split == "val" else ~out)  # (N,) positions in the store
        if len(self.episodes) == 0:
            raise StoreError(
                f"{store.name()} has no {split} episodes among its {len(store)}: collect more play, or hold none out "
                "(`data.val_fraction: 0`)"
            )
        self.store, self.config, self.seed = store, config, seed
        read = partial(_read, store, self.episodes)
        self.achieved = np.concatenate(read("achieved", store.spec.achieved_names))  # (sum T+1, G)
        self.state = np.concatenate(read("observation.state", store.spec.state_names))
        self.action = np.concatenate(read("expert_action", store.spec.action_names))  # (sum T, A)
        executed = read("action", store.spec.action_names)
        train = np.flatnonzero(~out).tolist()  # thresholds are measured on it for both splits, so that they agree
        self.table = RelabelIndex.of_store(store, config.settling, config.goal_names, self.episodes.tolist(), train)
        if config.target == "next_settled_delta" and len(self.table.change) == 0:
            raise UsageError(
                f"data.target: {store.name()} records no `achieved`, or its settled moments are read from the robot: "
                "there is no change to learn; leave target at actions"
            )
        self._goal_dimensions = ObjectLayout(store.spec.achieved_names).select(config.goal_names)
        self._corrected = self._corrections()
        self._last = self._last_of_chunk(executed)
        self._closed = self._grasps(train) if config.events else None
        self._sampler = config.goals.build()
        lengths = self.table.lengths
        episode = np.repeat(np.arange(len(lengths)), lengths)
        t = np.arange(len(episode)) - self.table.starts[episode]
        usable = self._sampler.valid(self.table, episode, t) & self._kept(t)
        if config.target == "next_settled_delta":
            usable &= self.table.following(episode, t) < self.table.offsets[episode + 1]
        if not usable.any():
            raise StoreError(
                f"{store.name()}: no {split} step has a goal to draw ({len(lengths)} episodes, {len(t)} steps, "
                f"{len(self.table.moments)} settled moments); {self._without_goals()}"
            )
        self._episode, self._t = episode[usable], t[usable]  # (n,), (n,)
        self._cumulative = self._weights() if config.balance else None

    def __len__(self) -> int:
        """n, the examples of an epoch."""
        return len(self._t)

    def where(self, indices: Indices) -> tuple[Indices, Indices]:
        """(n,), (n,): the episode (position in the store) and the step t of each example."""
        return self.episodes[self._episode[indices]], self._t[indices]

    def goals(self, epoch: int | Indices, indices: Indices) -> Indices:
        """(n,) the goal observation of each example in an epoch, counted from its episode's first (see GoalSampler)."""
        uniforms = counter_uniforms(self.seed, epoch, indices, UNIFORMS)
        return self._sampler.draw(self.table, self._episode[indices], self._t[indices], uniforms)

    def targets(self) -> Array:
        """(m, A) all targets: the recorded labels, or the change ahead of each example."""
        return self._change(self._episode, self._t) if self.config.target == "next_settled_delta" else self.action

    def epoch_indices(self, epoch: int) -> Indices:
        """(n,) the examples of an epoch in their order; each once, or as `balance` draws them."""
        rng = np.random.default_rng((self.seed, epoch))
        if self._cumulative is None:
            return rng.permutation(len(self))
        # Evenly spaced points: an example of weight w comes floor(n w) or ceil(n w) times.
        points = (np.arange(len(self)) + rng.random()) / len(self)
        drawn = np.searchsorted(self._cumulative, points, side="right")
        return rng.permutation(np.minimum(drawn, len(self) - 1))

    def probability(self, indices: Indices) -> NDArray[np.float64]:
        """(n,) the probability with which each example is drawn."""
        if self._cumulative is None:
            return np.full(len(indices), 1 / len(self))
        return np.asarray(np.diff(self._cumulative, prepend=0.0)[indices], np.float64)

    def batch(self, epoch: int | Indices, indices: Indices) -> Batch:
        """The given examples as they are in an epoch (one for all, or one each)."""
        indices = np.asarray(indices, np.int64)
        episode, t, goal = self._episode[indices], self._t[indices], self.goals(epoch, indices)
        length, config = self.table.lengths[episode], self.config
        past = t[:, None] + np.arange(1 - config.history, 1)  # (B, T)
        seen = np.maximum(past, 0)
        rows = self.table.rows[episode][:, None] + seen
        ahead = t[:, None] + np.arange(config.chunk)  # (B, H)
        leads = (goal > t) & (goal <= length)
        limit = np.where(leads, goal, length) if config.mask_after_goal else length
        limit = np.minimum(limit, self._last[self.table.starts[episode] + t] + 1)
        targets = self.table.starts[episode][:, None] + np.minimum(ahead, length[:, None] - 1)
        goal_row = self.table.rows[episode] + goal
        shown = np.searchsorted(self.table.rows, goal_row, side="right") - 1  # the goal's episode
        goals = (goal_row - self.table.rows[shown])[:, None]
        action, counts = self.action.take(targets, axis=0), ahead < limit[:, None]
        if config.target == "next_settled_delta":
            action, counts = self._change(episode, t)[:, None], self._counts(episode, t, goal_row)[:, None]
        return Batch(  # `take` is up to 20 times as fast as brackets where rows are short
            state=torch.from_numpy(self.state.take(rows, axis=0)),
            achieved=torch.from_numpy(self.achieved.take(rows, axis=0)),
            images={camera: self._frames(camera, episode, seen) for camera in config.cameras},
            history_mask=torch.from_numpy(past >= 0),
            goal_achieved=torch.from_numpy(self.achieved.take(goal_row, axis=0)),
            goal_proprio=torch.from_numpy(self.state.take(goal_row, axis=0)),
            goal_images={camera: self._frames(camera, shown, goals)[:, 0] for camera in config.goal_cameras},
            action=torch.from_numpy(action),
            action_mask=torch.from_numpy(counts),
            steps_to_goal=torch.from_numpy(np.where(leads, goal - t, 0)),
            events={} if self._closed is None else self._events(self._closed, episode, t),
        )

    def segments(self, episode: int) -> list[tuple[int, int, int]]:
        """(settled moment, last observation of its configuration, grasp or -1) of the episode at this place.

        Needs `DataConfig.events`.
        """
        own = slice(self.table.offsets[episode], self.table.offsets[episode + 1])
        closed = np.full(len(self.table.moments), -1) if self._closed is None else self._closed
        parts = (self.table.moments[own], self.table.ends[own], closed[own])
        return list(zip(*(part.tolist() for part in parts), strict=True))

    def _grasps(self, learned: Sequence[int]) -> Indices:
        """(M,) of `relabeling.grasps`. learned: the episodes on which thresholds are measured."""
        reader = robot_reader(self.store, self.config.settling, learned)
        return grasps(self.table, reader, [self.store.array(int(i), "observation.state") for i in self.episodes])

    def _events(self, closed: Indices, episode: Indices, t: Indices) -> dict[str, torch.Tensor]:
        """Event -> (B, S) float32, NaN where it does not lie ahead."""
        ahead = events_ahead(self.table, closed, episode, t)  # (B, E)
        rows = self.table.rows[episode][:, None] + np.maximum(ahead, 0)
        states = np.where((ahead >= 0)[..., None], self.state.take(rows, axis=0), np.float32(np.nan))
        return {name: torch.from_numpy(states[:, k]) for k, name in enumerate(EVENTS)}

    def _without_goals(self) -> str:
        """What to do where there is no goal to draw."""
        if self.config.goals.reads_moments and not len(self.table.moments) and not len(self.table.change):
            read = self.config.settling.robot.describe(self.store.spec.state_names)
            return f"{read}; or take any later moment as goal: `--data.goals.type future`"
        return "collect longer episodes, or choose other `goals` or thresholds in `settling`"

    def _frames(self, camera: str, episode: Indices, rows: Indices) -> torch.Tensor:
        """(B, k, h, w, 3) uint8 of observations rows (B, k)."""
        frames = np.empty((*rows.shape, *self.store.cameras()[camera], 3), np.uint8)
        order = np.argsort(episode, kind="stable")
        bounds = np.flatnonzero(np.diff(episode[order], prepend=-1, append=-1))
        for begin, end in pairwise(bounds):
            mine = order[begin:end]
            recorded = self.store.array(int(self.episodes[episode[mine[0]]]), IMAGES + camera)
            frames[mine] = recorded[rows[mine]]
        return torch.from_numpy(frames)

    def _change(self, episode: Indices, t: Indices) -> Array:
        """(n, G) float32: `achieved` of the next settled moment less that of step t."""
        row = self.table.rows[episode]
        settled = self.table.moments[self.table.following(episode, t)]
        measured = self.store.spec.quantities.achieved
        return difference(self.achieved[row + settled], self.achieved[row + t], measured)

    def _counts(self, episode: Indices, t: Indices, goal_row: Indices) -> NDArray[np.bool_]:
        """(n,) whether the change ahead counts, see `DataConfig.allow_detours`."""
        if self.config.allow_detours:
            return np.ones(len(t), np.bool_)
        settled = self.table.moments[self.table.following(episode, t)]
        goal = self.achieved[goal_row]
        now, then = (
            self.table.groups_apart(
                self.achieved[self.table.rows[episode] + at][:, self._goal_dimensions], goal[:, self._goal_dimensions]
            )
            for at in (t, settled)
        )
        return np.asarray(then.sum(axis=1) < now.sum(axis=1))

    def _last_of_chunk(self, executed: Sequence[Array]) -> Indices:
        """(sum T,) the last step t' >= t whose label is conditioned on what executing the labels from t on leads to."""
        deviates = np.abs(np.concatenate(executed) - self.action).max(axis=1) > self.config.max_label_deviation
        ends = deviates | ~np.append(self._corrected[1:], True)
        steps = np.arange(len(ends))
        first = np.minimum.accumulate(np.where(ends, steps, len(ends))[::-1])[::-1]  # flat, at or after each
        start = np.repeat(self.table.starts[:-1], self.table.lengths)
        return np.asarray(first - start, np.int64)  # may point past the episode, whose end counts then

    def _corrections(self) -> NDArray[np.bool_]:
        """(sum T,) the steps that are learned from, see `DataConfig.interventions_only`."""
        took_over = np.concatenate([self.store.array(int(i), "intervention") for i in self.episodes])
        if self.config.interventions_only and not took_over.any():
            raise StoreError(
                f"{self.store.name()}: data.interventions_only, and nobody took over at any step (`intervention`): set "
                "it to false, or name a store of corrections"
            )
        return took_over if self.config.interventions_only else np.ones(len(took_over), np.bool_)

    def _kept(self, t: Indices) -> NDArray[np.bool_]:
        """(sum T,) the steps learned from but the failing ones that `failure_fraction` leaves out."""
        if self.config.failure_fraction >= 1:
            return self._corrected
        episodes = self.episodes.tolist()
        failing = [leads_to_failure(self.store.array(i, "skill"), self.store.meta(i).annotations()) for i in episodes]
        recorded = np.repeat(self.store.indices()[self.episodes], self.table.lengths)
        drawn = counter_uniforms(0, recorded, t, 1)[:, 0] < self.config.failure_fraction
        return np.asarray(self._corrected & (drawn | ~np.concatenate(failing)))

    def _weights(self) -> NDArray[np.float64]:
        """(n,) the running sum of the examples' probabilities under `balance`."""
        groups = np.concatenate([self.table.changed_groups(), np.zeros((1, len(self.table.groups())), np.bool_)])
        following = self.table.following(self._episode, self._t)
        none = following >= self.table.offsets[self._episode + 1]
        _, kind, counts = np.unique(
            groups[np.where(none, len(groups) - 1, following)], axis=0, return_inverse=True, return_counts=True
        )
        weights = counts[kind.reshape(-1)] ** -float(self.config.balance)
        return np.asarray(np.cumsum(weights / weights.sum()), np.float64)


def _read(store: Store, episodes: Indices, key: str, names: Sequence[str]) -> list[Array]:
    """An array (n, D) of each episode; raises StoreError that names the first number that is not finite."""
    numbers, found = store.indices(), [store.array(int(i), key) for i in episodes]
    for i, one in zip(episodes.tolist(), found, strict=True):
        check_finite(one, names, f"{store.name()}, episode {numbers[i]}, {key}")
    return found


def _check(config: DataConfig, split: str) -> None:
    if split not in ("train", "val"):
        raise UsageError(f"split must be train or val, got {split!r}")
    for name, value in {"history": config.history, "chunk": config.chunk}.items():
        if value < 1:
            raise UsageError(f"data.{name} must be at least 1, got {value}")
    if config.target == "next_settled_delta" and config.chunk != 1:
        raise UsageError(f"data.target: a change is one label, so set policy.chunk to 1 (it is {config.chunk})")
    if not config.max_label_deviation > 0:
        raise UsageError(f"data.max_label_deviation must be above 0, got {config.max_label_deviation}")
    for name in ("val_fraction", "balance", "failure_fraction"):
        fraction = getattr(config, name)
        if not 0 <= fraction <= 1:
            raise UsageError(f"data.{name} must lie between 0 and 1, got {fraction}")
