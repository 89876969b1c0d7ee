"""A store as robomimic's HDF5 (Mandlekar et al., 2021, arXiv:2108.03298), which its own `SequenceDataset` reads.

    data/demo_7/actions      (T, A)   the labels     obs/robot0_state   (T, S)          proprioception
               /states       (T, N)                  obs/object         (T, G)          achieved: objects and fixtures
               /next_states  (T, N)                  obs/<camera>_image (T, h, w, 3)
               /rewards      (T,)     as recorded    next_obs/...       the same, one step later
               /dones        (T,)     1 at the end   attribute success  whether it succeeded, where that is known
    mask/train, mask/valid                           training and validation split

Without recorded rewards they are 0, and 1 at the end of an episode that succeeded. A demonstration has its episode's
number. States are there where the play has them; `next_states`, which only `playlearn import robomimic` reads, are the
same, one step later. What was imported without `next_obs` is written without it: each demonstration has its last action
and reward back (`EpisodeMeta.unobserved_step`), and `obs` has all observations. The names of all dimensions are in
`env_args`, which robomimic passes on.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.episode import Episode
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
    with new_hdf5(out, lambda path: _check(path, store)) as (file, check_disk):
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps(_environment(store))
        total = 0
        for i, number in enumerate(store.indices().tolist()):
            total += _write(data.create_group(f"demo_{number}"), store.read(i))
            check_disk()
            progress(i + 1)
        data.attrs["total"] = total
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


def _write(group: Any, episode: Episode) -> int:
    """Write one demonstration; returns the number of its actions."""
    after = episode.meta.unobserved_step
    actions = [*episode.expert_action, *([np.array(after["action"], np.float32)] if after else [])]
    ends = np.arange(1, len(actions) + 1) == len(actions)
    group.attrs["num_samples"] = len(actions)
    group["actions"] = np.stack(actions)
    group["dones"] = ends.astype(np.int64)
    success, marks = episode.meta.success, (ends & bool(episode.meta.success)).astype(np.float64)
    group["rewards"] = marks if episode.reward is None else np.append(episode.reward, after.get("reward", []))
    if success is not None:
        group.attrs["success"] = success
    moments = {f"obs/{STATE}": episode.state, f"obs/{ACHIEVED}": episode.achieved, "states": episode.sim_state}
    moments |= {f"obs/{camera}{IMAGE}": frames for camera, frames in episode.images.items()}
    for key, value in moments.items():
        if not value.shape[1]:
            continue
        # One chunk a frame: robomimic reads single frames in random order.
        frame = {"chunks": (1, *value.shape[1:]), "compression": "gzip", "compression_opts": 1}
        how = frame if value.dtype == np.uint8 else {}
        group.create_dataset(key, data=value[: len(actions)], **how)
        if not after:
            group.create_dataset(f"next_{key}", data=value[1:], **how)
    return len(actions)


def _check(path: Path, store: Store) -> None:
    """Raises StoreError if the file does not read back as it was written."""
    made = RobomimicFile(path)
    problems = made.problems()
    if list(made.names()) != sorted(store.indices().tolist()) or problems:
        raise StoreError(f"what was written reads back differently ({problems}): please report this as a bug")
