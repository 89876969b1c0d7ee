"""A LeRobot dataset (v3.0, or in the layout of v2.1) as a store of play, without conversion.

Opening reads the numbers into memory and reports everything that is missing or broken; what is whole and left out all
the same is in `remarks`. A video is decoded once, an episode at a time when its images are first read, into a file that
is memory-mapped from then on. The file is written whole or not at all, so that a killed run goes on where it was.

    frames     0     1     2   ...   n-1     a dataset with sidecars: T = n, the last observation is in the sidecar
    actions    0     1     2   ...   n-1     any other: T = n - 1, the observation after its last action is missing;
                                             that action is the episode's `unobserved_step`
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

from playlearn.config import digest, make_folder
from playlearn.episode import IMAGES, REWARD, STORED, Array, Episode, EpisodeMeta
from playlearn.errors import DiskError, EpisodeError, StoreError, UsageError
from playlearn.picture import resized
from playlearn.quantity import Quantities, subset
from playlearn.store.base import StoreSpec, spec_digest, summary
from playlearn.store.lerobot import check, sidecar
from playlearn.store.lerobot.content import NEXT_REWARD, SUCCESS
from playlearn.store.lerobot.features import Size
from playlearn.store.lerobot.files import Row
from playlearn.store.lerobot.frames import decode_episode
from playlearn.store.lerobot.metadata import DatasetMetadata, load_metadata
from playlearn.store.lerobot.parts import OUTCOMES, VECTORS, left_out, read_features
from playlearn.store.lerobot.subtasks import EVENTS, PERSISTENT
from playlearn.store.mmap_cache import MmapCache
from playlearn.store.object_dimensions import ObjectDimensions, choose_dimensions, own_dimensions
from playlearn.store.success import Signals, SuccessRule, how_ended
from playlearn.store.tensors import map_tensors, read_header, write_tensors

UNKNOWN = -1  # of the seed
# What an export writes for others, and reads from its sidecars.
KEPT_IN_SIDECARS = (SUCCESS, NEXT_REWARD, PERSISTENT, EVENTS)


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
        goal_names: tuple[str, ...] | None = None,
        success: str | None = None,
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
        self._sizes: dict[str, Size] = {name: image_size or camera.size for name, camera in cameras.items()}
        keys = read_features(metadata, state, achieved, action)
        self._columns, problems = check.read_columns(metadata, list(keys.values()), 1 if self._has_sidecars else 2)
        problems = check.check_counts(metadata) + problems + check.check_cameras(metadata, self._sizes)
        problems += check.check_tasks(metadata, self._columns, keys["task"]) if "task" in keys else []
        problems += self._check_sidecars(metadata) if self._has_sidecars else []
        self._metadata, self._keys, self.problems = metadata, keys, problems
        self._rows = check.usable_episodes(metadata, problems, skip_broken)
        place = f"{self.path.name}-{hashlib.sha256(str(self.path.resolve()).encode()).hexdigest()[:12]}"
        self._cache = (cache or _cache_folder()) / place
        self._maps, self._sidecar_maps = MmapCache(), MmapCache()
        self._rule = None if success is None else SuccessRule(success)
        self._objects = self._dimensions(goal_names)
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
            own = self._sidecars[row.index].meta
            return own if self._rule is None else dataclasses.replace(own, success=self._succeeded(row))
        cameras = {name: {"height": h, "width": w} for name, (h, w) in self._sizes.items()}
        tasks, _ = self._tasks_of(row)
        success = self._succeeded(row)
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
            ended=how_ended(success),
            task=tasks[0] if len(tasks) == 1 else "",
            verbatim=True,
            success=success,
            quantities=self.spec.quantities,
            unobserved_step=self._unobserved_step(row),
        )

    def read(self, i: int) -> Episode:
        keys = [*STORED.values(), *(IMAGES + camera for camera in self._sizes)]
        rewards = self.rewards(i)
        arrays = {key: self.array(i, key) for key in keys} | ({} if rewards is None else {REWARD: rewards})
        return Episode.from_arrays(self.meta(i), arrays)

    def array(self, i: int, key: str) -> Array:
        row = self._row(i)
        if key.startswith(IMAGES) and key.removeprefix(IMAGES) in self._sizes:
            return self._maps.get(i, partial(self._frames, row))[key]
        make = self._exact_array if self._has_sidecars else self._approximate_array
        return make(i, row, key)

    def digests(self) -> dict[str, str]:
        """Of an episode's numbers, and of the size of every file with images."""
        digests = {"spec": spec_digest(self.spec)}
        digests |= {f"episode {self.number(row.index)}": self._digest(row) for row in self._rows}
        images = {row.data for row in self._rows if set(row.clips) < set(self._sizes)}
        images |= {row.clips[name].file for row in self._rows for name in self._sizes if name in row.clips}
        return digests | {f"file {place}": str((self.path / place).stat().st_size) for place in sorted(images)}

    def remarks(self) -> dict[str, str]:
        unread = [camera.key for name, camera in self._metadata.cameras.items() if name not in self._sizes]
        kept = KEPT_IN_SIDECARS if self._has_sidecars else ()
        vectors = [] if self._has_sidecars else [self._keys[part] for part in VECTORS if part in self._keys]
        return {
            **left_out(self._metadata, {*self._keys.values(), *kept}),
            **self._metadata.remarks,
            **dict.fromkeys(unread, "left out: `without_images`"),
            **{key: why for key in vectors if (why := self._metadata.renamed(key))},
            **self._objects.remarks,
        }

    def rewards(self, i: int) -> Array | None:
        row = self._row(i)
        if self._has_sidecars:
            return self._sidecar_maps.get(i, self._sidecars[row.index].arrays).get(REWARD)
        if "reward" not in self._keys:
            return None
        return self._columns[row.index][self._keys["reward"]][: self._steps(row), 0].astype(np.float64)

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
            "version": self._metadata.version,
            **summary(self),
            "bytes": sum(path.stat().st_size for path in self.path.rglob("*") if path.is_file()),
            "frames": str(self._cache),
        }

    def _row(self, i: int) -> Row:
        if not 0 <= i < len(self._rows):
            raise StoreError(f"{self.path} has {len(self)} episodes, counted from 0: there is no episode {i}")
        return self._rows[i]

    def _unobserved_step(self, row: Row) -> dict[str, Any]:
        """The last frame's, see `EpisodeMeta`."""
        columns = self._columns[row.index]
        step: dict[str, Any] = {"action": columns[self._keys["action"]][-1].tolist()}
        return step | ({"reward": float(columns[self._keys["reward"]][-1, 0])} if "reward" in self._keys else {})

    def _steps(self, row: Row) -> int:
        return self._sidecars[row.index].steps if self._has_sidecars else row.length - 1

    def _spec(self) -> StoreSpec:
        if self._has_sidecars:
            first = self._sidecars[self._rows[0].index].meta
            return dataclasses.replace(StoreSpec.of_shapes(first, {}), cameras=self._sizes)
        metadata = self._metadata
        environment = {"type": "lerobot", "robot": metadata.robot}
        state, achieved, action = (self._keys.get(part, "") for part in ("state", "achieved", "action"))
        names = metadata.names(state), self._objects.goals(), metadata.names(action)
        measured = metadata.quantities(state), subset(metadata.quantities(achieved), self._objects.kept)
        quantities = Quantities(*measured, metadata.bounds(action))
        return StoreSpec(environment, *names, metadata.fps, self._sizes, quantities)

    def _exact_array(self, i: int, row: Row, key: str) -> Array:
        arrays = self._sidecar_maps.get(i, self._sidecars[row.index].arrays)
        if key in arrays:
            return arrays[key]
        columns = self._columns[row.index]
        if key == STORED["expert_action"]:
            return columns[self._keys["action"]][: self._steps(row)]
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
            "achieved": self._column(row, "achieved")[:, list(self._objects.kept)],
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

    def _column(self, row: Row, part: str) -> Array:
        """(length, n) the numbers of a part of one episode; n = 0 where the dataset has none."""
        key = self._keys.get(part)
        return np.zeros((row.length, 0), np.float32) if key is None else self._columns[row.index][key]

    def _dimensions(self, goal_names: tuple[str, ...] | None) -> ObjectDimensions:
        """What goals are about. Play that was recorded here knows; elsewhere what depends on the hand is left out."""
        names = self._metadata.names(self._keys.get("achieved", ""))
        if self._has_sidecars:
            if goal_names is not None:
                raise UsageError(
                    f"goal_names: {self.path} is an export of play, which is read as it was: say what goals are about "
                    "by data.goal_names"
                )
            return own_dimensions(names, None)
        return choose_dimensions(
            None,
            names,
            lambda: [(self._column(row, "achieved"), self._column(row, "state")) for row in self._rows],
            goal_names,
            self.path,
            'achieved: ""',
        )

    def _succeeded(self, row: Row) -> bool | None:
        """Whether an episode succeeded, as the user or the dataset says; None where that is not known."""
        own = {part: self._columns[row.index][key][:, 0] for part, key in self._keys.items() if part in OUTCOMES}
        if self._rule is not None:
            return self._rule(Signals(own.get("reward"), own.get("done")), f"{self.path}: episode {row.index}")
        return bool(own["success"].any()) if "success" in own else None

    def _tasks_of(self, row: Row) -> tuple[list[str], Array]:
        """The tasks of an episode, and (T,) int16 the task of each step; several tasks are read as skills."""
        steps = self._steps(row)
        if "task" not in self._keys:
            return [], np.zeros(steps, np.int16)
        numbers, own = np.unique(self._columns[row.index][self._keys["task"]][:steps, 0], return_inverse=True)
        return [self._metadata.tasks[int(n)] for n in numbers], own.astype(np.int16)

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
                if sidecar.LAST + key not in arrays:
                    continue
                last = {sidecar.LAST + key: resized(arrays[sidecar.LAST + key], (height, width))}
                frames[key] = sidecar.joined(frames[key], last, key)
        try:
            make_folder(path.parent)
            write_tensors(path, frames, {"source": source})
        except DiskError as error:
            raise DiskError(
                f"decoded frames cannot be kept: {error}; what is there is whole. Make room, or name another folder "
                "(`cache`) or a smaller `image_size`"
            ) from error
        return map_tensors(path, read_header(path).layout)

    def _digest(self, row: Row) -> str:
        columns, own = self._columns[row.index], []
        if self._has_sidecars:
            own = [self._sidecars[row.index].header.metadata["sha256"]]
        parts = [*own, *self._tasks_of(row)[0], *(f"{key} {digest(columns[key].tobytes())}" for key in sorted(columns))]
        return digest("; ".join(parts).encode())

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
                same = own.steps + bool(own.meta.unobserved_step) == row.length
                message = "" if same else f"{own.path} is of {own.steps} steps, the episode of {row.length}"
            except StoreError as error:
                message = str(error)
            except KeyError as error:
                message = f"{own.path} lacks {error}"
            if message:
                message += f"; or remove {sidecar.FOLDER}/ to read the dataset without it"
                problems.append(check.Problem(message, frozenset({row.index})))
        return problems


def _cache_folder() -> Path:
    """Default folder of decoded frames."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "playlearn" / "frames"
