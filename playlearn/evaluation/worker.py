"""What one worker does: set a few episodes up, let every contender attempt them, judge each step."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from playlearn.episode import Array, Observation
from playlearn.errors import RenderError
from playlearn.evaluation.actor_recipes import ActorRecipe, ExpertRecipe
from playlearn.evaluation.suite import EvalEpisode, SuiteConfig, derived_seed
from playlearn.process_cache import cached_env, cached_envs
from playlearn.report.pictures import Pictures, draw
from playlearn.rollout import LENGTH, STOPPED, Actor, Outcome, rollout
from playlearn.sim.environment import Environment, EnvironmentSpec

LOST = "(worker lost)"


@dataclass(frozen=True)
class EpisodeResult:
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
    start_sim_state: tuple[float, ...] = ()
    goal_sim_state: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What happened in an attempt, of several in a row in the last: what pictures are drawn from.

    states: (T+1, N) simulator states. achieved: (T+1, G). body: (T+1, S), the robot's own. goal_state: (N,).
    """

    states: Array
    achieved: Array
    proprio: Array
    goal_sim_state: Array


@dataclass(frozen=True, eq=False)
class BatchResult:
    """tracks: contender -> episode -> what it did at the last goal it attempted. spec: of the world acted in."""

    episode_results: tuple[EpisodeResult, ...]
    trajectories: Mapping[str, Mapping[int, Trajectory]]
    renderer: str
    spec: EnvironmentSpec


def run_batch(
    suite: SuiteConfig,
    episodes: Sequence[int],
    contenders: Sequence[ActorRecipe],
    expert: ExpertRecipe,
    tracked: int = 1,
) -> BatchResult:
    """Attempts of all contenders, tracks of the first `tracked` of them.

    A pure function of its arguments: where and beside what it runs changes nothing.

    What goes wrong in a contender's attempts counts as its failure; what goes wrong before is raised.
    """
    envs = cached_envs(suite.environment, len(episodes))
    actors = [contender.build(envs[0]) for contender in contenders]
    cameras = tuple(dict.fromkeys(camera for contender in contenders for camera in contender.cameras()))
    setups = [
        suite.kind.setup(envs[0], expert.build(envs[0]), episode, suite.seed, suite.max_steps, cameras)
        for episode in episodes
    ]
    episode_results: list[EpisodeResult] = []
    trajectories: dict[str, dict[int, Trajectory]] = {}
    for place, actor in enumerate(actors):
        rows, seen = _evaluate(suite, envs, setups, actor, contenders[place].name)
        episode_results += rows
        if place < tracked:
            trajectories[contenders[place].name] = seen
    return BatchResult(tuple(episode_results), trajectories, _renderer(envs[0]), envs[0].spec)


def lost(episode: int, policy: str, reason: str) -> EpisodeResult:
    """The attempt of a worker that was lost."""
    return EpisodeResult(policy, episode, LOST, success=False, strict=False, steps=0, reason=reason, redraws=0, seed=0)


def _evaluate(
    suite: SuiteConfig, envs: Sequence[Environment], setups: Sequence[EvalEpisode], actor: Actor, name: str
) -> tuple[list[EpisodeResult], dict[int, Trajectory]]:
    """One contender's attempts, goal after goal; each world goes on from where the goal before it was reached."""
    for env, setup in zip(envs, setups, strict=True):
        env.set_state(setup.start)
    episode_results: list[EpisodeResult] = []
    trajectories: dict[int, Trajectory] = {}
    going = list(range(len(setups)))
    for link in range(max(len(setup.links) for setup in setups)):
        going = [k for k in going if link < len(setups[k].links)]
        if not going:
            break
        trial = _Trial(suite, [envs[k] for k in going], [setups[k] for k in going], link, name)
        try:
            outcomes = trial.run(actor)
        except Exception as error:  # noqa: BLE001 - a crashed attempt is a failed one, and is counted
            episode_results += [trial.crashed(place, error) for place in range(len(going))]
            break
        rows = [trial.episode_result(place, outcome) for place, outcome in enumerate(outcomes)]
        episode_results += rows
        trajectories |= {row.episode: trial.trajectory(place, outcomes[place]) for place, row in enumerate(rows)}
        going = [k for k, row in zip(going, rows, strict=True) if row.success]
    return episode_results, trajectories


