"""The expert of OGBench's environments: state and goal alone decide which closed-loop oracle acts."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from ogbench.manipspace.oracles.markov.button_markov import ButtonMarkovOracle
from ogbench.manipspace.oracles.markov.cube_markov import CubeMarkovOracle
from ogbench.manipspace.oracles.markov.drawer_markov import DrawerMarkovOracle
from ogbench.manipspace.oracles.markov.window_markov import WindowMarkovOracle

from playlearn.envs.ogbench.cube import places
from playlearn.envs.ogbench.env import OgbenchEnv
from playlearn.envs.ogbench.scene import BLOCK, BUTTONS, DRAWER, DRAWER_Y, ON, OPENED, WINDOW, WINDOW_X, OgbenchSceneEnv
from playlearn.episode import Array, Decision, Goal, Observation
from playlearn.store.ogbench import WIDEST

REST = (0.425, 0.0, 0.3)  # meters, where an idle end effector waits
UP = np.array([0.0, 0.0, 1.0, 0.0, -1.0])
_THERE, _SLID = 0.02, 0.02  # meters off within which a cube, and a drawer or a window, is left alone
_GRIPPED = 0.5  # of the contact: OGBench's own
_APART = 0.05  # meters between the middles of two cubes, or of the gripper and what it may brush
_OVER = np.array([0.0, 0.0, 0.11])  # meters by which the gripper clears a cube
_LOW = 0.075  # meters below which a cube in the drawer lies on its floor
_SIZE = 0.04  # meters of a cube's edge
_AREA = np.stack(np.meshgrid(np.linspace(0.32, 0.53, 5), np.linspace(-0.25, 0.25, 9)), axis=-1).reshape(-1, 2)


class OgbenchExpert:
    """An `ExpertPolicy`. A subclass implements `_choose`."""

    name = "expert"
    cameras: tuple[str, ...] = ()

    def __init__(self, env: Any) -> None:
        assert isinstance(env, OgbenchEnv)  # noqa: S101 - registered for these alone
        self._env = env
        kinds = {"cube": CubeMarkovOracle, "button": ButtonMarkovOracle}
        kinds |= {"drawer": DrawerMarkovOracle, "window": WindowMarkovOracle}
        self._oracles = {kind: make(env=env.env) for kind, make in kinds.items()}
        for oracle in self._oracles.values():
            oracle._final_pos, oracle._final_yaw, oracle._step = np.array(REST), 0.0, 0
        self._goals: list[Array] = []

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        self._goals = [np.zeros(0) if goal is None else goal.achieved for goal in goals]

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> Sequence[Decision]:
        return [self.decide(seen, goal) for seen, goal in zip(observations, self._goals, strict=True)]

    def decide(self, seen: Observation, goal: Array) -> Decision:
        """What to do in this state towards goal (G,)."""
        state, achieved, goal = seen.state.astype(float), seen.achieved.astype(float), goal.astype(float)
        skill, privileged, beside = self._choose(state, achieved, goal)
        if any(np.hypot(*(state[:2] - place[:2])) < _APART and state[2] < place[2] for place in beside):
            return Decision(UP, skill=f"{skill}:rise")
        info = {
            "proprio/effector_pos": state[:3],
            "proprio/effector_yaw": np.array([np.arctan2(state[4], state[3])]),
            "proprio/gripper_opening": np.array([1.0 - state[5] / WIDEST]),
            "proprio/gripper_contact": state[6:7],
            **{f"privileged/{name}": value for name, value in privileged.items()},
        }
        action = self._oracles[skill.partition("_")[0]].select_action(None, info)
        return Decision(np.clip(action, -1.0, 1.0), skill=skill)

    def _choose(self, state: Array, achieved: Array, goal: Array) -> tuple[str, Mapping[str, Any], Sequence[Array]]:
        """The skill, its oracle's privileged input, and places (3,) m beside which a lower gripper must first rise."""
        raise NotImplementedError


def carry(achieved: Array, index: int, target: Array, yaw: float) -> tuple[str, Mapping[str, Any]]:
    """Bring the cube whose numbers are `achieved` (5,) to target (3,) m and yaw rad."""
    return f"cube_{index}", {
        "target_block": index,
        f"block_{index}_pos": achieved[:3],
        f"block_{index}_yaw": np.array([_yaw(achieved)]),
        "target_block_pos": target,
        "target_block_yaw": np.array([yaw]),
    }


