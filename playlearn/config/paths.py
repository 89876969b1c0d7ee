"""What a path in a config means.

A relative path is looked for from the working directory, as on a command line; one that begins with `./` or `../` and
stands in a file, from the folder of that file. What a job records is spelled in the second way: it means the same from
any folder, also after the run and what it names were moved together.
"""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self


def spelled_from(folder: Path) -> Callable[[Path], str]:
    """Spells a path for a file in `folder`: `./` or `../`, then the way there."""
    base = os.path.realpath(folder)

    def spell(path: Path) -> str:
        relative = os.path.relpath(path, base)
        return f"{relative}/" if relative == ".." else relative if _from_file(relative) else f"./{relative}"

    return spell


class FileText(str):
    """A text from a file that is a path from the file's folder, if it is a path."""

    __slots__ = ("_folder",)
    _folder: str

    def __new__(cls, text: str, folder: str) -> Self:
        """folder: of the file."""
        made = super().__new__(cls, text)
        made._folder = folder
        return made

    def found(self) -> str:
        """The path."""
        return os.path.normpath(Path(self._folder) / self)


def from_file(folder: Path, raw: Any) -> Any:
    """What was read from a file in `folder`, with every text that begins with `./` or `../` a FileText."""
    base = os.path.realpath(folder)
    return _mapped(raw, lambda text: FileText(text, base))


def found(raw: Any) -> Any:
    """The same with every FileText found."""
    return _mapped(raw, lambda text: text.found() if isinstance(text, FileText) else text)


def unmarked(raw: Any) -> Any:
    """The same with every FileText a plain text again."""
    return _mapped(raw, str)


def moved(raw: Any, source: Path, target: Path) -> Any:
    """What was read from a file in the folder `source`, for a file in the folder `target`."""
    base, spell = os.path.realpath(source), spelled_from(target)
    return _mapped(raw, lambda text: spell(Path(os.path.normpath(Path(base) / text))))


def _mapped(raw: Any, change: Callable[[str], str]) -> Any:
    if isinstance(raw, Mapping):
        return {key: _mapped(value, change) for key, value in raw.items()}
    if isinstance(raw, list):
        return [_mapped(value, change) for value in raw]
    return change(raw) if isinstance(raw, str) and _from_file(raw) else raw


def _from_file(text: str) -> bool:
    return text.startswith(("./", "../"))
