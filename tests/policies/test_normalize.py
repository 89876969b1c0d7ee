"""Laws of the normalizer and of the averaged weights."""

import numpy as np
import torch
from torch import nn

from playlearn.batch import Statistics
from playlearn.policies.ema import averaged
from playlearn.policies.normalize import Normalizer, pooled
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


def test_a_dimension_that_does_not_vary_is_only_shifted() -> None:
    normalizer = Normalizer({"state": Statistics(np.array([2.0]), np.array([1e-9]))})
    assert normalizer.normalize("state", torch.tensor([2.001])).item() < 0.01


def test_an_action_that_is_hardly_used_counts_as_a_quarter_of_the_largest_and_comes_back_whole() -> None:
    normalizer = Normalizer({"action": Statistics(np.zeros(3), np.array([0.4, 0.2, 0.01]))})
    actions = torch.tensor([[0.4, 0.2, 0.01]])
    torch.testing.assert_close(normalizer.normalize("action", actions), torch.tensor([[1.0, 1.0, 0.1]]))
    torch.testing.assert_close(normalizer.restore("action", normalizer.normalize("action", actions)), actions)


def test_dimensions_of_one_quantity_share_their_scale() -> None:
    """Two `x` of means 0 and 2 and spread 1 pool to mean 1 and spread sqrt(1 + 1); `y` stands alone."""
    given = {"state": Statistics(np.array([0.0, 5.0]), np.ones(2)), "achieved": Statistics(np.array([2.0]), np.ones(1))}
    made = pooled(given, {"state": ("eef.x", "eef.y"), "achieved": ("red.x",)})
    np.testing.assert_allclose(made["state"].mean, [1.0, 5.0])
    np.testing.assert_allclose(made["state"].std, [np.sqrt(2), 1.0])
    np.testing.assert_allclose(made["achieved"].mean, [1.0])
    np.testing.assert_allclose(made["achieved"].std, [np.sqrt(2)])
    np.testing.assert_allclose(given["state"].mean, [0.0, 5.0])  # what was given is left alone


def test_what_does_not_vary_enters_neither_the_scale_of_its_quantity_nor_the_floor_of_the_actions() -> None:
    """Three `x`, of which one never moves: the two that do have mean 1 and std 0.1; `y` never moves anywhere."""
    given = {
        "state": Statistics(np.array([1.0, 3.0, 0.2]), np.array([0.1, 0.0, 0.0])),
        "achieved": Statistics(np.array([1.0]), np.array([0.1])),
    }
    normalizer = Normalizer(pooled(given, {"state": ("eef.x", "button.x", "eef.y"), "achieved": ("red.x",)}))
    # the button in the units of all that is an x, 2 m from their mean; `y` shifted, by no unit
    torch.testing.assert_close(normalizer.normalize("state", torch.tensor([1.1, 3.0, 0.7])), torch.tensor([1, 20, 0.5]))
    actions = Normalizer({"action": Statistics(np.zeros(3), np.array([0.1, 0.02, 0.0]))})
    torch.testing.assert_close(
        actions.normalize("action", torch.tensor([0.1, 0.02, 0.0])), torch.tensor([1.0, 0.8, 0.0])
    )


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
