"""What depends on the hand is told from what is about objects: by the layouts of known tasks, else by measurement."""

from collections.abc import Callable

import numpy as np
import pytest

from playlearn.episode import Array
from playlearn.store.hand import moves_with_hand
from playlearn.store.robosuite_objects import NEW, OLD, known_order, object_orders

STEPS, CARRIED = 120, slice(58, 76)


def hand(rng: np.random.Generator) -> Array:
    """(T, 3) a hand that goes from stop to stop and rests there."""
    stops, place = np.repeat(rng.uniform(-0.2, 0.2, (6, 3)), STEPS // 6, 0), np.zeros((STEPS, 3))
    for t in range(1, STEPS):
        place[t] = place[t - 1] + 0.4 * (stops[t] - place[t - 1])
    return place


def cube(rng: np.random.Generator, at: Array) -> Array:
    """(T, 3) a cube that lies somewhere, is carried for a while, and stays where it is let go."""
    place = np.tile(rng.uniform(-0.2, 0.2, 3), (STEPS, 1))
    place[CARRIED] += at[CARRIED] - at[CARRIED][0]
    place[CARRIED.stop :] = place[CARRIED.stop - 1]
    return place


def turned(at: Array, vectors: Array) -> Array:
    """Vectors (T, 3) as seen by a hand that turns about z as it goes."""
    turn = 2 * at[:, 0]
    cos, sin, zero = np.cos(turn), np.sin(turn), np.zeros(len(turn))
    seen = [[cos, sin, zero], [-sin, cos, zero], [zero, zero, zero + 1]]
    return np.einsum("ijt,tj->ti", np.array(seen), vectors)


SEEN: dict[str, tuple[Callable[[Array, Array], Array], bool]] = {
    "place": (lambda at, own: own, False),
    "minus hand": (lambda at, own: own - at, True),
    "hand minus": (lambda at, own: at - own, True),
    "in the hand's frame": (lambda at, own: turned(at, own - at), True),
    "distance": (lambda at, own: np.linalg.norm(own - at, axis=1, keepdims=True), True),
    "the hand itself": (lambda at, own: at, True),
    "noisy place": (lambda at, own: own + np.random.default_rng(1).normal(0, 1e-3, own.shape), False),
    "conveyor": (lambda at, own: own + np.linspace(0, 1, len(own))[:, None], False),
    "lamp": (lambda at, own: (np.arange(len(own)) > 60).astype(float)[:, None], False),
    "constant": (lambda at, own: np.ones((len(own), 1)), False),
}


@pytest.mark.parametrize("what", SEEN)
def test_what_depends_on_the_hand_is_measured(what: str) -> None:
    rng, (see, depends) = np.random.default_rng(0), SEEN[what]
    hands = [hand(rng) for _ in range(8)]
    objects = [see(at, cube(rng, at)) for at in hands]
    robot = [np.concatenate([at, np.tile([0, 0, 0, 1, 0.02], (STEPS, 1))], 1) for at in hands]
    assert moves_with_hand(objects, robot).tolist() == [depends] * objects[0].shape[1]


def test_nothing_is_said_where_the_robot_does_not_move_or_is_not_recorded() -> None:
    rng = np.random.default_rng(0)
    objects = [cube(rng, hand(rng)) for _ in range(3)]
    assert not moves_with_hand(objects, [np.zeros((STEPS, 3))] * 3).any()
    assert not moves_with_hand(objects, [np.zeros((STEPS, 0))] * 3).any()
    assert not moves_with_hand([one[:5] for one in objects], [hand(rng)[:5]] * 3).any()


@pytest.mark.parametrize("size", [2, 7, 14])
def test_two_that_move_smoothly_all_the_time_do_not_depend_on_each_other(size: int) -> None:
    rng = np.random.default_rng(0)

    def wander(dimensions: int) -> Array:
        steps = rng.normal(size=(300, dimensions))
        return np.stack([np.convolve(np.cumsum(own), np.ones(15) / 15, "valid") for own in steps.T], 1)

    robot = [wander(size) for _ in range(10)]
    assert not moves_with_hand([wander(6) for _ in robot], robot).any()
    relative = moves_with_hand([wander(1)[:1] - one[:, :2] for one in robot], robot)  # to a place that stays
    assert relative.all() or size > 2  # a robot that moves in many directions at once hides what follows two of them


def can(at: Array, own: Array, order: str) -> Array:
    """(T, 14) `object` of PickPlaceCan."""
    still = np.tile([0.0, 0, 0, 1], (len(at), 1))
    absolute, relative = [own, still], [turned(at, own - at), still]
    return np.concatenate([*absolute, *relative] if order == OLD else [*relative, *absolute], 1)


@pytest.mark.parametrize("order", [OLD, NEW])
def test_the_order_of_a_robosuite_version_is_read_from_the_numbers(order: str) -> None:
    """The two orders of PickPlaceCan hold the same widths; the version that a file states may be another's."""
    rng = np.random.default_rng(0)
    hands = [hand(rng) for _ in range(3)]
    objects = [can(at, cube(rng, at), order) for at in hands]
    found = known_order("PickPlaceCan", "1.4.1", objects, hands, [np.concatenate(hands)])
    assert found is not None
    assert [name for name, odd in zip(found.names, found.marked("*"), strict=True) if not odd] == [
        f"Can.{part}" for part in ("x", "y", "z", "qx", "qy", "qz", "qw")
    ]
    place = 0 if order == OLD else 7
    assert found.names[place : place + 3] == ("Can.x", "Can.y", "Can.z")
    blind = known_order("PickPlaceCan", "1.4.1", objects, [np.zeros((STEPS, 0))] * 3, [])
    assert blind is not None
    assert blind.versions == OLD  # where no hand is recorded, the version tells
    assert known_order("PickPlaceCan", "", objects, [np.zeros((STEPS, 0))] * 3, []) is None
    assert known_order("SomebodysTask", "1.4.1", objects, hands, [np.concatenate(hands)]) is None


WIDTHS = {
    "Lift": 10,
    "Stack": 23,
    "Stack_D0": 23,
    "PickPlace": 56,
    "PickPlaceSingle": 15,
    "PickPlaceMilk": 14,
    "PickPlaceBread": 14,
    "PickPlaceCereal": 14,
    "PickPlaceCan": 14,
    "NutAssembly": 28,
    "NutAssemblySingle": 15,
    "NutAssemblySquare": 14,
    "NutAssemblyRound": 14,
    "Door": 14,
    "Wipe": 8,
    "ToolHang": 44,
    "TwoArmTransport": 41,
    "TwoArmLift": 19,
    "TwoArmHandover": 16,
    "TwoArmPegInHole": 17,
}


@pytest.mark.parametrize("task", WIDTHS)
def test_every_task_has_one_order_a_version(task: str) -> None:
    for version in ("1.2.0", "1.4.1", "1.5.1"):
        [order] = object_orders(task, WIDTHS[task], version)
        assert len(set(order.names)) == len(order.names) == WIDTHS[task]
        assert any(order.marked("*"))
        assert all(order.marked("*")) == (task == "TwoArmPegInHole")


@pytest.mark.slow
@pytest.mark.parametrize("task", ["Stack", "NutAssemblySquare", "Door", "TwoArmTransport"])
def test_the_order_is_that_of_the_robosuite_that_is_installed(task: str) -> None:
    import robosuite

    robots = ["Panda", "Panda"] if task.startswith("TwoArm") else "Panda"
    env = robosuite.make(task, robots=robots, has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False)
    rng, rows, hands = np.random.default_rng(0), [], []
    observed = env.reset()
    action = rng.uniform(-1, 1, env.action_dim)
    for _ in range(30):
        observed, *_ = env.step(action)
        rows.append(observed["object-state"])
        hands.append([observed[key] for key in sorted(observed) if key.startswith("robot") and key.endswith("eef_pos")])
    env.close()
    places = [np.array(own) for own in zip(*hands, strict=True)]
    found = known_order(task, "", [np.array(rows)], [np.concatenate(places, 1)], places)
    assert found is not None
    assert found.versions == NEW
    kept = [name for name, odd in zip(found.names, found.marked("*"), strict=True) if not odd]
    sensors = {f"{name.partition('.')[0]}_pos" for name in kept if name.endswith(".x")} - {"cubeA_to_cubeB_pos"}
    assert sensors <= env._observables.keys()
    for name in sensors:
        at = found.names.index(name.removesuffix("_pos") + ".x")
        np.testing.assert_allclose(rows[-1][at : at + 3], observed[name])
