"""Laws of what numbers are declared to measure."""

import numpy as np
import pytest

from playlearn.quantity import (
    Quantities,
    continuous,
    difference,
    middle,
    nearest,
    own_quantities,
    pools,
)

DECLARED = ("length x", "angle yaw", *("quaternion red",) * 4, "binary on", "")


def test_what_is_declared_alike_is_one_pool_and_the_rest_stands_alone() -> None:
    """An orientation's parts compare with nothing, and neither does what nobody declared."""
    declared = ("length x", "length y", "length x", "plain x", "", "", "quaternion a", "quaternion a")
    assert pools(declared) == [[0, 2], [1], [3], [4], [5], [6], [7]]


def test_our_own_names_end_in_what_they_measure() -> None:
    made = own_quantities(("eef.x", "eef.r00", "arm.q0"), ("lamp.on", "peg.qw", "lever.angle"), 2)
    assert made.state == ("length x", "direction r00", "plain q0")
    assert made.achieved == ("binary on", "quaternion peg", "plain angle")
    assert made.action_bounds == ((-1.0, 1.0), (-1.0, 1.0))


def test_a_pose_differs_from_itself_by_nothing_however_it_is_spelled() -> None:
    rng = np.random.default_rng(0)
    pose = rng.normal(size=(20, 8)).astype(np.float32)
    other = pose.copy()
    other[:, 1] += 2 * np.pi * rng.integers(-2, 3, 20)
    other[:, 2:6] *= rng.choice([-1, 1], (20, 1))
    np.testing.assert_allclose(difference(pose, other, DECLARED), 0, atol=5e-6)
    np.testing.assert_allclose(nearest(other, pose, DECLARED), pose, atol=5e-6)


def test_angles_differ_the_shorter_way_round() -> None:
    np.testing.assert_allclose(difference(np.array([3.1]), np.array([-3.1]), ("angle yaw",)), 6.2 - 2 * np.pi)


def test_what_has_one_spelling_is_subtracted_to_the_bit() -> None:
    one, other = np.random.default_rng(1).normal(size=(2, 50, 2)).astype(np.float32)
    for declared in ((), ("length x", "plain q0")):
        assert np.array_equal(difference(one, other, declared), one - other)
        assert continuous(one, declared) is one


def test_a_slow_turn_is_continuous_across_every_seam() -> None:
    """Two turns about z, the angle cut at pi and the quaternion's first part kept positive."""
    angle = np.linspace(0, 4 * np.pi, 200)
    quaternion = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], axis=1)
    quaternion *= np.where(quaternion[:, :1] < 0, -1, 1)
    cut = (angle + np.pi) % (2 * np.pi) - np.pi
    rows = np.column_stack([cut, quaternion])
    smooth = continuous(rows, ("angle yaw", *("quaternion red",) * 4))
    assert np.abs(np.diff(rows, axis=0)).max() > 1.9
    assert np.abs(np.diff(smooth, axis=0)).max() < 0.07


def test_the_middle_of_angles_about_pi_is_pi_and_no_sign_of_a_quaternion_changes_its_middle() -> None:
    rng = np.random.default_rng(2)
    angles = np.pi + rng.normal(0, 0.1, 500)
    cut = (angles + np.pi) % (2 * np.pi) - np.pi
    assert abs(abs(middle(cut[:, None], ("angle yaw",))[0]) - np.pi) < 0.02
    declared = ("quaternion red",) * 4
    rows = np.array([0.6, 0.0, 0.8, 0.0]) + rng.normal(0, 0.05, (500, 4))
    signed = rows * rng.choice([-1, 1], (500, 1))
    np.testing.assert_allclose(middle(signed, declared), middle(rows, declared), atol=1e-9)
    np.testing.assert_allclose(middle(rows, declared), [0.6, 0, 0.8, 0], atol=0.02)


def test_what_is_not_said_is_known_of_no_dimension() -> None:
    assert Quantities().of("state", 3) == ("", "", "")
    with pytest.raises(KeyError):
        Quantities.from_dict({"state": []})
