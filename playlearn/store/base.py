"""The read interface of every store of episodes, whatever its format on disk."""

import dataclasses
import json
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, Self

import draccus
import numpy as np
from numpy.typing import NDArray

from playlearn.config import json_digest
from playlearn.episode import IMAGES, Array, Episode, EpisodeMeta
from playlearn.errors import StoreError
from playlearn.quantity import Quantities

_SUCCESS = {"success": True, "failure": False, "unknown": None}


@dataclass(frozen=True)
class StoreConfig(draccus.ChoiceRegistry):
    """The base of every store's config; `type:` in a YAML picks the kind."""

    @classmethod
    def at(cls, folder: Path) -> "StoreConfig | None":
        """The config of the store in a folder; None if the folder holds another kind."""
        return None

    def without_objects(self) -> "StoreConfig":
        """The same, to be read without what it says of objects and success, as far as that can be left out."""
        return self

    def build(self) -> "Store":
        raise NotImplementedError


@dataclass(frozen=True)
class StoreSpec:
    """What all episodes of one store have in common.

    environment: full config of the environment.
    state_names: name of each dimension of the state.
    achieved_names: name of each dimension of the achieved goal.
    action_names: name of each dimension of the action.
    fps: control steps a second.
    cameras: name -> (height, width) of the recorded images; empty if only states were recorded.
    quantities: what the dimensions of `state` and `achieved` measure, and what bounds the actions.
    """

    environment: Mapping[str, Any]
    state_names: tuple[str, ...]
    achieved_names: tuple[str, ...]
    action_names: tuple[str, ...]
    fps: float
    cameras: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    quantities: Quantities = field(default_factory=Quantities)

    @classmethod
    def of(cls, episode: Episode) -> Self:
        """The spec of a store that this episode fits into."""
        return cls.of_shapes(episode.meta, {key: value.shape for key, value in episode.arrays().items()})

    @classmethod
    def of_shapes(cls, meta: EpisodeMeta, shapes: Mapping[str, tuple[int, ...]]) -> Self:
        """The spec from an episode's metadata and the shapes of its arrays."""
        cameras = {
            key.removeprefix(IMAGES): (shape[1], shape[2]) for key, shape in shapes.items() if key.startswith(IMAGES)
        }
        names = meta.state_names, meta.achieved_names, meta.action_names
        return cls(meta.environment, *names, meta.fps, cameras, meta.quantities)

    def check(self, other: "StoreSpec") -> None:
        """Raises StoreError that names the first field in which an episode's spec differs from its store's."""
        for entry in dataclasses.fields(self):
            own, theirs = plain(getattr(self, entry.name)), plain(getattr(other, entry.name))
            if own != theirs:
                raise StoreError(
                    f"an episode whose {entry.name} differs from the store's: {theirs} is not {own}; "
                    "put it into a store of its own"
                )


class Store(Protocol):
    """Episodes at rest, read side. Episode i is the i-th by position, 0 <= i < len(store)."""

    spec: StoreSpec

    def __len__(self) -> int: ...

    def name(self) -> str:
        """Its path, for messages."""
        ...

    def indices(self) -> NDArray[np.int64]:
        """(N,) the number that each episode was recorded under; it never changes."""
        ...

    def lengths(self) -> NDArray[np.int64]:
        """(N,) T of each episode."""
        ...

    def cameras(self) -> dict[str, tuple[int, int]]:
        """Camera -> (height, width)."""
        ...

    def meta(self, i: int) -> EpisodeMeta: ...

    def read(self, i: int) -> Episode:
        """Episode i, whole and checked; its arrays are memory-mapped views if the store can map them."""
        ...

    def array(self, i: int, key: str) -> Array:
        """One array of episode i under its stored name (`achieved`, `observation.images.front`), read-only."""
        ...

    def digests(self) -> dict[str, str]:
        """Of what it holds, part by part (`episode 3`): the same as long as nobody has changed that part; quick."""
        ...

    def remarks(self) -> Mapping[str, str]:
        """Array, feature or camera of the source -> why it is left out, or not called what it is called there."""
        ...

    def rewards(self, i: int) -> Array | None:
        """(T,) the rewards that episode i was recorded with; None where there are none."""
        ...

    def verify(self) -> list[str]:
        """One line for each problem; reads everything. Empty: the store is intact."""
        ...

    def info(self) -> dict[str, Any]:
        """Summary of the contents, as JSON."""
        ...


