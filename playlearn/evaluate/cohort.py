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
from playlearn.evaluate.suite import Setup, SuiteConfig, derived_seed
from playlearn.report.pictures import Pictures, draw
from playlearn.rollout import LENGTH, STOPPED, Actor, Outcome, rollout
from playlearn.sim.environment import Environment, EnvironmentConfig, EnvironmentSpec

LOST = "(worker lost)"


@dataclass(frozen=True)
class Attempt:
    """One contender's attempt at one goal: a row of `episodes.parquet`.

    success: the task's judge was content for `hold` steps in a row. strict: at that moment everything
    was where the goal shows it. steps: actions executed. reason: how it ended. link, links: which of how
    many goals in a row it was, the first being 0; what follows one that was not reached is not attempted,
    and has no row. already: the judge was content before anything was done. The achieved goals and
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
    link: int = 0
    links: int = 1
    already: bool = False
    made_by: str = ""
    start_achieved: tuple[float, ...] = ()
    goal_achieved: tuple[float, ...] = ()
    final_achieved: tuple[float, ...] = ()
    start_state: tuple[float, ...] = ()
    goal_state: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Track:
    """What happened in an attempt, of several in a row in the last: what pictures are drawn from.

    states: (T+1, N) simulator states. achieved: (T+1, G). body: (T+1, S), the robot's own. goal_state: (N,).
    """

    states: Array
    achieved: Array
    body: Array
    goal_state: Array


@dataclass(frozen=True, eq=False)
class CohortResult:
    """tracks: contender -> episode -> what it did at the last goal it attempted. spec: of the world acted in."""

    attempts: tuple[Attempt, ...]
    tracks: Mapping[str, Mapping[int, Track]]
    renderer: str
    spec: EnvironmentSpec


def run_cohort(
    suite: SuiteConfig, episodes: Sequence[int], contenders: Sequence[Contender], expert: Expert, tracked: int = 1
) -> CohortResult:
    """Attempts of all contenders, tracks of the first `tracked` of them.

    A pure function of its arguments: where and beside what it runs changes nothing.

    What goes wrong in a contender's attempts counts as its failure; what goes wrong before is raised.
    """
    worlds = _worlds(_key(suite.environment), suite.cohort)[: len(episodes)]
    actors = [contender.build(worlds[0]) for contender in contenders]
    cameras = tuple(dict.fromkeys(camera for contender in contenders for camera in contender.cameras()))
    setups = [
        suite.kind.setup(worlds[0], expert.build(worlds[0]), episode, suite.seed, suite.max_steps, cameras)
        for episode in episodes
    ]
    attempts: list[Attempt] = []
    tracks: dict[str, dict[int, Track]] = {}
    for place, actor in enumerate(actors):
        rows, seen = _attempt(suite, worlds, setups, actor, contenders[place].name)
        attempts += rows
        if place < tracked:
            tracks[contenders[place].name] = seen
    return CohortResult(tuple(attempts), tracks, _renderer(worlds[0]), worlds[0].spec)


def lost(episode: int, policy: str, reason: str) -> Attempt:
    """The attempt of a worker that was lost."""
    return Attempt(policy, episode, LOST, success=False, strict=False, steps=0, reason=reason, redraws=0, seed=0)


def _attempt(
    suite: SuiteConfig, worlds: Sequence[Environment], setups: Sequence[Setup], actor: Actor, name: str
) -> tuple[list[Attempt], dict[int, Track]]:
    """One contender's attempts, goal after goal; each world goes on from where the goal before it was reached."""
    for world, setup in zip(worlds, setups, strict=True):
        world.set_state(setup.start)
    attempts: list[Attempt] = []
    tracks: dict[int, Track] = {}
    going = list(range(len(setups)))
    for link in range(max(len(setup.links) for setup in setups)):
        going = [k for k in going if link < len(setups[k].links)]
        if not going:
            break
        trial = _Trial(suite, [worlds[k] for k in going], [setups[k] for k in going], link, name)
        try:
            outcomes = trial.run(actor)
        except Exception as error:  # noqa: BLE001 - a crashed attempt is a failed one, and is counted
            attempts += [trial.crashed(place, error) for place in range(len(going))]
            break
        rows = [trial.attempt(place, outcome) for place, outcome in enumerate(outcomes)]
        attempts += rows
        tracks |= {row.episode: trial.track(place, outcomes[place]) for place, row in enumerate(rows)}
        going = [k for k, row in zip(going, rows, strict=True) if row.success]
    return attempts, tracks


