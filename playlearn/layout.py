"""What the names of a vector say about its dimensions. Nothing else in playlearn takes such a name apart.

name         object   part    axis
red.x        red      x       x
nut.peg.x    nut      peg.x   x
lamp         lamp             lamp

What a dimension measures is not read off its name, but declared (see `quantity.py`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property

from playlearn.errors import UsageError


@dataclass(frozen=True)
class ObjectLayout:
    """The dimensions of a vector (G,), grouped by object and by place.

    names: (G,) one for each dimension.
    """

    names: Sequence[str]

    @cached_property
    def owners(self) -> tuple[str, ...]:
        """(G,) the object of each dimension: the name up to its first dot."""
        return tuple(name.partition(".")[0] for name in self.names)

    @cached_property
    def parts(self) -> tuple[str, ...]:
        """(G,) which part of its object each dimension is: what follows the first dot."""
        return tuple(name.partition(".")[2] for name in self.names)

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """(G,) the axis of each dimension, whatever the object: what follows the last dot, or the whole name."""
        return tuple(name.rpartition(".")[2] for name in self.names)

    def objects(self) -> dict[str, list[int]]:
        """Object -> its dimensions, both in the order of the names."""
        groups: dict[str, list[int]] = {}
        for k, owner in enumerate(self.owners):
            groups.setdefault(owner, []).append(k)
        return groups

    def having(self, parts: Sequence[str]) -> dict[str, tuple[int, ...]]:
        """Object -> where these parts of it stand; only objects that have them all."""
        index = {pair: k for k, pair in enumerate(zip(self.owners, self.parts, strict=True))}
        wanted = {owner: [(owner, part) for part in parts] for owner in self.objects()}
        return {owner: tuple(index[p] for p in pairs) for owner, pairs in wanted.items() if index.keys() >= set(pairs)}

    def places(self) -> dict[str, tuple[int, int, int]]:
        """Object -> where its x, y and z, in meters, stand; only objects whose place is given."""
        return {owner: (x, y, z) for owner, (x, y, z) in self.having(("x", "y", "z")).items()}

    def select(self, patterns: Sequence[str]) -> list[int]:
        """The dimensions whose name matches one of the shell-style patterns; none where there are no dimensions.

        Raises:
            UsageError: a pattern matches no name.
        """
        for pattern in patterns:
            if self.names and not any(fnmatchcase(name, pattern) for name in self.names):
                raise UsageError(f"goal_names: {pattern!r} matches none of: {', '.join(self.names)}")
        return [k for k, name in enumerate(self.names) if any(fnmatchcase(name, pattern) for pattern in patterns)]
