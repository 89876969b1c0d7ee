"""Import of robomimic's HDF5 (Mandlekar et al., 2021, arXiv:2108.03298): low-dimensional or with images.

An episode has all T actions of a demonstration where `next_obs` tells what was observed after the last one, else T - 1
(see `robomimic_demonstration`). Dimensions keep robomimic's names (`robot0_eef_pos.x`), but for the objects of
robosuite's own tasks (`cube.x`, see `robosuite_objects`); what depends on the hand is left out of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.episode import Episode, EpisodeMeta
from playlearn.errors import StoreError
from playlearn.quantity import Quantities, subset
from playlearn.store.base import StoreSpec, plain
from playlearn.store.hdf5 import (
    Demonstrations,
    beyond_mask,
    dataset,
    demonstration,
    demonstration_names,
    frequency,
    grouped,
    json_attribute,
    mask_members,
    masks,
    open_hdf5,
    unread,
)
from playlearn.store.object_dimensions import ObjectDimensions, choose_dimensions, own_dimensions
from playlearn.store.robomimic_demonstration import RobomimicDemonstration
from playlearn.store.robomimic_keys import ACHIEVED, IMAGE, choose_keys
from playlearn.store.robosuite_controller import action_bounds
from playlearn.store.robosuite_objects import known_order
from playlearn.store.success import SuccessRule, follow_convention, how_ended

__all__ = ["ACHIEVED", "IMAGE", "STATE", "RobomimicConfig", "RobomimicFile"]

FPS = 20.0  # robosuite's default, for files that do not state it
ACTIONS = ("dx", "dy", "dz", "droll", "dpitch", "dyaw", "gripper")  # robosuite's OSC_POSE
STATE = "robot0_state"  # what `robomimic_export` calls the robot's
ROBOSUITE = 1  # robomimic's type of an environment
SPARSE = (1, 3)  # robomimic's types of environments (robosuite, iGibson) that have its convention of rewards
_PARTS = {"pos": ("x", "y", "z"), "quat": ("qx", "qy", "qz", "qw")}
_READ = ("actions", "states", "next_states", "rewards", "dones", "obs", "next_obs")
_LOOKED_AT = 5  # demonstrations in which the order of the objects' numbers is looked for


@dataclass(frozen=True)
class RobomimicConfig:
    """How a file of robomimic is imported.

    state: keys of `obs` with the robot's proprioception (null: see `choose_keys`).
    achieved: keys of `obs` with the objects that goals are about (null: see `choose_keys`).
    goal_names: shell-style patterns of their dimensions that goals are about, such as `cube.*` (null: all that do not
        depend on the hand).
    success: which demonstrations succeeded, a rule such as `all`, `none`, `dones`, `reward>=1` or `last_reward>=0`
        (null: as robomimic's 0 and 1 say, else unknown).
    cameras: names without their suffix `_image` (null: all).
    mask: import only the demonstrations of this mask (null: all).
    val_mask: mask of the validation split; if it names none or all of the imported demonstrations, they are split by
        their numbers like any play.
    fps: control steps a second (null: as the file says, else 20).
    """

    state: tuple[str, ...] | None = None
    achieved: tuple[str, ...] | None = None
    goal_names: tuple[str, ...] | None = None
    success: str | None = None
    cameras: tuple[str, ...] | None = None
    mask: str | None = None
    val_mask: str = "valid"
    fps: float | None = None

    def build(self, path: Path) -> "RobomimicFile":
        return RobomimicFile(path, **{name: getattr(self, name) for name in self.__dataclass_fields__})


class RobomimicFile(Demonstrations):
    """`Recordings` of one file; it is open only while it is read."""

    def __init__(
        self,
        path: Path,
        *,
        state: tuple[str, ...] | None = None,
        achieved: tuple[str, ...] | None = None,
        goal_names: tuple[str, ...] | None = None,
        success: str | None = None,
        cameras: tuple[str, ...] | None = None,
        mask: str | None = None,
        val_mask: str = "valid",
        fps: float | None = None,
    ) -> None:
        """Checks the shapes of every demonstration, and reads what tells objects and success; see `RobomimicConfig`.

        Raises:
            StoreError: it is not such a file, or has no observations.
            UsageError: a key, camera or mask is missing in it, or goals have nothing to be about.
        """
        self._path, rule = path, None if success is None else SuccessRule(success)
        with open_hdf5(path) as file:
            names = demonstration_names(file, path)
            self.splits: Mapping[str, Sequence[int]] = masks(file, path, names)
            wanted = mask_members(mask, self.splits, path)
            self._names = {number: name for number, name in names.items() if wanted is None or number in wanted}
            val = self._names.keys() & set(self.splits.get(val_mask, ()))
            self._val = val if val != self._names.keys() else set()
            arguments = json_attribute(file["data"], "env_args")
            first = self._first(file)
            self._keys = choose_keys(first["obs"], path, state, achieved, cameras)
            read = ["actions", *(f"obs/{key}" for key in self._keys.everything())]
            self._layout = {key: dataset(first, key).shape[1:] for key in read}
            self._problems = {number: problem for number in self._names if (problem := self._problem(file, number))}
            sound = [self._demonstration(file["data"], n) for n in self._names if n not in self._problems]
            if not sound:
                raise StoreError("\n".join(self._problems.values()))
            self._objects = self._dimensions(sound, arguments, goal_names)
            sparse = _is_sparse(sound, arguments)
            self._success = {demo.group.name: self._succeeded(demo, rule, sparse) for demo in sound}
            rest = beyond_mask(mask, len(self._names), len(names)) | unread(file, names, _READ)
            rest |= self._not_everywhere(sound)
            for demo in sound:
                rest |= demo.remarks()
        recorded = _own_names(arguments)
        self.spec = StoreSpec(
            environment={"type": f"robomimic:{arguments.get('env_name', 'unknown')}", "env_args": arguments},
            state_names=_fitting(recorded.get("state"), self._parts(self._keys.state)),
            achieved_names=self._objects.goals(),
            action_names=_fitting(recorded.get("action"), action_names(int(self._layout["actions"][0]))),
            fps=frequency(fps, _kwargs(arguments).get("control_freq"), path, FPS),
            cameras={camera: self._layout[f"obs/{key}"][:2] for camera, key in self._keys.cameras.items()},
            quantities=self._quantities(arguments),
        )
        seen = {f"obs/{key}": why for key, why in self._keys.remarks.items()}
        self.remarks = grouped({**seen, **rest, **self._objects.remarks})
        keys = {"state": state, "achieved": achieved, "goal_names": goal_names, "cameras": cameras}
        settings = {**keys, "mask": mask, "val_mask": val_mask, "fps": fps, "success": success}
        self.note = plain({"format": "robomimic", "source": path.name, "bytes": path.stat().st_size, **settings})

    def _first(self, file: Any) -> Any:
        """The first demonstration that has observations, which the others must match."""
        import h5py

        for name in self._names.values():
            try:
                group = demonstration(file["data"], name)
            except StoreError:
                continue
            if isinstance(group.get("obs"), h5py.Group) and "actions" in group and dataset(group, "actions").ndim == 2:
                return group
        raise StoreError(
            f"{self._path} has no observations, only simulator states: import it with `playlearn import robosuite`, "
            "or let robomimic's dataset_states_to_obs.py observe it first"
        )

    def _demonstration(self, data: Any, number: int) -> RobomimicDemonstration:
        return RobomimicDemonstration(demonstration(data, self._names[number]), self._keys.everything())

    def _problem(self, file: Any, number: int) -> str | None:
        """Why a demonstration does not match the first one; None if it does."""
        try:
            problem = self._demonstration(file["data"], number).problem(self._layout)
        except StoreError as error:
            return str(error)
        return problem and f"{self._path}: {self._names[number]}: {problem}"

    def _not_everywhere(self, demos: Sequence[RobomimicDemonstration]) -> dict[str, str]:
        """Observations that only some demonstrations have, the first one not among them."""
        known = {*self._keys.everything(), *self._keys.remarks}
        return {
            f"obs/{key}": "left out: not every demonstration has it"
            for demo in demos
            for key in demo.group["obs"]
            if key not in known
        }

    def _dimensions(
        self,
        demos: Sequence[RobomimicDemonstration],
        arguments: Mapping[str, Any],
        goal_names: tuple[str, ...] | None,
    ) -> ObjectDimensions:
        """What each number about objects is called, and whether goals are about it."""
        names, keys = self._parts(self._keys.achieved), self._keys
        recorded = _own_names(arguments).get("achieved", ())
        if keys.achieved == (ACHIEVED,) and len(recorded) == len(names):
            return own_dimensions(recorded, goal_names)
        order = None
        if keys.achieved == (ACHIEVED,):
            looked = demos[:: max(1, len(demos) // _LOOKED_AT)]
            hands = [np.concatenate([demo.vectors([key]) for demo in looked]) for key in keys.hands()]
            order = known_order(
                str(arguments.get("env_name", "")),
                str(arguments.get("env_version") or ""),
                [demo.vectors(keys.achieved) for demo in looked],
                [demo.vectors(keys.state) for demo in looked],
                [hand for hand in hands if hand.shape[1] == 3],
            )
        return choose_dimensions(
            order,
            names,
            lambda: [(demo.vectors(keys.achieved), demo.vectors(keys.state)) for demo in demos],
            goal_names,
            self._path,
            "--achieved '[]'",
        )

    def _succeeded(self, demo: RobomimicDemonstration, rule: SuccessRule | None, sparse: bool) -> bool | None:
        """Whether a demonstration succeeded; None where that is not known."""
        own, stated = demo.signals, demo.group.attrs.get("success")
        if rule is not None:
            return rule(own, f"{self._path}: {demo.group.name}")
        if isinstance(stated, np.bool_):  # as `robomimic_export` writes it
            return bool(stated)
        return bool(own.rewards.any()) if sparse and own.rewards is not None else None

    def _parts(self, keys: Sequence[str]) -> tuple[str, ...]:
        names: list[str] = []
        for key in keys:
            width = int(np.prod(self._layout[f"obs/{key}"], dtype=int))
            parts = _PARTS.get(key.rpartition("_")[2], ())
            names += [f"{key}.{part}" for part in (parts if len(parts) == width else range(width))]
        return tuple(names)

    def _quantities(self, arguments: Mapping[str, Any]) -> Quantities:
        """What robosuite's own keys and controllers say, or `export robomimic` wrote; nothing is known of others."""
        names, actions = (self._parts(self._keys.state), self._objects.names), int(self._layout["actions"][0])
        written = (arguments.get("playlearn") or {}).get("quantities")
        if written is not None:
            own = Quantities.from_dict(written)
            # Other keys than the exported ones may have been asked for.
            given = (
                one if len(one) == len(of) else () for one, of in zip((own.state, own.achieved), names, strict=True)
            )
            bounds = own.action_bounds
        elif arguments.get("type") == ROBOSUITE:
            given = (tuple(map(_quantity, of)) for of in names)
            bounds = action_bounds(_kwargs(arguments), actions)
        else:
            return Quantities()
        state, achieved = given
        return Quantities(state, subset(achieved, self._objects.kept), bounds)

    def _episode(self, group: Any, number: int, name: str) -> Episode:
        demo, success = RobomimicDemonstration(group, self._keys.everything()), self._success[group.name]
        action = demo.actions()
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
            ended=how_ended(success),
            split=("val" if number in self._val else "train") if self._val else "",
            success=success,
            unobserved_step=demo.unobserved_step(),
        )
        return Episode(
            meta=meta,
            state=demo.vectors(self._keys.state),
            achieved=demo.vectors(self._keys.achieved)[:, list(self._objects.kept)],
            sim_state=demo.states(),
            time=np.arange(len(action) + 1) / self.spec.fps,
            action=action,
            expert_action=action.copy(),
            intervention=np.zeros(len(action), np.bool_),
            skill=np.zeros(len(action), np.int16),
            images={camera: demo.moments(f"obs/{key}") for camera, key in self._keys.cameras.items()},
            reward=demo.rewards(),
        )


