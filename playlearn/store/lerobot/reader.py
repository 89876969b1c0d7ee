"""A LeRobot v3.0 dataset as a store of play, without conversion.

Opening reads the numbers into memory and reports everything that is missing or broken. A video is decoded once, an
episode at a time when its images are first read, into a file that is memory-mapped from then on. The file is written
whole or not at all, so that a killed run goes on where it was.

    frames     0     1     2   ...   n-1     a dataset with sidecars: T = n, the last observation is in the sidecar
    actions    0     1     2   ...   n-1     any other: T = n - 1, the observation after its last action is missing
"""

import dataclasses
import hashlib
import os
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import IMAGES, STORED, Array, Episode, EpisodeMeta
from playlearn.errors import EpisodeError, StoreError
from playlearn.quantity import Quantities
from playlearn.store.base import StoreSpec, summary
from playlearn.store.lerobot import check, sidecar
from playlearn.store.lerobot.frames import Size, decode_episode, resized
from playlearn.store.lerobot.metadata import DatasetMetadata, Row, load_metadata
from playlearn.store.mmap_cache import MmapCache
from playlearn.store.tensors import map_tensors, read_header, write_tensors

UNKNOWN = -1  # of the seed


class LeRobotStore:
    """Read side; safe to share between threads."""

    def __init__(
        self,
        root: Path,
        *,
        state: str,
        achieved: str,
        action: str,
        image_size: Size | None = None,
        cache: Path | None = None,
        without_images: bool = False,
        skip_broken: bool = False,
    ) -> None:
        """root: folder of the dataset; the others are the fields of `LeRobotStoreConfig`.

        Raises:
            StoreError: there is no such dataset, it is of another version, or it is broken; says what can be used.
        """
        self.path = root
        metadata = load_metadata(self.path)
        self._sidecars = {
            row.index: sidecar.Sidecar.of(self.path, row.index) for row in metadata.rows if sidecar.exists(self.path)
        }
        self._has_sidecars = bool(self._sidecars)
        cameras = {} if without_images else metadata.cameras
        keys = _features(metadata, state, achieved, action)
        self._columns, problems = check.read_columns(metadata, list(keys.values()), 1 if self._has_sidecars else 2)
        problems = check.check_counts(metadata) + problems + check.check_videos(metadata, cameras)
        problems += self._check_sidecars(metadata) if self._has_sidecars else []
        self._metadata, self._keys, self.problems = metadata, keys, problems
        self._rows = check.usable_episodes(metadata, problems, skip_broken)
        self._sizes: dict[str, Size] = {name: image_size or camera.size for name, camera in cameras.items()}
        place = f"{self.path.name}-{hashlib.sha256(str(self.path.resolve()).encode()).hexdigest()[:12]}"
        self._cache = (cache or _cache_folder()) / place
        self._maps, self._sidecar_maps = MmapCache(), MmapCache()
        self.spec = self._spec()

    def __len__(self) -> int:
        return len(self._rows)

    def name(self) -> str:
        return str(self.path)

    def indices(self) -> NDArray[np.int64]:
        return np.array([self.number(row.index) for row in self._rows], np.int64)

    def number(self, entry: int) -> int:
        """The number that the dataset's episode `entry` was recorded under."""
        return self._sidecars[entry].index if self._has_sidecars else entry

    def lengths(self) -> NDArray[np.int64]:
        return np.array([self._steps(row) for row in self._rows], np.int64)

    def cameras(self) -> dict[str, tuple[int, int]]:
        return dict(self._sizes)

    def meta(self, i: int) -> EpisodeMeta:
        row = self._row(i)
        if self._has_sidecars:
            return self._sidecars[row.index].meta
        cameras = {name: {"height": h, "width": w} for name, (h, w) in self._sizes.items()}
        tasks, _ = self._tasks_of(row)
        return EpisodeMeta(
            environment=self.spec.environment,
            state_names=self.spec.state_names,
            achieved_names=self.spec.achieved_names,
            action_names=self.spec.action_names,
            fps=self.spec.fps,
            seed=UNKNOWN,
            actor="unknown",
            cameras=cameras,
            skills=tuple(tasks) if len(tasks) > 1 else (),
            task=tasks[0] if len(tasks) == 1 else "",
            quantities=self.spec.quantities,
        )

    def read(self, i: int) -> Episode:
        keys = [*STORED.values(), *(IMAGES + camera for camera in self._sizes)]
        return Episode.from_arrays(self.meta(i), {key: self.array(i, key) for key in keys})

    def array(self, i: int, key: str) -> Array:
        row = self._row(i)
        if key.startswith(IMAGES) and key.removeprefix(IMAGES) in self._sizes:
            return self._maps.get(i, partial(self._frames, row))[key]
        make = self._exact_array if self._has_sidecars else self._approximate_array
        return make(i, row, key)

    def verify(self) -> list[str]:
        problems = []
        for i, row in enumerate(self._rows):
            try:
                self.read(i)
            except (StoreError, EpisodeError) as error:
                problems.append(f"episode {row.index}: {error}")
        return problems

    def info(self) -> dict[str, Any]:
        return {
            "path": str(self.path),
            "format": "lerobot",
            "version": "3.0",
            **summary(self),
            "bytes": sum(path.stat().st_size for path in self.path.rglob("*") if path.is_file()),
            "frames": str(self._cache),
        }

    def _row(self, i: int) -> Row:
        if not 0 <= i < len(self._rows):
            raise StoreError(f"{self.path} has {len(self)} episodes, counted from 0: there is no episode {i}")
        return self._rows[i]

    def _steps(self, row: Row) -> int:
        return row.length if self._has_sidecars else row.length - 1

    def _spec(self) -> StoreSpec:
        if self._has_sidecars:
            first = self._sidecars[self._rows[0].index].meta
            return dataclasses.replace(StoreSpec.of_shapes(first, {}), cameras=self._sizes)
        metadata = self._metadata
        environment = {"type": "lerobot", "robot": metadata.robot}
        state, achieved, action = (self._keys.get(part, "") for part in ("state", "achieved", "action"))
        names = metadata.names(state), metadata.names(achieved), metadata.names(action)
        quantities = Quantities(metadata.quantities(state), metadata.quantities(achieved), metadata.bounds(action))
        return StoreSpec(environment, *names, metadata.fps, self._sizes, quantities)

    def _exact_array(self, i: int, row: Row, key: str) -> Array:
        arrays = self._sidecar_maps.get(i, self._sidecars[row.index].arrays)
        if key in arrays:
            return arrays[key]
        columns = self._columns[row.index]
        if key == STORED["expert_action"]:
            return columns[self._keys["action"]]
        for part in ("state", "achieved"):
            if key == STORED[part]:
                empty = np.zeros((row.length, 0), np.float32)
                return sidecar.joined(columns[self._keys[part]] if part in self._keys else empty, arrays, key)
        raise StoreError(f"{self.path} has no {key}")

    def _approximate_array(self, _i: int, row: Row, key: str) -> Array:
        steps, columns = self._steps(row), self._columns[row.index]
        empty = np.zeros((steps + 1, 0))
        action = columns[self._keys["action"]][:steps]
        intervention = columns[self._keys["intervention"]][:steps, 0] > 0 if "intervention" in self._keys else None
        arrays = {
            "state": columns[self._keys["state"]],
            "achieved": columns[self._keys["achieved"]] if "achieved" in self._keys else empty.astype(np.float32),
            "sim_state": empty,
            "time": np.arange(steps + 1) / self.spec.fps,
            "action": action,
            "expert_action": action,
            "intervention": np.zeros(steps, np.bool_) if intervention is None else intervention,
            "skill": self._tasks_of(row)[1],
        }
        stored = {STORED[name]: value for name, value in arrays.items()}
        if key not in stored:
            known = [*stored, *(IMAGES + camera for camera in self._sizes)]
            raise StoreError(f"{self.path} has no {key}: it has {', '.join(known)}")
        return stored[key]

    def _tasks_of(self, row: Row) -> tuple[list[str], Array]:
        """The tasks of an episode, and (T,) int16 the task of each step; several tasks are read as skills."""
        steps, names = self._steps(row), self._metadata.tasks
        if "task" not in self._keys:
            return [], np.zeros(steps, np.int16)
        numbers, own = np.unique(self._columns[row.index]["task_index"][:steps, 0].astype(int), return_inverse=True)
        return [names[n] if 0 <= n < len(names) else f"task {n}" for n in numbers], own.astype(np.int16)

    def _frames(self, row: Row) -> dict[str, Array]:
        """The frames of every camera in one episode, memory-mapped; decoded first if they are not cached."""
        path = self._cache / f"{row.index:06d}.safetensors"
        source = self._source(row)
        with suppress(StoreError):  # missing or damaged: decoded again
            header = read_header(path)
            if header.metadata.get("source") == source:
                return map_tensors(path, header.layout)
        frames = {IMAGES + name: images for name, images in decode_episode(self._metadata, row, self._sizes).items()}
        if self._has_sidecars:
            arrays = self._sidecars[row.index].arrays()
            for name, (height, width) in self._sizes.items():
                key = IMAGES + name
                last = {sidecar.LAST + key: resized(arrays[sidecar.LAST + key], (height, width))}
                frames[key] = sidecar.joined(frames[key], last, key)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_tensors(path, frames, {"source": source})
        except OSError as error:
            raise StoreError(
                f"decoded frames cannot be kept in {path.parent} ({error.strerror}); what is there is whole. Make "
                "room, or name another folder (`cache`) or a smaller `image_size`, and go on"
            ) from error
        return map_tensors(path, read_header(path).layout)

    def _source(self, row: Row) -> str:
        """What decoded frames depend on: they are stale if a file or the image size changes."""
        parts = [f"{self._sizes}"]
        for place in sorted({row.data, *(clip.file for clip in row.clips.values())}):
            status = (self.path / place).stat()
            parts.append(f"{place} {status.st_size} {status.st_mtime_ns}")
        return "; ".join([*parts, *(f"{name} {clip.begin:.6f}" for name, clip in sorted(row.clips.items()))])

    def _check_sidecars(self, metadata: DatasetMetadata) -> list[check.Problem]:
        problems = []
        for row in metadata.rows:
            own = self._sidecars[row.index]
            try:
                same = own.steps == row.length
                message = "" if same else f"{own.path} is of {own.steps} steps, the episode of {row.length}"
            except StoreError as error:
                message = str(error)
            except KeyError as error:
                message = f"{own.path} lacks {error}"
            if message:
                message += f"; or remove {sidecar.FOLDER}/ to read the dataset without it"
                problems.append(check.Problem(message, frozenset({row.index})))
        return problems


def _features(metadata: DatasetMetadata, state: str, achieved: str, action: str) -> dict[str, str]:
    """Part -> feature, for the parts that the dataset has.

    Raises:
        StoreError: it has no state or no action.
    """
    keys = {
        "state": state,
        "achieved": achieved,
        "action": action,
        "intervention": "intervention",
        "task": "task_index",
    }
    present = {part: key for part, key in keys.items() if key in metadata.features}
    for part in ("state", "action"):
        if part not in present:
            known = ", ".join(key for key in metadata.features if key.startswith(("observation", "action")))
            raise StoreError(
                f"{metadata.root} has no feature {keys[part]!r} for the {part}; it has {known}: set `{part}`"
            )
    return present


def _cache_folder() -> Path:
    """Default folder of decoded frames."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "playlearn" / "frames"
