"""What one worker does: set a few episodes up, let every contender attempt them, judge each step."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from playlearn.config import from_dict, to_dict
from playlearn.episode import Array, Observation
from playlearn.errors import RenderError
from playlearn.evaluate.contenders import Contender, Expert
from playlearn.evaluate.suite import Judge, Setup, SuiteConfig
from playlearn.report.pictures import Pictures, draw
from playlearn.rollout import LENGTH, STOPPED, Outcome, rollout
from playlearn.sim.environment import Environment, EnvironmentConfig, EnvironmentSpec

LOST = "(worker lost)"


@dataclass(frozen=True)
class Attempt:
    """One contender's attempt at one episode: a row of `episodes.parquet`.

    success: the task's judge was content for `hold` steps in a row. strict: at that moment everything
    was where the goal shows it. steps: actions executed. reason: how it ended. The achieved goals and
    simulator states are kept so that any attempt can be looked at again.
    """

    policy: str
    episode: int
    task: str
    success: bool
    strict: bool
    steps: int
    reason: str
    redraws: int
    seed: int
    start_achieved: tuple[float, ...] = ()
    goal_achieved: tuple[float, ...] = ()
    final_achieved: tuple[float, ...] = ()
    start_state: tuple[float, ...] = ()
    goal_state: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Track:
    """What pictures are drawn from: (T+1, N) simulator states of an attempt, and the goal's (N,)."""

    states: Array
    goal_state: Array


@dataclass(frozen=True, eq=False)
class CohortResult:
    """tracks: episode -> what the first contender did. spec: of the world they acted in."""

    attempts: tuple[Attempt, ...]
    tracks: Mapping[int, Track]
    renderer: str
    spec: EnvironmentSpec


def run_cohort(
    suite: SuiteConfig, episodes: Sequence[int], contenders: Sequence[Contender], expert: Expert
) -> CohortResult:
    """A pure function of its arguments: where and beside what it runs changes nothing.

    What goes wrong in a contender's attempts counts as its failure; what goes wrong before is raised.
    """
    worlds = _worlds(_key(suite.environment), suite.cohort)[: len(episodes)]
    actors = [contender.build(worlds[0]) for contender in contenders]
    cameras = tuple(dict.fromkeys(camera for contender in contenders for camera in contender.cameras()))
    setups = [
        suite.kind.setup(worlds[0], expert.build(worlds[0]), episode, suite.seed, suite.max_steps, cameras)
        for episode in episodes
    ]
    judges = [suite.kind.judge(worlds[0], setup.task) for setup in setups]
    attempts: list[Attempt] = []
    tracks: dict[int, Track] = {}
    for place, actor in enumerate(actors):
        trial = _Trial(worlds, setups, judges, suite.hold)
        try:
            outcomes = trial.run(actor, suite.max_steps)
        except Exception as error:  # noqa: BLE001 - a crashed attempt is a failed one, and is counted
            reason = f"crashed: {type(error).__name__}: {error}"
            attempts += [_failed(contenders[place].name, setup, reason) for setup in setups]
            continue
        attempts += [trial.attempt(k, contenders[place].name, outcome) for k, outcome in enumerate(outcomes)]
        if place == 0:
            tracks = {setup.episode: _track(setup, outcome) for setup, outcome in zip(setups, outcomes, strict=True)}
    return CohortResult(tuple(attempts), tracks, _renderer(worlds[0]), worlds[0].spec)


def lost(episode: int, policy: str, reason: str) -> Attempt:
    """The attempt of a worker that was lost."""
    return Attempt(policy, episode, LOST, success=False, strict=False, steps=0, reason=reason, redraws=0, seed=0)


class _Trial:
    """One contender's attempts, judged as they happen."""

    def __init__(
        self, worlds: Sequence[Environment], setups: Sequence[Setup], judges: Sequence[Judge], hold: int
    ) -> None:
        self._worlds, self._setups, self._judges, self._hold = worlds, setups, judges, hold
        self._content = [0] * len(setups)
        self._strict = [False] * len(setups)

    def run(self, actor: Any, max_steps: int) -> list[Outcome]:
        for world, setup in zip(self._worlds, self._setups, strict=True):
            world.set_state(setup.start)
        goals, seeds = [setup.goal for setup in self._setups], [setup.seed for setup in self._setups]
        return rollout(self._worlds, actor, goals, seeds=seeds, max_steps=max_steps, stop=self._judge)

    def _judge(self, k: int, observation: Observation) -> bool:
        setup = self._setups[k]
        content = self._judges[k](setup.start_achieved, observation.achieved, setup.goal.achieved)
        self._content[k] = self._content[k] + 1 if content else 0
        done = self._content[k] >= self._hold
        if done:
            self._strict[k] = self._worlds[k].reached(observation.achieved, setup.goal.achieved)
        return done

    def attempt(self, k: int, policy: str, outcome: Outcome) -> Attempt:
        setup, success = self._setups[k], outcome.ended == STOPPED
        words = {STOPPED: "reached", LENGTH: f"not reached in {outcome.steps} steps"}
        return Attempt(
            policy=policy,
            success=success,
            strict=success and self._strict[k],
            steps=outcome.steps,
            reason=words.get(outcome.ended, outcome.ended),
            final_achieved=_numbers(outcome.final.achieved),
            **_given(setup),
        )


def _failed(policy: str, setup: Setup, reason: str) -> Attempt:
    return Attempt(policy=policy, success=False, strict=False, steps=0, reason=reason, **_given(setup))


def _given(setup: Setup) -> dict[str, Any]:
    """What an attempt has from its setup."""
    return {
        "episode": setup.episode,
        "task": setup.task,
        "redraws": setup.redraws,
        "seed": setup.seed,
        "start_achieved": _numbers(setup.start_achieved),
        "goal_achieved": _numbers(setup.goal.achieved),
        "start_state": _numbers(setup.start),
        "goal_state": _numbers(setup.goal_state),
    }


def _track(setup: Setup, outcome: Outcome) -> Track:
    states = setup.start[None] if outcome.episode is None else outcome.episode.sim_state
    return Track(np.array(states), setup.goal_state)


def _numbers(values: Array) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _renderer(world: Environment) -> str:
    try:
        return world.renderer()
    except RenderError:
        return "none"


def _key(config: EnvironmentConfig) -> str:
    return json.dumps({"type": config.get_choice_name(type(config)), **to_dict(config)}, sort_keys=True)


@cache
def _worlds(key: str, count: int) -> list[Environment]:
    """The worlds of this process: dear to build, so they are built once."""
    first = from_dict(EnvironmentConfig, json.loads(key)).build()
    return [first, *(first.clone() for _ in range(count - 1))]


def draw_track(suite: SuiteConfig, track: Track, film: bool) -> Pictures:
    """Pictures of an attempt, drawn by the worker that this runs in."""
    world = _worlds(_key(suite.environment), suite.cohort)[0]
    return draw(world, track.states, track.goal_state, suite.camera, suite.picture, film=film)
