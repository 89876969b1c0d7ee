"""Laws of the normalizer and of the averaged weights."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
import torch
from torch import nn

from playlearn.batch import Statistics
from playlearn.policies import PolicySpec
from playlearn.policies.ema import averaged
from playlearn.policies.normalize import Normalizer, scaled
from playlearn.quantity import Quantities
from tests.policies.parts import generator


def test_restore_undoes_normalize() -> None:
    rng = np.random.default_rng(0)
    normalizer = Normalizer({"state": Statistics(rng.normal(size=5), rng.uniform(0.1, 2, 5))})
    values = torch.randn(7, 5, generator=generator())
    torch.testing.assert_close(normalizer.restore("state", normalizer.normalize("state", values)), values)


def test_data_comes_out_with_zero_mean_and_unit_std() -> None:
    data = np.random.default_rng(0).normal(3, 0.2, (1000, 2))
    normalizer = Normalizer({"state": Statistics(data.mean(0), data.std(0))})
    out = normalizer.normalize("state", torch.tensor(data, dtype=torch.float32))
    torch.testing.assert_close(out.mean(0), torch.zeros(2), atol=1e-4, rtol=0)
    torch.testing.assert_close(out.std(0), torch.ones(2), atol=1e-3, rtol=0)


def spec(
    state: tuple[str, ...], achieved: tuple[str, ...], bounds: tuple[tuple[float, float] | None, ...]
) -> PolicySpec:
    """Of an environment that declares this of its numbers."""
    widths = {"s": len(state), "a": len(achieved), "u": len(bounds)}
    names = [tuple(f"{what}.{k}" for k in range(width)) for what, width in widths.items()]
    return PolicySpec(*names, fps=20.0, quantities=Quantities(state, achieved, bounds))


def given(**stds: Sequence[float]) -> dict[str, Statistics]:
    """Statistics of mean 0 and these stds; of what is not named one dimension of std 1."""
    return {name: Statistics(np.zeros(len(own)), np.array(own)) for name, own in (NOTHING | stds).items()}


NOTHING = {"state": [1.0], "achieved": [1.0], "action": [1.0]}


def test_a_dimension_that_does_not_vary_is_only_shifted() -> None:
    steady = given() | {"state": Statistics(np.array([2.0]), np.array([1e-9]))}
    normalizer = Normalizer(scaled(steady, spec(("",), ("",), (None,))))
    assert normalizer.normalize("state", torch.tensor([2.001])).item() < 0.01


def test_a_bounded_action_that_is_hardly_used_counts_as_a_quarter_of_the_largest_and_comes_back_whole() -> None:
    normalizer = Normalizer(scaled(given(action=[0.4, 0.2, 0.01]), spec(("",), ("",), ((-1.0, 1.0),) * 3)))
    actions = torch.tensor([[0.4, 0.2, 0.01]])
    torch.testing.assert_close(normalizer.normalize("action", actions), torch.tensor([[1.0, 1.0, 0.1]]))
    torch.testing.assert_close(normalizer.restore("action", normalizer.normalize("action", actions)), actions)


def test_what_is_little_used_is_judged_by_each_action_s_own_bounds_and_not_at_all_without() -> None:
    """Of a range of 20, 0.1 is 1 % and counts as a quarter of the other's 80 %; what has no bounds counts in full."""
    stds = given(action=[0.8, 0.1, 1e-5])
    assert scaled(stds, spec(("",), ("",), ((-1.0, 1.0), (-10.0, 10.0), None)))["action"].std.tolist() == pytest.approx(
        [0.8, 0.25 * 0.8 * 10, 1e-5]
    )


def test_a_unit_that_nobody_declared_may_be_as_small_as_it_likes() -> None:
    """1e-6 of something is normalized; 1e-6 m is less than anything that moves."""
    made = scaled(given(state=[1e-6, 1e-6], action=[1e-6]), spec(("", "length x"), ("",), (None,)))
    assert made["state"].std.tolist() == pytest.approx([1e-6, 1.0])
    assert made["action"].std.tolist() == pytest.approx([1e-6])


def test_an_action_that_never_varies_is_off_by_a_share_of_itself() -> None:
    """Of 0.37 nothing else is known than its size; of 0 not even that: the least of the others has to do."""
    for scale in (1.0, 1e-4):
        steady = Statistics(scale * np.array([0.37, 0.0, 0.1, 0.0]), scale * np.array([0.0, 0.0, 0.02, 0.5]))
        made = scaled(given() | {"action": steady}, spec(("",), ("",), (None,) * 4))
        assert (made["action"].std / scale).tolist() == pytest.approx([0.37, 0.02, 0.02, 0.5])