class _Trial:
    """One contender's attempts at goal number `link` of each setup, from where the worlds are, judged as they happen.

    Nothing is remembered from the goal before, by the actor either: it is reset.
    """

    def __init__(
        self, suite: SuiteConfig, envs: Sequence[Environment], setups: Sequence[EvalEpisode], link: int, name: str
    ) -> None:
        self._envs, self._setups, self._success_hold_steps, self._link, self._name = (
            envs,
            setups,
            suite.success_hold_steps,
            link,
            name,
        )
        self._links = [setup.links[link] for setup in setups]
        self._judges = [suite.kind.judge(envs[0], one.task) for one in self._links]
        self._budgets = [setup.max_steps or suite.max_steps for setup in setups]
        self._starts = [(np.array(env.sim_state()), _achieved(env)) for env in envs]
        self._steps, self._content = [0] * len(setups), [0] * len(setups)
        self._reached, self._strict = [False] * len(setups), [False] * len(setups)

    def run(self, actor: Actor) -> list[Outcome]:
        # The first goal's luck is the episode's own, so that a chain begins as its first goal alone would.
        seeds = [derived_seed(setup.seed, self._link) if self._link else setup.seed for setup in self._setups]
        goals = [one.goal for one in self._links]
        return rollout(self._envs, actor, goals, seeds=seeds, max_steps=max(self._budgets), stop=self._judge)

    def _judge(self, k: int, observation: Observation) -> bool:
        goal = self._links[k].goal.achieved
        content = self._judges[k](self._starts[k][1], observation.achieved, goal)
        self._steps[k] += 1
        self._content[k] = self._content[k] + 1 if content else 0
        self._reached[k] = self._content[k] >= self._success_hold_steps
        if self._reached[k]:
            self._strict[k] = self._envs[k].reached(observation.achieved, goal)
        return self._reached[k] or self._steps[k] >= self._budgets[k]

    def episode_result(self, k: int, outcome: Outcome) -> EpisodeResult:
        words = dict.fromkeys((LENGTH, STOPPED), f"not reached in {outcome.steps} steps")
        return EpisodeResult(
            policy=self._name,
            success=self._reached[k],
            strict=self._strict[k],
            steps=outcome.steps,
            reason="reached" if self._reached[k] else words.get(outcome.ended, outcome.ended),
            final_achieved=_numbers(outcome.final.achieved),
            **self._given(k),
        )

    def crashed(self, k: int, error: Exception) -> EpisodeResult:
        reason = f"crashed: {type(error).__name__}: {error}"
        return EpisodeResult(policy=self._name, success=False, strict=False, steps=0, reason=reason, **self._given(k))

    def trajectory(self, k: int, outcome: Outcome) -> Trajectory:
        episode, goal_sim_state = outcome.episode, self._links[k].goal_sim_state
        if episode is None:
            start, achieved = self._starts[k]
            return Trajectory(start[None], achieved[None], np.array(outcome.final.state)[None], goal_sim_state)
        return Trajectory(
            np.array(episode.sim_state), np.array(episode.achieved), np.array(episode.state), goal_sim_state
        )

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
            "start_sim_state": _numbers(start),
            "goal_sim_state": _numbers(one.goal_sim_state),
        }


def _achieved(env: Environment) -> Array:
    return np.array(env.observe().achieved, dtype=np.float32)


def _numbers(values: Array) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _renderer(env: Environment) -> str:
    try:
        return env.renderer()
    except RenderError:
        return "none"


def env_of(suite: SuiteConfig) -> Environment:
    """The first of this process's environments; in any state."""
    return cached_env(suite.environment)


def draw_trajectory(suite: SuiteConfig, trajectory: Trajectory, film: bool) -> Pictures:
    """Pictures of an attempt, drawn by the worker that this runs in."""
    env = env_of(suite)
    return draw(env, trajectory.states, trajectory.goal_sim_state, suite.camera, suite.picture, film=film)
