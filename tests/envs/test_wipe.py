"""Laws of the Wipe environment: marks go where robosuite says they go, and never come back."""

import numpy as np
import pytest

from playlearn.envs import WipeConfig
from playlearn.envs.wipe import WipeEnv, left
from playlearn.episode import Goal
from playlearn.oracles import expert_for
from playlearn.rollout import rollout
from tests.shares import often


@pytest.fixture(scope="module")
def env() -> WipeEnv:
    return WipeConfig(wiped=0.0).build()


def test_marks_are_taken_up_by_robosuite_s_own_rule(env: WipeEnv) -> None:
    """At every step of a wipe, what is gone is what robosuite calls active in that very state, or was before."""
    env.reset(0)
    their_env, goal = env.robosuite, env.achieved().copy()
    left(goal)[:] = 0.0
    model, arena = their_env.sim.model, their_env.model.mujoco_arena
    for marker, (x, y) in zip(arena.markers, env.marks, strict=True):
        body = model.body_name2id(marker.root_body)
        model.body_pos[body][:2] = np.array([x, y]) - env._table
    corners, gone = their_env.robots[0].gripper["right"].important_geoms["corners"], set()
    expert = expert_for(env)
    for _ in range(60):
        env.step(expert.decide(env.observe(), goal).action)
        their_env.sim.data.qpos[:] = env.data.qpos
        their_env.sim.forward()
        gone |= {arena.markers.index(marker) for marker in their_env._get_active_markers(corners)}
        assert set(np.flatnonzero(env.left == 0)) == gone
    assert len(gone) > 5


def test_the_line_is_robosuite_s(env: WipeEnv) -> None:
    """Marks lie 5 mm apart along it, none outside what is left free at the table's edge."""
    for seed in range(5):
        env.reset(seed)
        steps = np.hypot(*np.diff(env.marks, axis=0).T)
        np.testing.assert_allclose(steps, 0.005, atol=1e-9)
        assert (np.abs(env.marks - env._table) <= np.array([0.25, 0.4]) * 0.6).all()


def wiped_clean(env: WipeEnv, seed: int) -> bool:
    """Whether the expert wipes all of it; an episode that ends so is a success, and none other is."""
    env.reset(seed)
    goal = env.achieved().copy()
    left(goal)[:] = 0.0
    outcome = rollout([env], expert_for(env), [Goal(goal)], seeds=[0], max_steps=400)[0]
    clean = outcome.ended == "there is nothing left to wipe"
    assert env.tasks["wipe_all"].judge(goal, outcome.final.achieved, goal) == clean
    return clean


def test_what_is_clean_and_left_alone_ends_the_episode(env: WipeEnv) -> None:
    assert often(wiped_clean(env, seed) for seed in range(1, 6))