def with_images(episode: Episode, images: Mapping[str, Array], renderer: str) -> Episode:
    """The same episode with other images, camera -> (T+1, h, w, 3) uint8, rendered by `renderer`."""
    cameras = {camera: {"height": frames.shape[1], "width": frames.shape[2]} for camera, frames in images.items()}
    meta = dataclasses.replace(episode.meta, cameras=cameras, renderer=renderer)
    return dataclasses.replace(episode, meta=meta, images=dict(images))


def spec_digest(spec: StoreSpec) -> str:
    """The digest of what all episodes of a store have in common."""
    return json_digest(plain(dataclasses.asdict(spec)))


def plain(value: Any) -> Any:
    """The value as JSON returns it: mappings become dicts, tuples lists."""
    return json.loads(json.dumps(value, default=_jsonable, sort_keys=True))


def to_json(record: Any) -> str:
    """A frozen dataclass of JSON-able fields, as text."""
    return json.dumps(
        {entry.name: getattr(record, entry.name) for entry in dataclasses.fields(record)}, default=_jsonable
    )


def _jsonable(value: Any) -> dict[str, Any]:
    return dataclasses.asdict(value) if isinstance(value, Quantities) else dict(value)


def from_json[T](cls: type[T], text: str) -> T:
    """Inverse of `to_json`; raises StoreError if a field is unknown or missing."""
    hints = typing.get_type_hints(cls)
    values = json.loads(text)
    unknown = sorted(set(values) - set(hints))
    if unknown:
        raise StoreError(f"{cls.__name__} with unknown {', '.join(unknown)}: written by a newer playlearn; update it")
    if "quantities" in hints:
        if "quantities" not in values:
            raise StoreError(
                f"{cls.__name__} does not say what its numbers measure (no `quantities`): it was written before "
                "playlearn recorded that; collect or import the recording again"
            )
        values["quantities"] = Quantities.from_dict(values["quantities"])
    tuples = {name for name, hint in hints.items() if typing.get_origin(hint) is tuple}
    try:
        return cls(**{name: tuple(value) if name in tuples else value for name, value in values.items()})
    except TypeError as error:
        raise StoreError(f"{cls.__name__} is incomplete: {error}") from error


def summary(store: Store) -> dict[str, Any]:
    """Summary of any store, without reading its images."""
    lengths = store.lengths()
    metas = [store.meta(i) for i in range(len(store))]
    skills: dict[str, int] = {}
    for i, meta in enumerate(metas):
        names = [name for name, _ in meta.annotations()]
        own = np.array([names.index(name) for name in names])[store.array(i, "skill")]  # one number a skill
        for number in own[np.flatnonzero(np.diff(own, prepend=-1))]:
            skills[names[number]] = skills.get(names[number], 0) + 1
    return {
        "episodes": len(store),
        "steps": int(lengths.sum()),
        "seconds": float(lengths.sum() / store.spec.fps),
        "fps": store.spec.fps,
        "environment": plain(store.spec.environment),
        "state": list(store.spec.state_names),
        "achieved": list(store.spec.achieved_names),
        "action": list(store.spec.action_names),
        "cameras": {camera: {"height": h, "width": w} for camera, (h, w) in store.cameras().items()},
        "tasks": _count(
            task for meta in metas for task in {meta.task, *(meta.skills if meta.verbatim else ())} if task
        ),
        "skills": {name: count for name, count in sorted(skills.items()) if name},
        "actors": _count(meta.actor for meta in metas),
        "ended": _count(meta.ended for meta in metas),
        "success": {what: sum(meta.success is value for meta in metas) for what, value in _SUCCESS.items()},
        "versions": {
            package: sorted({meta.versions[package] for meta in metas if package in meta.versions})
            for package in sorted({package for meta in metas for package in meta.versions})
        },
        "renderers": _count(meta.renderer for meta in metas if meta.renderer),
        "remarks": dict(store.remarks()),
    }


def _count(values: typing.Iterable[str]) -> dict[str, int]:
    counts: dict[str, int] = {}
    for value in values:
        counts[value] = counts.get(value, 0) + 1
    return dict(sorted(counts.items()))