def _quantity(name: str) -> str:
    """What `robot0_eef_pos.x`, `robot0_eef_quat.qw` or `cube.x` measures; "" of what robosuite's names do not tell."""
    owner, _, part = name.rpartition(".")
    if part in _PARTS["pos"]:
        return f"length {part}"
    return f"quaternion {owner}" if part in _PARTS["quat"] else ""


def _is_sparse(demos: Sequence[RobomimicDemonstration], arguments: Mapping[str, Any]) -> bool:
    """Whether rewards are robomimic's marks of success."""
    rewards = [own for demo in demos if (own := demo.signals.rewards) is not None]
    shaped = bool(_kwargs(arguments).get("reward_shaping"))
    return arguments.get("type") in SPARSE and not shaped and follow_convention(rewards)


def _kwargs(arguments: Mapping[str, Any]) -> Mapping[str, Any]:
    found = arguments.get("env_kwargs")
    return found if isinstance(found, Mapping) else {}


def _own_names(arguments: Mapping[str, Any]) -> Mapping[str, tuple[str, ...]]:
    """State, achieved, action -> the names that `robomimic_export` wrote; {} for a file of somebody else."""
    own = arguments.get("playlearn")
    names = own.get("names") if isinstance(own, Mapping) else None
    found = names if isinstance(names, Mapping) else {}
    return {part: tuple(map(str, listed)) for part, listed in found.items() if isinstance(listed, list)}


def _fitting(recorded: tuple[str, ...] | None, otherwise: tuple[str, ...]) -> tuple[str, ...]:
    return recorded if recorded is not None and len(recorded) == len(otherwise) else otherwise


def action_names(width: int) -> tuple[str, ...]:
    """Those of robosuite's default controller, or numbers."""
    return ACTIONS if width == len(ACTIONS) else tuple(f"action.{k}" for k in range(width))
