"""What a job reads, by digest: so that one that goes on knows when it is not what the job was begun with."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

type Digests = Mapping[str, Mapping[str, str]]  # a setting -> a part of what it names (`episode 3`) -> its digest

_LENGTH = 16  # hexadecimal digits of a digest
_LISTED = 5  # parts in a message


def digest(data: bytes) -> str:
    """A short digest of bytes."""
    return hashlib.sha256(data).hexdigest()[:_LENGTH]


def json_digest(value: Any) -> str:
    """The digest of a value that JSON can hold."""
    return digest(json.dumps(value, sort_keys=True).encode())


def file_digest(path: Path) -> str:
    """The digest of a file's content; `missing` where there is none."""
    return digest(path.read_bytes()) if path.is_file() else "missing"


def input_changes(before: Digests, now: Digests) -> list[str]:
    """What differs of the inputs that both name, in words."""
    changes = []
    for name in sorted(before.keys() & now.keys()):
        old, new = before[name], now[name]
        kinds = {
            "added": [part for part in new if part not in old],
            "removed": [part for part in old if part not in new],
            "changed": [part for part in new if part in old and new[part] != old[part]],
        }
        words = [f"{len(parts)} {kind} ({_listed(parts)})" for kind, parts in kinds.items() if parts]
        if words:
            changes.append(f"{name}: {', '.join(words)}")
    return changes


def _listed(parts: Sequence[str]) -> str:
    return ", ".join([*parts[:_LISTED], *(["..."] if len(parts) > _LISTED else [])])
