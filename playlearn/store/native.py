"""The project's own store: a folder with `store.json` and one safetensors file an episode.

    NAME/store.json                     format, version, environment, names, fps, cameras
    NAME/episodes/000007.safetensors    named by the number that the episode was recorded under
    NAME/.lock                          held by the one writer

Episodes are written whole or not at all, in any order. A file that a kill left half written has another name, is never
read, and is removed by the next writer. `store.json` is written last: a folder without it is no store yet, and a writer
that was killed while making it can start again.
"""

import bisect
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from playlearn.config import atomic_write, held, make_folder
from playlearn.episode import REWARD, Array, Episode, EpisodeMeta
from playlearn.errors import DiskError, EpisodeError, MissingStoreError, StoreError
from playlearn.store.base import StoreConfig, StoreSpec, from_json, spec_digest, summary, to_json, with_images
from playlearn.store.folder import check_free, episode_path, foreign_files, indices, sweep
from playlearn.store.mmap_cache import MmapCache
from playlearn.store.tensors import DAMAGED, Header, Layout, checksum_holds, map_tensors, read_header, write_tensors

FORMAT, VERSION = "playlearn", 1
IMPORTED = "import.json"  # beside store.json: what the episodes of an import were made from
_MAX_LISTED = 10  # damaged files in one message


@StoreConfig.register_subclass("native")
@dataclass(frozen=True)
class NativeStoreConfig(StoreConfig):
    """A native store.

    path: its folder.
    """

    path: Path = Path("datasets/play")

    def build(self) -> "NativeStore":
        return NativeStore.open(self.path)


class NativeStore:
    """Read side; safe to share between threads.

    It shows the episodes that were there when it was opened, and those that its own writer adds; `refresh` looks again.
    """

    def __init__(self, path: Path, spec: StoreSpec) -> None:
        """Used by `open` and `create`."""
        self.path, self.spec = path, spec
        self._layouts: dict[int, Layout] = {}
        self._checksums: dict[int, str] = {}
        self._indices: list[int] = []  # ascending
        self._maps = MmapCache()
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
    def create(
        cls, path: Path | str, spec: StoreSpec, notes: Mapping[str, Callable[[Path], None]] | None = None
    ) -> "NativeStore":
        """Make an empty store.

        notes: file name -> function that writes that file beside `store.json`, given its path. They are written
            first, so that no store lacks them.

        Raises:
            StoreError: the folder already holds something.
            BusyError: another process is making it.
            DiskError: the disk is full.
        """
        path, notes = Path(path), notes or {}
        check_free(path, notes)
        make_folder(path / "episodes")
        with held(path):
            check_free(path, notes)  # another process may have made it meanwhile
            for name, write in notes.items():
                write(path / name)
            description = {"format": FORMAT, "version": VERSION, **json.loads(to_json(spec))}
            atomic_write(path / "store.json", json.dumps(description, indent=2).encode())
        return cls(path, _read_spec(path))

    def refresh(self) -> None:
        """Look again which episodes are there; raises StoreError that names those that cannot be read."""
        found = sorted(indices(self.path))
        layouts, problems = {}, []
        for index in found:
            try:
                layouts[index] = self._layouts.get(index) or self._checked(index)
            except StoreError as error:
                problems.append(str(error))
        if problems:
            more = f"\nand {len(problems) - _MAX_LISTED} more" if len(problems) > _MAX_LISTED else ""
            raise StoreError("\n".join(problems[:_MAX_LISTED]) + more)
        self._layouts, self._indices = layouts, found

    def add(self, index: int) -> None:
        """Add the episode that was just written under `index`, without looking for others."""
        self._layouts[index] = self._checked(index)
        bisect.insort(self._indices, index)

    @contextmanager
    def writer(self) -> Iterator["Writer"]:
        """Hold the store's lock to append; removes files that a killed writer left half written.

        Raises:
            BusyError: another process is writing.
        """
        with held(self.path):
            try:
                sweep(self.path)
                self.refresh()
                yield Writer(self)
            finally:
                sweep(self.path)  # of workers that died meanwhile

    def __len__(self) -> int:
        return len(self._indices)

    def name(self) -> str:
        return str(self.path)

    def last(self) -> int:
        """The highest episode number; -1 for an empty store."""
        return self._indices[-1] if self._indices else -1

    def indices(self) -> NDArray[np.int64]:
        return np.array(self._indices, np.int64)

    def lengths(self) -> NDArray[np.int64]:
        return np.array([self._layouts[index].slots["action"].shape[0] for index in self._indices], np.int64)

    def cameras(self) -> dict[str, tuple[int, int]]:
        return {camera: (int(h), int(w)) for camera, (h, w) in self.spec.cameras.items()}

    def meta(self, i: int) -> EpisodeMeta:
        return _meta(episode_path(self.path, self._index(i)))[0]

    def read(self, i: int) -> Episode:
        arrays = self._arrays(i)
        return Episode.from_arrays(self.meta(i), arrays)

    def array(self, i: int, key: str) -> Array:
        arrays = self._arrays(i)
        if key not in arrays:
            raise StoreError(f"{self.path} has no {key}: it has {', '.join(sorted(arrays))}")
        return arrays[key]

    def rewards(self, i: int) -> Array | None:
        return self._arrays(i).get(REWARD)

    def with_images(self, i: int, images: Mapping[str, Array], renderer: str) -> Episode:
        """Episode i with other images, for a store of its own (see `base.with_images`)."""
        return with_images(self.read(i), images, renderer)

    def digests(self) -> dict[str, str]:
        return {"spec": spec_digest(self.spec)} | {
            f"episode {index}": self._checksums[index][:16] for index in self._indices
        }

    def verify(self) -> list[str]:
        problems = [f"{path} does not belong here: move it out of the store" for path in foreign_files(self.path)]
        for i, index in enumerate(self._indices):
            path = episode_path(self.path, index)
            try:
                if not checksum_holds(path):
                    problems.append(f"{path}: its checksum does not hold; delete it, or fetch it again")
                else:
                    self.read(i)
            except OSError as error:
                problems.append(f"{path} cannot be read ({error.strerror}); delete it, or fetch it again")
            except (EpisodeError, StoreError) as error:
                problems.append(f"{path}: {error}")
        return problems

    def remarks(self) -> dict[str, str]:
        if not (self.path / IMPORTED).is_file():
            return {}
        try:
            return dict(json.loads((self.path / IMPORTED).read_text(encoding="utf-8")).get("remarks", {}))
        except (OSError, *DAMAGED) as error:
            raise StoreError(f"{self.path / IMPORTED} cannot be read ({error}): import it again") from error

    def info(self) -> dict[str, Any]:
        present = set(self._indices)
        return {
            "path": str(self.path),
            "format": FORMAT,
            "version": VERSION,
            **summary(self),
            "bytes": sum(self._layouts[index].size for index in self._indices),
            "missing": [index for index in range(max(present, default=0)) if index not in present],
        }

    def _checked(self, index: int) -> Layout:
        path = episode_path(self.path, index)
        meta, header = _meta(path)
        layout = header.layout
        try:
            self.spec.check(StoreSpec.of_shapes(meta, {key: slot.shape for key, slot in layout.slots.items()}))
        except StoreError as error:
            raise StoreError(f"{path}: {error}") from error
        self._checksums[index] = header.metadata.get("sha256", "")
        return layout

    def _index(self, i: int) -> int:
        if not 0 <= i < len(self._indices):
            raise StoreError(f"{self.path} has {len(self)} episodes, counted from 0: there is no episode {i}")
        return self._indices[i]

    def _arrays(self, i: int) -> dict[str, Array]:
        index = self._index(i)
        return self._maps.get(index, lambda: map_tensors(episode_path(self.path, index), self._layouts[index]))


