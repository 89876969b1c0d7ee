"""What one worker does: set up a few episodes, roll out every actor on them, check success at each step."""

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
    """Outcome of one policy's attempt at one goal: a row of `episodes.parquet`.

    policy: name of the actor.
    episode: number in the suite.
    task: name of the task.
    success: the task's judge was satisfied for `success_hold_steps` steps in a row.
    strict: at that moment everything was where the goal shows it.
    steps: actions executed.
    reason: how it ended.
    redraws: start states that were drawn and rejected before this one.
    seed: of the actor.
    goal_index: position in a chain of goals, from 0. Goals after a failed one are not attempted and have no row.
    num_goals: goals of the chain.
    solved_at_start: the judge was satisfied before the first action.
    expert_tasks: tasks that the expert did to make the goal, if `task` does not name them.
    start_achieved, goal_achieved, final_achieved: (G,) achieved goal at the start, of the goal, and at the end.
    start_sim_state, goal_sim_state: (N,) simulator state at the start and of the goal, to replay an attempt.
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
    goal_index: int = 0
    num_goals: int = 1
    solved_at_start: bool = False
    expert_tasks: str = ""
    start_achieved: tuple[float, ...] = ()
    goal_achieved: tuple[float, ...] = ()
    final_achieved: tuple[float, ...] = ()
    start_sim_state: tuple[float, ...] = ()
    goal_sim_state: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Trajectory of the last attempted goal of an episode; pictures are rendered from it.

    sim_states: (T+1, N) simulator states.
    achieved: (T+1, G).
    proprio: (T+1, S) state of the robot.
    goal_sim_state: (N,).
    """

    sim_states: Array
    achieved: Array
    proprio: Array
    goal_sim_state: Array


@dataclass(frozen=True, eq=False)
class BatchResult:
    """What `run_batch` returns.

    episode_results: a row for each policy and attempted goal.
    trajectories: policy -> episode -> trajectory of its last attempted goal.
    renderer: what renders here.
    spec: of the environment.
    """

    episode_results: tuple[EpisodeResult, ...]
    trajectories: Mapping[str, Mapping[int, Trajectory]]
    renderer: str
    spec: EnvironmentSpec


def run_batch(
    suite: SuiteConfig,
    episodes: Sequence[int],
    recipes: Sequence[ActorRecipe],
    expert: ExpertRecipe,
    num_tracked: int = 1,
) -> BatchResult:
    """Results of all actors, and trajectories of the first `num_tracked` of them.

    A pure function of its arguments. An error in a rollout counts as a failure; an error before it is raised.
    """
    envs = cached_envs(suite.environment, len(episodes))
    actors = [recipe.build(envs[0]) for recipe in recipes]
    cameras = tuple(dict.fromkeys(camera for recipe in recipes for camera in recipe.cameras()))
    eval_episodes = [
        suite.kind.setup(envs[0], expert.build(envs[0]), episode, suite.seed, suite.max_steps, cameras)
        for episode in episodes
    ]
    episode_results: list[EpisodeResult] = []
    trajectories: dict[str, dict[int, Trajectory]] = {}
    for k, actor in enumerate(actors):
        rows, own_trajectories = _evaluate(suite, envs, eval_episodes, actor, recipes[k].name)
        episode_results += rows
        if k < num_tracked:
            trajectories[recipes[k].name] = own_trajectories
    return BatchResult(tuple(episode_results), trajectories, _renderer(envs[0]), envs[0].spec)


def lost(episode: int, policy: str, reason: str) -> EpisodeResult:
    """The result of an episode whose worker was lost."""
    return EpisodeResult(policy, episode, LOST, success=False, strict=False, steps=0, reason=reason, redraws=0, seed=0)


def _evaluate(
    suite: SuiteConfig, envs: Sequence[Environment], eval_episodes: Sequence[EvalEpisode], actor: Actor, name: str
) -> tuple[list[EpisodeResult], dict[int, Trajectory]]:
    """One actor's results, goal after goal; each environment goes on from where the previous goal was reached."""
    for env, eval_episode in zip(envs, eval_episodes, strict=True):
        env.set_state(eval_episode.start_sim_state)
    episode_results: list[EpisodeResult] = []
    trajectories: dict[int, Trajectory] = {}
    active = list(range(len(eval_episodes)))
    for goal_index in range(max(len(eval_episode.goals) for eval_episode in eval_episodes)):
        active = [k for k in active if goal_index < len(eval_episodes[k].goals)]
        if not active:
            break
        rollouts = _GoalRollouts(suite, [envs[k] for k in active], [eval_episodes[k] for k in active], goal_index, name)
        try:
            outcomes = rollouts.run(actor)
        except Exception as error:  # noqa: BLE001 - a crashed rollout counts as a failure
            episode_results += [rollouts.crashed(k, error) for k in range(len(active))]
            break
        rows = [rollouts.episode_result(k, outcome) for k, outcome in enumerate(outcomes)]
        episode_results += rows
        trajectories |= {row.episode: rollouts.trajectory(k, outcomes[k]) for k, row in enumerate(rows)}
        active = [k for k, row in zip(active, rows, strict=True) if row.success]
    return episode_results, trajectories


