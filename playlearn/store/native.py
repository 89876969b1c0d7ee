"""The project's own store: a folder with `store.json` and one safetensors file an episode.

    NAME/store.json                     format, version, environment, names, fps, cameras
    NAME/episodes/000007.safetensors    named by the number the episode was recorded under
    NAME/.lock                          held by the one writer

Episodes come whole or not at all, in any order; a file that a kill left half written bears another
name, is never read, and is removed by the next writer.
"""

import errno
import json
import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import filelock
import numpy as np
from numpy.typing import NDArray

from playlearn.config import atomic_write
from playlearn.episode import Array, Episode, EpisodeMeta
from playlearn.errors import EpisodeError, StoreError
from playlearn.store.base import StoreConfig, StoreSpec, from_json, summary, to_json, with_images
from playlearn.store.tensors import TEMPORARY, Header, checksum_holds, map_tensors, read_header, write_tensors

FORMAT, VERSION = "playlearn", 1
SUFFIX = ".safetensors"
OPEN_MAPS = 256  # each costs a file descriptor, of which a process has 1,024 by default


@StoreConfig.register_subclass("native")
@dataclass(frozen=True)
class NativeStoreConfig(StoreConfig):
    """path: the store's folder."""

    path: Path = Path("datasets/play")

    def build(self) -> "NativeStore":
        return NativeStore.open(self.path)


class NativeStore:
    """Read side; safe to share between threads.

    It shows the episodes that were there when it was opened (`refresh` looks again), and those that its
    own writer adds.
    """

    def __init__(self, path: Path, spec: StoreSpec) -> None:
        """Used by `open` and `create`."""
        self.path, self.spec = path, spec
        self._headers: dict[int, Header] = {}
        self._indices: NDArray[np.int64] = np.zeros(0, np.int64)
        self._maps: OrderedDict[int, dict[str, Array]] = OrderedDict()
        self._guard = threading.Lock()
        self.refresh()

    @classmethod
    def open(cls, path: Path | str) -> "NativeStore":
        """Open a store for reading.

        Raises:
            StoreError: there is none, the folder is something else, it was written by a newer version,
                or an episode in it cannot be read.
        """
        path = Path(path)
        return cls(path, _read_spec(path))

    @classmethod
    def create(cls, path: Path | str, spec: StoreSpec) -> "NativeStore":
        """Make an empty store. Raises StoreError where the folder already holds something."""
        path = Path(path)
        if (path / "store.json").exists():
            raise StoreError(f"{path} is already a store: add to it with --resume, or name another folder")
        if path.exists() and (not path.is_dir() or any(map(_foreign, path.iterdir()))):
            raise StoreError(f"{path} already holds something that is not a store: name another folder")
        (path / "episodes").mkdir(parents=True, exist_ok=True)
        description = {"format": FORMAT, "version": VERSION, **json.loads(to_json(spec))}
        atomic_write(path / "store.json", json.dumps(description, indent=2).encode())
        return cls(path, _read_spec(path))

    def refresh(self) -> None:
        """Look again which episodes are there."""
        found = sorted(_indices(self.path))
        for index in found:
            if index not in self._headers:
                self._headers[index] = self._checked_header(episode_path(self.path, index))
        self._indices = np.array(found, np.int64)

    @contextmanager
    def writer(self) -> Iterator["Writer"]:
        """Hold the store's lock and append; what a killed writer left half written is removed first.

        Raises:
            StoreError: another process is writing.
        """
        lock = filelock.FileLock(self.path / ".lock")
        try:
            lock.acquire(timeout=0)
        except filelock.Timeout as error:
            raise StoreError(
                f"{self.path} is being written by another process: wait for it to end (lock: {lock.lock_file})"
            ) from error
        try:
            for left in (*self.path.glob(f"*{TEMPORARY}"), *(self.path / "episodes").glob(f"*{TEMPORARY}")):
                left.unlink(missing_ok=True)
            self.refresh()
            yield Writer(self)
        finally:
            lock.release()

    def __len__(self) -> int:
        return len(self._indices)

    def name(self) -> str:
        return str(self.path)

    def indices(self) -> NDArray[np.int64]:
        return self._indices.copy()

    def lengths(self) -> NDArray[np.int64]:
        return np.array([self._headers[int(index)].slots["action"].shape[0] for index in self._indices], np.int64)

    def cameras(self) -> dict[str, tuple[int, int]]:
        return {camera: (int(h), int(w)) for camera, (h, w) in self.spec.cameras.items()}

    def meta(self, i: int) -> EpisodeMeta:
        return from_json(EpisodeMeta, self._headers[self._index(i)].metadata["meta"])

    def read(self, i: int) -> Episode:
        return Episode.from_arrays(self.meta(i), self._arrays(i))

    def array(self, i: int, key: str) -> Array:
        arrays = self._arrays(i)
        if key not in arrays:
            raise StoreError(f"{self.path} has no {key}: it has {', '.join(sorted(arrays))}")
        return arrays[key]

    def with_images(self, i: int, images: Mapping[str, Array], renderer: str) -> Episode:
        """Episode i with other images, for a store of its own (see `base.with_images`)."""
        return with_images(self.read(i), images, renderer)

    def verify(self) -> list[str]:
        problems = []
        for i, index in enumerate(self._indices):
            path = episode_path(self.path, int(index))
            if not checksum_holds(path, self._headers[int(index)]):
                problems.append(f"{path}: its checksum does not hold; delete it, or fetch it again")
                continue
            try:
                self.read(i)
            except EpisodeError as error:
                problems.append(f"{path}: {error}")
        return problems

    def info(self) -> dict[str, Any]:
        sizes = [self._headers[int(index)].size for index in self._indices]
        return {"path": str(self.path), "format": FORMAT, "version": VERSION, **summary(self), "bytes": sum(sizes)}

    def _checked_header(self, path: Path) -> Header:
        header = read_header(path)
        if "meta" not in header.metadata or "action" not in header.slots:
            raise StoreError(f"{path} is not an episode: move it out of the store")
        meta = from_json(EpisodeMeta, header.metadata["meta"])
        try:
            self.spec.check(StoreSpec.of_shapes(meta, {key: slot.shape for key, slot in header.slots.items()}))
        except StoreError as error:
            raise StoreError(f"{path}: {error}") from error
        return header

    def _index(self, i: int) -> int:
        if not 0 <= i < len(self._indices):
            raise StoreError(f"{self.path} has {len(self)} episodes, counted from 0: there is no episode {i}")
        return int(self._indices[i])

    def _arrays(self, i: int) -> dict[str, Array]:
        index = self._index(i)
        with self._guard:
            arrays = self._maps.get(index)
            if arrays is None:
                arrays = self._maps[index] = map_tensors(episode_path(self.path, index), self._headers[index])
                if len(self._maps) > OPEN_MAPS:
                    self._maps.popitem(last=False)
            else:
                self._maps.move_to_end(index)
        return arrays


