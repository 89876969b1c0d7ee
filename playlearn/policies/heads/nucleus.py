"""Nucleus sampling (Holtzman et al. 2020): a token drawn from the likeliest ones."""

import torch
from torch import Tensor


def draw_tokens(logits: Tensor, uniforms: Tensor, temperature: float, top_p: float) -> Tensor:
    """(..., K) logits and (...) numbers, uniform in (0, 1) -> (...) tokens."""
    cumulative = nucleus((logits / temperature).softmax(-1), top_p).cumsum(-1)
    tokens = torch.searchsorted(cumulative, uniforms.unsqueeze(-1) * cumulative[..., -1:]).squeeze(-1)
    # a draw beyond what rounding left of the sum is the last token
    return tokens.clamp_(max=logits.shape[-1] - 1)


def nucleus(probability: Tensor, top_p: float) -> Tensor:
    """(..., K): only the likeliest tokens that together have a probability of `top_p`."""
    if top_p >= 1:
        return probability
    ordered, order = probability.sort(-1, descending=True)
    kept = torch.where(ordered.cumsum(-1) - ordered < top_p, ordered, 0.0)
    return torch.zeros_like(probability).scatter(-1, order, kept)