class _GoalRollouts:
    """One actor's rollouts towards goal number `goal_index` of each episode, from the environments' present states.

    The actor is reset for each goal, so it remembers nothing of the previous one.
    """

    def __init__(
        self,
        suite: SuiteConfig,
        envs: Sequence[Environment],
        eval_episodes: Sequence[EvalEpisode],
        goal_index: int,
        name: str,
    ) -> None:
        self._envs, self._eval_episodes, self._goal_index, self._name = envs, eval_episodes, goal_index, name
        self._success_hold_steps = suite.success_hold_steps
        self._goals = [eval_episode.goals[goal_index] for eval_episode in eval_episodes]
        self._judges = [suite.kind.judge(envs[0], goal.task) for goal in self._goals]
        self._budgets = [eval_episode.max_steps or suite.max_steps for eval_episode in eval_episodes]
        self._starts = [(np.array(env.sim_state()), _achieved(env)) for env in envs]
        self._steps, self._steps_held = [0] * len(eval_episodes), [0] * len(eval_episodes)
        self._success, self._strict = [False] * len(eval_episodes), [False] * len(eval_episodes)

    def run(self, actor: Actor) -> list[Outcome]:
        # The first goal uses the episode's seed, so a chain begins exactly like an episode with that goal alone.
        k = self._goal_index
        seeds = [derived_seed(episode.seed, k) if k else episode.seed for episode in self._eval_episodes]
        goals = [goal.goal for goal in self._goals]
        return rollout(self._envs, actor, goals, seeds=seeds, max_steps=max(self._budgets), stop=self._check)

    def _check(self, k: int, observation: Observation) -> bool:
        goal = self._goals[k].goal.achieved
        success = self._judges[k](self._starts[k][1], observation.achieved, goal)
        self._steps[k] += 1
        self._steps_held[k] = self._steps_held[k] + 1 if success else 0
        self._success[k] = self._steps_held[k] >= self._success_hold_steps
        if self._success[k]:
            self._strict[k] = self._envs[k].reached(observation.achieved, goal)
        return self._success[k] or self._steps[k] >= self._budgets[k]

    def episode_result(self, k: int, outcome: Outcome) -> EpisodeResult:
        timeout = dict.fromkeys((LENGTH, STOPPED), f"not reached in {outcome.steps} steps")
        return EpisodeResult(
            policy=self._name,
            success=self._success[k],
            strict=self._strict[k],
            steps=outcome.steps,
            reason="reached" if self._success[k] else timeout.get(outcome.ended, outcome.ended),
            final_achieved=_numbers(outcome.final.achieved),
            **self._shared_columns(k),
        )

    def crashed(self, k: int, error: Exception) -> EpisodeResult:
        reason = f"crashed: {type(error).__name__}: {error}"
        return EpisodeResult(
            policy=self._name, success=False, strict=False, steps=0, reason=reason, **self._shared_columns(k)
        )

    def trajectory(self, k: int, outcome: Outcome) -> Trajectory:
        episode, goal_sim_state = outcome.episode, self._goals[k].goal_sim_state
        if episode is None:
            start, achieved = self._starts[k]
            return Trajectory(start[None], achieved[None], np.array(outcome.final.state)[None], goal_sim_state)
        return Trajectory(
            np.array(episode.sim_state), np.array(episode.achieved), np.array(episode.state), goal_sim_state
        )

    def _shared_columns(self, k: int) -> dict[str, Any]:
        """The columns that are known before the rollout."""
        eval_episode, goal, (start, achieved) = self._eval_episodes[k], self._goals[k], self._starts[k]
        return {
            "episode": eval_episode.episode,
            "task": goal.task,
            "redraws": eval_episode.redraws,
            "seed": eval_episode.seed,
            "goal_index": self._goal_index,
            "num_goals": len(eval_episode.goals),
            "solved_at_start": self._judges[k](achieved, achieved, goal.goal.achieved),
            "expert_tasks": eval_episode.expert_tasks,
            "start_achieved": _numbers(achieved),
            "goal_achieved": _numbers(goal.goal.achieved),
            "start_sim_state": _numbers(start),
            "goal_sim_state": _numbers(goal.goal_sim_state),
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
    """The first environment of this process, in any state."""
    return cached_env(suite.environment)


def draw_trajectory(suite: SuiteConfig, trajectory: Trajectory, film: bool) -> Pictures:
    """Pictures of an episode, rendered by the worker process."""
    env = env_of(suite)
    return draw(env, trajectory.sim_states, trajectory.goal_sim_state, suite.camera, suite.picture, film=film)
