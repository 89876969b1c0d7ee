"""Laws of the one loop that steps an environment."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from playlearn.episode import Decision, Episode, Goal, Observation
from playlearn.rollout import Actor, Outcome, RandomActor, rollout
from tests.fakes import PointConfig, PointEnv, PointExpert, PointPlayPolicy


def env(seed: int, config: PointConfig | None = None) -> PointEnv:
    environment = PointEnv(config or PointConfig())
    environment.reset(seed)
    return environment


def run(envs: Sequence[PointEnv], actor: Actor, **options: object) -> list[Outcome]:
    goals = [None] * len(envs)
    arguments = {"seeds": [100 + k for k in range(len(envs))], "max_steps": 20} | options
    return rollout(envs, actor, goals, **arguments)  # type: ignore[arg-type]


def recorded(outcome: Outcome) -> Episode:
    assert outcome.episode is not None
    return outcome.episode


class Script:
    """Plays the same action in every environment, at every step."""

    name = "script"
    cameras: tuple[str, ...] = ()

    def __init__(self, action: Sequence[float]) -> None:
        self._action = np.array(action, dtype=np.float32)

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        pass

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        return [Decision(self._action) for _ in observations]


class Watcher(Script):
    """Must see the front camera."""

    cameras = ("front",)


def test_an_episode_replays_to_itself() -> None:
    """From its first simulator state, the recorded actions lead through every recorded state."""
    episode = recorded(run([env(0)], PointPlayPolicy(noise=0.3), max_steps=60)[0])
    replay = env(99)
    replay.set_state(episode.sim_state[0])
    for t, action in enumerate(episode.action):
        replay.step(action)
        np.testing.assert_array_equal(replay.sim_state(), episode.sim_state[t + 1])
        np.testing.assert_array_equal(replay.observe().achieved, episode.achieved[t + 1])
    assert len(np.unique(episode.sim_state[:, 1])) > 10, "the recorder made copies"


def test_a_row_does_not_depend_on_its_neighbors() -> None:
    """Environment 1 goes the same way by itself and beside others that end early."""
    single = recorded(run([env(1)], PointPlayPolicy(noise=0.3), seeds=[101], max_steps=40)[0])
    together = run([env(0), env(1), env(2)], PointPlayPolicy(noise=0.3), max_steps=40, stop=lambda k, _: k != 1)
    assert [outcome.steps for outcome in together] == [1, 40, 1]
    for key, values in recorded(together[1]).arrays().items():
        np.testing.assert_array_equal(values, single.arrays()[key])


def test_the_label_is_kept_beside_what_was_executed() -> None:
    episode = recorded(run([env(0)], PointPlayPolicy(noise=0.3))[0])
    assert (episode.action[:, :2] != episode.expert_action[:, :2]).any()
    clean = recorded(run([env(0)], PointPlayPolicy(noise=0.0))[0])
    np.testing.assert_array_equal(clean.action, clean.expert_action)
    assert {clean.meta.skills[i] for i in clean.skill} == set(clean.meta.skills)


def test_each_camera_is_rendered_once_a_step_and_kept_only_where_asked() -> None:
    """3 steps have 4 observations; the actor's camera is seen, the recorded one kept, none drawn twice."""
    seen = env(0)
    episode = recorded(run([seen], Watcher([0, 0, 0]), max_steps=3, cameras=("wrist", "front"))[0])
    assert sorted(seen.renders) == ["front"] * 4 + ["wrist"] * 4
    assert episode.images["front"].shape == (4, 24, 32, 3)
    assert episode.meta.cameras == {"wrist": {"height": 16, "width": 16}, "front": {"height": 24, "width": 32}}
    unseen = env(0)
    episode = recorded(run([unseen], Watcher([0, 0, 0]), max_steps=3)[0])
    assert unseen.renders == ["front"] * 4
    assert episode.images == {}
    assert episode.meta.renderer == ""


def test_meta_says_where_the_episode_comes_from() -> None:
    meta = recorded(run([env(0)], RandomActor(3), seeds=[42])[0]).meta
    assert meta.environment["type"] == "point"
    assert (meta.seed, meta.actor, meta.fps, meta.ended) == (42, "random", 10.0, "length")
    assert meta.action_names == PointEnv.spec.action_names
    assert meta.versions["numpy"] == np.__version__


def test_what_falls_off_ends_the_episode_and_says_so() -> None:
    """A puck 0.05 from the edge, in a closed hand that goes 0.1 to the right: over after one step."""
    environment = env(0)
    state = np.array(environment.sim_state())
    state[[1, 2, 4, 5]] = [0.95, 0.0, 0.95, 0.0]
    environment.set_state(state)
    outcome = run([environment], Script([1, 0, 1]))[0]
    assert (outcome.ended, outcome.steps) == ("the puck fell off the table", 1)
    again = run([environment], Script([1, 0, 1]))[0]
    assert again.episode is None, "it had fallen before the first action"
    assert again.steps == 0
    assert again.ended == "the puck fell off the table"


@pytest.mark.parametrize("at", [1, 5])
def test_divergence_ends_one_world_and_leaves_the_others(at: int) -> None:
    """The step that diverged is not recorded: at = 5 leaves 4 steps, at = 1 leaves no episode."""
    envs = [env(0, replace(PointConfig(), diverge_at=at)), env(1)]
    broken, sound = run(envs, RandomActor(3))
    assert broken.ended == "diverged: the point left the plane"
    assert broken.steps == at - 1
    assert (broken.episode is None) == (at == 1)
    assert (sound.steps, sound.ended) == (20, "length")


def test_a_nan_action_is_refused_before_it_does_damage() -> None:
    environment = env(0)
    before = np.array(environment.sim_state())
    outcome = run([environment], Script([np.nan, 0, 0]))[0]
    assert outcome.ended.startswith("refused: an action must be 3 finite numbers")
    np.testing.assert_array_equal(environment.sim_state(), before)


def test_the_expert_reaches_its_goal() -> None:
    """Goals can be reached in the fake environment, or tests that build on it would show nothing."""
    environment = env(3)
    goal = np.array([0.5, -0.5, 1.0], dtype=np.float32)
    outcome = rollout([environment], PointExpert(), [Goal(goal)], seeds=[0], max_steps=100)[0]
    assert environment.reached(outcome.final.achieved, goal)


def test_random_actions_are_smooth_and_in_range() -> None:
    """Lag-1 correlation of the AR(1) is its smoothness, 0.9, a little less after clipping."""
    action = recorded(run([env(0)], RandomActor(3), max_steps=2000)[0]).action
    assert np.abs(action).max() <= 1
    correlation = np.corrcoef(action[:-1, 0], action[1:, 0])[0, 1]
    assert 0.8 < correlation < 0.95


def test_lengths_must_agree() -> None:
    with pytest.raises(ValueError, match="1 environments, 1 goals and 2 seeds"):
        rollout([env(0)], RandomActor(3), [None], seeds=[1, 2], max_steps=1)
