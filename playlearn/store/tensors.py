"""One self-contained safetensors file: written whole or not at all, checked, memory-mapped.

    8 bytes, little endian: h     h bytes of JSON, padded     the arrays, one after another
    |-----------------------------|---------------------------|------------------------------>
                                  {"__metadata__": {"sha256": ..., ...}, "action": {"dtype", ...}}

The checksum covers the JSON without itself, then the arrays.
"""

import hashlib
import json
import mmap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.config import atomic_write
from playlearn.episode import Array
from playlearn.errors import StoreError

TEMPORARY = ".tmp"  # suffix that `atomic_write` gives to an unfinished file
_DTYPES = {
    "F64": "float64",
    "F32": "float32",
    "I64": "int64",
    "I32": "int32",
    "I16": "int16",
    "U8": "uint8",
    "BOOL": "bool",
}
_CODES = {name: code for code, name in _DTYPES.items()}
_CHUNK = 1 << 22
DAMAGED = (
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    AttributeError,
    ArithmeticError,
)  # raised by JSON that is not ours


@dataclass(frozen=True)
class Slot:
    """Where an array is in the file.

    dtype: numpy's name.
    shape: of the array.
    offset: first byte, from the start of the file.
    """

    dtype: str
    shape: tuple[int, ...]
    offset: int

    def nbytes(self) -> int:
        return int(np.prod(self.shape, dtype=np.int64)) * np.dtype(self.dtype).itemsize


@dataclass(frozen=True)
class Layout:
    """Where all arrays are in the file.

    slots: name -> Slot.
    start: first byte of the arrays.
    size: bytes of the whole file.
    """

    slots: Mapping[str, Slot]
    start: int
    size: int


@dataclass(frozen=True)
class Header:
    """Header of a file.

    metadata: the file's own.
    raw: the JSON, for the checksum.
    layout: of the arrays.
    """

    metadata: Mapping[str, str]
    raw: Mapping[str, Any]
    layout: Layout


def write_tensors(path: Path, arrays: Mapping[str, Array], metadata: Mapping[str, str]) -> None:
    """Write `arrays` to `path` atomically: temporary file beside it, fsync, rename, fsync of the folder.

    An existing file of that name is replaced.

    Raises:
        DiskError: the disk is full or cannot be written; nothing was changed.
    """
    # Widest numbers first, so that every array begins at a multiple of its own item size.
    ordered = sorted(arrays.items(), key=lambda item: (-item[1].dtype.itemsize, item[0]))
    header: dict[str, Any] = {"__metadata__": dict(metadata)}
    at = 0
    for name, value in ordered:
        header[name] = {
            "dtype": _CODES[value.dtype.name],
            "shape": list(value.shape),
            "data_offsets": [at, at + value.nbytes],
        }
        at += value.nbytes
    buffers = [memoryview(np.ascontiguousarray(value).reshape(-1).view(np.uint8)) for _, value in ordered]
    header["__metadata__"]["sha256"] = _digest(header, buffers)
    text = _dump(header)
    text += b" " * (-len(text) % 8)
    atomic_write(path, b"".join([len(text).to_bytes(8, "little"), text, *buffers]))


def read_header(path: Path) -> Header:
    """The header of a file.

    Raises:
        StoreError: the file cannot be read, is cut short, or is not safetensors.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            length = int.from_bytes(file.read(8), "little")
            if not 0 < length <= size - 8:
                raise ValueError("its header is cut short")
            raw = json.loads(file.read(length))
        slots = {
            name: Slot(_DTYPES[entry["dtype"]], tuple(entry["shape"]), 8 + length + entry["data_offsets"][0])
            for name, entry in raw.items()
            if name != "__metadata__"
        }
        metadata = dict(raw.get("__metadata__", {}))
        if any(min((0, *slot.shape)) < 0 or slot.offset < 8 + length for slot in slots.values()):
            raise ValueError("its header is damaged")
        if any(slot.offset + slot.nbytes() > size for slot in slots.values()):
            raise ValueError("its arrays are cut short")
    except (OSError, *DAMAGED) as error:
        raise StoreError(f"{path} cannot be read ({error}): delete it, or fetch it again") from error
    return Header(metadata, raw, Layout(slots, 8 + length, size))


def map_tensors(path: Path, layout: Layout) -> dict[str, Array]:
    """Every array as a read-only, memory-mapped view; the mapping lives as long as any view."""
    try:
        with path.open("rb") as file:
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        if len(mapped) != layout.size:
            raise ValueError("its size has changed")
    except (OSError, ValueError) as error:
        raise StoreError(
            f"{path} cannot be read ({error}): it was whole when the store was opened; open it again"
        ) from error
    return {
        name: np.ndarray(slot.shape, np.dtype(slot.dtype), buffer=mapped, offset=slot.offset)
        for name, slot in layout.slots.items()
    }


def checksum_holds(path: Path) -> bool:
    """Whether every byte is as written; raises StoreError or OSError if the file cannot be read."""
    header = read_header(path)
    raw = {**header.raw, "__metadata__": {k: v for k, v in header.metadata.items() if k != "sha256"}}
    with path.open("rb") as file:
        file.seek(header.layout.start)
        return header.metadata.get("sha256") == _digest(raw, iter(lambda: file.read(_CHUNK), b""))


def _digest(header: Mapping[str, Any], parts: Iterable[bytes | memoryview]) -> str:
    digest = hashlib.sha256(_dump(header))
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def _dump(header: Mapping[str, Any]) -> bytes:
    return json.dumps(header, separators=(",", ":"), ensure_ascii=True).encode()