def test_dimensions_of_one_quantity_share_their_scale() -> None:
    """Two `x` of means 0 and 2 and spread 1 pool to mean 1 and spread sqrt(1 + 1); `y` stands alone."""
    told = {"state": Statistics(np.array([0.0, 5.0]), np.ones(2)), "achieved": Statistics(np.array([2.0]), np.ones(1))}
    made = scaled(given() | told, spec(("length x", "length y"), ("length x",), (None,)))
    np.testing.assert_allclose(made["state"].mean, [1.0, 5.0])
    np.testing.assert_allclose(made["state"].std, [np.sqrt(2), 1.0])
    np.testing.assert_allclose(made["achieved"].mean, [1.0])
    np.testing.assert_allclose(made["achieved"].std, [np.sqrt(2)])
    np.testing.assert_allclose(told["state"].mean, [0.0, 5.0])  # what was given is left alone


def test_a_name_is_not_a_unit() -> None:
    """Two joints `a.pos` and `b.pos` that nobody declares alike keep their own mean and spread."""
    joints = {"state": Statistics(np.array([0.0, 90.0]), np.array([1.0, 40.0]))}
    undeclared = PolicySpec(("a.pos", "b.pos"), ("s.0",), ("u.0",), fps=20.0)
    made = scaled(given() | joints, undeclared)["state"]
    assert (made.mean.tolist(), made.std.tolist()) == ([0.0, 90.0], [1.0, 40.0])


def test_what_does_not_vary_enters_neither_the_scale_of_its_quantity_nor_the_floor_of_the_actions() -> None:
    """Three `x`, of which one never moves: the two that do have mean 1 and std 0.1; `y` never moves anywhere."""
    told = {
        "state": Statistics(np.array([1.0, 3.0, 0.2]), np.array([0.1, 0.0, 0.0])),
        "achieved": Statistics(np.array([1.0]), np.array([0.1])),
        "action": Statistics(np.zeros(3), np.array([0.1, 0.02, 0.0])),
    }
    declared = spec(("length x", "length x", "length y"), ("length x",), ((-1.0, 1.0),) * 3)
    normalizer = Normalizer(scaled(told, declared))
    # the button in the units of all that is an x, 2 m from their mean; `y` shifted, by no unit
    state = normalizer.normalize("state", torch.tensor([1.1, 3.0, 0.7]))
    torch.testing.assert_close(state, torch.tensor([1, 20, 0.5]))
    actions = normalizer.normalize("action", torch.tensor([0.1, 0.02, 0.0]))
    torch.testing.assert_close(actions, torch.tensor([1.0, 0.8, 0.0]))


def test_spellings_of_one_pose_are_one_input() -> None:
    """An angle of 3.1 and one of -3.1 are 0.08 apart, q and -q nothing; a whole turn changes no input."""
    declared = ("angle yaw", *("quaternion red",) * 4)
    told = given() | {"achieved": Statistics(np.zeros(5), np.ones(5))}
    normalizer = Normalizer(scaled(told, spec(("",), declared, (None,))), Quantities(achieved=declared))
    q = torch.tensor([0.5, 0.5, 0.5, 0.5])
    now = torch.cat([torch.tensor([3.1]), q]).expand(1, 2, 5)
    goal = torch.cat([torch.tensor([-3.1]), -q]).unsqueeze(0)
    past, wanted = normalizer.together("achieved", now, goal)
    off = wanted - past[:, -1]
    torch.testing.assert_close(off, torch.tensor([[2 * math.pi - 6.2, 0, 0, 0, 0]]), atol=1e-5, rtol=0)
    turned = now.clone()
    turned[:, 0, 0] += 2 * math.pi
    turned[:, 0, 1:] *= -1
    torch.testing.assert_close(normalizer.together("achieved", turned, goal)[0], past, atol=1e-5, rtol=0)


def test_the_rounding_of_a_large_number_is_no_variation_and_a_small_unit_is() -> None:
    rounded = np.float32(1000) + np.float32([0, 1, 2, 1]) * np.spacing(np.float32(1000))
    fine = 1e-7 * np.array([1, 2, 3, 4], np.float32)
    found = Statistics(*(np.array([one(rounded), one(fine)], np.float32) for one in (np.mean, np.std)))
    assert found.varies.tolist() == [False, True]


def test_the_average_is_the_recursion_written_out() -> None:
    """With decay d_n = min(0.5, (1 + n) / (10 + n)): e_0 = w_0, e_n = d_n e_{n-1} + (1 - d_n) w_n."""
    model = nn.Linear(1, 1, bias=False)
    ema = averaged(model, 0.5)
    expected = None
    for n, weight in enumerate([1.0, 2.0, 5.0, -3.0]):
        with torch.no_grad():
            model.weight.fill_(weight)
        ema.update_parameters(model)
        decay = min(0.5, (1 + n) / (10 + n))
        expected = weight if expected is None else decay * expected + (1 - decay) * weight
    assert abs(ema.module.weight.item() - expected) < 1e-6
    assert model.weight.item() == -3.0
