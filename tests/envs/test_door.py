"""Laws of the Door environment: where its lever is, what robosuite calls open, and that a latch holds."""

import numpy as np
import pytest

from playlearn.envs import DoorConfig
from playlearn.envs.door import ANGLE, LATCH, DoorEnv, grip
from playlearn.episode import Goal
from playlearn.oracles import expert_for
from playlearn.rollout import rollout
from tests.shares import often


@pytest.fixture(scope="module")
def env() -> DoorEnv:
    return DoorConfig().build()


@pytest.mark.parametrize(("angle", "latch"), [(0.0, 0.0), (0.2, 1.0), (0.4, -1.3)])
def test_the_lever_is_where_achieved_says(env: DoorEnv, angle: float, latch: float) -> None:
    """The handle's site is 12.5 cm from the latch's axis along the lever, the grip 10 cm."""
    for seed in (0, 1):
        env.reset(seed)
        env.data.qpos[[env._hinge, env._latch]] = angle, latch
        env._refresh()
        place, rotation = grip(env.achieved(), angle, latch)
        site = env.data.site_xpos[env.model.site("Door_handle").id]
        np.testing.assert_allclose(place - 0.025 * rotation[:, 1], site, atol=2e-4)
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-6)


def test_a_lever_within_its_friction_is_not_turned(env: DoorEnv) -> None:
    env.reset(0)
    angles = []
    for latch in (-0.1, 0.1, 0.11, 0.61, -0.61):
        env.data.qpos[env._latch] = latch
        angles.append(float(env.achieved()[LATCH]))
    np.testing.assert_allclose(angles, [0, 0, 0, 0.5, -0.5], atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 0.29, 0.31, 0.4])
def test_open_is_what_robosuite_calls_open(env: DoorEnv, angle: float) -> None:
    env.reset(0)
    start = env.achieved()
    env.swing(angle)
    their_env = env.robosuite
    their_env.sim.data.qpos[:] = env.data.qpos
    their_env.sim.forward()
    assert env.tasks["open_door"].judge(start, env.achieved(), start) == bool(their_env._check_success())


def test_two_doors_of_one_model_stand_where_each_began(env: DoorEnv) -> None:
    """Where a door stands belongs to the state, though MuJoCo keeps it in the model that clones share."""
    env.reset(3)
    twin = env.clone()
    twin.reset(4)
    here, there = env.achieved(), twin.achieved()
    assert np.abs(here[2:] - there[2:]).max() > 0.005
    for _ in range(5):
        env.step(np.zeros(7))
        twin.step(np.zeros(7))
    np.testing.assert_allclose(env.achieved()[2:], here[2:], atol=1e-7)
    np.testing.assert_allclose(twin.achieved()[2:], there[2:], atol=1e-7)


def test_a_shut_door_is_held_by_its_latch(env: DoorEnv) -> None:
    """The same push opens it no further than the latch's play, or wide where the lever is held up."""
    hinge = int(env.model.joint("Door_hinge").dofadr[0])
    opened = []
    for lever in (0.0, -1.4):
        env.reset(0)
        env.swing(0.0)
        for _ in range(20):
            env.data.qpos[env._latch] = lever
            env.data.qvel[hinge] += 0.5
            env.step(np.zeros(7))
        opened.append(env.achieved()[ANGLE])
    assert opened[0] < 0.05
    assert opened[1] > 0.3


def shut_again(env: DoorEnv, angle: float, seed: int) -> bool:
    """Whether the expert shuts a door that a slip left half way, the lever sprung back."""
    env.reset(seed)
    env.data.qpos[[env._hinge, env._latch]] = angle, -1.4
    for _ in range(15):
        env.step(np.zeros(7))
    goal = env.achieved().copy()
    goal[ANGLE] = 0.0

    def shut(_: int, seen: object) -> bool:
        return env.reached(env.achieved(), goal)

    return rollout([env], expert_for(env), [Goal(goal)], seeds=[0], max_steps=250, stop=shut)[0].ended == "stopped"


@pytest.mark.parametrize("angle", [0.1, 0.15])
def test_the_expert_frees_a_door_whose_latch_is_caught_behind_its_post(env: DoorEnv, angle: float) -> None:
    assert often(shut_again(env, angle, seed) for seed in range(1, 6))