class Writer:
    """The one writer of a store, made by `NativeStore.writer()`."""

    def __init__(self, store: NativeStore) -> None:
        self._store = store

    def append(self, episode: Episode, index: int | None = None) -> int:
        """Add an episode under `index` (None: one more than the last) and return the index.

        Raises:
            StoreError: it is another environment's, or the index is taken.
            DiskError: the disk is full; says how many episodes are safe.
        """
        index = self._store.last() + 1 if index is None else index
        if episode_path(self._store.path, index).exists():
            raise StoreError(f"{self._store.path} already has an episode {index}")
        write_episode(self._store.path, index, episode)
        self._store.add(index)
        return index


def write_episode(folder: Path | str, index: int, episode: Episode) -> Path:
    """Write an episode into the store at `folder` under `index`, atomically; an existing one is replaced.

    Takes no lock: for worker processes whose parent holds it. Two jobs with the same index give one episode.

    Raises:
        StoreError: no store is there, or the episode is another environment's.
        DiskError: the disk is full; says how many episodes are safe.
    """
    folder = Path(folder)
    _read_spec(folder).check(StoreSpec.of(episode))
    path = episode_path(folder, index)
    try:
        write_tensors(
            path, episode.arrays(), {"format": FORMAT, "version": str(VERSION), "meta": to_json(episode.meta)}
        )
    except DiskError as error:
        raise DiskError(f"{error}; {len(indices(folder))} episodes are safe") from error
    return path


def _meta(path: Path) -> tuple[EpisodeMeta, Header]:
    """Metadata of an episode file, and the file's header; raises StoreError if it is not an episode."""
    header = read_header(path)
    if "meta" not in header.metadata or "action" not in header.layout.slots:
        raise StoreError(f"{path} is not an episode: move it out of the store")
    try:
        return from_json(EpisodeMeta, header.metadata["meta"]), header
    except StoreError as error:
        raise StoreError(f"{path}: {error}") from error
    except DAMAGED as error:
        raise StoreError(f"{path} cannot be read ({error}): delete it, or fetch it again") from error


def _read_spec(folder: Path) -> StoreSpec:
    path = folder / "store.json"
    if folder.is_file():
        raise MissingStoreError(
            f"{folder} is a file, and a store is a folder: read recordings with `playlearn import "
            f"robomimic|robosuite|ogbench {folder} OUT`, and then give OUT"
        )
    if not folder.is_dir():
        raise MissingStoreError(f"there is no store at {folder}: make one with `playlearn collect --out {folder}`")
    if not path.exists():
        raise MissingStoreError(
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
    try:
        return from_json(StoreSpec, json.dumps(description))
    except StoreError as error:
        raise StoreError(f"{path}: {error}") from error
