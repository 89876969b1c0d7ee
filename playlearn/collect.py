"""Record play into a store, and draw images for play that was recorded: episode by episode, on all cores."""

import dataclasses
import functools
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.config import atomic_write, from_dict, git_revision, save_config, to_dict, versions
from playlearn.errors import PlaylearnError, UsageError
from playlearn.executor import Job, LocalExecutorConfig
from playlearn.report.progress import Progress
from playlearn.rollout import rollout
from playlearn.sim import CameraConfig, Environment, EnvironmentConfig
from playlearn.store import NativeStore, StoreSpec, write_episode
from playlearn.tasks import PlayTableConfig
from playlearn.teleop import PlayConfig, player_for


@dataclass(frozen=True)
class CollectConfig:
    """environment: where to play. play: how. episodes: how many, each of at most `steps` control steps.

    cameras: which of the environment's cameras to record; none is quickest, and `playlearn render`
    draws them later from the simulator states, which are always recorded.
    seed: with an episode's number it decides everything in that episode.
    """

    environment: EnvironmentConfig = field(default_factory=PlayTableConfig)
    play: PlayConfig = field(default_factory=PlayConfig)
    episodes: int = 100
    steps: int = 400
    cameras: tuple[str, ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("episodes", "steps"):
            if getattr(self, name) < 1:
                raise UsageError(f"{name} must be at least 1, got {getattr(self, name)}")


def collect(config: CollectConfig, out: Path, *, workers: int | None = None, resume: bool = False) -> None:
    """Record episodes 0 ... episodes-1 into the store at `out`; with `resume`, those that are missing.

    The same seed gives the same episodes, whatever the number of workers and interruptions.

    Raises:
        UsageError: `out` was collected with another config; an unknown camera.
        StoreError: `out` holds something already and `resume` was not asked for; the disk is full.
    """
    environment = _environment(json.dumps(_kind(config.environment)))
    unknown = sorted(set(config.cameras) - set(environment.spec.cameras))
    if unknown:
        raise UsageError(f"cameras: {unknown[0]!r} is not one of {', '.join(environment.spec.cameras)}")
    if config.cameras:
        environment.renderer()  # no OpenGL is said now, not in a worker
    store = _open(config, environment, out, resume)
    with store.writer():
        done = set(store.indices().tolist())
        missing = [index for index in range(config.episodes) if index not in done]
        jobs = [
            Job(
                key=index,
                function=record,
                kwargs={"settings": json.dumps(_settings(config)), "folder": str(out), "index": index},
                seed=episode_seed(config.seed, index),
            )
            for index in missing
        ]
        _run(jobs, f"collect {out}", len(done), environment.spec.fps, workers)


def record(settings: str, folder: str, index: int) -> tuple[int, str]:
    """Play one episode and put it into the store: what a worker does. Returns steps and why it ended."""
    config = from_dict(CollectConfig, json.loads(settings))
    environment = _environment(json.dumps(_kind(config.environment)))
    seed = episode_seed(config.seed, index)
    environment.reset(seed)
    player = player_for(environment, config.play)
    outcome = rollout([environment], player, [None], seeds=[seed], max_steps=config.steps, cameras=config.cameras)[0]
    if outcome.episode is None:
        raise PlaylearnError(f"episode {index} (seed {seed}) ended before its first action: {outcome.ended}")
    write_episode(folder, index, outcome.episode)
    return outcome.steps, outcome.ended


def episode_seed(seed: int, index: int) -> int:
    """The seed of episode `index` of a collection."""
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0])