class _Trial:
    """One contender's attempts at goal number `link` of each setup, from where the worlds are, judged as they happen.

    Nothing is remembered from the goal before, by the actor either: it is reset.
    """

    def __init__(
        self, suite: SuiteConfig, worlds: Sequence[Environment], setups: Sequence[Setup], link: int, name: str
    ) -> None:
        self._worlds, self._setups, self._hold, self._link, self._name = worlds, setups, suite.hold, link, name
        self._links = [setup.links[link] for setup in setups]
        self._judges = [suite.kind.judge(worlds[0], one.task) for one in self._links]
        self._budgets = [setup.max_steps or suite.max_steps for setup in setups]
        self._starts = [(np.array(world.sim_state()), _achieved(world)) for world in worlds]
        self._steps, self._content = [0] * len(setups), [0] * len(setups)
        self._reached, self._strict = [False] * len(setups), [False] * len(setups)

    def run(self, actor: Actor) -> list[Outcome]:
        # The first goal's luck is the episode's own, so that a chain begins as its first goal alone would.
        seeds = [derived_seed(setup.seed, self._link) if self._link else setup.seed for setup in self._setups]
        goals = [one.goal for one in self._links]
        return rollout(self._worlds, actor, goals, seeds=seeds, max_steps=max(self._budgets), stop=self._judge)

    def _judge(self, k: int, observation: Observation) -> bool:
        goal = self._links[k].goal.achieved
        content = self._judges[k](self._starts[k][1], observation.achieved, goal)
        self._steps[k] += 1
        self._content[k] = self._content[k] + 1 if content else 0
        self._reached[k] = self._content[k] >= self._hold
        if self._reached[k]:
            self._strict[k] = self._worlds[k].reached(observation.achieved, goal)
        return self._reached[k] or self._steps[k] >= self._budgets[k]

    def attempt(self, k: int, outcome: Outcome) -> Attempt:
        words = dict.fromkeys((LENGTH, STOPPED), f"not reached in {outcome.steps} steps")
        return Attempt(
            policy=self._name,
            success=self._reached[k],
            strict=self._strict[k],
            steps=outcome.steps,
            reason="reached" if self._reached[k] else words.get(outcome.ended, outcome.ended),
            final_achieved=_numbers(outcome.final.achieved),
            **self._given(k),
        )

    def crashed(self, k: int, error: Exception) -> Attempt:
        reason = f"crashed: {type(error).__name__}: {error}"
        return Attempt(policy=self._name, success=False, strict=False, steps=0, reason=reason, **self._given(k))

    def track(self, k: int, outcome: Outcome) -> Track:
        episode, goal_state = outcome.episode, self._links[k].goal_state
        if episode is None:
            start, achieved = self._starts[k]
            return Track(start[None], achieved[None], np.array(outcome.final.state)[None], goal_state)
        return Track(np.array(episode.sim_state), np.array(episode.achieved), np.array(episode.state), goal_state)

    def _given(self, k: int) -> dict[str, Any]:
        """What an attempt has before it begins."""
        setup, one, (start, achieved) = self._setups[k], self._links[k], self._starts[k]
        return {
            "episode": setup.episode,
            "task": one.task,
            "redraws": setup.redraws,
            "seed": setup.seed,
            "link": self._link,
            "links": len(setup.links),
            "already": self._judges[k](achieved, achieved, one.goal.achieved),
            "made_by": setup.made_by,
            "start_achieved": _numbers(achieved),
            "goal_achieved": _numbers(one.goal.achieved),
            "start_state": _numbers(start),
            "goal_state": _numbers(one.goal_state),
        }


def _achieved(world: Environment) -> Array:
    return np.array(world.observe().achieved, dtype=np.float32)


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


def world_of(suite: SuiteConfig) -> Environment:
    """The first of this process's worlds; in any state."""
    return _worlds(_key(suite.environment), suite.cohort)[0]


def draw_track(suite: SuiteConfig, track: Track, film: bool) -> Pictures:
    """Pictures of an attempt, drawn by the worker that this runs in."""
    world = world_of(suite)
    return draw(world, track.states, track.goal_state, suite.camera, suite.picture, film=film)
