"""Import of robomimic's HDF5 (Mandlekar et al., 2021, arXiv:2108.03298): low-dimensional or with images.

A demonstration has T actions and the T observations before them. The observation after the last action is missing, so
an episode has the first T - 1 actions. Dimensions keep robomimic's names: `robot0_eef_pos.x`, `object.3`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.config import nearest
from playlearn.episode import Array, Episode, EpisodeMeta
from playlearn.errors import StoreError, UsageError
from playlearn.quantity import Quantities
from playlearn.store.base import StoreSpec, plain
from playlearn.store.hdf5 import (
    Demonstrations,
    dataset,
    demonstration_names,
    json_attribute,
    mask_members,
    masks,
    open_hdf5,
)
from playlearn.store.robosuite_controller import action_bounds

FPS = 20.0  # robosuite's default, for files that do not state it
ACTIONS = ("dx", "dy", "dz", "droll", "dpitch", "dyaw", "gripper")  # robosuite's OSC_POSE
ROBOSUITE = 1  # robomimic's type of an environment
_PROPRIO = ("eef_pos", "eef_quat", "gripper_qpos")
_PARTS = {"pos": ("x", "y", "z"), "quat": ("qx", "qy", "qz", "qw")}
IMAGE = "_image"  # suffix of a camera's key
SUCCESS = "success"  # how an episode ends that was rewarded


@dataclass(frozen=True)
class RobomimicConfig:
    """How a file of robomimic is imported.

    state: keys of `obs` with the robot's proprioception (null: see `_keys`).
    achieved: keys of `obs` with the objects that goals are about (null: see `_keys`).
    cameras: names without their suffix `_image` (null: all).
    mask: import only the demonstrations of this mask (null: all).
    val_mask: mask of the validation split; if it names none or all of the imported demonstrations, they are split by
        their numbers like any play.
    fps: control steps a second (null: as the file says, else 20).
    """

    state: tuple[str, ...] | None = None
    achieved: tuple[str, ...] | None = None
    cameras: tuple[str, ...] | None = None
    mask: str | None = None
    val_mask: str = "valid"
    fps: float | None = None

    def build(self, path: Path) -> "RobomimicFile":
        return RobomimicFile(path, self.state, self.achieved, self.cameras, self.mask, self.val_mask, self.fps)


class RobomimicFile(Demonstrations):
    """`Recordings` of one file; it is open only while it is read."""

    def __init__(
        self,
        path: Path,
        state: tuple[str, ...] | None = None,
        achieved: tuple[str, ...] | None = None,
        cameras: tuple[str, ...] | None = None,
        mask: str | None = None,
        val_mask: str = "valid",
        fps: float | None = None,
    ) -> None:
        """Checks the shapes of every demonstration, and reads none; arguments as in `RobomimicConfig`.

        Raises:
            StoreError: it is not such a file, or has no observations.
            UsageError: a key, camera or mask is missing in it.
        """
        self._path = path
        with open_hdf5(path) as file:
            names = demonstration_names(file, path)
            self.splits: Mapping[str, Sequence[int]] = masks(file, path, names)
            wanted = mask_members(mask, self.splits, path)
            self._names = {number: name for number, name in names.items() if wanted is None or number in wanted}
            val = self._names.keys() & set(self.splits.get(val_mask, ()))
            self._val = val if val != self._names.keys() else set()
            arguments = json_attribute(file["data"], "env_args")
            first = file["data"][next(iter(self._names.values()))]
            self._state, self._achieved, self._cameras = _keys(first, path, state, achieved, cameras)
            self._layout = {key: dataset(first, key).shape[1:] for key in self._all()}
            kwargs = arguments.get("env_kwargs") or {}
            name = str(arguments.get("env_name", "unknown"))
            self._problems = {number: problem for number in self._names if (problem := self._problem(file, number))}
        actions = int(self._layout["actions"][0])
        self.spec = StoreSpec(
            environment={"type": f"robomimic:{name}", "env_args": arguments},
            state_names=self._parts(self._state),
            achieved_names=self._parts(self._achieved),
            action_names=ACTIONS if actions == len(ACTIONS) else tuple(f"action.{k}" for k in range(actions)),
            fps=float(fps or kwargs.get("control_freq") or FPS),
            cameras={camera: self._layout[key][:2] for camera, key in self._cameras.items()},
            quantities=self._quantities(arguments, actions),
        )
        settings = {"state": state, "achieved": achieved, "cameras": cameras, "mask": mask, "val_mask": val_mask}
        note = {"format": "robomimic", "source": path.name, "bytes": path.stat().st_size, **settings, "fps": fps}
        self.note = plain(note)

    def _all(self) -> list[str]:
        return ["actions", *(f"obs/{key}" for key in (*self._state, *self._achieved)), *self._cameras.values()]

    def _problem(self, file: Any, number: int) -> str | None:
        """Why a demonstration does not match the first one; None if it does."""
        group, name = file["data"][self._names[number]], f"{self._path}: {self._names[number]}"
        try:
            found = {key: dataset(group, key) for key in self._all()}
        except StoreError as error:
            return str(error)
        rows = found["actions"].shape[0] if found["actions"].ndim == 2 else 0
        if rows < 2:
            return f"{name} has {rows} actions, and an episode needs two or more"
        for key, one in found.items():
            if one.shape != (rows, *self._layout[key]):
                return f"{name}: {key} has shape {one.shape}, not {(rows, *self._layout[key])}"
            if not np.issubdtype(one.dtype, np.number):
                return f"{name}: {key} is of {one.dtype}, not of numbers"
        return None

    def _parts(self, keys: Sequence[str]) -> tuple[str, ...]:
        names: list[str] = []
        for key in keys:
            width = int(np.prod(self._layout[f"obs/{key}"], dtype=int))
            parts = _PARTS.get(key.rpartition("_")[2], ())
            names += [f"{key}.{part}" for part in (parts if len(parts) == width else range(width))]
        return tuple(names)

    def _quantities(self, arguments: Mapping[str, Any], actions: int) -> Quantities:
        """What robosuite's own keys and controllers say, or `export robomimic` wrote; nothing is known of others."""
        written = (arguments.get("playlearn") or {}).get("quantities")
        if written is not None:
            own = Quantities.from_dict(written)
            of = ((own.state, self._state), (own.achieved, self._achieved))  # other keys may have been asked for
            state, achieved = (given if len(given) == len(self._parts(keys)) else () for given, keys in of)
            return Quantities(state, achieved, own.action_bounds)
        if arguments.get("type") != ROBOSUITE:
            return Quantities()
        state, achieved = (tuple(map(_quantity, self._parts(keys))) for keys in (self._state, self._achieved))
        return Quantities(state, achieved, action_bounds(arguments.get("env_kwargs") or {}, actions))

    def _episode(self, group: Any, number: int, name: str) -> Episode:
        steps = dataset(group, "actions").shape[0] - 1

        def together(keys: Sequence[str]) -> Array:
            columns = [np.asarray(dataset(group, f"obs/{key}"), np.float32).reshape(steps + 1, -1) for key in keys]
            return np.concatenate([np.zeros((steps + 1, 0), np.float32), *columns], axis=1)

        action = np.asarray(dataset(group, "actions")[:steps], np.float32)
        states = np.asarray(dataset(group, "states"), np.float64) if "states" in group else np.zeros((steps + 1, 0))
        success = "rewards" in group and bool((plain := np.asarray(dataset(group, "rewards"))).size and plain.max() > 0)
        meta = EpisodeMeta(
            environment=self.spec.environment,
            state_names=self.spec.state_names,
            achieved_names=self.spec.achieved_names,
            action_names=self.spec.action_names,
            fps=self.spec.fps,
            seed=number,
            actor="demonstrator",
            quantities=self.spec.quantities,
            cameras={camera: {"height": h, "width": w} for camera, (h, w) in self.spec.cameras.items()},
            ended=SUCCESS if success else "length",
            split=("val" if number in self._val else "train") if self._val else "",
        )
        return Episode(
            meta=meta,
            state=together(self._state),
            achieved=together(self._achieved),
            sim_state=states,
            time=np.arange(steps + 1) / self.spec.fps,
            action=action,
            expert_action=action.copy(),
            intervention=np.zeros(steps, np.bool_),
            skill=np.zeros(steps, np.int16),
            images={camera: np.asarray(dataset(group, key)) for camera, key in self._cameras.items()},
        )


