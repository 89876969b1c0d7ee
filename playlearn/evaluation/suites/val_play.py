"""Held-out play: start and goal are two moments of an episode that no policy was trained on."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Self

import numpy as np

from playlearn.config import from_dict, read_config, to_dict
from playlearn.data import DataConfig
from playlearn.data.split import val_mask
from playlearn.episode import Array
from playlearn.errors import PlaylearnError, StoreError, UsageError
from playlearn.evaluation.suite import EvalEpisode, Judge, SuiteKind, derived_seed, goal_from
from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment
from playlearn.store import Store, StoreConfig, open_store, parse_store

RUN_CONFIG = "config.yaml"


@SuiteKind.register_subclass("val_play")
@dataclass(frozen=True)
class ValPlayConfig(SuiteKind):
    """From a moment of held-out play to a settled moment a few seconds later; success is `Environment.reached`.

    The goal's simulator state is the recorded one, with the arm where it was. The task is named after the objects
    that changed.

    store: of the play (null: the store that the run was trained on).
    val_fraction: fraction of the episodes that is held out (null: as in the run's training).
    seconds: range of times from start to goal.
    settling: how settled moments are found.
    """

    store: Path | StoreConfig | None = None
    val_fraction: float | None = None
    seconds: tuple[float, float] = (2.0, 4.0)
    settling: SettlingConfig = field(default_factory=SettlingConfig)

    def prepare(self, run: Path | None) -> Self:
        store, val_fraction = self.store, self.val_fraction
        if run is not None and (store is None or val_fraction is None):
            trained_on, trained_fraction = _training(run)
            store, val_fraction = store or trained_on, trained_fraction if val_fraction is None else val_fraction
        if store is None:
            raise UsageError("this suite needs play: name its store with `--kind.store PATH`, or give a --run")
        complete = replace(
            self, store=store, val_fraction=DataConfig().val_fraction if val_fraction is None else val_fraction
        )
        complete._candidates()
        return complete

    def judge(self, environment: Environment, task: str) -> Judge:
        return lambda _start, achieved, goal: environment.reached(achieved, goal)

    def setup(
        self,
        environment: Environment,
        expert: Actor,
        episode: int,
        seed: int,
        max_steps: int,
        cameras: Sequence[str],
    ) -> EvalEpisode:
        store, moments = self._candidates()
        if tuple(store.spec.achieved_names) != tuple(environment.spec.achieved_names):
            raise StoreError(f"{self.store} holds play of another environment than this suite's; name another store")
        rng = np.random.default_rng((seed, episode))
        for redraws, k in enumerate(rng.permutation(len(moments))):
            recorded, goal_at, changed = moments[k]
            start_at = goal_at - int(rng.integers(*self._steps(store.spec.fps), endpoint=True))
            if start_at < 0:
                continue
            achieved = store.array(recorded, "achieved")
            states: Array = store.array(recorded, "sim.state")
            if environment.reached(achieved[start_at], achieved[goal_at]):
                continue
            environment.set_state(np.array(states[goal_at]))
            goal = goal_from(environment, cameras)
            environment.set_state(np.array(states[start_at]))
            if environment.failure() is not None:
                continue
            return EvalEpisode(
                episode=episode,
                task=changed,
                start_sim_state=np.array(states[start_at]),
                start_achieved=np.array(achieved[start_at]),
                goal=goal,
                goal_sim_state=np.array(states[goal_at]),
                seed=derived_seed(seed, episode),
                redraws=redraws,
            )
        raise PlaylearnError(
            f"no two moments of the held-out play in {self.store} lie {self.seconds[0]:g} to {self.seconds[1]:g} s "
            "apart and differ: collect more play, or widen `kind.seconds`"
        )

    def _candidates(self) -> tuple[Store, tuple[tuple[int, int, str], ...]]:
        low, high = self.seconds
        if not 0 < low <= high:
            raise UsageError(f"kind.seconds must be two rising positive numbers, got {low:g}, {high:g}")
        return _candidates(self.store or Path(), self.val_fraction or 0.0, json.dumps(to_dict(self.settling)))

    def _steps(self, fps: float) -> tuple[int, int]:
        return max(1, round(self.seconds[0] * fps)), max(1, round(self.seconds[1] * fps))


@cache
def _candidates(
    path: Path | StoreConfig, val_fraction: float, settling: str
) -> tuple[Store, tuple[tuple[int, int, str], ...]]:
    """The store, and every settled moment of its held-out episodes: episode, moment, what changed."""
    store = open_store(path)
    val = val_mask(store, val_fraction)
    held_out, trained = np.flatnonzero(val), np.flatnonzero(~val)
    if len(held_out) == 0:
        raise StoreError(f"{store.name()} has no held-out episodes among its {len(store)}: collect more play")
    config = from_dict(SettlingConfig, json.loads(settling))
    table = RelabelIndex.of_store(store, config, episodes=held_out.tolist(), learned=trained.tolist())
    groups = np.array(table.groups())
    moments = [
        (int(held_out[e]), int(table.moments[m]), " + ".join(groups[table.changed_groups()[m]]))
        for e in range(len(held_out))
        for m in range(table.offsets[e], table.offsets[e + 1])
    ]
    if not moments:
        raise StoreError(f"nothing changed and came to rest in the {len(held_out)} held-out episodes of {store.name()}")
    return store, tuple(moments)


def _training(run: Path) -> tuple[Path | StoreConfig | None, float | None]:
    """The store and the held-out fraction that a run was trained with."""
    path = run / RUN_CONFIG
    if not path.is_file():
        return None, None
    config = read_config(path)
    store = config.get("store")
    return (None if store is None else parse_store(store)), (config.get("data") or {}).get("val_fraction")
