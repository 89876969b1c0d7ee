"""Control steps a second without images: ours, robosuite's `env.step`, and the limit of physics alone."""

import time
from collections.abc import Iterator
from functools import partial

import mujoco

from playlearn.bench.base import Figure, Size, measuring, rates, timed
from playlearn.bench.envs import SEED, Pair, actions, pairs


def stepping(size: Size) -> Iterator[Figure]:
    """PlayTable and Lift, one process; the limit is `mj_step` alone, from the same states."""
    for pair in pairs(size.envs, images=False):
        measuring(f"{pair.name}: control steps")
        measured = rates({"ours": partial(_ours, pair, size), "peer": partial(_peer, pair, size)}, size.rounds)
        measured["limit"] = _limit(pair, size)
        yield Figure.beside(f"{pair.name}: control steps", "steps/s", measured, "robosuite env.step", "mj_step alone")


def _ours(pair: Pair, size: Size) -> tuple[int, float]:
    pair.ours.reset(SEED)
    planned = actions(size.steps)

    def work() -> None:
        for action in planned:
            pair.ours.step(action)
            pair.ours.observe()

    return size.steps, timed(work)


def _peer(pair: Pair, size: Size) -> tuple[int, float]:
    pair.peer.reset()
    planned = actions(size.steps)

    def work() -> None:
        for action in planned:
            pair.peer.step(action)

    return size.steps, timed(work)


def _limit(pair: Pair, size: Size) -> float:
    """Control steps a second of physics alone: one control period from each state, with constant controls."""
    env = pair.ours
    substeps = round(1 / env.spec.fps / env.model.opt.timestep)
    env.reset(SEED)
    seconds = 0.0
    for action in actions(size.steps):
        env.step(action)
        after = env.sim_state()
        began = time.perf_counter()
        mujoco.mj_step(env.model, env.data, substeps)
        seconds += time.perf_counter() - began
        env.set_state(after)
    return size.steps / seconds
