"""The network of the diffusion and flow heads: residual layers modulated (FiLM) by features and time."""

import torch
from torch import Tensor, nn


class Denoiser(nn.Module):
    """(N, B, H A) noisy chunks, (N, B) times and (B, D) features -> (N, B, H A).

    Scale and shift of a block are the sum of a projection of the features, computed once an example, and one of the
    time, looked up among `times`. N noised copies of a chunk then cost no more than their own layers.
    """

    def __init__(self, width: int, blocks: int, times: int, features: int, out: int) -> None:
        super().__init__()
        self.in_proj = nn.Linear(out, width)
        self.from_features = nn.Linear(features, blocks * 2 * width)
        self.from_time = nn.Sequential(nn.Linear(64, 128), nn.SiLU(), nn.Linear(128, blocks * 2 * width))
        self.blocks = nn.ModuleList(_Block(width) for _ in range(blocks))
        self.out_proj = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, out))
        self.register_buffer("times", _sinusoids(times, 64), persistent=False)

    def forward(self, noisy: Tensor, time: Tensor, features: Tensor) -> Tensor:
        film = self.from_features(features) + self._film(time)  # (N, B, 2 W blocks)
        hidden = self.in_proj(noisy)  # (N, B, W)
        for block, modulation in zip(self.blocks, film.chunk(len(self.blocks), dim=-1), strict=True):
            hidden = block(hidden, modulation)
        out: Tensor = self.out_proj(hidden)
        return out

    def _film(self, time: Tensor) -> Tensor:
        """(N, B) times -> (N, B, 2 W blocks): only the times needed or, where those are many, all there are."""
        times = self.get_buffer("times")
        if time.numel() < len(times):
            few: Tensor = self.from_time(times[time])
            return few
        return nn.functional.embedding(time, self.from_time(times))


class _Block(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width, elementwise_affine=False)
        self.inner = nn.Linear(width, width)
        self.outer = nn.Linear(width, width)

    def forward(self, hidden: Tensor, film: Tensor) -> Tensor:
        scale, shift = film.chunk(2, dim=-1)
        modulated = torch.addcmul(shift, self.norm(hidden), 1 + scale)
        out: Tensor = hidden + self.outer(nn.functional.silu(self.inner(modulated)))
        return out


def _sinusoids(steps: int, width: int) -> Tensor:
    """(steps, width): sine and cosine of the step at geometrically spaced frequencies."""
    frequencies = torch.exp(-torch.arange(width // 2) / (width // 2) * torch.log(torch.tensor(1e4)))
    angles = torch.arange(steps)[:, None] * frequencies
    return torch.cat([angles.sin(), angles.cos()], dim=1)
