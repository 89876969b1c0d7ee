"""Which observations of a robomimic file are the robot's, which the objects', which are cameras; why others are not."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from playlearn.config import nearest
from playlearn.errors import StoreError, UsageError
from playlearn.store.hdf5 import dataset, is_numeric

IMAGE = "_image"  # suffix of a camera's key
ACHIEVED = "object"
_PROPRIO = re.compile(r"(robot\d*_)?((right|left)_)?(eef_pos|eef_quat|gripper_qpos)")
_ROBOT = re.compile(r"(robot\d*|proprio|eef|ee|tcp|joints?|gripper|arm)(_|$)")
_HAND = re.compile(r"(\w+_)?(eef|ee)_pos")
_LANGUAGE = "lang_emb"


@dataclass(frozen=True)
class ObservationKeys:
    """Keys of `obs`.

    state: of the robot.
    achieved: of the objects.
    cameras: name -> key.
    remarks: key -> why it is left out, or not called what it is called there.
    """

    state: tuple[str, ...]
    achieved: tuple[str, ...]
    cameras: Mapping[str, str]
    remarks: Mapping[str, str]

    def everything(self) -> list[str]:
        """All of them."""
        return [*self.state, *self.achieved, *self.cameras.values()]

    def hands(self) -> list[str]:
        """Those of the state that are the place of a hand."""
        return [key for key in self.state if _HAND.fullmatch(key)]


def choose_keys(
    obs: Any,
    path: Path,
    state: Sequence[str] | None,
    achieved: Sequence[str] | None,
    cameras: Sequence[str] | None,
) -> ObservationKeys:
    """The keys that were asked for, or the usual ones, of one demonstration's observations.

    Default state: each robot's end effector and gripper, or every key named after a robot if those are missing.
    Default achieved goal: `object`, or all other vectors if it is missing.

    Raises:
        UsageError: a key is not there or cannot be read, or nothing is known to be the robot's.
    """
    vectors, images, unread = _sorted(obs)
    robots = [key for key in vectors if _ROBOT.match(key) and "_to_" not in key]
    proprio = [key for key in robots if _PROPRIO.fullmatch(key)]
    others = [key for key in vectors if key not in robots and key != _LANGUAGE]
    names, renamed = _camera_names(images)
    asked = (("state", state, vectors), ("achieved", achieved, vectors), ("cameras", cameras, list(names)))
    for what, wanted, known in asked:
        for key in wanted or ():
            if key in unread and key not in known:
                raise UsageError(f"{what}: {path}: obs/{key} cannot be read, {unread[key].removeprefix('left out: ')}")
            if key not in known:
                raise UsageError(f"{what}: {path} has no {key!r} in its observations{nearest(key, known)}")
    if state is None and not robots:
        listed = ", ".join(vectors) or "no vector at all"
        raise UsageError(
            f"state: {path}: no key of obs is known to be the robot's; name its proprioception by --state, and objects "
            f"by --achieved, of {listed}"
        )
    own = tuple(proprio or robots) if state is None else tuple(state)
    goals = tuple([ACHIEVED] if ACHIEVED in others else others) if achieved is None else tuple(achieved)
    seen = {name: names[name] for name in (names if cameras is None else cameras)}
    left = [key for key in (*vectors, *images) if key not in (*own, *goals, *seen.values())]
    unused = dict.fromkeys(left, "left out: none of `state`, `achieved` and `cameras` names it")
    return ObservationKeys(own, goals, seen, unread | unused | renamed)


def _sorted(obs: Any) -> tuple[list[str], list[str], dict[str, str]]:
    """Keys of vectors, keys of color images, and key -> why it is neither."""
    vectors: list[str] = []
    images: list[str] = []
    unread: dict[str, str] = {}
    for key in obs:
        try:
            one = dataset(obs, key)
        except StoreError as error:
            unread[key] = f"left out: {error}"
            continue
        if one.ndim == 4 and one.shape[3] == 3 and one.dtype == "uint8":
            images.append(key)
        elif one.ndim in (1, 2) and all(one.shape[1:]) and is_numeric(one):
            vectors.append(key)
        else:
            unread[key] = (
                f"left out: {one.dtype} of shape {one.shape} are neither vectors of numbers (T, n) nor color images "
                "(T, h, w, 3) of uint8"
            )
    return vectors, images, unread


def _camera_names(keys: Sequence[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Name -> key of each camera, all different; and key -> why its name is not the short one."""
    short = {key: key.removesuffix(IMAGE) for key in keys}
    counts = Counter(short.values())
    names = {key: name if counts[name] == 1 else key for key, name in short.items()}
    remarks = {
        key: f"called {key}: two cameras are {short[key]!r}" for key, name in names.items() if name != short[key]
    }
    return {name: key for key, name in names.items()}, remarks
