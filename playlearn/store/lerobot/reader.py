"""A LeRobot v3.0 dataset as a store of play, without conversion.

Numbers are read into memory when it is opened, and everything that is missing or broken is named then. A video is
decoded once, an episode at a time when its pictures are first asked for, into a file that is memory-mapped from then
on: whole or not there, so that a killed run goes on where it was.

    frames     0     1     2   ...   n-1     a dataset that we wrote: T = n, the last observation stands beside
    actions    0     1     2   ...   n-1     any other: T = n - 1, its last action leads to nothing that was seen
"""

import dataclasses
import hashlib
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import IMAGES, STORED, Array, Episode, EpisodeMeta
from playlearn.errors import EpisodeError, StoreError
from playlearn.store.base import StoreSpec, summary
from playlearn.store.lerobot import check, sidecar
from playlearn.store.lerobot.config import LeRobotStoreConfig, cache_folder
from playlearn.store.lerobot.frames import Size, decoded, scaled
from playlearn.store.lerobot.hub import resolve_dataset
from playlearn.store.lerobot.metadata import Description, Row, describe
from playlearn.store.mmap_cache import Maps
from playlearn.store.tensors import map_tensors, read_header, write_tensors

UNKNOWN = -1  # of the seed


class LeRobotStore:
    """Read side; safe to share between threads."""

    def __init__(self, config: LeRobotStoreConfig) -> None:
        """See `LeRobotStoreConfig`.

        Raises:
            StoreError: there is no such dataset, it is of another version, or it is not whole; says what can be used.
        """
        self.path = resolve_dataset(config)
        described = describe(self.path)
        self._rests = {
            row.index: sidecar.Rest.of(self.path, row.index) for row in described.rows if sidecar.is_kept(self.path)
        }
        self._ours = bool(self._rests)
        cameras = {} if config.without_images else described.cameras
        keys = _features(described, config)
        self._columns, problems = check.numbers(described, list(keys.values()), 1 if self._ours else 2)
        problems = check.counted(described) + problems + check.films(described, cameras)
        problems += self._check_rest(described) if self._ours else []
        self._described, self._keys, self.problems = described, keys, problems
        self._rows = check.usable(described, problems, config.skip_broken)
        self._sizes: dict[str, Size] = {name: config.image_size or camera.size for name, camera in cameras.items()}
        place = f"{self.path.name}-{hashlib.sha256(str(self.path.resolve()).encode()).hexdigest()[:12]}"
        self._cache = (config.cache or cache_folder()) / place
        self._maps, self._kept = Maps(), Maps()
        self.spec = self._spec()

    def __len__(self) -> int:
        return len(self._rows)

    def name(self) -> str:
        return str(self.path)

    def indices(self) -> NDArray[np.int64]:
        return np.array([self.number(row.index) for row in self._rows], np.int64)

    def number(self, entry: int) -> int:
        """What the dataset's episode `entry` was recorded under."""
        return self._rests[entry].index if self._ours else entry

    def lengths(self) -> NDArray[np.int64]:
        return np.array([self._steps(row) for row in self._rows], np.int64)

    def cameras(self) -> dict[str, tuple[int, int]]:
        return dict(self._sizes)

    def meta(self, i: int) -> EpisodeMeta:
        row = self._row(i)
        if self._ours:
            return self._rests[row.index].meta
        cameras = {name: {"height": h, "width": w} for name, (h, w) in self._sizes.items()}
        tasks, _ = self._spoken(row)
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
        )

    def read(self, i: int) -> Episode:
        keys = [*STORED.values(), *(IMAGES + camera for camera in self._sizes)]
        return Episode.from_arrays(self.meta(i), {key: self.array(i, key) for key in keys})

    def array(self, i: int, key: str) -> Array:
        row = self._row(i)
        if key.startswith(IMAGES) and key.removeprefix(IMAGES) in self._sizes:
            return self._maps.get(i, partial(self._pictures, row))[key]
        make = self._ours_array if self._ours else self._their_array
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
        return row.length if self._ours else row.length - 1

    def _spec(self) -> StoreSpec:
        if self._ours:
            first = self._rests[self._rows[0].index].meta
            return dataclasses.replace(StoreSpec.of_shapes(first, {}), cameras=self._sizes)
        described = self._described
        environment = {"type": "lerobot", "robot": described.robot}
        state, achieved, action = (
            described.names(self._keys.get(part, "")) for part in ("state", "achieved", "action")
        )
        return StoreSpec(environment, state, achieved, action, described.fps, self._sizes)

    def _ours_array(self, i: int, row: Row, key: str) -> Array:
        kept = self._kept.get(i, self._rests[row.index].arrays)
        if key in kept:
            return kept[key]
        columns = self._columns[row.index]
        if key == STORED["expert_action"]:
            return columns[self._keys["action"]]
        for part in ("state", "achieved"):
            if key == STORED[part]:
                none = np.zeros((row.length, 0), np.float32)
                return sidecar.joined(columns[self._keys[part]] if part in self._keys else none, kept, key)
        raise StoreError(f"{self.path} has no {key}")

    def _their_array(self, _i: int, row: Row, key: str) -> Array:
        steps, columns = self._steps(row), self._columns[row.index]
        nothing = np.zeros((steps + 1, 0))
        action = columns[self._keys["action"]][:steps]
        taken_over = columns[self._keys["intervention"]][:steps, 0] > 0 if "intervention" in self._keys else None
        made = {
            "state": columns[self._keys["state"]],
            "achieved": columns[self._keys["achieved"]] if "achieved" in self._keys else nothing.astype(np.float32),
            "sim_state": nothing,
            "time": np.arange(steps + 1) / self.spec.fps,
            "action": action,
            "expert_action": action,
            "intervention": np.zeros(steps, np.bool_) if taken_over is None else taken_over,
            "skill": self._spoken(row)[1],
        }
        stored = {STORED[name]: value for name, value in made.items()}
        if key not in stored:
            has = [*stored, *(IMAGES + camera for camera in self._sizes)]
            raise StoreError(f"{self.path} has no {key}: it has {', '.join(has)}")
        return stored[key]

    def _spoken(self, row: Row) -> tuple[list[str], Array]:
        """What an episode's steps are called, and (T,) int16 which each is; tasks that change are its skills."""
        steps, known = self._steps(row), self._described.tasks
        if "task" not in self._keys:
            return [], np.zeros(steps, np.int16)
        numbers, own = np.unique(self._columns[row.index]["task_index"][:steps, 0].astype(int), return_inverse=True)
        return [known[n] if 0 <= n < len(known) else f"task {n}" for n in numbers], own.astype(np.int16)

    def _pictures(self, row: Row) -> dict[str, Array]:
        """Every camera's frames of one episode, mapped; decoded before where that has not been done."""
        path = self._cache / f"{row.index:06d}.safetensors"
        source = self._source(row)
        with suppress(StoreError):  # not there yet, or damaged: it is made anew
            header = read_header(path)
            if header.metadata.get("source") == source:
                return map_tensors(path, header.layout)
        frames = {IMAGES + name: pictures for name, pictures in decoded(self._described, row, self._sizes).items()}
        if self._ours:
            kept = self._rests[row.index].arrays()
            for name, (height, width) in self._sizes.items():
                key = IMAGES + name
                last = {sidecar.LAST + key: scaled(kept[sidecar.LAST + key], (height, width))}
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
        """What decoded frames depend on: another file or another size makes them stale."""
        parts = [f"{self._sizes}"]
        for place in sorted({row.data, *(clip.file for clip in row.clips.values())}):
            status = (self.path / place).stat()
            parts.append(f"{place} {status.st_size} {status.st_mtime_ns}")
        return "; ".join([*parts, *(f"{name} {clip.begin:.6f}" for name, clip in sorted(row.clips.items()))])

    def _check_rest(self, described: Description) -> list[check.Problem]:
        problems = []
        for row in described.rows:
            kept = self._rests[row.index]
            try:
                same = kept.steps == row.length
                words = "" if same else f"{kept.path} is of {kept.steps} steps, the episode of {row.length}"
            except StoreError as error:
                words = str(error)
            except KeyError as error:
                words = f"{kept.path} lacks {error}"
            if words:
                words += f"; or remove {sidecar.FOLDER}/ to read the dataset without it"
                problems.append(check.Problem(words, frozenset({row.index})))
        return problems


def _features(described: Description, config: LeRobotStoreConfig) -> dict[str, str]:
    """Part -> feature, of the parts that the dataset has.

    Raises:
        StoreError: it has no state or no action.
    """
    keys = {
        "state": config.state,
        "achieved": config.achieved,
        "action": config.action,
        "intervention": "intervention",
        "task": "task_index",
    }
    there = {part: key for part, key in keys.items() if key in described.features}
    for part in ("state", "action"):
        if part not in there:
            known = ", ".join(key for key in described.features if key.startswith(("observation", "action")))
            raise StoreError(
                f"{described.root} has no feature {keys[part]!r} for the {part}; it has {known}: set `{part}`"
            )
    return there
