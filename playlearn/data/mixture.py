"""Several datasets in one stream of batches, each with its fraction; a pure function of (seed, step)."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from playlearn.batch import Batch
from playlearn.data.dataset import DataConfig, PlayDataset
from playlearn.data.prefetch import prepared_ahead
from playlearn.data.stream import Indices
from playlearn.errors import UsageError
from playlearn.store import Store, StoreConfig, open_store


@dataclass(frozen=True)
class DatasetSource:
    """More play beside a run's own, such as DAgger's rollouts.

    store: the play, as in TrainConfig.
    fraction: of all examples.
    data: how examples are cut from it (null: as from the run's own play).
    """

    store: Path | StoreConfig
    fraction: float
    data: DataConfig | None = None

    def __post_init__(self) -> None:
        """Raises UsageError where the fraction leaves nothing to one side."""
        if not 0 < self.fraction < 1:
            raise UsageError(f"fraction must lie between 0 and 1, both excluded, got {self.fraction:g}")


def build_sources(
    own: PlayDataset, sources: Sequence[DatasetSource], seed: int, *, blind: bool = False
) -> list[tuple[PlayDataset, float]]:
    """The training split of each further store, with its fraction of all examples.

    own: the run's own play; its config is that of a source without one.
    blind: see `open_store`; as the run's own play was opened.

    Raises:
        UsageError: the fractions leave nothing to `own`; a store's numbers or images mean something else.
        StoreError: a store is missing, or holds nothing to learn from.
    """
    built = []
    for number, source in enumerate(sources, 1):
        store = open_store(source.store, blind=blind)
        _check_same(own, store)
        built.append(((source.data or own.config).build(store, "train", seed + number), source.fraction))
    _check_fractions([source.fraction for source in sources])
    return built


def mix_datasets[P: "Part"](own: P, extra: Sequence[tuple["Part", float]]) -> "P | DatasetMixture":
    """The examples of a run: its own play, or a mixture with further examples, each with its fraction.

    Raises:
        UsageError: the fractions leave nothing to `own`.
    """
    return DatasetMixture(own, extra) if extra else own


class Part(Protocol):
    """Examples that make up a run or a part of one, see `Examples`."""

    def at(self, places: Indices, orders: dict[int, Indices]) -> Batch: ...
    def batches(self, batch_size: int, start_step: int = 0, rank: int = 0, ranks: int = 1) -> Iterator[Batch]: ...


class DatasetMixture:
    """Datasets with fractions, in batches as `Examples.batches` gives them.

    Places of the common stream are dealt out evenly, not drawn: of any n places in a row a part gets its fraction to
    within one or two. Each part goes through its own epochs at its own pace.
    """

    def __init__(self, own: Part, extra: Sequence[tuple[Part, float]]) -> None:
        """own: gets what the fractions of the others leave.

        Raises:
            UsageError: they leave nothing.
        """
        fractions = [fraction for _, fraction in extra]
        _check_fractions(fractions)
        self.parts = [*(part for part, _ in extra), own]
        left = 1.0 - np.concatenate([[0.0], np.cumsum(fractions)])
        self._of_rest = [fraction / rest for fraction, rest in zip(fractions, left[:-1].tolist(), strict=True)]

    def places(self, start: int, count: int) -> list[Indices]:
        """For each part the places of its own stream that the common places start ... start+count-1 stand for."""
        left, dealt = np.arange(start, start + count), []
        for fraction in self._of_rest:
            before, after = np.floor(left * fraction).astype(np.int64), np.floor((left + 1) * fraction).astype(np.int64)
            mine = after > before
            dealt.append(before[mine])
            left = (left - after)[~mine]
        return [*dealt, left]

    def batches(self, batch_size: int, start_step: int = 0, rank: int = 0, ranks: int = 1) -> Iterator[Batch]:
        """See `Examples.batches`."""
        orders: list[dict[int, Indices]] = [{} for _ in self.parts]

        def make(step: int) -> Batch:
            dealt = self.places((step * ranks + rank) * batch_size, batch_size)
            return joined([p.at(at, order) for p, at, order in zip(self.parts, dealt, orders, strict=True) if len(at)])

        return prepared_ahead(make, start_step)


def joined(batches: Sequence[Batch]) -> Batch:
    """One batch of all examples."""

    def join(values: list[Any]) -> Any:
        if not isinstance(values[0], Mapping):
            return torch.cat(values)
        cameras = dict.fromkeys(camera for value in values for camera in value)
        return {camera: torch.cat(filled([value.get(camera) for value in values])) for camera in cameras}

    def filled(parts: list[torch.Tensor | None]) -> list[torch.Tensor]:
        """Keypoints that a part lacks are NaN."""
        known = next(part for part in parts if part is not None)
        return [
            known.new_full((len(batch), *known.shape[1:]), torch.nan) if part is None else part
            for batch, part in zip(batches, parts, strict=True)
        ]

    names = [entry.name for entry in dataclasses.fields(Batch)]
    return Batch(**{name: join([getattr(batch, name) for batch in batches]) for name in names})


def _check_fractions(fractions: Sequence[float]) -> None:
    """Raises UsageError where they leave nothing to the run's own play."""
    if sum(fractions) >= 1:
        raise UsageError(
            f"the fractions of further play add up to {sum(fractions):g}: leave some of 1 to the run's own"
        )


def _check_same(own: PlayDataset, other: Store) -> None:
    """Raises UsageError where an example of the other store would mean something else."""
    mine, its = own.store.spec, other.spec
    seen = (*own.config.cameras, *own.config.goal_cameras)
    named = ("state_names", "achieved_names", "action_names", "fps")
    parts: list[tuple[str, Any, Any]] = [(name, getattr(mine, name), getattr(its, name)) for name in named]
    sides = mine.quantities, its.quantities
    parts += [(f"declaration of {name}", *(getattr(side, name) for side in sides)) for name in vars(mine.quantities)]
    sizes = own.store.cameras(), other.cameras()
    parts += [(f"size of {camera}", sizes[0].get(camera), sizes[1].get(camera)) for camera in seen]
    apart = [f"{name} ({_differ(one, another)})" for name, one, another in parts if one != another]
    if apart:
        raise UsageError(f"{other.name()} has another {', '.join(apart)} than {own.store.name()}: they cannot be mixed")


def _differ(mine: Any, its: Any) -> str:
    """Of two lists of names, what only one of them has; of anything else, both values."""
    if isinstance(mine, tuple) and isinstance(its, tuple) and set(mine) != set(its):
        sides = {"it has": [name for name in its if name not in mine], "it lacks": [n for n in mine if n not in its]}
        return "; ".join(f"{side} {', '.join(map(str, names))}" for side, names in sides.items() if names)
    return f"{its}, not {mine}"