class CubeExpert(OgbenchExpert):
    """Lower cubes come first; what is in the way is laid aside; what the gripper holds is put down before all else."""

    def _choose(self, state: Array, achieved: Array, goal: Array) -> tuple[str, Mapping[str, Any], Sequence[Array]]:
        cubes, wanted = achieved.reshape(-1, 5), goal.reshape(-1, 5)
        here, there = places(achieved), places(goal)
        wrong = [int(i) for i in np.argsort(there[:, 2], kind="stable") if np.linalg.norm(here[i] - there[i]) > _THERE]
        near = int(np.linalg.norm(here - state[:3], axis=1).argmin())
        held = near if state[6] > _GRIPPED and np.linalg.norm(here[near] - state[:3]) < 0.03 else None
        first = held if held is not None else next(iter(wrong), near)
        if held is None:
            while (obstacle := self._in_the_way(here, there, first)) is not None:
                first = obstacle
        target = there[first]
        if first in wrong and self._taken(here, there, first):
            target = self._aside(here, there, first)
        if first not in wrong:
            target = here[first] if held is None else there[first]
        beside = [place + _OVER for i, place in enumerate(here) if i != first and held is None]
        return *carry(cubes[first], first, target, _yaw(wanted[first])), beside

    def _in_the_way(self, here: Array, there: Array, index: int) -> int | None:
        """What is on it; or at its goal, and neither on its own way there nor below it."""
        for other in range(len(here)):
            off = here[other] - here[index]
            if other != index and np.hypot(*off[:2]) < 0.03 and off[2] > _SIZE / 2:
                return other
        blocker = self._taken(here, there, index)
        return None if blocker is None or self._taken(here, there, blocker[0]) == (index,) else blocker[0]

    def _taken(self, here: Array, there: Array, index: int) -> tuple[int] | None:
        """Which other cube is where this one is to come."""
        if np.linalg.norm(here[index] - there[index]) <= _THERE:
            return None
        for other in range(len(here)):
            off = here[other] - there[index]
            if other != index and np.hypot(*off[:2]) < _APART and abs(off[2]) < _SIZE / 2:
                return (other,)
        return None

    def _aside(self, here: Array, there: Array, index: int) -> Array:
        """(3,) m: the first spot that nothing else is at or is to come to; always the same one."""
        taken = np.concatenate([np.delete(here, index, 0), there])[:, :2]
        far = np.linalg.norm(_AREA[:, None] - taken[None], axis=2).min(axis=1)
        return np.array([*_AREA[int(np.argmax(far > 0.1))], _SIZE / 2])


class SceneExpert(OgbenchExpert):
    """The cube first, with what it takes to get at it, then drawer, window and buttons."""

    def __init__(self, env: Any) -> None:
        super().__init__(env)
        assert isinstance(env, OgbenchSceneEnv)  # noqa: S101
        info = env.env.compute_ob_info()
        self._yaws = {name: info[f"privileged/{name}_handle_yaw"] for name in ("drawer", "window")}
        self._tops = [np.array(env.data.site_xpos[site]) for site in env.env._button_site_ids]
        self._opened = env.handle("drawer_slide", OPENED)

    def _choose(self, state: Array, achieved: Array, goal: Array) -> tuple[str, Mapping[str, Any], Sequence[Array]]:
        place, held = achieved[BLOCK], state[6] > _GRIPPED and np.linalg.norm(achieved[BLOCK] - state[:3]) < 0.03
        inside, to_inside = _in_drawer(achieved), _in_drawer(goal)
        lying = np.linalg.norm(place - goal[BLOCK]) <= _THERE or (inside and to_inside and place[2] < _LOW)
        if lying and held:
            return *carry(achieved[:5], 0, place, _yaw(achieved)), ()
        if not lying:
            if (inside or to_inside) and achieved[DRAWER_Y] < self._opened[1] - 0.03:
                return self._slide("drawer", achieved, self._opened)
            target = self._env.env._drawer_center if to_inside else goal[BLOCK]
            skill, privileged = carry(achieved[:5], 0, target, _yaw(goal))
            return skill, privileged, [] if held else self._beside(achieved, "cube_0")
        for name, column, part in (("drawer", DRAWER_Y, DRAWER), ("window", WINDOW_X, WINDOW)):
            if abs(achieved[column] - goal[column]) > _SLID:
                return self._slide(name, achieved, goal[part])
        for i in range(BUTTONS):
            if abs(achieved[ON[i]] - goal[ON[i]]) > 0.5:
                return self._press(i, achieved)
        return *carry(achieved[:5], 0, place, _yaw(achieved)), self._beside(achieved, "cube_0")

    def _slide(self, name: str, achieved: Array, to: Array) -> tuple[str, Mapping[str, Any], Sequence[Array]]:
        lock = ("drawer", "window").index(name)
        if achieved[ON[lock]] < 0.5:
            return self._press(lock, achieved)
        part = {"drawer": DRAWER, "window": WINDOW}[name]
        privileged = {f"{name}_handle_pos": achieved[part], f"{name}_handle_yaw": self._yaws[name]}
        return name, {**privileged, f"target_{name}_handle_pos": to}, self._beside(achieved, name)

    def _press(self, index: int, achieved: Array) -> tuple[str, Mapping[str, Any], Sequence[Array]]:
        privileged = {"target_button": index, "target_button_top_pos": self._tops[index]}
        privileged |= {f"button_{index}_state": 0, "target_button_state": 1}
        return f"button_{index}", privileged, self._beside(achieved, f"button_{index}")

    def _beside(self, achieved: Array, skill: str) -> list[Array]:
        """How high the gripper must be above objects that the skill is not about, before it goes elsewhere."""
        tops = {"cube_0": achieved[BLOCK] + _OVER}
        tops |= {f"button_{i}": self._tops[i] + (0, 0, 0.04) for i in range(BUTTONS)}
        tops |= {"drawer": achieved[DRAWER] + (0, 0, 0.1), "window": achieved[WINDOW] + (0, 0, 0.045)}
        own = tops[skill]
        return [place for place in tops.values() if np.hypot(*(place - own)[:2]) > 2 * _APART]


def _in_drawer(achieved: Array) -> bool:
    """As OGBench has it, from where the handle is."""
    x, y, z = achieved[BLOCK]
    handle = achieved[DRAWER_Y]
    return bool(0.21 <= x <= 0.45 and handle - 0.27 <= y <= handle - 0.07 and z <= 0.15)


def _yaw(cube: Array) -> float:
    """rad, up to a quarter turn."""
    return float(np.arctan2(cube[4], cube[3])) / 4
