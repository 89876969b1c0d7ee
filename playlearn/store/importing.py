"""Other people's recordings, put into a store of ours: episode by episode, so that a kill loses none that was done."""

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from playlearn.config import RunFolder, atomic_write
from playlearn.episode import Episode
from playlearn.errors import StoreError, UsageError
from playlearn.store.base import StoreSpec, plain
from playlearn.store.native import NativeStore

NOTE = "import.json"  # what the episodes were made from, beside store.json
_NAMED = 10  # broken recordings in one message


class Recordings(Protocol):
    """What an importer offers. note: what decides the episodes, as JSON. splits: name -> numbers of its episodes."""

    spec: StoreSpec
    note: Mapping[str, Any]
    splits: Mapping[str, Sequence[int]]

    def names(self) -> Mapping[int, str]:
        """Number -> what the source calls it; of all that are to be imported."""
        ...

    def problems(self) -> Mapping[int, str]:
        """Number -> why it cannot be imported, as far as that shows without reading it whole."""
        ...

    def read(self, numbers: Sequence[int]) -> Iterator[tuple[int, Episode | StoreError]]:
        """The episodes under these ascending numbers, one in memory at a time; what is wrong with one, in its place."""
        ...


def import_recordings(
    recordings: Recordings,
    out: Path,
    *,
    skip_broken: bool = False,
    progress: Callable[[int], None] = lambda done: None,
    say: Callable[[str], None] = lambda words: print(words, file=sys.stderr),
) -> NativeStore:
    """Put every recording into the store at `out`; those that are there already are left alone.

    skip_broken: leave broken ones out, saying so, instead of stopping at them.

    Raises:
        StoreError: some are broken, which the message names; `out` holds something else.
        UsageError: `out` was imported from something else.
    """
    names, broken = recordings.names(), dict(recordings.problems())
    if broken and not skip_broken:
        raise StoreError(_told(broken, len(names)))
    store = _begin(recordings, out)
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
    for words in broken.values():
        say(f"left out: {words}")
    if not len(store):
        raise StoreError(f"none of {len(names)} recordings could be imported")
    return store


def _begin(recordings: Recordings, out: Path) -> NativeStore:
    note = plain({**recordings.note, "splits": recordings.splits})
    if not (out / "store.json").exists():
        text = json.dumps(note, indent=2).encode()
        return NativeStore.create(out, recordings.spec, {NOTE: lambda path: atomic_write(path, text)})
    store = NativeStore.open(out)
    try:
        before = json.loads((out / NOTE).read_text())
    except (OSError, ValueError) as error:
        raise UsageError(f"{out} was not made by `playlearn import` (no {NOTE} to read): give another OUT") from error
    RunFolder(out, NOTE, "import", "give another OUT").check_same(before, note)
    store.spec.check(recordings.spec)
    return store


_ADVICE = "what was done before it is kept; mend it, or leave broken ones out with --skip-broken, and run this again"


def _told(broken: Mapping[int, str], total: int) -> str:
    lines = [f"{len(broken)} of {total} recordings are broken; --skip-broken imports the others"]
    lines += [f"  {words}" for words in list(broken.values())[:_NAMED]]
    return "\n".join(lines + ([f"  and {len(broken) - _NAMED} more"] if len(broken) > _NAMED else []))
