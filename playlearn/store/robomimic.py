"""Import of robomimic's HDF5 (Mandlekar et al., 2021, arXiv:2108.03298): low-dimensional or with images.

A demonstration has T actions and the T observations before them; what the last action led to is not there, so an
episode has its first T - 1 actions. Numbers keep robomimic's names: `robot0_eef_pos.x`, `object.3`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.config import nearest, to_dict
from playlearn.episode import Array, Episode, EpisodeMeta
from playlearn.errors import StoreError, UsageError
from playlearn.store.base import StoreSpec
from playlearn.store.hdf5 import Demonstrations, chosen, dataset, demonstrations, described, masks, opened

FPS = 20.0  # robosuite's own, where a file does not say
ACTIONS = ("dx", "dy", "dz", "droll", "dpitch", "dyaw", "gripper")  # robosuite's OSC_POSE
_BODY = ("eef_pos", "eef_quat", "gripper_qpos")
_PARTS = {"pos": ("x", "y", "z"), "quat": ("qx", "qy", "qz", "qw")}
IMAGE, WON = "_image", "success"  # how a camera's key ends, and how an episode that was rewarded does


@dataclass(frozen=True)
class RobomimicConfig:
    """state, achieved: keys of `obs` that tell of the robot, and of what goals speak (null: see `_keys`).

    cameras: names without their `_image` (null: all). mask: import only what is under this one. heldout: the mask
    that training holds out; where it names none of the imported, or all, they are held out by their numbers as any
    play is. fps: control steps a second (null: as the file says, else 20).
    """

    state: tuple[str, ...] | None = None
    achieved: tuple[str, ...] | None = None
    cameras: tuple[str, ...] | None = None
    mask: str | None = None
    val_mask: str = "valid"
    fps: float | None = None


class RobomimicFile(Demonstrations):
    """`Recordings` of one file; it is open only while it is read."""

    def __init__(self, path: Path, config: RobomimicConfig | None = None) -> None:
        """Looks at every demonstration's shapes, and reads none.

        Raises:
            StoreError: it is no such file, or nothing in it can be told from anything else.
            UsageError: a key, camera or mask that was asked for is not there.
        """
        self._path, config = path, config or RobomimicConfig()
        with opened(path) as file:
            names = demonstrations(file, path)
            self.splits: Mapping[str, Sequence[int]] = masks(file, path, names)
            wanted = chosen(config.mask, self.splits, path)
            self._names = {number: name for number, name in names.items() if wanted is None or number in wanted}
            out = self._names.keys() & set(self.splits.get(config.val_mask, ()))
            self._out = out if out != self._names.keys() else set()
            arguments = described(file["data"], "env_args")
            first = file["data"][next(iter(self._names.values()))]
            self._state, self._achieved, self._cameras = _keys(first, path, config)
            self._layout = {key: dataset(first, key).shape[1:] for key in self._all()}
            kwargs = arguments.get("env_kwargs") or {}
            name = str(arguments.get("env_name", "unknown"))
            self._problems = {number: words for number in self._names if (words := self._wrong(file, number))}
        fps = float(config.fps or kwargs.get("control_freq") or FPS)
        actions = int(self._layout["actions"][0])
        self.spec = StoreSpec(
            environment={"type": f"robomimic:{name}", "env_args": arguments},
            state_names=self._parts(self._state),
            achieved_names=self._parts(self._achieved),
            action_names=ACTIONS if actions == len(ACTIONS) else tuple(f"action.{k}" for k in range(actions)),
            fps=fps,
            cameras={camera: self._layout[key][:2] for camera, key in self._cameras.items()},
        )
        self.note = {"format": "robomimic", "source": path.name, "bytes": path.stat().st_size} | to_dict(config)

    def _all(self) -> list[str]:
        return ["actions", *(f"obs/{key}" for key in (*self._state, *self._achieved)), *self._cameras.values()]

    def _wrong(self, file: Any, number: int) -> str | None:
        """Why a demonstration does not fit the first one, None where it does."""
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

    def _episode(self, group: Any, number: int, name: str) -> Episode:
        steps = dataset(group, "actions").shape[0] - 1

        def together(keys: Sequence[str]) -> Array:
            columns = [np.asarray(dataset(group, f"obs/{key}"), np.float32).reshape(steps + 1, -1) for key in keys]
            return np.concatenate([np.zeros((steps + 1, 0), np.float32), *columns], axis=1)

        action = np.asarray(dataset(group, "actions")[:steps], np.float32)
        states = np.asarray(dataset(group, "states"), np.float64) if "states" in group else np.zeros((steps + 1, 0))
        won = "rewards" in group and bool((plain := np.asarray(dataset(group, "rewards"))).size and plain.max() > 0)
        meta = EpisodeMeta(
            environment=self.spec.environment,
            state_names=self.spec.state_names,
            achieved_names=self.spec.achieved_names,
            action_names=self.spec.action_names,
            fps=self.spec.fps,
            seed=number,
            actor="demonstrator",
            cameras={camera: {"height": h, "width": w} for camera, (h, w) in self.spec.cameras.items()},
            ended=WON if won else "length",
            split=("val" if number in self._out else "train") if self._out else "",
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


def _keys(group: Any, path: Path, config: RobomimicConfig) -> tuple[tuple[str, ...], tuple[str, ...], dict[str, str]]:
    """Keys of the state, of what is achieved, and camera -> key of its images, as they are in the first demonstration.

    By default the state is each robot's hand and gripper, or all that is named after a robot where those are not
    there; achieved is `object`, or all other vectors where that is not there.
    """
    if "obs" not in group:
        raise StoreError(
            f"{path} has no observations, only states of the simulator: import it with `playlearn import robosuite`, "
            "or let robomimic's dataset_states_to_obs.py observe it first"
        )
    shapes = {key: dataset(group["obs"], key) for key in group["obs"]}
    images = {key.removesuffix(IMAGE): f"obs/{key}" for key, one in shapes.items() if _is_image(one)}
    vectors = [key for key, one in shapes.items() if one.ndim in (1, 2) and np.issubdtype(one.dtype, np.number)]
    robots = [key for key in vectors if key.startswith("robot")]
    hands = [key for key in robots if key.partition("_")[2] in _BODY]
    things = ["object"] if "object" in vectors else [key for key in vectors if key not in robots]
    for what, asked, known in (
        ("state", config.state, vectors),
        ("achieved", config.achieved, vectors),
        ("cameras", config.cameras, list(images)),
    ):
        for key in asked or ():
            if key not in known:
                raise UsageError(f"{what}: {path} has no {key!r} in its observations{nearest(key, known)}")
    cameras = {name: images[name] for name in (config.cameras if config.cameras is not None else images)}
    state = tuple(hands or robots) if config.state is None else config.state
    return state, tuple(things) if config.achieved is None else config.achieved, cameras


def _is_image(one: Any) -> bool:
    return bool(one.ndim == 4 and one.shape[3] == 3 and one.dtype == np.uint8)
