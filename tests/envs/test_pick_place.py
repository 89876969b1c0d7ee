"""Laws of the bins: robosuite's success is ours, a parcel has the same numbers however it is turned, far is reached."""

import numpy as np
import pytest

from playlearn.envs import PickPlaceConfig
from playlearn.envs.parcel import FLOOR
from playlearn.envs.pick_place import _CENTERS, PARCELS, PickPlaceEnv, compartment
from playlearn.episode import Array, Goal
from playlearn.oracles import expert_for
from playlearn.oracles.end_effector import EndEffector, Style
from playlearn.oracles.skills import Reach, TiltedSkill
from playlearn.rollout import rollout
from tests.shares import often


@pytest.fixture(scope="module", params=list(PARCELS))
def env(request: pytest.FixtureRequest) -> PickPlaceEnv:
    return PickPlaceConfig(object=request.param).build()


@pytest.fixture(scope="module")
def can() -> PickPlaceEnv:
    return PickPlaceConfig().build()


def test_stowed_is_what_robosuite_calls_success(env: PickPlaceEnv) -> None:
    """robosuite also asks that the gripper has left it, as it has here."""
    own, their_env = list(PARCELS).index(env.parcel.name), env.robosuite
    env.reset(0)
    for index, center in enumerate(_CENTERS):
        env.lay(np.array(center), 0.3)
        env.refresh()
        their_env.sim.data.qpos[:] = env.data.qpos
        their_env.sim.forward()
        assert compartment(env.achieved()) == index
        assert bool(their_env._check_success()) == (index == own)


def test_it_stands_where_it_was_laid(env: PickPlaceEnv) -> None:
    """Its height above the floor is what its task's goals say."""
    env.reset(0)
    env.lay(np.array([0.1, -0.2]), 0.4)
    env.settle(20)
    seen = env.achieved()
    assert env.parcel.standing(seen)
    np.testing.assert_allclose(seen[:3], [0.1, -0.2, FLOOR + env.parcel.rest(seen)], atol=0.003)


def turned(yaw: float, tip: float) -> Array:
    c, s, d, e = np.cos(yaw), np.sin(yaw), np.cos(tip), np.sin(tip)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, d, -e], [0, e, d]])


@pytest.mark.parametrize("name", list(PARCELS))
def test_a_parcel_is_told_by_how_it_looks(name: str) -> None:
    """Upside down is no different, and a can's turning about its own axis is not seen."""
    parcel, here = PARCELS[name], np.zeros(3)
    for yaw in (-0.5, 0.0, 1.1):
        for tip in (0.0, 0.4, np.pi / 2):
            upside_down = turned(yaw, tip) @ np.diag([1.0, -1.0, -1.0])
            np.testing.assert_allclose(
                parcel.achieved_of(here, upside_down), parcel.achieved_of(here, turned(yaw, tip)), atol=1e-6
            )
    standing, lying = parcel.achieved_of(here, turned(0.3, 0.0)), parcel.achieved_of(here, turned(0.3, np.pi / 2))
    np.testing.assert_allclose(standing[3:6], [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(lying[3:6], [0, -np.cos(0.6), -np.sin(0.6)], atol=1e-6)  # at 0.3 + pi / 2
    if parcel.round:
        np.testing.assert_allclose(parcel.achieved_of(here, turned(0.9, 0.0)), standing, atol=1e-6)


def carried_lying(can: PickPlaceEnv, seed: int) -> bool:
    """Whether the expert brings a can that fell to where it is to lie."""
    can.reset(seed)
    tipped = [np.cos(np.pi / 4), np.sin(np.pi / 4), 0, 0]
    can.put("Can_joint0", [0.1, -0.25, FLOOR + 0.026], tipped)
    can.refresh()
    goal = can.achieved().copy()
    assert not can.parcel.standing(goal)
    goal[:2] = (0.02, -0.33)

    def there(_: int, seen: object) -> bool:
        return can.reached(can.achieved(), goal)

    return rollout([can], expert_for(can), [Goal(goal)], seeds=[0], max_steps=250, stop=there)[0].ended == "stopped"


def test_a_can_that_fell_is_carried_lying(can: PickPlaceEnv) -> None:
    assert often(carried_lying(can, seed) for seed in range(1, 6))


def test_a_leaning_hand_points_outwards_and_only_far_out() -> None:
    """0.1 m beyond where it begins, over a hand length of 0.2 m: half a radian, were 0.45 not the most."""
    down = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    for away, lean in ((0.5, 0.0), (0.7, 0.0), (0.74, 0.2), (0.8, 0.45)):
        place = np.array([away, 0.0, 1.0])
        reach = Reach("reach", (away, 0.0, 1.0))
        c, s = np.cos(lean), np.sin(lean)
        leant = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) @ down  # about -y: its z axis tips towards +x
        np.testing.assert_allclose(leant[:, 2], [s, 0, -c], atol=1e-12)
        action = TiltedSkill(reach, (0.0, 0.0), 0.7).act(EndEffector(place, leant, 0.08), np.zeros(0), Style())
        np.testing.assert_allclose(action[:6], 0, atol=1e-6)  # there it is, leaning as it should
        if lean == 0:
            plain = reach.act(EndEffector(place, leant, 0.08), np.zeros(0), Style())
            np.testing.assert_array_equal(action, plain)


def test_a_can_left_lying_in_a_compartment_ends_the_episode(can: PickPlaceEnv) -> None:
    can.reset(1)
    can.put("Can_joint0", [*_CENTERS[0], FLOOR + 0.026], [np.cos(np.pi / 4), np.sin(np.pi / 4), 0, 0])
    can.refresh()
    for _ in range(20):
        can.step(np.array([0, 0, 0.5, 0, 0, 0, -1.0]))
    assert "too low" in str(can.failure())
