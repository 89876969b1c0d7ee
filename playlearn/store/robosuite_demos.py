"""Import of robosuite's raw demonstrations (`collect_human_demonstrations`): simulator states and actions, no more.

Observations are computed with each demonstration's own model, set to each of its states. A demonstration has T actions
and the T states before them, so an episode has the first T - 1 actions.

state       eef.x y z, eef.r00 r10 r20 r01 r11 r21 (two columns of its rotation), gripper.q0 ... (its joints); of
            several hands eef0 ..., eef1 ..., gripper0 ..., gripper1 ...
achieved    <joint>.x y z qw qx qy qz of free joints, <joint>.pos of hinge and slide joints, but for the robot's own
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from playlearn.episode import Array, Episode, EpisodeMeta
from playlearn.errors import StoreError
from playlearn.quantity import Quantities, own_quantities, subset
from playlearn.store.base import StoreSpec, plain
from playlearn.store.hdf5 import (
    LAST,
    Demonstrations,
    beyond_mask,
    dataset,
    demonstration,
    demonstration_names,
    frequency,
    grouped,
    is_numeric,
    json_attribute,
    mask_members,
    masks,
    open_hdf5,
    unread,
)
from playlearn.store.object_dimensions import own_dimensions
from playlearn.store.robomimic import FPS, action_names
from playlearn.store.robosuite_controller import action_bounds
from playlearn.store.success import Signals, SuccessRule, how_ended

_PLACE = ("x", "y", "z", "qw", "qx", "qy", "qz")
_TURN = ("r00", "r10", "r20", "r01", "r11", "r21")
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_SINGLE = (int(mujoco.mjtJoint.mjJNT_SLIDE), _HINGE)


@dataclass(frozen=True)
class RobosuiteConfig:
    """How a file of robosuite is imported.

    mask: import only the demonstrations of this mask (null: all).
    fps: control steps a second (null: as the file says, else 20).
    goal_names: shell-style patterns of the numbers of objects that goals are about (null: all).
    success: whether the demonstrations succeeded, `all` or `none` (null: unknown; the file does not say).
    """

    mask: str | None = None
    fps: float | None = None
    goal_names: tuple[str, ...] | None = None
    success: str | None = None

    def build(self, path: Path) -> "RobosuiteFile":
        return RobosuiteFile(path, self.mask, self.fps, self.goal_names, self.success)


class RobosuiteFile(Demonstrations):
    """`Recordings` of one file."""

    def __init__(
        self,
        path: Path,
        mask: str | None = None,
        fps: float | None = None,
        goal_names: tuple[str, ...] | None = None,
        success: str | None = None,
    ) -> None:
        """Checks the shapes of every demonstration, and compiles the model of the first; arguments: `RobosuiteConfig`.

        Raises:
            StoreError: it is not such a file, or the model of its first demonstration cannot be compiled.
            UsageError: there is no such mask, number of an object, or rule of success.
        """
        self._path, self._rule = path, None if success is None else SuccessRule(success)
        with open_hdf5(path) as file:
            names = demonstration_names(file, path)
            self.splits: Mapping[str, Sequence[int]] = masks(file, path, names)
            wanted = mask_members(mask, self.splits, path)
            self._names = {number: name for number, name in names.items() if wanted is None or number in wanted}
            data = file["data"]
            self._problems = {
                number: problem for number, name in self._names.items() if (problem := _problem(path, name, data))
            }
            sound = [number for number in self._names if number not in self._problems]
            if not sound:
                raise StoreError("\n".join(self._problems.values()))
            first = data[self._names[sound[0]]]
            scene = Scene(first.attrs["model_file"], f"{path}: {self._names[sound[0]]}")
            self._objects = own_dimensions(scene.achieved_names, goal_names)
            if self._rule is not None:
                self._rule(Signals(), str(path))
            info, kind = json_attribute(data, "env_info"), data.attrs.get("env")
            kind = kind.decode() if isinstance(kind, bytes) else kind or info.get("env_name", "unknown")
            width = int(dataset(first, "actions").shape[1])
            rest = beyond_mask(mask, len(self._names), len(names)) | unread(file, names, ("states", "actions"))
            self.remarks = grouped({**LAST, **rest, **self._objects.remarks})
        self.spec = StoreSpec(
            environment={"type": f"robosuite:{kind}", "env_info": info},
            state_names=scene.state_names,
            achieved_names=self._objects.goals(),
            action_names=action_names(width),
            fps=frequency(fps, info.get("control_freq"), path, FPS),
            quantities=Quantities(
                scene.quantities.state,
                subset(scene.quantities.achieved, self._objects.kept),
                action_bounds(info, width),
            ),
        )
        settings = {"mask": mask, "fps": fps, "goal_names": goal_names, "success": success}
        self.note = plain({"format": "robosuite", "source": path.name, "bytes": path.stat().st_size, **settings})

    def _episode(self, group: Any, number: int, name: str) -> Episode:
        scene, states = Scene(group.attrs["model_file"], name), np.asarray(dataset(group, "states"), np.float64)
        if (scene.state_names, scene.achieved_names) != (self.spec.state_names, self._objects.names):
            raise StoreError(f"{name} is of another scene than the first demonstration: import it separately")
        state, achieved = scene.observe(states, name)
        success = None if self._rule is None else self._rule(Signals(), name)
        *_, last = actions = np.asarray(dataset(group, "actions"), np.float32)
        action = actions[:-1].copy()
        meta = EpisodeMeta(
            environment=self.spec.environment,
            state_names=self.spec.state_names,
            achieved_names=self.spec.achieved_names,
            action_names=self.spec.action_names,
            fps=self.spec.fps,
            seed=number,
            actor="demonstrator",
            ended=how_ended(success),
            success=success,
            quantities=self.spec.quantities,
            unobserved_step={"action": last.tolist()},
        )
        return Episode(
            meta=meta,
            state=state,
            achieved=achieved[:, list(self._objects.kept)],
            sim_state=states,
            time=np.arange(len(states)) / self.spec.fps,
            action=action,
            expert_action=action.copy(),
            intervention=np.zeros(len(action), np.bool_),
            skill=np.zeros(len(action), np.int16),
        )


class Scene:
    """A demonstration's model; computes observations from its states."""

    def __init__(self, xml: str | bytes, name: str) -> None:
        """Raises StoreError if the model cannot be compiled, or names files that are not robosuite's."""
        try:
            spec = mujoco.MjSpec.from_string(_with_local_files(xml, name))
            spec.compiler.discardvisual = True
            self._model = spec.compile()
        except (ValueError, TypeError, ElementTree.ParseError) as error:
            raise StoreError(f"{name}: its model cannot be compiled ({error})") from error
        model = self._model
        self._data = mujoco.MjData(model)
        self._sites = [k for k in range(model.nsite) if model.site(k).name.endswith("grip_site")]
        if not self._sites:
            raise StoreError(f"{name}: its model has no end effector (no site `..._grip_site`)")
        hands = [model.site(k).name.removesuffix("grip_site") for k in self._sites]  # gripper0_right_
        joints = [model.joint(k) for k in range(model.njnt)]
        fingers = [[joint for joint in joints if joint.name.startswith(hand)] for hand in hands]
        self._fingers = [int(joint.qposadr[0]) for own in fingers for joint in own]
        robots = {int(model.body_rootid[model.site_bodyid[k]]) for k in self._sites}  # arms, legs and wheels included
        self._object_qpos: list[int] = []
        names: list[str] = []
        turning: list[str] = []  # those whose numbers are a hinge that goes round and round
        for joint in joints:
            owned = joint.name.startswith(("gripper", "robot")) or int(model.body_rootid[joint.bodyid[0]]) in robots
            if owned or int(joint.type[0]) not in (_FREE, *_SINGLE):
                continue
            parts = _PLACE if int(joint.type[0]) == _FREE else ("pos",)
            self._object_qpos += range(int(joint.qposadr[0]), int(joint.qposadr[0]) + len(parts))
            own_names = [f"{joint.name or f'joint{joint.id}'}.{part}" for part in parts]
            names += own_names
            endless = int(joint.type[0]) == _HINGE and not model.jnt_limited[joint.id]
            turning += own_names if endless else []
        numbers = [""] if len(hands) == 1 else [str(k) for k in range(len(hands))]
        eef = [f"eef{number}.{part}" for number in numbers for part in (*_PLACE[:3], *_TURN)]
        named = zip(numbers, fingers, strict=True)
        grippers = [f"gripper{number}.q{k}" for number, own in named for k in range(len(own))]
        self.state_names = (*eef, *grippers)
        self.achieved_names = tuple(names)
        own = own_quantities(self.state_names, names, 0)
        alone = {name: f"{'angle' if name in turning else 'plain'} {name}" for name in names if name.endswith(".pos")}
        achieved = tuple(alone.get(name, text) for name, text in zip(names, own.achieved, strict=True))
        self.quantities = Quantities(own.state, achieved)

    def observe(self, states: Array, name: str) -> tuple[Array, Array]:
        """State (T, S) and achieved goal (T, G), float32, from robosuite's flat states (T, 1 + nq + nv)."""
        model, data = self._model, self._data
        if states.ndim != 2 or states.shape[1] < 1 + model.nq + model.nv:
            raise StoreError(
                f"{name}: states of {states.shape} do not fit its model of {model.nq} + {model.nv} numbers"
            )
        rows = []
        for qpos in states[:, 1 : 1 + model.nq]:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            turns = [data.site_xmat[site].reshape(3, 3)[:, :2].T.ravel() for site in self._sites]
            hands = [np.concatenate([data.site_xpos[k], turn]) for k, turn in zip(self._sites, turns, strict=True)]
            rows.append(np.concatenate([*hands, qpos[self._fingers]]))
        return np.array(rows, np.float32), states[:, 1 + np.array(self._object_qpos, int)].astype(np.float32)


