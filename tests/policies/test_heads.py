"""Laws of the heads."""

import pytest
import torch

from playlearn.policies.heads import DeterministicConfig, DiffusionConfig, Guidance, draw_noise, masked_mean
from tests.policies.parts import generator


def test_masked_mean_counts_what_it_should() -> None:
    error = torch.tensor([[[1.0, 3.0], [float("nan"), 100.0]]])
    assert masked_mean(error, torch.tensor([[True, False]])) == 2.0  # (1 + 3) / 2
    assert masked_mean(error, torch.tensor([[False, False]])) == 0.0


def test_noise_of_a_row_is_its_own_generators() -> None:
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


@pytest.mark.parametrize("prediction", ["sample", "epsilon", "v_prediction"])
def test_diffusion_recovers_two_modes(prediction: str) -> None:
    """Data is -1 or +1 (a quarter and three quarters), by whole chunks: samples must be so too, never between.

    The mean, 0.5, is what a regression would say. Of 400 samples 300 +- 9 (one standard deviation) are
    expected at +1; 60 allows for a network trained for a second.
    """
    torch.manual_seed(0)
    config = DiffusionConfig(width=64, blocks=2, train_steps=50, prediction=prediction, sample_steps=10, clip=1.2)  # type: ignore[arg-type]
    head = config.build(2, 2, 1)
    optimizer = torch.optim.Adam(head.parameters(), lr=3e-3)
    rng = generator(1)
    for _ in range(400):
        sign = torch.where(torch.rand(64, generator=rng) < 0.75, 1.0, -1.0)
        optimizer.zero_grad()
        loss, _ = head.loss(
            torch.ones(64, 2), sign.view(64, 1, 1).expand(64, 2, 1), torch.ones(64, 2, dtype=torch.bool), rng
        )
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        drawn = head.sample(torch.ones(400, 2), generator(2)).squeeze(-1)  # (400, 2)
    assert ((drawn.abs() - 1).abs() < 0.25).float().mean() > 0.95
    assert (drawn[:, 0].sign() == drawn[:, 1].sign()).float().mean() > 0.95
    assert (drawn[:, 0] > 0).sum().item() == pytest.approx(300, abs=60)


def test_both_samplers_end_where_a_perfect_denoiser_points() -> None:
    """If the denoiser always answers with the clean chunk c, every sampler must return c."""

    class Oracle(torch.nn.Module):
        def forward(self, noisy: torch.Tensor, time: torch.Tensor, features: torch.Tensor) -> torch.Tensor:
            return features.expand_as(noisy)

    for sampler in ("ddim", "dpm"):
        head = DiffusionConfig(sampler=sampler, sample_steps=8).build(4, 2, 2)  # type: ignore[arg-type]
        head.denoiser = Oracle()
        clean = torch.randn(3, 4, generator=generator())
        torch.testing.assert_close(head.sample(clean, generator(1)).flatten(1), clean, atol=0.05, rtol=0)


def test_guidance_extrapolates_from_without_to_with_the_goal() -> None:
    guide = Guidance(torch.zeros(1, 1), weight=3.0)
    assert guide.combine(torch.tensor(2.0), torch.tensor(1.0)) == 4.0  # 1 + 3 (2 - 1)
