"""`playlearn` with the fake environment and a play policy that fails on demand: `python point.py collect ...`.

Worker processes import the main script too, so they know that environment and that policy as well. What
happens is in $PLAYLEARN_FAULTS as `{"episode": "what"}`, see `FaultyPlayPolicy`.
"""

import functools
import json
import os
import signal
import sys
import time
from collections.abc import Sequence

from playlearn import cli
from playlearn.collection import CollectConfig, episode_seed, job
from playlearn.episode import Decision, Goal, Observation
from playlearn.executor import LocalExecutorConfig
from playlearn.oracles import PlayConfig
from playlearn.sim import Environment
from tests.fakes import PointConfig, PointEnv, PointPlayPolicy

FAULTS = "PLAYLEARN_FAULTS"
PACE = "PLAYLEARN_PACE"  # seconds a step takes
RETRIES = "PLAYLEARN_RETRIES"
SEED = 5
AT = 3  # the step at which it happens


def config(episodes: int = 12, steps: int = 12) -> CollectConfig:
    return CollectConfig(environment=PointConfig(), episodes=episodes, steps=steps, seed=SEED)


class FaultyPlayPolicy(PointPlayPolicy):
    """Plays on until step `AT` of an episode to which something happens."""

    def __init__(self, env: PointEnv) -> None:
        super().__init__(noise=0.3)
        faults = json.loads(os.environ.get(FAULTS, "{}"))
        self._faults = {episode_seed(SEED, int(episode)): what for episode, what in faults.items()}
        self._pace = float(os.environ.get(PACE, "0"))
        self._env, self._what, self._step = env, "", 0

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        super().reset(goals, seeds)
        self._what, self._step = self._faults.get(seeds[0], ""), 0
        self._env._diverge_at = {"diverges at once": 1, "diverges": AT}.get(self._what)

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        time.sleep(self._pace)
        self._step += 1
        if self._step == AT:
            self._happen()
        return super().act(observations, active)

    def _happen(self) -> None:
        if self._what == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        elif self._what == "hangs":
            time.sleep(1000)
        elif self._what == "bug":
            raise ZeroDivisionError("a bug")


def play_policy(environment: Environment, _config: PlayConfig) -> FaultyPlayPolicy:
    assert isinstance(environment, PointEnv)
    return FaultyPlayPolicy(environment)


def install() -> None:
    """From now on this process plays with that policy."""
    job.play_policy_for = play_policy  # type: ignore[assignment]
    if RETRIES in os.environ:
        job.LocalExecutorConfig = functools.partial(LocalExecutorConfig, retries=int(os.environ[RETRIES]))  # type: ignore[misc, assignment]


if __name__ in {"__main__", "__mp_main__"}:  # the latter in a worker process
    install()
if __name__ == "__main__":
    sys.exit(cli.main())
