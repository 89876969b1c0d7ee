"""At which noise levels a diffusion head asks its denoiser: from the noisiest on, evenly, as often as was said."""

from typing import Any

import pytest
import torch

from playlearn.policies.heads import DiffusionConfig


class Asked(torch.nn.Module):
    """A denoiser that remembers at which steps it was asked, noisiest first, and predicts zero."""

    def __init__(self) -> None:
        super().__init__()
        self.times: list[int] = []

    def forward(self, noisy: torch.Tensor, time: torch.Tensor, _features: torch.Tensor) -> torch.Tensor:
        self.times += time.flatten().tolist()
        return torch.zeros_like(noisy)


@pytest.mark.parametrize("sampler", ["ddim", "dpm"])
@pytest.mark.parametrize("count", [1, 4, 5, 10])
def test_sampling_begins_at_the_noisiest_step_and_goes_down_evenly(sampler: Any, count: int) -> None:
    """A sample starts as pure noise, and so must the first step say: 99 of 100, then every 100 / count further."""
    head = DiffusionConfig(width=8, blocks=1, train_steps=100, sample_steps=count, sampler=sampler).build(4, 2, 1)
    head.denoiser = Asked()
    head.mode(torch.zeros(3, 4))
    assert head.denoiser.times == [100 - 1 - k * 100 // count for k in range(count)]
