"""Import of robosuite's raw demonstrations (`collect_human_demonstrations`): simulator states and actions, no more.

Observations are computed with each demonstration's own model, set to each of its states. A demonstration has T actions
and the T states before them, so an episode has the first T - 1 actions.

state       eef.x y z, eef.r00 r10 r20 r01 r11 r21 (two columns of its rotation), gripper.q0 ... (its joints)
achieved    <joint>.x y z qw qx qy qz of free joints, <joint>.pos of hinge and slide joints
"""

import dataclasses
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from playlearn.episode import Array, Episode, EpisodeMeta
from playlearn.errors import StoreError
from playlearn.quantity import Quantities, own_quantities
from playlearn.store.base import StoreSpec
from playlearn.store.hdf5 import (
    Demonstrations,
    dataset,
    demonstration_names,
    json_attribute,
    mask_members,
    masks,
    open_hdf5,
)
from playlearn.store.robomimic import ACTIONS, FPS
from playlearn.store.robosuite_controller import action_bounds

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
    """

    mask: str | None = None
    fps: float | None = None

    def build(self, path: Path) -> "RobosuiteFile":
        return RobosuiteFile(path, self.mask, self.fps)


class RobosuiteFile(Demonstrations):
    """`Recordings` of one file."""

    def __init__(self, path: Path, mask: str | None = None, fps: float | None = None) -> None:
        """Checks the shapes of every demonstration, and compiles the model of the first; arguments: `RobosuiteConfig`.

        Raises:
            StoreError: it is not such a file, or the model of its first demonstration cannot be compiled.
            UsageError: there is no such mask.
        """
        self._path = path
        with open_hdf5(path) as file:
            names = demonstration_names(file, path)
            self.splits: Mapping[str, Sequence[int]] = masks(file, path, names)
            wanted = mask_members(mask, self.splits, path)
            self._names = {number: name for number, name in names.items() if wanted is None or number in wanted}
            data = file["data"]
            self._problems = {
                number: problem for number, name in self._names.items() if (problem := _problem(path, name, data[name]))
            }
            sound = [number for number in self._names if number not in self._problems]
            if not sound:
                raise StoreError("\n".join(self._problems.values()))
            first = data[self._names[sound[0]]]
            scene = Scene(first.attrs["model_file"], f"{path}: {self._names[sound[0]]}")
            info = json_attribute(data, "env_info")
            kind = str(data.attrs.get("env", info.get("env_name", "unknown")))
            width = int(dataset(first, "actions").shape[1])
        self.spec = StoreSpec(
            environment={"type": f"robosuite:{kind}", "env_info": info},
            state_names=scene.state_names,
            achieved_names=scene.achieved_names,
            action_names=ACTIONS if width == len(ACTIONS) else tuple(f"action.{k}" for k in range(width)),
            fps=float(fps or info.get("control_freq") or FPS),
            quantities=dataclasses.replace(scene.quantities, action_bounds=action_bounds(info, width)),
        )
        size = path.stat().st_size
        self.note = {"format": "robosuite", "source": path.name, "bytes": size, "mask": mask, "fps": fps}

    def _episode(self, group: Any, number: int, name: str) -> Episode:
        scene, states = Scene(group.attrs["model_file"], name), np.asarray(dataset(group, "states"), np.float64)
        if (scene.state_names, scene.achieved_names) != (self.spec.state_names, self.spec.achieved_names):
            raise StoreError(f"{name} is of another scene than the first demonstration: import it separately")
        state, achieved = scene.observe(states, name)
        action = np.asarray(dataset(group, "actions")[:-1], np.float32)
        meta = EpisodeMeta(
            environment=self.spec.environment,
            state_names=self.spec.state_names,
            achieved_names=self.spec.achieved_names,
            action_names=self.spec.action_names,
            fps=self.spec.fps,
            seed=number,
            actor="demonstrator",
            quantities=self.spec.quantities,
        )
        return Episode(
            meta=meta,
            state=state,
            achieved=achieved,
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
        except (ValueError, ElementTree.ParseError) as error:
            raise StoreError(f"{name}: its model cannot be compiled ({error})") from error
        model = self._model
        self._data = mujoco.MjData(model)
        sites = [k for k in range(model.nsite) if model.site(k).name.endswith("grip_site")]
        if not sites:
            raise StoreError(f"{name}: its model has no end effector (no site `..._grip_site`)")
        self._site = sites[0]
        joints = [model.joint(k) for k in range(model.njnt)]
        self._fingers = [int(joint.qposadr[0]) for joint in joints if joint.name.startswith("gripper")]
        self._object_qpos: list[int] = []
        names: list[str] = []
        turning: list[str] = []  # those whose numbers are a hinge that goes round and round
        for joint in joints:
            if joint.name.startswith(("gripper", "robot")) or int(joint.type[0]) not in (_FREE, *_SINGLE):
                continue
            parts = _PLACE if int(joint.type[0]) == _FREE else ("pos",)
            self._object_qpos += range(int(joint.qposadr[0]), int(joint.qposadr[0]) + len(parts))
            names += [f"{joint.name}.{part}" for part in parts]
            endless = int(joint.type[0]) == _HINGE and not model.jnt_limited[joint.id]
            turning += [f"{joint.name}.pos"] if endless else []
        eef = [f"eef.{part}" for part in (*_PLACE[:3], *_TURN)]
        self.state_names = (*eef, *(f"gripper.q{k}" for k in range(len(self._fingers))))
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
            turn = data.site_xmat[self._site].reshape(3, 3)[:, :2].T.ravel()
            rows.append(np.concatenate([data.site_xpos[self._site], turn, qpos[self._fingers]]))
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


def _problem(path: Path, name: str, group: Any) -> str | None:
    """Why a demonstration cannot be read, judging by shapes; None if it can."""
    where = f"{path}: {name}"
    if "model_file" not in group.attrs:
        return f"{where} has no model (`model_file`): is this robomimic's? `playlearn import robomimic` reads that"
    try:
        states, actions = dataset(group, "states"), dataset(group, "actions")
    except StoreError as error:
        return str(error)
    if actions.ndim != 2 or actions.shape[0] < 2:
        return f"{where} has actions of {actions.shape}, and an episode needs two or more"
    if states.shape[0] != actions.shape[0]:
        return f"{where} has {states.shape[0]} states and {actions.shape[0]} actions"
    return None
