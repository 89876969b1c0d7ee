"""A plan: smooth, kept, followed by feel alone, and left when the fingers close on nothing."""

import numpy as np
import pytest

from playlearn.episode import Array
from playlearn.oracles.end_effector import CLOSE, OPEN, REST_YAW, EndEffector, Style
from playlearn.oracles.open_loop import FASTEST, Plan
from playlearn.oracles.skills import Waypoint

DOWN = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])  # gripper down, fingers along y
TAKE = (
    Waypoint((0.3, 0.0, 1.0), REST_YAW, OPEN),
    Waypoint((0.3, 0.0, 0.9), REST_YAW, CLOSE, wait=4),
    Waypoint((0.3, 0.0, 1.1), REST_YAW, CLOSE),
)


def follow(plan: Plan, opening: float = 0.04) -> tuple[Array, Array]:
    """Places (n, 3) and actions (n, 7) of an arm that answers as the real one: a quarter of what is asked."""
    hand, places, actions = EndEffector(np.array([0.0, 0.0, 1.0]), DOWN, 0.08), [], []
    while not plan.over:
        action = plan.act(hand)
        fingers = max(opening, hand.opening - 0.02) if action[-1] == CLOSE else 0.08
        hand = EndEffector(hand.position + FASTEST * action[:3], DOWN, fingers)
        plan.advance(hand)
        places.append(hand.position)
        actions.append(action)
        assert len(places) < 300, "it ends"
    return np.array(places), np.array(actions)


def plan(seed: int = 0, path_noise: float = 0.0, speed: float = 1.0) -> Plan:
    start = EndEffector(np.array([0.0, 0.0, 1.0]), DOWN, 0.08)
    return Plan(TAKE, start, Style(speed), path_noise, np.random.default_rng(seed))


def test_it_passes_its_waypoints_and_lasts_as_long_as_it_said() -> None:
    made = plan()
    expected = made.steps
    places, _ = follow(made)
    for stop in TAKE:
        assert np.linalg.norm(places - stop.position, axis=1).min() < 0.012
    # Waiting for a late end effector adds at most 10 steps at the one stop.
    assert expected <= len(places) <= expected + 15


def test_fingers_close_where_the_plan_says_and_not_on_the_way() -> None:
    places, actions = follow(plan())
    first = int(np.argmax(actions[:, -1] == CLOSE))
    assert np.linalg.norm(places[first - 1] - TAKE[1].position) < 0.012
    assert (actions[first:, -1] == CLOSE).all()


def test_speed_is_smooth_and_scales_with_the_style() -> None:
    """Half the speed takes twice as long; an action never jumps by more than a quarter of full speed.

    A leg of 0.3 m takes 45 steps of which the fastest changes by far less; stops between legs are slow.
    """
    places, actions = follow(plan())
    slow, _ = follow(plan(speed=0.5))
    assert len(slow) / len(places) == pytest.approx(2, abs=0.25)
    assert np.abs(np.diff(actions[:, :3], axis=0)).max() < 0.25


def test_path_noise_bends_the_path_and_not_its_ends() -> None:
    straight, _ = follow(plan())
    bent = [follow(plan(seed, path_noise=0.1))[0] for seed in range(8)]
    ways = np.array([np.abs(places[:40, 1]).max() for places in bent])
    assert np.abs(straight[:, 1]).max() < 1e-9
    # Of a leg of 0.3 m a std of 0.1 is 3 cm; eight draws of a Gaussian are all below 4 std.
    assert 0.01 < np.median(ways) < 0.12
    assert all(np.linalg.norm(places - TAKE[1].position, axis=1).min() < 0.012 for places in bent)


def test_fingers_that_close_on_nothing_end_it() -> None:
    places, actions = follow(plan(), opening=0.0)
    assert places[-1, 2] < 0.95, "it was left soon after the grasp, not at its end 20 cm above"
    assert (actions[:, -1] == CLOSE).any()
