"""Recorded play: stores, training examples, collecting, exporting."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from playlearn.api.configs import NO_OVERRIDES, Overrides, Where, as_arguments, resolve

if TYPE_CHECKING:
    from playlearn.collection import CollectConfig
    from playlearn.data import DataConfig, PlayDataset
    from playlearn.store import Store, StoreConfig


def open_store(where: "Where | StoreConfig", *, blind: bool = False) -> "Store":
    """The store in a folder, of whatever kind (native, LeRobot); raises StoreError where there is none.

    blind: as a robot would have recorded it, without object poses, simulator states, skills and clean labels.
    """
    from playlearn.store import open_store as run

    return run(where, blind=blind)


def make_dataset(
    store: "Where | Store",
    config: "DataConfig | None" = None,
    *,
    split: Literal["train", "val"] = "train",
    seed: int = 0,
    overrides: Overrides = NO_OVERRIDES,
) -> "PlayDataset":
    """Goal-conditioned training examples cut from a store; `batch(epoch, indices)` gives them as tensors.

    overrides: fields of DataConfig: `{"history": 2, "chunk": 8, "goals.ahead": 2}`.

    Raises:
        UsageError: an unknown field, or a camera that the store lacks.
        StoreError: there is no store, or nothing in it to learn from.
    """
    from playlearn.config import load_config, to_dict
    from playlearn.data import DataConfig
    from playlearn.store import open_store as opened

    if overrides:
        before = {} if config is None else to_dict(config)
        config = load_config(DataConfig, None, [*as_arguments(before), *as_arguments(overrides)])
    play = opened(store) if isinstance(store, Path | str) else store
    return (config or DataConfig()).build(play, split, seed)


def collect(
    config: "Where | CollectConfig",
    out: Where,
    *,
    overrides: Overrides = NO_OVERRIDES,
    workers: int | None = None,
    resume: bool = False,
) -> "Store":
    """Record play into a store at `out`, as `playlearn collect` does, and open it.

    workers: processes (None: one a core; 0: this one only). resume: go on with a store that is there.

    Raises:
        UsageError: the config is wrong, or `out` was collected with another one.
        StoreError: `out` is taken and `resume` was not asked for.
        DiskError: the disk is full.
        PlaylearnError: episodes failed; the others are kept.
    """
    from playlearn.collection import collect as run

    run(resolve("collect", config, overrides), Path(out), workers=workers, resume=resume)
    return open_store(out)


def export_lerobot(
    store: "Where | Store",
    out: Where,
    *,
    goals: str | None = None,
    videos: Literal["av1", "h264"] | None = None,
    subtasks: bool = False,
) -> None:
    """Write a store as a LeRobot v3.0 dataset, with its card.

    goals: relabel with this goal sampler ("settled", "final" ...): each window an episode that carries its goal.
    videos: encode the cameras as video instead of images. subtasks: skills as LeRobot's subtask annotation.

    Raises:
        UsageError: `out` is taken, or the sampler is unknown.
        StoreError: the store is missing or broken; it cannot be written.
    """
    from playlearn.config import load_config
    from playlearn.lerobot.goals import RelabelConfig
    from playlearn.lerobot.share import contents, share
    from playlearn.store import open_store as opened

    relabel = None if goals is None else load_config(RelabelConfig, None, [f"--goals.type={json.dumps(goals)}"])
    play = opened(store) if isinstance(store, Path | str) else store
    share(contents(play, relabel, subtasks=subtasks), Path(out), videos)