def _quantity(name: str) -> str:
    """What `robot0_eef_pos.x` or `robot0_eef_quat.qw` measures; "" of what robosuite's names do not tell."""
    key, _, part = name.rpartition(".")
    if key.endswith("_pos") and part in _PARTS["pos"]:
        return f"length {part}"
    return f"quaternion {key}" if part in _PARTS["quat"] else ""


def _keys(
    group: Any,
    path: Path,
    state: tuple[str, ...] | None,
    achieved: tuple[str, ...] | None,
    cameras: tuple[str, ...] | None,
) -> tuple[tuple[str, ...], tuple[str, ...], dict[str, str]]:
    """Keys of the state, keys of the achieved goal, and camera -> key of its images, read from one demonstration.

    Default state: each robot's end effector and gripper, or every key named after a robot if those are missing.
    Default achieved goal: `object`, or all other vectors if it is missing.
    """
    if "obs" not in group:
        raise StoreError(
            f"{path} has no observations, only simulator states: import it with `playlearn import robosuite`, "
            "or let robomimic's dataset_states_to_obs.py observe it first"
        )
    shapes = {key: dataset(group["obs"], key) for key in group["obs"]}
    images = {key.removesuffix(IMAGE): f"obs/{key}" for key, one in shapes.items() if _is_image(one)}
    vectors = [key for key, one in shapes.items() if one.ndim in (1, 2) and np.issubdtype(one.dtype, np.number)]
    robots = [key for key in vectors if key.startswith("robot")]
    proprio = [key for key in robots if key.partition("_")[2] in _PROPRIO]
    objects = ["object"] if "object" in vectors else [key for key in vectors if key not in robots]
    for what, wanted, known in (
        ("state", state, vectors),
        ("achieved", achieved, vectors),
        ("cameras", cameras, list(images)),
    ):
        for key in wanted or ():
            if key not in known:
                raise UsageError(f"{what}: {path} has no {key!r} in its observations{nearest(key, known)}")
    state = tuple(proprio or robots) if state is None else state
    achieved = tuple(objects) if achieved is None else achieved
    return state, achieved, {name: images[name] for name in (images if cameras is None else cameras)}


def _is_image(one: Any) -> bool:
    return bool(one.ndim == 4 and one.shape[3] == 3 and one.dtype == np.uint8)
