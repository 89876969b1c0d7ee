"""Laws of the heads."""

import functools

import pytest
import torch

from playlearn.policies.heads import (
    AutoregressiveConfig,
    CVAEConfig,
    DeterministicConfig,
    GaussianConfig,
    Guidance,
    Head,
    LatentPlanConfig,
    LogisticConfig,
    MixtureConfig,
    draw_noise,
    guided,
    masked_mean,
)
from playlearn.policies.heads.guidance import GuidedRows
from tests.policies.parts import MULTIMODAL, examples, generator, policy, train_on_two_modes


def test_masked_mean_counts_what_it_should() -> None:
    error = torch.tensor([[[1.0, 3.0], [float("nan"), 100.0]]])
    assert masked_mean(error, torch.tensor([[True, False]])) == 2.0  # (1 + 3) / 2
    assert masked_mean(error, torch.tensor([[False, False]])) == 0.0


def test_the_noise_of_a_row_comes_from_its_own_generator() -> None:
    rows = draw_noise((3, 2, 2), [generator(seed) for seed in (5, 6, 7)], torch.device("cpu"))
    assert torch.equal(rows[1], torch.randn(2, 2, generator=generator(6)))


@pytest.mark.parametrize(("loss", "expected"), [("l1", 0.0), ("mse", 0.25)])
def test_the_deterministic_head_finds_the_median_or_the_mean(loss: str, expected: float) -> None:
    """Of actions 0, 0, 0 and 1 the median is 0 and the mean is 0.25."""
    torch.manual_seed(0)
    head = DeterministicConfig(loss=loss, hidden=0).build(1, 1, 1)  # type: ignore[arg-type]
    optimizer = torch.optim.Adam(head.parameters(), lr=0.02)
    chunk = torch.tensor([0.0, 0, 0, 1]).view(4, 1, 1)
    for _ in range(300):
        optimizer.zero_grad()
        value, _ = head.loss(torch.ones(4, 1), chunk, torch.ones(4, 1, dtype=torch.bool), generator())
        value.backward()
        optimizer.step()
    assert head.mode(torch.ones(1, 1)).item() == pytest.approx(expected, abs=0.03)


WEIGHED = ("diffusion", "flow")  # whose mode weights are checked more closely