class Writer:
    """The one writer of a store; got from `NativeStore.writer()`."""

    def __init__(self, store: NativeStore) -> None:
        self._store = store

    def append(self, episode: Episode, index: int | None = None) -> int:
        """Add an episode under `index` (None: one more than the last) and return the index.

        Raises:
            StoreError: it is another environment's, the index is taken, or the disk is full.
        """
        taken = self._store.indices()
        if index is None:
            index = int(taken.max()) + 1 if len(taken) else 0
        elif index in taken:
            raise StoreError(f"{self._store.path} already has an episode {index}")
        write_episode(self._store.path, index, episode)
        self._store.refresh()
        return index


def write_episode(folder: Path | str, index: int, episode: Episode) -> Path:
    """Put an episode into the store at `folder` under `index`, atomically; one that is there is replaced.

    Takes no lock: for worker processes whose parent holds it. Two jobs with one index give one episode.

    Raises:
        StoreError: no store is there, the episode is another environment's, or the disk is full.
    """
    folder = Path(folder)
    _read_spec(folder).check(StoreSpec.of(episode))
    path = episode_path(folder, index)
    try:
        write_tensors(
            path, episode.arrays(), {"format": FORMAT, "version": str(VERSION), "meta": to_json(episode.meta)}
        )
    except OSError as error:
        reason = (
            "the disk is full" if error.errno in (errno.ENOSPC, errno.EDQUOT) else f"cannot write ({error.strerror})"
        )
        safe = len(_indices(folder))
        raise StoreError(f"{folder}: {reason}; {safe} episodes are safe. Make room and go on with --resume") from error
    return path


def episode_path(folder: Path, index: int) -> Path:
    """Where the episode recorded under `index` lies."""
    return folder / "episodes" / f"{index:06d}{SUFFIX}"


def _foreign(entry: Path) -> bool:
    """Whether a file is none of those that a kill leaves while a store is made."""
    return entry.name not in (".lock", "episodes") and not entry.name.endswith(TEMPORARY)


def _indices(folder: Path) -> list[int]:
    return [int(path.stem) for path in (folder / "episodes").glob(f"*{SUFFIX}") if path.stem.isdecimal()]


def _read_spec(folder: Path) -> StoreSpec:
    path = folder / "store.json"
    if not folder.is_dir():
        raise StoreError(f"there is no store at {folder}: make one with `playlearn collect --out {folder}`")
    if not path.exists():
        raise StoreError(
            f"{folder} is not a store (no store.json in it): give the folder that `playlearn collect` wrote"
        )
    try:
        description = json.loads(path.read_text())
        kind, version = description.pop("format"), int(description.pop("version"))
    except (OSError, ValueError, KeyError, AttributeError, TypeError) as error:
        raise StoreError(f"{path} cannot be read ({error}): fetch it again") from error
    if kind != FORMAT:
        raise StoreError(f"{path} is of the format {kind!r}, not {FORMAT!r}")
    if version > VERSION:
        raise StoreError(
            f"{folder} was written by a newer playlearn (store version {version}, known {VERSION}): update playlearn"
        )
    return from_json(StoreSpec, json.dumps(description))
