"""Laws of the samplers of diffusion."""

import pytest
import torch

from playlearn.policies.heads import DiffusionConfig, draw_noise
from tests.policies.parts import generator


def test_both_samplers_end_where_a_perfect_denoiser_points() -> None:
    """If the denoiser always predicts the clean chunk c, every sampler must return c."""

    class Oracle(torch.nn.Module):
        def forward(self, noisy: torch.Tensor, time: torch.Tensor, features: torch.Tensor) -> torch.Tensor:
            return features.expand_as(noisy)

    for sampler in ("ddim", "dpm"):
        head = DiffusionConfig(sampler=sampler, sample_steps=8).build(4, 2, 2)  # type: ignore[arg-type]
        head.denoiser = Oracle()
        clean = torch.randn(3, 4, generator=generator())
        torch.testing.assert_close(head.sample(clean, generator(1)).flatten(1), clean, atol=0.05, rtol=0)


class GaussianDenoiser(torch.nn.Module):
    """The best estimate of the clean chunk where the data is N(mean, std^2): linear in the noisy chunk.

    That is x = sqrt(a) c + sqrt(1 - a) noise, so E[c | x] = mean + g (x - sqrt(a) mean) with
    g = sqrt(a) std^2 / (a std^2 + 1 - a).
    """

    def __init__(self, kept: torch.Tensor, mean: float, std: float) -> None:
        super().__init__()
        self.kept, self.mean, self.std = kept, mean, std

    def forward(self, noisy: torch.Tensor, time: torch.Tensor, features: torch.Tensor) -> torch.Tensor:
        a = self.kept[time].unsqueeze(-1)
        gain = a.sqrt() * self.std**2 / (a * self.std**2 + 1 - a)
        return self.mean + gain * (noisy - a.sqrt() * self.mean)


@pytest.mark.parametrize("sampler", ["ddim", "dpm"])
def test_all_steps_of_a_sampler_lead_noise_to_the_known_gaussian(sampler: str) -> None:
    """With the best denoiser of N(0.4, 0.3^2) the path without noise ends in c = 0.4 + 0.3 z of its first draw z.

    Zero noise must end in the mean itself, which is where DDPM's mean path ends too; the std of many draws
    must be 0.3. The noisiest step keeps a little of the clean chunk, so z is recovered to some per cent.
    """
    mean, std = 0.4, 0.3
    head = DiffusionConfig(train_steps=200, sample_steps=200, sampler=sampler).build(4, 2, 1)  # type: ignore[arg-type]
    kept = head.noiser.alphas_cumprod
    head.denoiser = GaussianDenoiser(kept, mean, std)
    features = torch.zeros(4000, 4)
    with torch.no_grad():
        drawn = head.sample(features, generator(1))
        middle = head.mode(features[:1])
        # DDPM's own mean path: the mean of q(x_{t-1} | x_t, c) at every step, from zero noise
        path = torch.zeros(1, 2, 1)
        for t in range(199, -1, -1):
            before = kept[t - 1] if t else torch.tensor(1.0)
            alpha = kept[t] / before
            clean = head.denoiser(path.flatten(1).unsqueeze(0), torch.full((1, 1), t), features)[0].view(1, 2, 1)
            path = (before.sqrt() * (1 - alpha) * clean + alpha.sqrt() * (1 - before) * path) / (1 - kept[t])
    torch.testing.assert_close(middle, path, atol=0.01, rtol=0)
    torch.testing.assert_close(middle, torch.full_like(middle, mean), atol=0.01, rtol=0)
    assert drawn.mean().item() == pytest.approx(mean, abs=0.015)
    assert drawn.std().item() == pytest.approx(std, abs=0.015)
    torch.testing.assert_close(
        drawn, mean + std * draw_noise(drawn.shape, generator(1), drawn.device), atol=0.06, rtol=0
    )


def test_what_is_rarely_other_than_zero_can_be_predicted() -> None:
    """A switch used once in 400 steps lies 20 standard deviations from its mean, far beyond the usual 5."""

    class Oracle(torch.nn.Module):
        def forward(self, noisy: torch.Tensor, time: torch.Tensor, features: torch.Tensor) -> torch.Tensor:
            return features.expand_as(noisy)

    head = DiffusionConfig(sample_steps=8).build(1, 1, 1)
    head.denoiser = Oracle()
    assert head.mode(torch.full((1, 1), 20.0)).item() == pytest.approx(5.0)
    head.fit_action_statistics(torch.tensor([0.0, 20.0]).view(2, 1, 1))
    assert head.mode(torch.full((1, 1), 20.0)).item() == pytest.approx(20.0)
    head.fit_action_statistics(torch.tensor([0.0, 1.0]).view(2, 1, 1))
    assert head.reach.item() == 5.0