@functools.cache
def trained_with_decay(name: str) -> Head:
    """Cached: it takes seconds, and is the same every time."""
    return train_on_two_modes(MULTIMODAL[name], updates=600, decay=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", MULTIMODAL)
def test_a_multimodal_head_recovers_two_modes(name: str) -> None:
    """Samples must be near -1 or +1, by whole chunks, and never between.

    The mean, 0.5, is what a regression would say. Of 400 samples 300 +- 9 (one standard deviation) are
    expected at +1; 60 allows for a network trained for a second.
    """
    assert not MULTIMODAL[name].unimodal
    head = trained_with_decay(name) if name in WEIGHED else train_on_two_modes(MULTIMODAL[name], updates=400)
    with torch.no_grad():
        drawn = head.sample(torch.ones(400, 2), generator(2)).squeeze(-1)  # (400, 2)
    assert ((drawn.abs() - 1).abs() < 0.25).float().mean() > 0.95
    assert (drawn[:, 0].sign() == drawn[:, 1].sign()).float().mean() > 0.95
    assert (drawn[:, 0] > 0).sum().item() == pytest.approx(300, abs=60)


@pytest.mark.slow
def test_one_gaussian_averages_two_modes() -> None:
    """Why the other heads exist: mean 0.5 and standard deviation sqrt(0.75), where there is no data at all."""
    head = train_on_two_modes(GaussianConfig(hidden=32), updates=400)
    assert head.mode(torch.ones(1, 2)).flatten().tolist() == pytest.approx([0.5, 0.5], abs=0.1)
    drawn = head.sample(torch.ones(2000, 2), generator(2))
    assert drawn.std().item() == pytest.approx(0.75**0.5, abs=0.08)


LIKELY = {
    "gaussian": GaussianConfig(hidden=8),
    "mixture": MixtureConfig(components=3, hidden=8, std_range=(0.2, 0.8)),
    "logistic": LogisticConfig(components=3, bins=20, hidden=8),
    "autoregressive": AutoregressiveConfig(bins=20, width=16, layers=1, top_p=1.0),
}


@pytest.mark.parametrize("name", LIKELY)
@pytest.mark.parametrize("dimensions", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_likelihood_integrates_to_one_and_is_what_is_sampled(name: str, dimensions: int) -> None:
    """Quadrature over [-10, 10], where stds are at most 2 and means near 0, and the mean of 20,000 samples."""
    torch.manual_seed(3)
    head = LIKELY[name].build(4, dimensions, 1).double()
    features = torch.randn(1, 4, generator=generator(4)).double()
    axis = torch.arange(-9.975, 10, 0.05).double()  # the centers of 400 cells
    grid = torch.cartesian_prod(*[axis] * dimensions).view(-1, dimensions, 1)
    mask = torch.ones(len(grid), dimensions, dtype=torch.bool)
    with torch.no_grad():
        density = head.log_prob(features.expand(len(grid), -1), grid, mask).exp()  # type: ignore[operator]
        drawn = head.sample(features.expand(20000, -1), generator(5)).squeeze(-1)
    cell = float(axis[1] - axis[0]) ** dimensions
    assert float(density.sum()) * cell == pytest.approx(1.0, abs=1e-3)
    expected = (density[:, None] * grid.squeeze(-1)).sum(0) * cell
    torch.testing.assert_close(drawn.mean(0).double(), expected, atol=0.05, rtol=0)
    squares = (density[:, None] * (grid.squeeze(-1) - expected).square()).sum(0) * cell
    within_bins = {"logistic": 0.5**2 / 12, "autoregressive": 0.5**2 / 12}.get(name, 0.0)  # draws are bins' centers
    torch.testing.assert_close(drawn.var(0).double(), squares - within_bins, atol=0.0, rtol=0.05)


def test_a_masked_step_is_integrated_out() -> None:
    """Of two independent steps, hiding the second leaves the first's own density."""
    torch.manual_seed(0)
    head = GaussianConfig(hidden=8).build(4, 2, 1)
    features = torch.randn(1, 4, generator=generator())
    chunk = torch.tensor([[[0.3], [9.0]]])
    first = head.log_prob(features, chunk, torch.tensor([[True, False]]))
    second = head.log_prob(features, chunk, torch.tensor([[False, True]]))
    torch.testing.assert_close(first + second, head.log_prob(features, chunk, torch.tensor([[True, True]])))
    assert head.log_prob(features, chunk, torch.tensor([[False, False]])) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", WEIGHED)
def test_mode_weights_come_out_within_a_twentieth(name: str) -> None:
    """A quarter of the data is at -1: of 4,000 draws 0.25 +- 0.007 (one standard deviation) are expected there."""
    head = trained_with_decay(name)
    with torch.no_grad():
        drawn = head.sample(torch.ones(4000, 2), generator(2)).squeeze(-1)
    assert (drawn[:, 0] < 0).float().mean().item() == pytest.approx(0.25, abs=0.05)


def test_a_decoders_guidance_is_that_of_a_single_prediction() -> None:
    features, guidance = torch.randn(3, 4, generator=generator()), Guidance(torch.randn(3, 4), weight=2.5)
    net = torch.nn.Linear(4, 2)
    for guide in (None, guidance):
        rows = GuidedRows(features, guide)
        torch.testing.assert_close(rows.combine(net(rows.features)), guided(net, features, guide))
        assert rows.expand(features).shape == rows.features.shape


def test_the_kl_of_a_cvae_warms_up_in_training_and_counts_fully_outside_of_it() -> None:
    """The loss less the error is kl 0.5 (max(each dimension's divergence, free)): 0 at first, half of it midway."""
    model = policy(head="cvae", head_options={"warmup": 10, "kl": 0.5})
    charged = []
    for updates in (0, 5, 10, 1000, None):
        loss, metrics = model(examples(8), generator(), updates)
        charged.append((loss - metrics["error"]).item())
    assert charged[0] == pytest.approx(0.0, abs=1e-6)
    assert charged[2] > 0.05  # 4 dimensions of at least `free`, 0.05 nats, each: 0.1 or more
    assert charged[1] == pytest.approx(charged[2] / 2, rel=1e-4)
    assert charged[3:] == pytest.approx([charged[2]] * 2, rel=1e-4)


def test_guidance_extrapolates_from_without_to_with_the_goal() -> None:
    guide = Guidance(torch.zeros(1, 1), weight=3.0)
    assert guide.combine(torch.tensor(2.0), torch.tensor(1.0)) == 4.0  # 1 + 3 (2 - 1)


def test_the_probabilities_of_a_logistics_bins_sum_to_one() -> None:
    """Of two numbers, the probabilities of all 12 x 12 pairs of bins, each density times the bin's area, sum to one.

    Whatever the weights, and with a std so small that nearly all is in one bin, or so large that it is in the tails.
    """
    data = torch.rand(200, 1, 2, generator=generator()) * torch.tensor([1.0, 3.0]) - 0.5
    for scale_range in ((0.001, 0.002), (0.5, 1.0), (50.0, 60.0)):
        torch.manual_seed(0)
        head = LogisticConfig(components=3, bins=12, hidden=8, scale_range=scale_range).build(4, 1, 2).double()
        head.fit_action_statistics(data.double())
        low, width = head.law.get_buffer("low"), head.law.get_buffer("width")
        centers = low + (torch.arange(12)[:, None] + 0.5) * width  # (12, 2)
        grid = torch.cartesian_prod(centers[:, 0], centers[:, 1]).unsqueeze(1)  # (144, 1, 2)
        features = torch.randn(1, 4, generator=generator(1)).double().expand(144, -1)
        mask = torch.ones(144, 1, dtype=torch.bool)
        probability = head.log_prob(features, grid, mask).exp() * width.prod()
        assert probability.sum().item() == pytest.approx(1.0, abs=1e-9)
        beyond = grid + 12 * width
        assert (head.log_prob(features, beyond, mask) == -torch.inf).all()
        assert head.loss(features, beyond, mask, generator())[0].isfinite()


@pytest.mark.slow
def test_a_proposed_plan_is_one_that_was_recognized() -> None:
    """With two modes in the data, its draws lead to both, by their weights, and seldom to what is between."""
    head = train_on_two_modes(LatentPlanConfig(latent=2, hidden=32, kl=0.1), updates=1000)
    with torch.no_grad():
        drawn = head.sample(torch.ones(400, 2), generator(2)).squeeze(-1)
    assert ((drawn.abs() - 1).abs() < 0.25).float().mean() > 0.75
    assert (drawn[:, 0] > 0).sum().item() == pytest.approx(300, abs=60)


@pytest.mark.slow
def test_the_latent_matters_where_there_are_two_modes() -> None:
    """And chooses between them. It is continuous, so some z must lead to what lies between: here one in eight."""
    head = train_on_two_modes(CVAEConfig(latent=2, hidden=32, kl=0.1, warmup=100), updates=1500)
    chunk = torch.tensor([1.0, -1.0]).repeat(50).view(100, 1, 1).expand(100, 2, 1)
    with torch.no_grad():
        _, metrics = head.loss(torch.ones(100, 2), chunk, torch.ones(100, 2, dtype=torch.bool), generator())
        drawn = head.sample(torch.ones(400, 2), generator(2)).squeeze(-1)
    assert metrics["z_matters"] > 2  # with the other mode's z the error is three times as large or more
    assert ((drawn.abs() - 1).abs() < 0.25).float().mean() > 0.75
    assert (drawn[:, 0] > 0).sum().item() == pytest.approx(300, abs=60)
