"""The files of a LeRobot dataset, read without trust: no path leaves its folder. What each layout of them offers."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from string import Formatter
from typing import Any, Protocol

import pyarrow as pa
import pyarrow.parquet as pq

from playlearn.errors import StoreError

INFO = "meta/info.json"
UNREADABLE = (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, pa.ArrowException)


@dataclass(frozen=True)
class Clip:
    """The part of a video that holds an episode's frames; begin and end in seconds."""

    file: str
    begin: float
    end: float


@dataclass(frozen=True)
class Row:
    """One episode.

    index: of the episode.
    length: frames.
    begin: index of its first frame in the whole dataset.
    data: the parquet file that holds its numbers.
    clips: camera -> part of a video.
    """

    index: int
    length: int
    begin: int
    data: str
    clips: Mapping[str, Clip]


class Layout(Protocol):
    """Where a version of the format keeps what.

    version: of the format, as `codebase_version` begins.
    tasks: the file with the texts of tasks.
    """

    version: str
    tasks: str

    def rows(self, root: Path, info: Mapping[str, Any], videos: Mapping[str, str]) -> tuple[Row, ...]:
        """The episodes that the metadata lists, by their number. videos: camera -> its feature.

        Raises:
            StoreError: a file is missing or broken, or a path leads out of the dataset.
        """
        ...

    def texts(self, root: Path) -> dict[int, str]:
        """Task index -> its text; raises StoreError where the table is missing, or holds something else."""
        ...


def read_parquet(path: Path, columns: list[str] | None = None) -> pa.Table:
    """A table, or those of the columns that are there.

    Raises:
        StoreError: it is missing or cannot be read.
    """
    if not path.is_file():
        raise StoreError(f"{path} is missing: fetch it again")
    try:
        with pq.ParquetFile(path) as file:
            there = file.schema_arrow.names
            twice = [name for name in columns or there if there.count(name) > 1]
            if twice:
                raise ValueError(f"it has two columns {twice[0]!r}")
            return file.read(columns=None if columns is None else [name for name in columns if name in there])
    except UNREADABLE as error:
        raise StoreError(f"{path} cannot be read ({first_line(error)}): fetch it again") from error


def column_types(path: Path) -> dict[str, pa.DataType]:
    """The columns of a table; none where it cannot be read, which `read_parquet` says."""
    with suppress(*UNREADABLE):
        schema = pq.read_schema(path)
        return dict(zip(schema.names, schema.types, strict=True))
    return {}


def template(root: Path, info: Mapping[str, Any], key: str, default: str, *fields: str) -> str:
    """The template of paths that `info.json` has under `key`; raises StoreError where it has fields besides these."""
    given = info.get(key) or default
    try:
        used = {name for _, name, _, _ in Formatter().parse(given) if name is not None}
    except UNREADABLE as error:
        raise StoreError(f"{root / INFO} cannot be read ({first_line(error)}): fetch it again") from error
    if not used <= set(fields):
        raise StoreError(f"the template {given!r} in {INFO} asks for {', '.join(sorted(used - set(fields)))}: refused")
    return str(given)


def inside(pattern: str, **values: Any) -> str:
    """The path that a template gives; refuses a path out of the dataset."""
    path = PurePosixPath(pattern.format(**values))
    if path.is_absolute() or ".." in path.parts or "\\" in str(path):
        raise StoreError(f"the path {str(path)!r} that {INFO} gives leads out of the dataset: refused")
    return str(path)


def first_line(error: BaseException) -> str:
    text = str(error).splitlines()[0] if str(error) else type(error).__name__
    return f"no {text}" if isinstance(error, KeyError) else text
