"""Import of OGBench's manipulation datasets (Park et al., 2024, arXiv:2410.20092): `cube-*` and `scene-*`, as .npz.

Its rows are the observations s_0 ... s_T of an episode, each with the action taken there; `terminals` marks s_T, whose
action leads nowhere. They are converted to the observations of our OGBench environments (`playlearn.envs.ogbench`), so
that a policy trained on them can be evaluated there. OGBench's observation, in this order:

    joint positions (6) and velocities (6); end effector x y z, minus 0.425 m in x, times 10; cos and sin of its yaw;
    closing of the gripper, times 3; its contact
    each cube: x y z like the end effector, quaternion w x y z, cos and sin of its yaw
    each button: state, one-hot (2); height, times 120; velocity
    drawer, times 18, and its velocity; window, times 15, and its velocity
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from playlearn.episode import Array, Episode, EpisodeMeta
from playlearn.errors import EpisodeError, StoreError
from playlearn.quantity import own_quantities
from playlearn.store.base import StoreSpec
from playlearn.store.npz import Rows, members

FPS = 20.0
WIDEST = 0.085  # meters between the fingers
ROBOT, CUBE, BUTTON, SLIDES = 19, 9, 4, 4  # dimensions of each part of OGBench's observation
BUTTONS = 2
STATE_NAMES = (
    *("eef.x", "eef.y", "eef.z", "eef.c", "eef.s", "gripper.opening", "gripper.contact"),
    *(f"arm.q{k}" for k in range(6)),
    *(f"arm.v{k}" for k in range(6)),
)
ACTION_NAMES = ("dx", "dy", "dz", "dyaw", "gripper")
_CENTER, _SCALE = np.array([0.425, 0.0, 0.0]), 10.0
_UP, _DRAWER, _WINDOW = 120.0, 18.0, 15.0
# Of its scene, meters: tops of the released buttons; handles of drawer and window when closed, and their axes.
_TOPS = ((0.58, -0.0500616, 0.1254), (0.58, 0.0499417, 0.1212))
_HANDLES = (((0.3302867, -0.2400002, 0.08), (-0.0015927, -0.9999987, 0.0)), ((0.286, 0.225, 0.237), (1.0, 0.0, 0.0)))
_ARRAYS = ("observations", "actions", "terminals")


@dataclass(frozen=True)
class _Kind:
    """The environment of a dataset, inferred from the widths of its arrays.

    cubes: how many.
    scene: whether it is the scene with drawer, window and buttons.
    """

    cubes: int
    scene: bool

    @property
    def environment(self) -> Mapping[str, object]:
        return {"type": "ogbench_scene"} if self.scene else {"type": "ogbench_cube", "cubes": self.cubes}

    @property
    def achieved_names(self) -> tuple[str, ...]:
        names = [f"block_{i}.{part}" for i in range(self.cubes) for part in ("x", "y", "z", "c", "s")]
        if self.scene:
            names += [f"button_{i}.{part}" for i in range(BUTTONS) for part in ("x", "y", "z", "on")]
            names += [f"{fixture}.{axis}" for fixture in ("drawer", "window") for axis in ("x", "y", "z")]
        return tuple(names)


class OgbenchFile:
    """`Recordings` of one .npz."""

    def __init__(self, path: Path) -> None:
        """Reads only where episodes end.

        Raises:
            StoreError: it is not such a file, or of an unknown environment.
        """
        self._path, present = path, members(path)
        with Rows(path, ["terminals"]) as rows:
            if rows.shapes["terminals"] not in ((), (1,)):
                shape = (rows.length, *rows.shapes["terminals"])
                raise StoreError(f"{path}: terminals of the shape {shape}, not one for each row")
            terminals = np.asarray(rows.take(rows.length)["terminals"]).reshape(-1)
        kept = [name for name in ("qpos", "qvel", "button_states") if name in present]
        self._arrays = [*_ARRAYS, *kept]
        with Rows(path, self._arrays) as rows:
            self._kind = _kind(path, rows)
        ends = np.flatnonzero(terminals) + 1
        if not len(ends) or ends[-1] != len(terminals):
            raise StoreError(f"{path}: its last row does not end an episode: it is incomplete; fetch it again")
        self._bounds = np.concatenate([[0], ends])
        self.splits: Mapping[str, Sequence[int]] = {}
        others = [name for name in present if name not in self._arrays]
        self.remarks: Mapping[str, str] = dict.fromkeys(others, "left out: playlearn has no place for it")
        names = STATE_NAMES, self._kind.achieved_names, ACTION_NAMES
        quantities = own_quantities(STATE_NAMES, self._kind.achieved_names, len(ACTION_NAMES))
        self.spec = StoreSpec(self._kind.environment, *names, FPS, quantities=quantities)
        self.note = {"format": "ogbench", "source": path.name, "bytes": path.stat().st_size}

    def names(self) -> Mapping[int, str]:
        return {k: f"rows {a} to {b - 1}" for k, (a, b) in enumerate(zip(self._bounds, self._bounds[1:], strict=False))}

    def problems(self) -> Mapping[int, str]:
        short = np.flatnonzero(np.diff(self._bounds) < 2).tolist()
        return {k: f"{self._path}: {self.names()[k]}: an episode needs an action, and this one has none" for k in short}

    def read(self, numbers: Sequence[int]) -> Iterator[tuple[int, Episode | StoreError]]:
        with Rows(self._path, self._arrays) as rows:
            at = 0
            for number in numbers:
                begin, end = int(self._bounds[number]), int(self._bounds[number + 1])
                rows.skip(begin - at)
                taken, at = rows.take(end - begin), end
                try:
                    yield number, self._episode(taken, number)
                except EpisodeError as error:
                    yield number, StoreError(f"{self._path}: rows {begin} to {end - 1}: {error}")

    def _episode(self, rows: Mapping[str, Array], number: int) -> Episode:
        observed = np.asarray(rows["observations"], np.float64)
        action = np.array(rows["actions"][:-1], np.float32)
        kept = [np.asarray(rows[name], np.float64).reshape(len(observed), -1) for name in self._arrays[len(_ARRAYS) :]]
        meta = EpisodeMeta(
            environment=self.spec.environment,
            state_names=self.spec.state_names,
            achieved_names=self.spec.achieved_names,
            action_names=self.spec.action_names,
            fps=FPS,
            seed=number,
            actor="ogbench oracles",
            quantities=self.spec.quantities,
        )
        return Episode(
            meta=meta,
            state=robot(observed),
            achieved=self._objects(observed).astype(np.float32),
            sim_state=np.concatenate([np.zeros((len(observed), 0)), *kept], axis=1),
            time=np.arange(len(observed)) / FPS,
            action=action,
            expert_action=action.copy(),
            intervention=np.zeros(len(action), np.bool_),
            skill=np.zeros(len(action), np.int16),
        )

    def _objects(self, observed: Array) -> Array:
        """Achieved goals (T+1, G) from OGBench's observations (T+1, D)."""
        cubes = [cube(observed[:, at : at + CUBE]) for at in ROBOT + CUBE * np.arange(self._kind.cubes)]
        if not self._kind.scene:
            return np.concatenate(cubes, axis=1)
        at = ROBOT + CUBE * self._kind.cubes
        parts = [*cubes]
        for i, top in enumerate(_TOPS):
            own = observed[:, at + BUTTON * i : at + BUTTON * (i + 1)]
            place = np.tile(top, (len(observed), 1))
            place[:, 2] += own[:, 2] / _UP
            parts += [place, own[:, 1:2]]
        slides = observed[:, at + BUTTON * BUTTONS :]
        for (shut, axis), position in zip(_HANDLES, (slides[:, 0] / _DRAWER, slides[:, 2] / _WINDOW), strict=True):
            parts.append(np.array(shut) + position[:, None] * np.array(axis))
        return np.concatenate(parts, axis=1)


