"""Import recordings of other formats into a native store, episode by episode: a kill loses none that is done."""

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from playlearn.config import RunFolder, atomic_write
from playlearn.episode import Episode
from playlearn.errors import StoreError, UsageError
from playlearn.store.base import StoreSpec, plain
from playlearn.store.native import IMPORTED, NativeStore

_MAX_LISTED = 10  # broken recordings in one message


class Recordings(Protocol):
    """What an importer offers.

    spec: of the store.
    note: everything that determines the episodes, as JSON.
    splits: name -> numbers of its episodes.
    remarks: array, feature or camera of the source -> why it is left out, or not called what it is called there.
    """

    spec: StoreSpec
    note: Mapping[str, Any]
    splits: Mapping[str, Sequence[int]]
    remarks: Mapping[str, str]

    def names(self) -> Mapping[int, str]:
        """Number -> name in the source, of every recording to import."""
        ...

    def problems(self) -> Mapping[int, str]:
        """Number -> why it cannot be imported, as far as is known without reading it whole."""
        ...

    def read(self, numbers: Sequence[int]) -> Iterator[tuple[int, Episode | StoreError]]:
        """The episodes of these ascending numbers, one in memory at a time; an error in place of a broken one."""
        ...


def import_recordings(
    recordings: Recordings,
    out: Path,
    *,
    skip_broken: bool = False,
    progress: Callable[[int], None] = lambda done: None,
    say: Callable[[str], None] = lambda line: print(line, file=sys.stderr),
) -> NativeStore:
    """Import every recording into the store at `out`; those already there are kept as they are.

    skip_broken: leave broken ones out, with a message, instead of stopping at them.
    progress: called with the number of episodes done.
    say: prints a message.

    Raises:
        StoreError: some are broken, which the message names; `out` holds something else.
        UsageError: `out` was imported from something else.
    """
    names, broken = recordings.names(), dict(recordings.problems())
    if broken and not skip_broken:
        raise StoreError(_format_problems(broken, len(names)))
    store = _begin(recordings, out)
    for name, remark in recordings.remarks.items():
        say(f"{name}: {remark}")
    with store.writer() as writer:
        done = set(store.indices().tolist())
        for number, got in recordings.read([n for n in sorted(names) if n not in done and n not in broken]):
            if isinstance(got, StoreError):
                if not skip_broken:
                    raise StoreError(f"{got}\n{_ADVICE}") from got
                broken[number] = str(got)
            else:
                writer.append(got, number)
                progress(len(store))
    for problem in broken.values():
        say(f"left out: {problem}")
    if not len(store):
        raise StoreError(f"none of {len(names)} recordings could be imported")
    return store


def _begin(recordings: Recordings, out: Path) -> NativeStore:
    note = plain({**recordings.note, "splits": recordings.splits, "remarks": recordings.remarks})
    if not (out / "store.json").exists():
        text = json.dumps(note, indent=2).encode()
        return NativeStore.create(out, recordings.spec, {IMPORTED: lambda path: atomic_write(path, text)})
    store = NativeStore.open(out)
    try:
        before = json.loads((out / IMPORTED).read_text())
    except (OSError, ValueError) as error:
        raise UsageError(
            f"{out} was not made by `playlearn import` (no {IMPORTED} to read): give another OUT"
        ) from error
    RunFolder(out, IMPORTED, "import", "give another OUT", adjustable=["remarks"]).check_same(before, note)
    store.spec.check(recordings.spec)
    return store


_ADVICE = "the episodes before it are kept; repair it, or leave broken ones out with --skip-broken, and run this again"


def _format_problems(broken: Mapping[int, str], total: int) -> str:
    lines = [f"{len(broken)} of {total} recordings are broken; --skip-broken imports the others"]
    lines += [f"  {problem}" for problem in list(broken.values())[:_MAX_LISTED]]
    return "\n".join(lines + ([f"  and {len(broken) - _MAX_LISTED} more"] if len(broken) > _MAX_LISTED else []))
