"""The folder that a job writes into: empty, or begun by the same job with the same settings.

Every job that can be interrupted keeps to this. It asks `RunFolder.begun`; if so, it hands the settings of then and now
to `RunFolder.check_same`; if not, it writes its record before anything else.
"""

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from playlearn.config.digests import Digests, input_changes
from playlearn.config.held import LOCK
from playlearn.config.record import atomic_write
from playlearn.errors import UsageError

INPUTS = "inputs.json"  # what the job reads, by digest
_TEMPORARY = ".tmp"  # how `atomic_write` ends the name of a file that is not whole yet


@dataclass(frozen=True)
class RunFolder:
    """A job's output folder.

    path: the folder.
    record: name of the file in it that the job writes first; where it is, the job was begun.
    holds: what the folder then holds, for messages (`DAgger run`).
    elsewhere: advice for a folder that is taken.
    adjustable: dotted names of settings that may differ when the job continues, with all below them.
    entries: names of settings that are mappings whose entries may come and go; entries of both must agree.
    leftovers: names of files that a job killed before its record was written may have left.
    """

    path: Path
    record: str
    holds: str
    elsewhere: str = "choose another --out"
    adjustable: Collection[str] = ()
    entries: Collection[str] = ()
    leftovers: Collection[str] = ()

    @property
    def file(self) -> Path:
        """The record."""
        return self.path / self.record

    def begun(self, *, resume: bool | None = None) -> bool:
        """Whether the job was begun here, so that it continues.

        resume: True where it must have been, False where it must not have been, None where either is right.

        Raises:
            UsageError: the folder is not what `resume` asks for, or holds something else; says what to do.
        """
        if self.file.is_file():
            if resume is False:
                raise UsageError(f"{self.path} is there already: {self.elsewhere}, or continue it with --resume")
            return True
        if self.path.exists() and (not self.path.is_dir() or any(map(self._foreign, self.path.iterdir()))):
            raise UsageError(
                f"{self.path} is there already and holds no {self.holds} (no {self.record}): {self.elsewhere}"
            )
        if resume:
            raise UsageError(f"there is no {self.holds} at {self.path} to resume; start it without --resume")
        return False

    def check_same(self, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
        """Compare the settings that the job was begun with to those it is to continue with, both as JSON.

        Raises:
            UsageError: they differ; names every setting that does.
        """
        before, now = _plain(before), _plain(now)
        for name in self.entries:
            before = {name: {}, **before}  # of a folder from before there was that setting
            shared = before[name].keys() & now[name].keys()
            before, now = ({**one, name: {key: one[name][key] for key in shared}} for one in (before, now))
        names = [name for name in differences(before, now) if not self._adjustable(name)]
        if names:
            raise UsageError(
                f"{self.path} was begun with another {', '.join(names)}: give the same, or {self.elsewhere}"
            )

    def keep_inputs(self, inputs: Digests) -> None:
        """Record what the job reads; called before its own record is written."""
        atomic_write(self.path / INPUTS, json.dumps(inputs, indent=1).encode())

    def inputs(self) -> Digests:
        """What `keep_inputs` recorded last; empty where it did not."""
        file = self.path / INPUTS
        recorded: Digests = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
        return recorded

    def check_inputs(self, now: Digests) -> None:
        """Compare what the job reads to what it read when it was begun; of what only one of the two reads, nothing.

        Raises:
            UsageError: it is not the same; names the settings, and what was added, removed or changed.
        """
        changes = input_changes(self.inputs(), now)
        if changes:
            raise UsageError(
                f"{self.path} was begun with other inputs: {'; '.join(changes)}. Put it back as it was, "
                f"or {self.elsewhere}"
            )

    def _foreign(self, path: Path) -> bool:
        return path.name not in (LOCK, INPUTS, *self.leftovers) and path.suffix != _TEMPORARY

    def _adjustable(self, name: str) -> bool:
        return any(name == one or name.startswith(f"{one}.") for one in self.adjustable)


def differences(before: Mapping[str, Any], now: Mapping[str, Any], prefix: str = "") -> list[str]:
    """The dotted names under which two nested mappings differ, sorted."""
    names: list[str] = []
    for key in sorted(before.keys() | now.keys()):
        old, new = before.get(key), now.get(key)
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            names += differences(old, new, f"{prefix}{key}.")
        elif old != new:
            names.append(prefix + key)
    return names


def _plain(settings: Mapping[str, Any]) -> dict[str, Any]:
    """As JSON gives them back: tuples are lists."""
    plain: dict[str, Any] = json.loads(json.dumps(settings))
    return plain
