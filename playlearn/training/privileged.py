"""What privileged information a training run uses, by its config and its play; what a blind run may not start from."""

from collections.abc import Iterator
from pathlib import Path

from playlearn.data import DataConfig
from playlearn.episode import STORED
from playlearn.errors import UsageError
from playlearn.layout import ObjectLayout
from playlearn.privileges import (
    CORRECTIONS,
    EXPERT,
    LABELED_BY_EXPERT,
    LABELS,
    POSES,
    RECORDED_POSES,
    SCENES,
    SKILLS,
    Privileges,
)
from playlearn.store import Store, open_store
from playlearn.training.config import TrainConfig


def check_start(config: TrainConfig) -> None:
    """Raises UsageError where a blind run would start from one that used privileged information, or may have."""
    if not config.blind or config.init_from is None:
        return
    used = Privileges.of_run(config.init_from)
    if used.training or used.relabeling:
        raise UsageError(
            f"blind: init_from is {config.init_from}, whose privileged information is {used}: start from a run that "
            "used none, from none, or set blind to false"
        )


def privileged(config: TrainConfig, store: Store) -> Privileges:
    """What the run uses, with what the runs used that it starts from. store: its own play, as it is opened."""
    used = Privileges(goal=_goal(config, store))
    for source, data in _play(config, store):
        used |= _of_play(config, source, data)
    perceived = None if config.perceived is None else config.perceived.encoder
    for run in (config.init_from, perceived):
        used |= _start(run)
    return used


def _of_play(config: TrainConfig, store: Store, data: DataConfig) -> Privileges:
    encoder = config.policy.encoder
    poses, named = _poses(store), bool(store.spec.achieved_names)
    reads_state = "state" in encoder.goals
    training = {
        poses: named and (reads_state or encoder.supervised or data.target != "actions"),
        LABELS: data.target == "actions" and _has_clean_labels(store),
        EXPERT: any(store.meta(i).actor == LABELED_BY_EXPERT for i in range(len(store))),
        CORRECTIONS: config.corrections is not None,
        SCENES: config.scenes is not None,
    }
    of_objects = data.settling.source == "achieved" and bool(_covered(store, data.goal_names))
    reads_moments = data.goals.reads_moments or data.balance > 0 or data.target != "actions"
    relabeling = {poses: of_objects and reads_moments, SKILLS: data.failure_fraction < 1}
    return Privileges(_those(training), _those(relabeling))


def _play(config: TrainConfig, store: Store) -> Iterator[tuple[Store, DataConfig]]:
    """Every store of the run, and how its examples are cut."""
    yield store, config.data
    for source in config.extra_datasets:
        yield open_store(source.store, blind=config.blind), source.data or config.data


def _goal(config: TrainConfig, store: Store) -> tuple[str, ...]:
    encoder = config.policy.encoder
    return _those({_poses(store): "state" in encoder.goals and bool(_covered(store, encoder.goal_names))})


def _start(run: Path | None) -> Privileges:
    """What a run used before; its goals are not this one's."""
    used = Privileges() if run is None else Privileges.of_run(run)
    return Privileges(used.training, used.relabeling)


def _covered(store: Store, patterns: tuple[str, ...]) -> list[int]:
    return ObjectLayout(store.spec.achieved_names).select(patterns)


def _poses(store: Store) -> str:
    """Where no simulator state is recorded, it is not known whether the poses are a simulator's."""
    return POSES if store.array(0, STORED["sim_state"]).shape[1] else RECORDED_POSES


def _has_clean_labels(store: Store) -> bool:
    label, executed = STORED["expert_action"], STORED["action"]
    return any((store.array(i, label) != store.array(i, executed)).any() for i in range(len(store)))


def _those(asked: dict[str, bool]) -> tuple[str, ...]:
    return tuple(word for word, is_used in asked.items() if is_used)