def _with_local_files(xml: str | bytes, name: str) -> str:
    """The XML with the paths of the installed robosuite; a file that is not robosuite's is never read."""
    import robosuite

    home = Path(robosuite.__file__).resolve().parent
    root = ElementTree.fromstring(xml)
    for element in root.iter():
        if element.tag == "include":
            raise StoreError(f"{name}: its model includes other files, which are not read")
        for attribute in ("meshdir", "texturedir", "assetdir"):
            element.attrib.pop(attribute, None)
        for attribute in [key for key in element.attrib if key.startswith("file")]:
            parts = element.attrib[attribute].replace("\\", "/").split("/")
            inside = parts[len(parts) - parts[::-1].index("robosuite") :] if "robosuite" in parts else [".."]
            place = home.joinpath(*inside).resolve()
            if not place.is_relative_to(home):
                raise StoreError(f"{name}: its model names {element.attrib[attribute]}, which is not robosuite's")
            element.set(attribute, str(place))
    return ElementTree.tostring(root, encoding="unicode")


def _problem(path: Path, name: str, data: Any) -> str | None:
    """Why a demonstration cannot be read, judging by shapes; None if it can."""
    where = f"{path}: {name}"
    try:
        group = demonstration(data, name)
        if "model_file" not in group.attrs:
            return f"{where} has no model (`model_file`): is this robomimic's? `playlearn import robomimic` reads that"
        states, actions = dataset(group, "states"), dataset(group, "actions")
    except StoreError as error:
        return str(error)
    if actions.ndim != 2 or actions.shape[0] < 2:
        return f"{where} has actions of {actions.shape}, and an episode needs two or more"
    if states.ndim != 2:
        return f"{where} has states of {states.shape}, which are not rows of numbers"
    if states.shape[0] != actions.shape[0]:
        return f"{where} has {states.shape[0]} states and {actions.shape[0]} actions"
    odd = next((one for one in (states, actions) if not is_numeric(one)), None)
    return None if odd is None else f"{where}: {odd.name.rpartition('/')[2]} is of {odd.dtype}, not of numbers"
