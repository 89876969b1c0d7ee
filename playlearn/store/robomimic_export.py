"""A store as robomimic's HDF5 (Mandlekar et al., 2021, arXiv:2108.03298), which its own `SequenceDataset` reads.

    data/demo_7/actions   (T, A)   the labels        obs/robot0_state   (T, S)          proprioception
               /states    (T, N)                     obs/object         (T, G)          achieved: objects and fixtures
               /rewards   (T,)     as recorded       obs/<camera>_image (T, h, w, 3)
               /dones     (T,)     1 at the end      next_obs/...       the same, one step later
                                                     attribute success  whether it succeeded, where that is known
    mask/train, mask/valid                           training and validation split

Without recorded rewards they are 0, and 1 at the end of an episode that succeeded. A demonstration has its episode's
number. `playlearn import robomimic` drops the last action of each recording, as it reads `obs` only. The names of all
dimensions are in `env_args`, which robomimic passes on.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.episode import Array, Episode
from playlearn.errors import StoreError
from playlearn.store.base import Store, plain
from playlearn.store.hdf5_writer import new_hdf5
from playlearn.store.robomimic import ACHIEVED, IMAGE, STATE, RobomimicFile

GYM = 2  # robomimic's type of an environment that it does not build itself


def export_robomimic(
    store: Store,
    out: Path,
    masks: Mapping[str, Sequence[int]],
    progress: Callable[[int], None] = lambda done: None,
) -> None:
    """Write a store to the file `out`: written beside it, checked, then moved there.

    masks: name -> numbers of its episodes (as in `store.indices()`).

    Raises:
        UsageError: h5py is not installed.
        StoreError: `out` is taken, or there is nothing to write.
        BusyError: another process exports to `out`.
        DiskError: the disk is full; nothing is left there.
    """
    if out.exists():
        raise StoreError(f"{out} already exists: remove it, or name another file")
    if not len(store):
        raise StoreError(f"{store.name()} holds no episodes: there is nothing to export")
    short = [int(i) for i, steps in zip(store.indices(), store.lengths(), strict=True) if steps < 2]
    if short:
        raise StoreError(f"{store.name()}: episode {short[0]} has one action only, and a demonstration needs two")
    with new_hdf5(out, lambda path: _check(path, store)) as (file, check_disk):
        data = file.create_group("data")
        data.attrs["total"] = int(store.lengths().sum())
        data.attrs["env_args"] = json.dumps(_environment(store))
        for i, number in enumerate(store.indices().tolist()):
            _write(data.create_group(f"demo_{number}"), store.read(i))
            check_disk()
            progress(i + 1)
        for mask, members in masks.items():
            file[f"mask/{mask}"] = np.array([f"demo_{number}" for number in sorted(members)], dtype="S")


def _environment(store: Store) -> dict[str, Any]:
    """`env_args`; `control_freq` has the place that robosuite gives it and our importer expects."""
    spec = store.spec
    names = {"state": spec.state_names, "achieved": spec.achieved_names, "action": spec.action_names}
    return {
        "env_name": str(spec.environment.get("type", "unknown")),
        "type": GYM,
        "env_kwargs": {"control_freq": spec.fps},
        "playlearn": {
            "environment": plain(spec.environment),
            "names": plain(names),
            "quantities": plain(spec.quantities),
        },
    }


def _write(group: Any, episode: Episode) -> None:
    steps, ends = len(episode), np.arange(1, len(episode) + 1) == len(episode)
    group.attrs["num_samples"] = steps
    group["actions"] = episode.expert_action
    group["states"] = episode.sim_state[:steps]
    group["dones"] = ends.astype(np.int64)
    success, marks = episode.meta.success, (ends & bool(episode.meta.success)).astype(np.float64)
    group["rewards"] = marks if episode.reward is None else episode.reward
    if success is not None:
        group.attrs["success"] = success
    observed = {STATE: episode.state, ACHIEVED: episode.achieved}
    for key, value in observed.items():
        if value.shape[1]:
            _write_observation(group, key, value)
    for camera, frames in episode.images.items():
        # One chunk a frame: robomimic reads single frames in random order.
        _write_observation(
            group, camera + IMAGE, frames, chunks=(1, *frames.shape[1:]), compression="gzip", compression_opts=1
        )


def _write_observation(group: Any, key: str, value: Array, **how: Any) -> None:
    """The observations before and after each action."""
    group.create_dataset(f"obs/{key}", data=value[:-1], **how)
    group.create_dataset(f"next_obs/{key}", data=value[1:], **how)


def _check(path: Path, store: Store) -> None:
    """Raises StoreError if the file does not read back as it was written."""
    made = RobomimicFile(path)
    problems = made.problems()
    if list(made.names()) != sorted(store.indices().tolist()) or problems:
        raise StoreError(f"what was written reads back differently ({problems}): please report this as a bug")
