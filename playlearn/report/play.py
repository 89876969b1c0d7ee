"""What is in a store of play, as numbers: where things were, what changed, what went wrong and was mended.

Nothing here knows a world: objects and fixtures are the groups of `achieved_names` (`red.x`, `drawer.opening`), the
hand is the first group of `state_names` that has an x and a y, changes are the settled moments of relabeling.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import Array, read_annotation
from playlearn.errors import UsageError
from playlearn.layout import ObjectLayout
from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.store import Store

CELLS = 28  # of a heat map along its longer side
BINS = 25
STILL = 0.01  # meters a second below which a hand, and its fingers, stand still
EMPTY = 0.004  # meters between fingers that hold nothing
GAVE_UP, AGAIN, MISSED = "gave_up", "again", "missed_grasp"
MISHAPS = ("mistake", "slip", MISSED)


@dataclass(frozen=True)
class SkillAttempt:
    """One skill from its first step to its last: steps [begin, end) of an episode.

    marks: what was said of any of its steps, and `missed_grasp` where the fingers closed on nothing and opened
    again. cut: the episode ended in it, so that its outcome is not known.
    """

    episode: int
    begin: int
    end: int
    skill: str
    marks: frozenset[str]
    cut: bool

    @property
    def failed(self) -> bool:
        return GAVE_UP in self.marks


def attempts(store: Store) -> list[SkillAttempt]:
    """Every attempt of a store. The same skill twice running counts twice where the player said so."""
    found = []
    for i in range(len(store)):
        said = [read_annotation(text) for text in store.meta(i).skills] or [("", ())]
        numbers = store.array(i, "skill")
        own = np.array([[name for name, _ in said].index(name) for name, _ in said])[numbers]
        gave_up, again = (np.array([mark in marks for _, marks in said])[numbers] for mark in (GAVE_UP, AGAIN))
        fresh = np.flatnonzero((own[1:] != own[:-1]) | gave_up[:-1] | again[1:]) + 1
        for begin, end in zip([0, *fresh.tolist()], [*fresh.tolist(), len(own)], strict=True):
            marks = {mark for number in np.unique(numbers[begin:end]) for mark in said[number][1]} - {AGAIN}
            if _missed(store, i, begin, end):
                marks.add(MISSED)
            cut = end == len(own) and GAVE_UP not in marks
            found.append(SkillAttempt(i, begin, end, said[numbers[begin]][0], frozenset(marks), cut))
    return found


def figures(store: Store, settling: SettlingConfig | None = None) -> dict[str, Any]:
    """Everything the report says, as JSON.

    Raises:
        UsageError: the store is empty.
    """
    if not len(store):
        raise UsageError(f"{store.name()} has no episodes yet: there is nothing to report")
    spec = store.spec
    table = RelabelIndex.of_store(store, settling or SettlingConfig())
    tried = attempts(store)
    return {
        "store": store.info(),
        "lengths": _spread(store.lengths() / spec.fps),
        "places": _places(store),
        "values": _values(store),
        "settled": _settled(table),
        "changes": _changes(table),
        "hand": _hand(store),
        "steps": _step_shares(store),
        "skills": _skills(tried, spec.fps),
        "mishaps": {mark: _mended([one for one in tried if mark in one.marks]) for mark in MISHAPS},
        "attempts": _mended(tried),
        "actions": _actions(store),
    }


def hand_names(names: Sequence[str]) -> tuple[str, str, str] | None:
    """The x, y and z of the first group that has all three."""
    for x, y, z in ObjectLayout(names).places().values():
        return names[x], names[y], names[z]
    return None


def _missed(store: Store, i: int, begin: int, end: int) -> bool:
    """Whether fingers closed on nothing and opened again."""
    actions = [k for k, name in enumerate(store.spec.action_names) if name.startswith("grip")]
    widths = [k for k, name in enumerate(store.spec.state_names) if name.endswith("opening")]
    if not actions or not widths:
        return False
    closed = store.array(i, "action")[begin:end, actions[0]] > 0
    empty = store.array(i, "observation.state")[begin:end, widths[0]] < EMPTY
    return bool((closed[:-1] & ~closed[1:] & empty[:-1]).any())


def _mended(tried: Sequence[SkillAttempt]) -> dict[str, Any]:
    """How many attempts, in how many of them the outcome came nevertheless, and in how many it did not."""
    known = [one for one in tried if not one.cut]
    failed = sum(one.failed for one in known)
    return {"count": len(tried), "reached": len(known) - failed, "failed": failed, "cut": len(tried) - len(known)}


def _places(store: Store) -> dict[str, Any]:
    """Heat maps, all over the same ground: counts[row][column] with y upwards and x to the right."""
    names, hand = store.spec.achieved_names, hand_names(store.spec.state_names)
    groups = ObjectLayout(names).having(("x", "y"))
    tracks = {group: _columns(store, "achieved", names, (f"{group}.x", f"{group}.y")) for group in groups}
    if hand is not None:
        tracks["hand"] = _columns(store, "observation.state", store.spec.state_names, hand[:2])
    if not tracks:
        return {}
    low, high = np.percentile(np.concatenate(list(tracks.values())), [0.1, 99.9], axis=0)
    cell = max(float((high - low).max()) / CELLS, 1e-6)
    shape = np.maximum(np.ceil((high - low) / cell - 1e-9).astype(int), 1)
    edges = [low[k] + cell * np.arange(shape[k] + 1) for k in range(2)]
    maps = {name: np.histogram2d(track[:, 0], track[:, 1], edges)[0] for name, track in tracks.items()}
    ground = sum(maps.values()) > 0
    return {
        "x": [float(edges[0][0]), float(edges[0][-1])],
        "y": [float(edges[1][0]), float(edges[1][-1])],
        "cell": cell,
        "maps": {
            name: {"counts": counts.T[::-1].astype(int).tolist(), "covers": float((counts > 0).sum() / ground.sum())}
            for name, counts in maps.items()
        },
    }


def _values(store: Store) -> dict[str, Any]:
    """Histograms of what has no place: an opening, a lamp."""
    names = store.spec.achieved_names
    placed = {f"{name[:-2]}." for name in names if name.endswith(".x")}
    single = [name for name in names if not any(name.startswith(group) for group in placed)]
    return {name: _histogram(_columns(store, "achieved", names, (name,))[:, 0]) for name in single}


def _settled(table: RelabelIndex) -> dict[str, Any]:
    gaps = np.concatenate([_gaps(table, table.settled(i)[0]) for i in range(len(table.lengths))])
    return {
        "moments": len(table.moments),
        "per_minute": 60 * len(table.moments) / float(table.lengths.sum() / table.fps),
        "seconds_between": _spread(gaps),
        "histogram": _histogram(gaps),
    }


def _changes(table: RelabelIndex) -> dict[str, Any]:
    """Of each object and fixture: how often it changed and came to rest, and how long lay between."""
    minutes = float(table.lengths.sum() / table.fps) / 60
    changed, changes = table.changed_groups(), {}
    for column, (group, count) in enumerate(table.change_counts().items()):
        own = [
            table.moments[span][changed[span, column]]
            for span in map(slice, table.offsets[:-1].tolist(), table.offsets[1:].tolist())
        ]
        gaps = np.concatenate([_gaps(table, moments)[1:] for moments in own])
        changes[group] = {"count": count, "per_minute": count / minutes, "seconds_between": _spread(gaps)}
    return changes


def _gaps(table: RelabelIndex, moments: Array) -> Array:
    """Seconds from the beginning to the first moment, then from each to the next."""
    return np.diff(moments, prepend=0) / table.fps


def _hand(store: Store) -> dict[str, Any]:
    """Speed in m/s, and the share of steps in which hand and fingers stood still."""
    names, fps = store.spec.state_names, store.spec.fps
    place = hand_names(names)
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
        "speed": {**_spread(speed), "mean": float(speed.mean()), "histogram": _histogram(speed)},
        "idle": float(np.concatenate(still).mean()),
    }


def _step_shares(store: Store) -> dict[str, float]:
    """Mark of what lasts -> share of all steps that bear it."""
    counts: dict[str, int] = {}
    for i in range(len(store)):
        said = store.meta(i).skills
        for number, count in zip(*np.unique(store.array(i, "skill"), return_counts=True), strict=True):
            for mark in read_annotation(said[number])[1] if said else ():
                counts[mark] = counts.get(mark, 0) + int(count)
    lasting = sorted(set(counts) - {GAVE_UP, AGAIN})
    return {mark: counts[mark] / int(store.lengths().sum()) for mark in lasting}


def _skills(tried: Sequence[SkillAttempt], fps: float) -> dict[str, Any]:
    named = sorted({one.skill for one in tried if one.skill})
    skills = {}
    for name in named:
        own = [one for one in tried if one.skill == name]
        whole = np.array([one.end - one.begin for one in own if not one.cut]) / fps
        marks = {mark: sum(mark in one.marks for one in own) for mark in ("open_loop", "pause", *MISHAPS)}
        skills[name] = {**_mended(own), "seconds": _spread(whole), "marks": marks}
    return dict(sorted(skills.items(), key=lambda item: -item[1]["count"]))


def _actions(store: Store) -> dict[str, Any]:
    """Of each dimension: what was executed and what was meant, and the spread of the difference.

    differ: quartiles of how far a step was from its label, in the dimension in which it was furthest.
    """
    executed = np.concatenate([store.array(i, "action") for i in range(len(store))])
    meant = np.concatenate([store.array(i, "expert_action") for i in range(len(store))])
    edges = np.linspace(-1, 1, BINS + 1)
    strayed = np.abs(executed - meant).max(axis=1)
    return {
        "differ": _spread(strayed),
        "dimensions": {
            name: {
                "edges": [-1.0, 1.0],
                "executed": np.histogram(executed[:, k], edges)[0].tolist(),
                "meant": np.histogram(meant[:, k], edges)[0].tolist(),
                "noise": float((executed[:, k] - meant[:, k]).std()),
            }
            for k, name in enumerate(store.spec.action_names)
        },
    }


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


def _spread(values: Array) -> Mapping[str, float | None]:
    """Quartiles and ends; None where there is nothing."""
    names = ("low", "lower", "median", "upper", "high")
    if not len(values):
        return dict.fromkeys(names)
    return dict(zip(names, np.percentile(values, [0, 25, 50, 75, 100]).tolist(), strict=True))
