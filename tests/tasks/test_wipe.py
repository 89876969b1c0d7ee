"""Laws of the Wipe world: marks go where robosuite says they go, and never come back."""

import numpy as np
import pytest

from playlearn.episode import Goal
from playlearn.rollout import rollout
from playlearn.tasks import WipeConfig
from playlearn.tasks.wipe import WipeWorld, left
from playlearn.teleop import expert_for
from tests.shares import often


@pytest.fixture(scope="module")
def world() -> WipeWorld:
    return WipeConfig(wiped=0.0).build()


def test_marks_are_taken_up_by_robosuite_s_own_rule(world: WipeWorld) -> None:
    """At every step of a wipe, what is gone is what robosuite calls active in that very state, or was before."""
    world.reset(0)
    env, goal = world.robosuite, world.achieved().copy()
    left(goal)[:] = 0.0
    model, arena = env.sim.model, env.model.mujoco_arena
    for marker, (x, y) in zip(arena.markers, world.marks, strict=True):
        body = model.body_name2id(marker.root_body)
        model.body_pos[body][:2] = np.array([x, y]) - world._table
    corners, gone = env.robots[0].gripper["right"].important_geoms["corners"], set()
    expert = expert_for(world)
    for _ in range(60):
        world.step(expert.decide(world.observe(), goal).action)
        env.sim.data.qpos[:] = world.data.qpos
        env.sim.forward()
        gone |= {arena.markers.index(marker) for marker in env._get_active_markers(corners)}
        assert set(np.flatnonzero(world.left == 0)) == gone
    assert len(gone) > 5


def test_the_line_is_robosuite_s(world: WipeWorld) -> None:
    """Marks lie 5 mm apart along it, none outside what is left free at the table's edge."""
    for seed in range(5):
        world.reset(seed)
        steps = np.hypot(*np.diff(world.marks, axis=0).T)
        np.testing.assert_allclose(steps, 0.005, atol=1e-9)
        assert (np.abs(world.marks - world._table) <= np.array([0.25, 0.4]) * 0.6).all()


def wiped_clean(world: WipeWorld, seed: int) -> bool:
    """Whether the expert wipes all of it; an episode that ends so is a success, and none other is."""
    world.reset(seed)
    goal = world.achieved().copy()
    left(goal)[:] = 0.0
    outcome = rollout([world], expert_for(world), [Goal(goal)], seeds=[0], max_steps=400)[0]
    clean = outcome.ended == "there is nothing left to wipe"
    assert world.tasks["wipe_all"].judge(goal, outcome.final.achieved, goal) == clean
    return clean


def test_what_is_clean_and_left_alone_ends_the_episode(world: WipeWorld) -> None:
    assert often(wiped_clean(world, seed) for seed in range(1, 6))
