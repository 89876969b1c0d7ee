"""Statistics of a store of play: where objects were, what changed, mistakes and recoveries.

They hold for any environment: objects and fixtures are the groups of `achieved_names` (`red.x`, `drawer.opening`), the
end effector is the first group of `state_names` with x, y and z, changes are the settled moments of relabeling.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import Array
from playlearn.errors import UsageError
from playlearn.layout import ObjectLayout
from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.store import Store

CELLS = 28  # of a heat map along its longer side
BINS = 25
STILL = 0.01  # meters a second below which end effector and fingers are idle
EMPTY = 0.004  # meters between fingers that hold nothing
GAVE_UP, AGAIN, MISSED = "gave_up", "again", "missed_grasp"
MISHAPS = ("mistake", "slip", MISSED)


@dataclass(frozen=True)
class SkillAttempt:
    """One skill from its first step to its last: steps [begin, end) of an episode.

    episode: position in the store.
    begin, end: steps.
    skill: its name.
    marks: annotations of any of its steps, and `missed_grasp` if the fingers closed on nothing and opened again.
    truncated: the episode ended during it, so its outcome is unknown.
    unknown: it is a task in the recorder's own words, and nothing says how it ended.
    """

    episode: int
    begin: int
    end: int
    skill: str
    marks: frozenset[str]
    truncated: bool
    unknown: bool = False

    @property
    def failed(self) -> bool:
        return GAVE_UP in self.marks


def attempts(store: Store) -> list[SkillAttempt]:
    """Every attempt of a store. The same skill twice in a row counts twice if its annotation says so."""
    found = []
    for i in range(len(store)):
        meta, numbers = store.meta(i), store.array(i, "skill")
        annotations = meta.annotations()
        own = np.array([[name for name, _ in annotations].index(name) for name, _ in annotations])[numbers]
        gave_up, again = (np.array([mark in marks for _, marks in annotations])[numbers] for mark in (GAVE_UP, AGAIN))
        fresh = np.flatnonzero((own[1:] != own[:-1]) | gave_up[:-1] | again[1:]) + 1
        for begin, end in zip([0, *fresh.tolist()], [*fresh.tolist(), len(own)], strict=True):
            marks = {mark for number in np.unique(numbers[begin:end]) for mark in annotations[number][1]} - {AGAIN}
            if _missed(store, i, begin, end):
                marks.add(MISSED)
            truncated = end == len(own) and GAVE_UP not in marks
            name, unknown = annotations[numbers[begin]][0], meta.verbatim and not truncated
            found.append(SkillAttempt(i, begin, end, name, frozenset(marks), truncated, unknown))
    return found


def figures(store: Store, settling: SettlingConfig | None = None) -> dict[str, Any]:
    """All statistics of the report, as JSON.

    Raises:
        UsageError: the store is empty.
    """
    if not len(store):
        raise UsageError(f"{store.name()} has no episodes yet: there is nothing to report")
    spec = store.spec
    index = RelabelIndex.of_store(store, settling or SettlingConfig())
    found = attempts(store)
    return {
        "store": store.info(),
        "lengths": _quantiles(store.lengths() / spec.fps),
        "heat_maps": _heat_maps(store),
        "values": _values(store),
        "settled": _settled(index),
        "changes": _changes(index),
        "end_effector": _end_effector(store),
        "steps": _step_fractions(store),
        "skills": _skills(found, spec.fps),
        "mishaps": {mark: _outcomes([attempt for attempt in found if mark in attempt.marks]) for mark in MISHAPS},
        "attempts": _outcomes(found),
        "actions": _actions(store),
    }


def position_names(names: Sequence[str]) -> tuple[str, str, str] | None:
    """The x, y and z of the first group that has all three."""
    for x, y, z in ObjectLayout(names).places().values():
        return names[x], names[y], names[z]
    return None


def _missed(store: Store, i: int, begin: int, end: int) -> bool:
    """Whether the fingers closed on nothing and opened again."""
    actions = [k for k, name in enumerate(store.spec.action_names) if name.startswith("grip")]
    widths = [k for k, name in enumerate(store.spec.state_names) if name.endswith("opening")]
    if not actions or not widths:
        return False
    closed = store.array(i, "action")[begin:end, actions[0]] > 0
    empty = store.array(i, "observation.state")[begin:end, widths[0]] < EMPTY
    return bool((closed[:-1] & ~closed[1:] & empty[:-1]).any())


def _outcomes(skill_attempts: Sequence[SkillAttempt]) -> dict[str, Any]:
    """How many attempts, and how many of them succeeded, failed, were truncated or ended nobody knows how."""
    known = [attempt for attempt in skill_attempts if not (attempt.truncated or attempt.unknown)]
    failed = sum(attempt.failed for attempt in known)
    return {
        "count": len(skill_attempts),
        "succeeded": len(known) - failed,
        "failed": failed,
        "truncated": sum(attempt.truncated for attempt in skill_attempts),
        "unknown": sum(attempt.unknown for attempt in skill_attempts),
    }


def _heat_maps(store: Store) -> dict[str, Any]:
    """Heat maps on a common grid: counts[row][column] with y upwards and x to the right."""
    names, effector = store.spec.achieved_names, position_names(store.spec.state_names)
    groups = ObjectLayout(names).having(("x", "y"))
    positions = {group: _columns(store, "achieved", names, (f"{group}.x", f"{group}.y")) for group in groups}
    if effector is not None:
        positions["end effector"] = _columns(store, "observation.state", store.spec.state_names, effector[:2])
    if not positions:
        return {}
    low, high = np.percentile(np.concatenate(list(positions.values())), [0.1, 99.9], axis=0)
    cell = max(float((high - low).max()) / CELLS, 1e-6)
    shape = np.maximum(np.ceil((high - low) / cell - 1e-9).astype(int), 1)
    edges = [low[k] + cell * np.arange(shape[k] + 1) for k in range(2)]
    maps = {name: np.histogram2d(track[:, 0], track[:, 1], edges)[0] for name, track in positions.items()}
    visited = sum(maps.values()) > 0
    return {
        "x": [float(edges[0][0]), float(edges[0][-1])],
        "y": [float(edges[1][0]), float(edges[1][-1])],
        "cell": cell,
        "maps": {
            name: {"counts": counts.T[::-1].astype(int).tolist(), "coverage": float((counts > 0).sum() / visited.sum())}
            for name, counts in maps.items()
        },
    }


def _values(store: Store) -> dict[str, Any]:
    """Histograms of dimensions without a position: an opening, a lamp."""
    names = store.spec.achieved_names
    positioned = {f"{name[:-2]}." for name in names if name.endswith(".x")}
    single = [name for name in names if not any(name.startswith(group) for group in positioned)]
    return {name: _histogram(_columns(store, "achieved", names, (name,))[:, 0]) for name in single}


def _settled(index: RelabelIndex) -> dict[str, Any]:
    gaps = np.concatenate([_gaps(index, index.settled(i)[0]) for i in range(len(index.lengths))])
    return {
        "moments": len(index.moments),
        "per_minute": 60 * len(index.moments) / float(index.lengths.sum() / index.fps),
        "seconds_between": _quantiles(gaps),
        "histogram": _histogram(gaps),
    }


def _changes(index: RelabelIndex) -> dict[str, Any]:
    """For each object and fixture: how often it changed and settled, and the time in between."""
    minutes = float(index.lengths.sum() / index.fps) / 60
    changed, changes = index.changed_groups(), {}
    for column, (group, count) in enumerate(index.change_counts().items()):
        own = [
            index.moments[span][changed[span, column]]
            for span in map(slice, index.offsets[:-1].tolist(), index.offsets[1:].tolist())
        ]
        gaps = np.concatenate([_gaps(index, moments)[1:] for moments in own])
        changes[group] = {"count": count, "per_minute": count / minutes, "seconds_between": _quantiles(gaps)}
    return changes


def _gaps(index: RelabelIndex, moments: Array) -> Array:
    """Seconds from the beginning to the first moment, then from each to the next."""
    return np.diff(moments, prepend=0) / index.fps


def _end_effector(store: Store) -> dict[str, Any]:
    """Speed in m/s, and the fraction of steps in which end effector and fingers were idle."""
    names, fps = store.spec.state_names, store.spec.fps
    place = position_names(names)
    if place is None:
        return {}
    columns = [names.index(name) for name in place]
    fingers = [k for k, name in enumerate(names) if name.endswith("opening")][:1]
    speeds, still = [], []
    for i in range(len(store)):
        moved = np.diff(store.array(i, "observation.state").astype(float), axis=0) * fps
        speed = np.linalg.norm(moved[:, columns], axis=1)
        speeds.append(speed)
        still.append((speed < STILL) & (np.abs(moved[:, fingers]) < STILL).all(axis=1))
    speed = np.concatenate(speeds)
    return {
        "speed": {**_quantiles(speed), "mean": float(speed.mean()), "histogram": _histogram(speed)},
        "idle": float(np.concatenate(still).mean()),
    }


def _step_fractions(store: Store) -> dict[str, float]:
    """Mark of steps -> fraction of all steps that have it."""
    counts: dict[str, int] = {}
    for i in range(len(store)):
        annotations = store.meta(i).annotations()
        for number, count in zip(*np.unique(store.array(i, "skill"), return_counts=True), strict=True):
            for mark in annotations[number][1]:
                counts[mark] = counts.get(mark, 0) + int(count)
    marks = sorted(set(counts) - {GAVE_UP, AGAIN})
    return {mark: counts[mark] / int(store.lengths().sum()) for mark in marks}


def _skills(skill_attempts: Sequence[SkillAttempt], fps: float) -> dict[str, Any]:
    named = sorted({attempt.skill for attempt in skill_attempts if attempt.skill})
    skills = {}
    for name in named:
        own = [attempt for attempt in skill_attempts if attempt.skill == name]
        whole = np.array([attempt.end - attempt.begin for attempt in own if not attempt.truncated]) / fps
        marks = {mark: sum(mark in attempt.marks for attempt in own) for mark in ("open_loop", "pause", *MISHAPS)}
        skills[name] = {**_outcomes(own), "seconds": _quantiles(whole), "marks": marks}
    return dict(sorted(skills.items(), key=lambda item: -item[1]["count"]))


def _actions(store: Store) -> dict[str, Any]:
    """For each dimension: executed actions and labels, and the standard deviation of their difference.

    label_distance: quantiles of the largest difference between an action and its label over all dimensions.
    """
    executed = np.concatenate([store.array(i, "action") for i in range(len(store))])
    label = np.concatenate([store.array(i, "expert_action") for i in range(len(store))])
    bounds = store.spec.quantities.action_bounds or (None,) * executed.shape[1]
    edges = [_edges(np.stack([executed[:, k], label[:, k]]), pair) for k, pair in enumerate(bounds)]
    distance = np.abs(executed - label).max(axis=1)
    return {
        "label_distance": _quantiles(distance),
        "dimensions": {
            name: {
                "edges": [float(edges[k][0]), float(edges[k][-1])],
                "executed": np.histogram(executed[:, k], edges[k])[0].tolist(),
                "label": np.histogram(label[:, k], edges[k])[0].tolist(),
                "noise": float((executed[:, k] - label[:, k]).std()),
            }
            for k, name in enumerate(store.spec.action_names)
        },
    }


def _edges(values: Array, bounds: tuple[float, float] | None) -> Array:
    """(BINS + 1,) from bound to bound, and as far beyond as the values reach."""
    low, high = float(values.min()), float(values.max())
    if bounds is not None:
        low, high = min(low, bounds[0]), max(high, bounds[1])
    return np.linspace(low, high if high > low else low + 1e-3, BINS + 1)


def _columns(store: Store, key: str, names: Sequence[str], wanted: Sequence[str]) -> NDArray[np.float64]:
    """(all observations, n) float64."""
    columns = [list(names).index(name) for name in wanted]
    return np.concatenate([store.array(i, key)[:, columns] for i in range(len(store))]).astype(np.float64)


def _histogram(values: Array) -> dict[str, Any]:
    if not len(values):
        return {"edges": [0.0, 1.0], "counts": [0] * BINS}
    low, high = float(values.min()), float(values.max())
    counts, edges = np.histogram(values, BINS, (low, high if high > low else low + 1e-3))
    return {"edges": [float(edges[0]), float(edges[-1])], "counts": counts.tolist()}


def _quantiles(values: Array) -> Mapping[str, float | None]:
    """Quartiles, minimum and maximum; None without values."""
    names = ("low", "lower", "median", "upper", "high")
    if not len(values):
        return dict.fromkeys(names)
    return dict(zip(names, np.percentile(values, [0, 25, 50, 75, 100]).tolist(), strict=True))
