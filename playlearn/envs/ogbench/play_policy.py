"""Play as OGBench's play datasets have it: its planning oracles, a new random target whenever one is done."""

from collections.abc import Sequence

import numpy as np

from playlearn.envs.ogbench.env import OgbenchEnv, Oracle
from playlearn.envs.tabletop import numpy_seeded_from
from playlearn.episode import Decision, Goal, Observation
from playlearn.errors import UsageError
from playlearn.sim.environment import Environment

_FIRST_STACKING = 0.5  # OGBench draws an episode's first target before it says how probable stacking is


class OgbenchPlayPolicy:
    """An Actor for one environment, whose privileged state its oracles read.

    Raises:
        UsageError: the environment is none of OGBench's.
    """

    name = "ogbench oracles"
    cameras: tuple[str, ...] = ()

    def __init__(self, environment: Environment, noise: float, smoothing: float) -> None:
        if not isinstance(environment, OgbenchEnv):
            raise UsageError("play: `type: ogbench` plays in OGBench's environments only; leave `type` out elsewhere")
        self._env = environment
        self._oracles = environment.oracles(noise, smoothing)
        self._rng = np.random.default_rng(0)
        self._stacking = 0.0
        self._oracle: Oracle | None = None
        self._skill = ""

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        if len(seeds) != 1:
            raise UsageError(f"{self.name} play in one environment at a time, not in {len(seeds)}")
        self._rng = np.random.default_rng(seeds[0])
        self._stacking = self._env.stacking(self._rng)
        self._begin(_FIRST_STACKING)

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> Sequence[Decision]:
        if self._oracle is None or self._oracle.done:
            self._begin(self._stacking)
        assert self._oracle is not None  # noqa: S101
        action = self._oracle.select_action(None, self._env.env.compute_ob_info())
        return [Decision(np.clip(action, -1.0, 1.0), skill=self._skill)]

    def _begin(self, stacking: float) -> None:
        """A new target, and the plan that leads to it."""
        env = self._env.env
        env._np_random = self._rng
        env.set_new_target(return_info=False, p_stack=stacking)
        info = env.compute_ob_info()
        kind = str(info["privileged/target_task"])
        self._oracle = self._oracles[kind]
        with numpy_seeded_from(self._rng):
            self._oracle.reset(None, info)
        which = {"cube": "target_block", "button": "target_button"}.get(kind)
        self._skill = kind if which is None else f"{kind}_{info[f'privileged/{which}']}"
