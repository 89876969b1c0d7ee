"""Laws of the heads that make tokens of chunks: autoregressive and FAST."""

import pytest
import torch

from playlearn.policies.heads import AutoregressiveConfig, FastConfig
from tests.policies.parts import generator


@pytest.mark.parametrize("binning", ["uniform", "quantile"])
def test_tokens_and_numbers_again_an_action_is_at_most_half_a_bin_off(binning: str) -> None:
    head = AutoregressiveConfig(bins=16, binning=binning, width=8, layers=1, heads=1).build(4, 3, 2)  # type: ignore[arg-type]
    chunk = torch.randn(50, 3, 2, generator=generator()) * torch.tensor([1.0, 0.2])
    head.fit_action_statistics(chunk)
    tokens = head.tokens(chunk)
    edges = head.get_buffer("edges")
    width = (edges[:, 1:] - edges[:, :-1])[torch.arange(2), tokens]
    assert ((head.numbers(tokens) - chunk).abs() <= width / 2 + 1e-4).all()
    if binning == "quantile":  # 300 numbers in 2 x 16 bins: each holds 9.4
        counts = torch.stack([torch.bincount(tokens[..., a].flatten(), minlength=16) for a in range(2)])
        assert counts.min() >= 7


@pytest.mark.parametrize("order", ["token", "step", "parallel"])
def test_decoding_with_a_cache_is_decoding_without(order: str) -> None:
    """Every token chosen one after the other is the likeliest one in a single pass over all of them."""
    torch.manual_seed(1)
    head = AutoregressiveConfig(bins=8, order=order, width=16, layers=2, heads=2).build(4, 3, 2)  # type: ignore[arg-type]
    features = torch.randn(5, 4, generator=generator())
    with torch.no_grad():
        tokens = head.tokens(head.mode(features))
        again = head._logits(features, tokens).argmax(-1)
    assert torch.equal(tokens, again)


def smooth(count: int, steps: int, actions: int) -> torch.Tensor:
    """Slow waves, of about unit std."""
    phase, speed = (torch.rand(count, 1, actions, generator=generator(seed)) for seed in (1, 2))
    return 1.4 * torch.sin(6.3 * phase + 0.2 * speed * torch.arange(steps)[:, None])


def test_tokens_are_the_chunk_up_to_rounding_and_fewer_than_its_numbers() -> None:
    """A coefficient is at most half a step of 1 / 10 off, and the transform keeps lengths: sqrt(H A) / 20 in all.

    A learned vocabulary makes a smooth chunk of 16 x 3 numbers less than half as long; without it every number is a
    token.
    """
    head = FastConfig(width=8, layers=1, heads=1).build(4, 16, 3)
    chunk = smooth(500, 16, 3)
    assert head.token_ids_of(chunk).shape == (500, 16 * 3 + 1)
    head.fit_action_statistics(chunk)
    token_ids = head.token_ids_of(chunk)
    off = (head.numbers(token_ids) - chunk).flatten(1).norm(dim=1)
    assert off.max() <= (16 * 3) ** 0.5 / 20 + 1e-4
    assert (token_ids != head.end).sum(1).float().mean() < 16 * 3 / 2


def test_too_few_or_too_many_tokens_still_are_a_chunk() -> None:
    head = FastConfig(width=8, layers=1, heads=1).build(4, 4, 2)
    zero = head.token_ids_of(torch.zeros(1, 4, 2))[:, :1]
    none, many = torch.full((1, 1), head.end), zero.repeat(1, 30)
    for token_ids in (none, many):
        assert torch.equal(head.numbers(token_ids), torch.zeros(1, 4, 2))


def test_the_tokenizer_is_saved_with_the_weights_and_decoding_with_a_cache_is_decoding_without() -> None:
    torch.manual_seed(1)
    config = FastConfig(vocabulary=300, width=16, layers=2, heads=2)
    head, other = config.build(4, 8, 2), config.build(4, 8, 2)
    head.fit_action_statistics(smooth(200, 8, 2))
    other.load_state_dict(head.state_dict())
    features, decoded = torch.randn(5, 4, generator=generator()), []
    numbers = other.numbers
    other.numbers = lambda ids: (decoded.append(ids), numbers(ids))[1]  # type: ignore[method-assign,func-returns-value]
    with torch.no_grad():
        assert torch.equal(other.mode(features), head.mode(features))
        token_ids = decoded[0]
        before = torch.nn.functional.pad(other.token_embedding(token_ids[:, :-1]), (0, 0, 1, 0))
        hidden = other.in_proj(features).unsqueeze(1) + other.pos_embedding[: token_ids.shape[1]] + before
        assert torch.equal(other.out_proj(other.decoder(hidden)).argmax(-1), token_ids)


def test_a_chunk_that_reaches_far_is_still_within_the_letters() -> None:
    """20 standard deviations for a whole chunk, beside a number of the usual size that keeps its fine steps."""
    chunks = smooth(50, 8, 2)
    chunks[7, :, 1] = 20.0
    head = FastConfig(vocabulary=300, width=16, layers=1, heads=2).build(4, 8, 2)
    assert (head.numbers(head.token_ids_of(chunks)) - chunks).abs()[7, :, 1].max() > 10
    head.fit_action_statistics(chunks)
    assert (head.numbers(head.token_ids_of(chunks)) - chunks).abs()[..., 1].max() < 0.4
    assert head.scale[0] == head.config.scale