def robot(observed: Array) -> Array:
    """State (T+1, 19) float32 in our order and SI units, from OGBench's observations (T+1, D)."""
    position = observed[:, 12:15] / _SCALE + _CENTER
    opening = WIDEST * (1.0 - observed[:, 17:18] / 3.0)
    values: Array = np.concatenate(
        [position, observed[:, 15:17], opening, observed[:, 18:19], observed[:, :12]], axis=1
    )
    return values.astype(np.float32)


def cube(observed: Array) -> Array:
    """(T+1, 5) x y z and (cos, sin)(4 yaw), in any orientation (see `playlearn.envs.pieces.env.yaw_code`)."""
    w, x, y, z = (observed[:, 3:7] / np.linalg.norm(observed[:, 3:7], axis=1, keepdims=True)).T
    axes = [  # each of its axes, in the plane
        (1 - 2 * (y * y + z * z)) + 2j * (x * y + w * z),
        2 * (x * y - w * z) + 1j * (1 - 2 * (x * x + z * z)),
        2 * (x * z + w * y) + 2j * (y * z - w * x),
    ]
    code = 0.5 * np.sum([axis**4 for axis in axes], axis=0)
    values: Array = np.concatenate(
        [observed[:, :3] / _SCALE + _CENTER, np.stack([code.real, code.imag], axis=1)], axis=1
    )
    return values


def _kind(path: Path, rows: Rows) -> _Kind:
    width, switches = rows.shapes["observations"], rows.shapes.get("button_states")
    if len(width) == 3:
        raise StoreError(f"{path} holds images: import OGBench's state datasets, not `visual-*` ones")
    if rows.shapes["actions"] != (len(ACTION_NAMES),) or len(width) != 1:
        raise StoreError(
            f"{path}: observations of {width} and actions of {rows.shapes['actions']} are not those of a manipulation "
            "environment; `cube-*` and `scene-*` can be imported"
        )
    cubes, rest = divmod(width[0] - ROBOT, CUBE)
    if switches is None and not rest and 1 <= cubes <= 4:
        return _Kind(cubes, scene=False)
    if switches == (BUTTONS,) and width[0] == ROBOT + CUBE + BUTTONS * BUTTON + SLIDES:
        return _Kind(1, scene=True)
    raise StoreError(f"{path}: {width[0]} dimensions of an observation match neither a cube environment nor the scene")
