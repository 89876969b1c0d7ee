"""Goal-conditioned batches a second of our dataset beside LeRobotDataset's, reading the same frames.

A batch is 64 shuffled examples: the observation of two cameras and the state, the next 16 labels, and an image of a
goal drawn uniformly from the next five seconds. LeRobot has no goals: as its users must do, one more frame is fetched
for each example, from a second dataset over the same files without chunks. Each reads its own format (ours: raw
images; LeRobot's: PNG, or video decoded by PyAV) in the main process, from the page cache.
"""

import tempfile
import time
import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import torch

from playlearn.batch import Batch
from playlearn.bench.base import Figure, Size, measuring, rates
from playlearn.bench.envs import SEED, SIDE
from playlearn.collection import CollectConfig, collect
from playlearn.data import DataConfig, PlayDataset
from playlearn.envs import PlayTableConfig
from playlearn.relabeling import UniformConfig
from playlearn.sim import CameraConfig
from playlearn.store import LeRobotStoreConfig, NativeStore
from playlearn.store.lerobot.export import Codec, export_lerobot

EXAMPLES = 64
CHUNK = 16
CAMERAS, GOAL_CAMERA = ("front", "wrist"), "front"
HORIZON = 5.0  # seconds


def reading(size: Size) -> Iterator[Figure]:
    """One process, no workers; beside LeRobot's images, then its video."""
    measuring("data: play to read")
    with tempfile.TemporaryDirectory() as folder:
        store = _store(Path(folder) / "play", size)
        goals = UniformConfig(horizon=HORIZON)
        config = DataConfig(goals=goals, chunk=CHUNK, cameras=CAMERAS, goal_cameras=(GOAL_CAMERA,), val_fraction=0)
        ours = PlayDataset(store, config, seed=SEED)
        kinds: dict[str, Codec | None] = {"images": None, "video": "av1"}
        for kind, videos in kinds.items():
            exported = Path(folder) / kind
            named = f"goal batches of {EXAMPLES}, chunk {CHUNK}, {kind}"
            measuring(named)
            export_lerobot(store, exported, videos=videos)
            measured = rates(
                {
                    "ours": partial(_turn, _our_batches(ours), max(2, size.steps)),
                    "peer": partial(_turn, _peer_batches(exported, store.spec.fps), max(1, size.steps // 100)),
                },
                size.rounds,
            )
            yield Figure.beside(named, "batches/s", measured, f"LeRobotDataset, {kind}")
            measuring(f"as a store, {kind}")
            for epoch, rate in _epochs(exported, config, Path(folder) / "frames" / kind).items():
                figures = {"ours": rate, "peer": measured["peer"]}
                yield Figure.beside(f"as a store, {epoch}, {kind}", "batches/s", figures, f"LeRobotDataset, {kind}")


def _store(out: Path, size: Size) -> NativeStore:
    env = PlayTableConfig(cameras={name: CameraConfig(SIDE, SIDE) for name in CAMERAS})
    collect(CollectConfig(environment=env, cameras=CAMERAS, episodes=4, steps=size.steps, seed=SEED), out, workers=0)
    return NativeStore.open(out)


def _epochs(exported: Path, config: DataConfig, cache: Path) -> dict[str, float]:
    """Batches a second in the first epoch, with decoding, and in the second."""
    began = time.perf_counter()
    dataset = PlayDataset(LeRobotStoreConfig(root=exported, cache=cache).build(), config, seed=SEED)
    count, batches = max(1, len(dataset) // EXAMPLES), _our_batches(dataset)
    _turn(batches, count)
    first = time.perf_counter() - began  # including the opening
    return {"first epoch": count / first, "second epoch": count / _turn(batches, count)[1]}


def _turn(batches: Iterator[Any], count: int) -> tuple[int, float]:
    began = time.perf_counter()
    for _ in range(count):
        next(batches)
    return count, time.perf_counter() - began


def _our_batches(dataset: PlayDataset) -> Iterator[Batch]:
    """In the calling thread; training also prepares the next batch in a background thread."""
    epoch = 0
    while True:
        order, examples = dataset.epoch_indices(epoch), min(EXAMPLES, len(dataset))
        for start in range(0, len(order) - examples + 1, examples):
            yield dataset.batch(epoch, order[start : start + examples])
        epoch += 1


class _PeerGoals(torch.utils.data.Dataset[dict[str, Any]]):
    """LeRobotDataset whose items include the image of a later frame of the episode."""

    def __init__(self, root: Path, fps: float) -> None:
        # Slow to import.
        from lerobot.datasets.lerobot_dataset import LeRobotDataset

        ahead = [step / fps for step in range(CHUNK)]
        name = f"local/{root.name}"
        self.frames = LeRobotDataset(name, root=root, delta_timestamps={"action": ahead}, video_backend="pyav")
        self.goals = LeRobotDataset(name, root=root, video_backend="pyav")
        self.horizon = round(HORIZON * fps)
        self.ends = [int(end) for end in self.frames.meta.episodes["dataset_to_index"]]
        self.draws = torch.Generator().manual_seed(SEED)

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> dict[str, Any]:
        item: dict[str, Any] = self.frames[index]
        last = min(index + self.horizon, self.ends[int(item["episode_index"])] - 1)
        goal = int(torch.randint(index, last + 1, (), generator=self.draws))
        key = f"observation.images.{GOAL_CAMERA}"
        return item | {f"observation.images.goal_{GOAL_CAMERA}": self.goals[goal][key]}


def _peer_batches(root: Path, fps: float) -> Iterator[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        dataset = _PeerGoals(root, fps)
        loader = torch.utils.data.DataLoader(
            dataset,
            min(EXAMPLES, len(dataset)),
            shuffle=True,
            drop_last=True,
            generator=torch.Generator().manual_seed(SEED),
            num_workers=0,
        )
        while True:
            yield from loader
