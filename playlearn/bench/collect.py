"""Collect play into a store: steps a second, beside robosuite's loop and the parts of our own."""

import tempfile
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from playlearn.bench.base import Figure, Size, measuring, rates, timed
from playlearn.bench.envs import SEED, SIDE, Pair, actions, pairs
from playlearn.collection import CollectConfig, play
from playlearn.collection import collect as collect_store
from playlearn.envs import PlayTableConfig
from playlearn.sim import CameraConfig
from playlearn.store import write_episode

CAMERAS = ("front", "wrist")


def collecting(size: Size) -> Iterator[Figure]:
    """PlayTable, with two cameras and with none, in one process."""
    for cameras in (CAMERAS, ()):
        pair = next(pairs(("playtable",), images=bool(cameras)))
        config = collect_config(cameras, size)
        cameras_text = f"two cameras of {SIDE} px" if cameras else "no camera"
        measuring(f"collect, {cameras_text}")
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "play"
            collect_store(collect_config(cameras, size, episodes=1), out, workers=0)
            measured = rates(
                {
                    "ours": partial(_ours, config, out),
                    "peer": partial(_peer, pair, size),
                    "limit": partial(_parts, pair, cameras, size),
                },
                size.rounds,
            )
        yield Figure.beside(
            f"collect, {cameras_text}",
            "steps/s",
            measured,
            "robosuite env.step, nothing stored",
            "stepping and rendering alone",
        )


def collect_config(cameras: Sequence[str], size: Size, episodes: int = 1) -> CollectConfig:
    """What is collected here and in `workers`."""
    env = PlayTableConfig(cameras={name: CameraConfig(SIDE, SIDE) for name in CAMERAS})
    return CollectConfig(environment=env, cameras=tuple(cameras), episodes=episodes, steps=size.steps, seed=SEED)


def _ours(config: CollectConfig, out: Path) -> tuple[int, float]:
    began = time.perf_counter()
    episode = play(config, 0)
    write_episode(out, 0, episode)
    return len(episode), time.perf_counter() - began


def _peer(pair: Pair, size: Size) -> tuple[int, float]:
    pair.peer.reset()
    planned = actions(size.steps)
    return size.steps, timed(lambda: [pair.peer.step(action) for action in planned])


def _parts(pair: Pair, cameras: Sequence[str], size: Size) -> tuple[int, float]:
    pair.ours.reset(SEED)
    seconds = 0.0
    for action in actions(size.steps):
        began = time.perf_counter()
        pair.ours.step(action)
        for camera in cameras:
            pair.ours.render(camera, SIDE, SIDE)
        seconds += time.perf_counter() - began
    return size.steps, seconds