def render_store(source: Path, out: Path, cameras: Mapping[str, CameraConfig], workers: int | None = None) -> None:
    """A store like `source` with images of these cameras and sizes, drawn from its simulator states.

    Goes on where an interrupted call stopped.

    Raises:
        StoreError: `source` is missing, or `out` holds something else.
        UsageError: the environment has no such camera.
    """
    store = NativeStore.open(source)
    config = from_dict(EnvironmentConfig, store.spec.environment)
    known = config.build().spec.cameras
    unknown = sorted(set(cameras) - set(known))
    if unknown:
        raise UsageError(f"camera {unknown[0]!r} is not one of {', '.join(known)}")
    sizes = {name: (size.height, size.width) for name, size in cameras.items()}
    spec = dataclasses.replace(store.spec, cameras=sizes)
    made = NativeStore.open(out) if (out / "store.json").exists() else NativeStore.create(out, spec)
    made.spec.check(spec)
    with made.writer():
        done = set(made.indices().tolist())
        jobs = [
            Job(
                key=int(index),
                function=redraw,
                kwargs={"source": str(source), "out": str(out), "position": position, "sizes": sizes},
            )
            for position, index in enumerate(store.indices())
            if int(index) not in done
        ]
        with (
            LocalExecutorConfig(workers=workers).build() as executor,
            Progress(f"render {out}", len(store), "episode", begun=len(done)) as progress,
        ):
            for count, _ in enumerate(executor.run(jobs), len(done) + 1):
                progress.to(count)


def redraw(source: str, out: str, position: int, sizes: Mapping[str, Sequence[int]]) -> None:
    """Draw one episode anew: what a worker does."""
    store = _store(source)
    environment = _environment(json.dumps(dict(store.spec.environment)))
    states = store.array(position, "sim.state")
    images = {camera: np.empty((len(states), h, w, 3), np.uint8) for camera, (h, w) in sizes.items()}
    for t, state in enumerate(states):
        environment.set_state(np.array(state))
        for camera, (h, w) in sizes.items():
            images[camera][t] = environment.render(camera, h, w)
    episode = store.with_images(position, images, environment.renderer())
    write_episode(out, int(store.indices()[position]), episode)


def _open(config: CollectConfig, environment: Environment, out: Path, resume: bool) -> NativeStore:
    note = out / "collect.json"
    if resume and (out / "store.json").exists():
        if note.is_file():
            before = json.loads(note.read_text())["config"]
            changed = sorted(key for key, value in _settings(config).items() if before.get(key) != value)
            if changed:
                raise UsageError(
                    f"{out} was collected with another {', '.join(changed)}: give the same, or another --out"
                )
        return NativeStore.open(out)
    seen = environment.observe(config.cameras).images
    sizes = {name: (int(image.shape[0]), int(image.shape[1])) for name, image in seen.items()}
    spec = StoreSpec(
        environment=_kind(config.environment),
        state_names=environment.spec.state_names,
        achieved_names=environment.spec.achieved_names,
        action_names=environment.spec.action_names,
        fps=environment.spec.fps,
        cameras=sizes,
    )
    store = NativeStore.create(out, spec)
    record = {"config": _settings(config), "versions": versions(), "git_revision": git_revision()}
    atomic_write(note, json.dumps(record, indent=2).encode())
    save_config(config, out / "collect.yaml")
    return store


def _run(jobs: Sequence[Job], title: str, begun: int, fps: float, workers: int | None) -> None:
    steps, began = 0, time.perf_counter()
    ended: dict[str, int] = {}
    with (
        LocalExecutorConfig(workers=workers).build() as executor,
        Progress(title, begun + len(jobs), "episode", begun) as progress,
    ):
        for count, result in enumerate(executor.run(jobs), begun + 1):
            steps += result.value[0]
            ended[result.value[1]] = ended.get(result.value[1], 0) + 1
            progress.to(count)
    if jobs:
        seconds = time.perf_counter() - began
        odd = ", ".join(f"{count} x {why}" for why, count in sorted(ended.items()) if why != "length")
        print(
            f"{len(jobs)} episodes, {steps} steps ({steps / fps:.0f} s of play) in {seconds:.0f} s: "
            f"{steps / seconds:.0f} steps/s{'; ended early: ' + odd if odd else ''}",
            file=sys.stderr,
        )


def _settings(config: CollectConfig) -> dict[str, Any]:
    """What decides the episodes; how many there are does not."""
    settings = to_dict(config)
    return {key: value for key, value in settings.items() if key != "episodes"}


def _kind(config: EnvironmentConfig) -> dict[str, Any]:
    return {"type": config.get_choice_name(type(config)), **to_dict(config)}


@functools.cache
def _environment(config: str) -> Environment:
    return from_dict(EnvironmentConfig, json.loads(config)).build()


@functools.cache
def _store(path: str) -> NativeStore:
    return NativeStore.open(path)
