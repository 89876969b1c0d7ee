"""Play without a simulator: objects that rest, are moved one at a time, and rest again."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from playlearn.episode import Array, Episode, EpisodeMeta
from playlearn.quantity import own_quantities
from playlearn.store import NativeStore, StoreSpec

STATE = ("eef.x", "eef.y", "eef.z", "gripper.opening")
ACHIEVED = ("red.x", "red.y", "red.z", "red.c", "red.s", "drawer.opening", "lamp.on")
ACTION = ("dx", "dy", "dz", "gripper")
SKILLS = ("push red", "open drawer", "flip lamp")
FPS = 20.0
QUANTITIES = own_quantities(STATE, ACHIEVED, len(ACTION))
ENVIRONMENT = {"type": "synthetic", "objects": 3}


def make_episode(
    rng: np.random.Generator,
    steps: int = 200,
    cameras: Mapping[str, tuple[int, int]] | Sequence[str] = (),
    *,
    seed: int = 0,
    task: str = "",
    ended: str = "length",
    success: bool | None = None,
    reward: Array | None = None,
) -> Episode:
    """Segments of 2 to 4 s: pause, move one object smoothly, rest for a second.

    steps: T. cameras: names (16x16) or name -> (h, w); an image's top left pixel is (observation index
    mod 256, seed mod 256, camera number), the rest is a picture that changes with the achieved goal.
    """
    sizes = dict(cameras) if isinstance(cameras, Mapping) else dict.fromkeys(cameras, (16, 16))
    achieved, skill = _env(rng, steps)
    state = np.cumsum(rng.normal(0, 0.004, (steps + 1, len(STATE))), axis=0).astype(np.float32)
    action = np.clip(rng.normal(0, 0.4, (steps, len(ACTION))), -1, 1).astype(np.float32)
    meta = EpisodeMeta(
        environment=ENVIRONMENT,
        state_names=STATE,
        achieved_names=ACHIEVED,
        action_names=ACTION,
        fps=FPS,
        seed=seed,
        actor="player",
        skills=SKILLS,
        cameras={camera: {"height": h, "width": w} for camera, (h, w) in sizes.items()},
        versions={"playlearn": "0"},
        task=task,
        ended=ended,
        success=success,
        quantities=QUANTITIES,
    )
    return Episode(
        meta=meta,
        state=state,
        achieved=achieved,
        sim_state=rng.normal(size=(steps + 1, 5)),
        time=np.arange(steps + 1) / FPS,
        action=np.clip(action + rng.normal(0, 0.05, action.shape), -1, 1).astype(np.float32),
        expert_action=action,
        intervention=np.zeros(steps, np.bool_),
        skill=skill,
        images={camera: _pictures(achieved, size, seed, number) for number, (camera, size) in enumerate(sizes.items())},
        reward=reward,
    )


def make_store(
    path: Path,
    rng: np.random.Generator,
    episodes: int = 4,
    steps: int = 200,
    cameras: Mapping[str, tuple[int, int]] | Sequence[str] = (),
) -> NativeStore:
    """A store of such episodes, numbered from 0, each under its number as seed."""
    made = [make_episode(rng, steps, cameras, seed=seed) for seed in range(episodes)]
    store = NativeStore.create(path, StoreSpec.of(made[0]))
    with store.writer() as writer:
        for episode in made:
            writer.append(episode)
    return store


def _env(rng: np.random.Generator, steps: int) -> tuple[Array, Array]:
    """achieved (T+1, G) float32 with less than 1 mm of jitter, and skill (T,) int16."""
    achieved = np.zeros((steps + 1, len(ACHIEVED)))
    skill = np.zeros(steps, np.int16)
    at, now = 0, np.array([0.1, 0.0, 0.02, 1.0, 0.0, 0.0, 0.0])
    while at <= steps:
        kind = int(rng.integers(len(SKILLS)))
        target = _changed(now, kind, rng)
        pause, motion, rest = int(rng.integers(5, 15)), int(rng.integers(20, 40)), 20
        ramp = np.clip((np.arange(pause + motion + rest) - pause) / motion, 0, 1)[:, None]
        if kind == 2:
            ramp = (ramp >= 1).astype(np.float64)
        segment = now + (target - now) * (3 * ramp**2 - 2 * ramp**3)
        segment = segment[: steps + 1 - at]
        achieved[at : at + len(segment)] = segment
        skill[at : at + len(segment)] = kind
        at, now = at + len(segment), target
    achieved[:, :3] += rng.uniform(-3e-4, 3e-4, (steps + 1, 3))
    return achieved.astype(np.float32), skill


def _changed(now: Array, kind: int, rng: np.random.Generator) -> Array:
    target = now.copy()
    if kind == 0:
        angle = rng.uniform(0, 2 * np.pi)
        target[:2] = now[:2] + rng.uniform(0.05, 0.15) * np.array([np.cos(angle), np.sin(angle)])
        target[3:5] = np.cos(2 * angle), np.sin(2 * angle)
    elif kind == 1:
        target[5] = 0.2 - now[5] if now[5] in (0.0, 0.2) else 0.0
    else:
        target[6] = 1 - now[6]
    return target


def _pictures(achieved: Array, size: tuple[int, int], seed: int, number: int) -> Array:
    """(T+1, h, w, 3) uint8."""
    h, w = size
    down, across = np.mgrid[:h, :w]
    x = (achieved[:, 0, None, None] * 40 + w / 2) % w
    y = (achieved[:, 1, None, None] * 40 + h / 2) % h
    frames = np.full((len(achieved), h, w, 3), 60, np.uint8)
    frames[..., 0] = np.where((np.abs(across - x) < 2) & (np.abs(down - y) < 2), 220, 60)
    frames[..., 1] = (achieved[:, 5, None, None] * 500).astype(np.uint8)
    frames[..., 2] = (achieved[:, 6, None, None] * 200).astype(np.uint8)
    frames[:, 0, 0, 0] = np.arange(len(achieved)) % 256
    frames[:, 0, 0, 1:] = seed % 256, number
    return frames


def red_then_lamp(path: Path) -> NativeStore:
    """One episode: red moves at observation 50 and the lamp goes on at 100, each at rest 6 steps (0.3 s) later."""
    achieved = np.zeros((201, 7), np.float32)
    achieved[50:, 0], achieved[100:, 6] = 0.1, 1.0
    episode = dataclasses.replace(make_episode(np.random.default_rng(0), 200), achieved=achieved)
    store = NativeStore.create(path, StoreSpec.of(episode))
    with store.writer() as writer:
        writer.append(episode)
    return store
