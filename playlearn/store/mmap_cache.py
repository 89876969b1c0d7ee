"""Least-recently-used cache of memory-mapped files of arrays."""

import threading
from collections import OrderedDict
from collections.abc import Callable

from playlearn.episode import Array

OPEN_MAPS = 256  # each costs a file descriptor, of which a process has 1,024 by default


class MmapCache:
    """Number -> arrays of a file; safe to share between threads."""

    def __init__(self) -> None:
        self._maps: OrderedDict[int, dict[str, Array]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, number: int, load: Callable[[], dict[str, Array]]) -> dict[str, Array]:
        """The arrays of a file, loaded unless cached; one thread at a time."""
        with self._lock:
            arrays = self._maps.get(number)
            if arrays is None:
                arrays = self._maps[number] = load()
                if len(self._maps) > OPEN_MAPS:
                    self._maps.popitem(last=False)
            else:
                self._maps.move_to_end(number)
        return arrays
