"""Laws of the Door world: where its lever is, what robosuite calls open, and that a latch holds."""

import numpy as np
import pytest

from playlearn.episode import Goal
from playlearn.rollout import rollout
from playlearn.tasks import DoorConfig
from playlearn.tasks.door import ANGLE, LATCH, DoorWorld, grip
from playlearn.teleop import expert_for
from tests.shares import often


@pytest.fixture(scope="module")
def world() -> DoorWorld:
    return DoorConfig().build()


@pytest.mark.parametrize(("angle", "latch"), [(0.0, 0.0), (0.2, 1.0), (0.4, -1.3)])
def test_the_lever_is_where_achieved_says(world: DoorWorld, angle: float, latch: float) -> None:
    """The handle's site is 12.5 cm from the latch's axis along the lever, the grip 10 cm."""
    for seed in (0, 1):
        world.reset(seed)
        world.data.qpos[[world._hinge, world._latch]] = angle, latch
        world._refresh()
        place, rotation = grip(world.achieved(), angle, latch)
        site = world.data.site_xpos[world.model.site("Door_handle").id]
        np.testing.assert_allclose(place - 0.025 * rotation[:, 1], site, atol=2e-4)
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-6)


def test_a_lever_within_its_friction_is_not_turned(world: DoorWorld) -> None:
    world.reset(0)
    told = []
    for latch in (-0.1, 0.1, 0.11, 0.61, -0.61):
        world.data.qpos[world._latch] = latch
        told.append(float(world.achieved()[LATCH]))
    np.testing.assert_allclose(told, [0, 0, 0, 0.5, -0.5], atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 0.29, 0.31, 0.4])
def test_open_is_what_robosuite_calls_open(world: DoorWorld, angle: float) -> None:
    world.reset(0)
    start = world.achieved()
    world.swing(angle)
    env = world.robosuite
    env.sim.data.qpos[:] = world.data.qpos
    env.sim.forward()
    assert world.tasks["open_door"].judge(start, world.achieved(), start) == bool(env._check_success())


def test_two_doors_of_one_model_stand_where_each_began(world: DoorWorld) -> None:
    """Where a door stands belongs to the state, though MuJoCo keeps it in the model that clones share."""
    world.reset(3)
    twin = world.clone()
    twin.reset(4)
    here, there = world.achieved(), twin.achieved()
    assert np.abs(here[2:] - there[2:]).max() > 0.005
    for _ in range(5):
        world.step(np.zeros(7))
        twin.step(np.zeros(7))
    np.testing.assert_allclose(world.achieved()[2:], here[2:], atol=1e-7)
    np.testing.assert_allclose(twin.achieved()[2:], there[2:], atol=1e-7)


def test_a_shut_door_is_held_by_its_latch(world: DoorWorld) -> None:
    """The same push opens it no further than the latch's play, or wide where the lever is held up."""
    hinge = int(world.model.joint("Door_hinge").dofadr[0])
    opened = []
    for lever in (0.0, -1.4):
        world.reset(0)
        world.swing(0.0)
        for _ in range(20):
            world.data.qpos[world._latch] = lever
            world.data.qvel[hinge] += 0.5
            world.step(np.zeros(7))
        opened.append(world.achieved()[ANGLE])
    assert opened[0] < 0.05
    assert opened[1] > 0.3


def shut_again(world: DoorWorld, angle: float, seed: int) -> bool:
    """Whether the expert shuts a door that a slip left half way, the lever sprung back."""
    world.reset(seed)
    world.data.qpos[[world._hinge, world._latch]] = angle, -1.4
    for _ in range(15):
        world.step(np.zeros(7))
    goal = world.achieved().copy()
    goal[ANGLE] = 0.0

    def shut(_: int, seen: object) -> bool:
        return world.reached(world.achieved(), goal)

    return rollout([world], expert_for(world), [Goal(goal)], seeds=[0], max_steps=250, stop=shut)[0].ended == "stopped"


@pytest.mark.parametrize("angle", [0.1, 0.15])
def test_the_expert_frees_a_door_whose_latch_is_caught_behind_its_post(world: DoorWorld, angle: float) -> None:
    assert often(shut_again(world, angle, seed) for seed in range(1, 6))
