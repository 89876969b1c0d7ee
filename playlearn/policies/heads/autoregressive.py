"""Actions as words (RT-1, Brohan et al. 2022): every number of a chunk is one of `bins`, predicted in turn.

order     positions   one forward pass gives        passes to sample
token     H A         the next number               H A, with a key-value cache
step      H           the A numbers of a step       H, with a key-value cache
parallel  H           everything at once            1
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from playlearn.policies.heads.base import Generators, Guidance, Head, HeadConfig, draw_noise
from playlearn.policies.heads.decoder import Decoder

LIMIT = 5.0  # standard deviations that the bins span before `fit` has seen any data


@HeadConfig.register_subclass("autoregressive")
@dataclass(frozen=True)
class AutoregressiveConfig(HeadConfig):
    """bins: values a number can take. binning: of equal width, or of equal share of the data.

    order: see the module. width, layers, heads: of the causal decoder. soft: spread, in bins, of the
    target around the true one, 0 for none. temperature, top_p: of sampling; top_p keeps the likeliest
    bins that together have that share.
    """

    bins: int = 256
    binning: Literal["uniform", "quantile"] = "uniform"
    order: Literal["token", "step", "parallel"] = "token"
    width: int = 128
    layers: int = 2
    heads: int = 4
    label_smoothing_bins: float = 1.0
    temperature: float = 1.0
    top_p: float = 0.95

    def build(self, width: int, chunk: int, actions: int) -> "AutoregressiveHead":
        return AutoregressiveHead(self, width, chunk, actions)


class AutoregressiveHead(Head):
    def __init__(self, config: AutoregressiveConfig, width: int, chunk: int, actions: int) -> None:
        super().__init__()
        self.config = config
        self.shape = (chunk, actions)
        self.unit = 1 if config.order == "token" else actions  # numbers that one position stands for
        self.register_buffer("edges", torch.linspace(-LIMIT, LIMIT, config.bins + 1).repeat(actions, 1))  # (A, K + 1)
        positions = chunk * actions // self.unit
        self.in_proj = nn.Linear(width, config.width)
        self.token_embedding = nn.Embedding(actions * config.bins, config.width)
        self.pos_embedding = nn.Parameter(torch.randn(positions, config.width) * 0.1)
        self.decoder = Decoder(config.width, config.layers, config.heads)
        self.out_proj = nn.Parameter(torch.randn(actions, config.bins, config.width) * config.width**-0.5)

    def fit_action_statistics(self, chunks: Tensor) -> None:
        """Span each action's bins over what the data holds."""
        values = chunks.flatten(0, -2).T.contiguous()  # (A, n)
        edges = self.get_buffer("edges")
        share = torch.linspace(0, 1, self.config.bins + 1)
        if self.config.binning == "uniform":
            low, high = values.min(1, keepdim=True).values, values.max(1, keepdim=True).values
            made = low + (high - low).clamp(min=1e-3) * share
        else:
            ranked = values.sort(1).values
            made = ranked[:, (share * (ranked.shape[1] - 1)).round().long()]
            # a value that is met often fills several bins: keep each at least a hair wide
            made = made + 1e-5 * torch.arange(self.config.bins + 1)
        edges.copy_(made)

    def tokens(self, chunk: Tensor) -> Tensor:
        """(B, H, A) numbers -> (B, H, A) bins."""
        edges = self.get_buffer("edges")
        inner = edges[:, 1:-1].contiguous()  # (A, K - 1)
        values = chunk.detach().flatten(0, 1).T.contiguous()  # (A, B H)
        found: Tensor = torch.searchsorted(inner, values, right=True).T.view(chunk.shape)
        return found

    def numbers(self, tokens: Tensor) -> Tensor:
        """(B, H, A) bins -> (B, H, A), their centers."""
        edges = self.get_buffer("edges")
        centers = (edges[:, 1:] + edges[:, :-1]) / 2
        return centers[torch.arange(self.shape[1], device=tokens.device), tokens]

    def loss(
        self, features: Tensor, chunk: Tensor, mask: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Cross-entropy in nats a number."""
        tokens = self.tokens(torch.where(mask.unsqueeze(-1), chunk, 0.0))
        logs = self._logits(features, tokens).log_softmax(-1)  # (B, H, A, K)
        weight = mask.unsqueeze(-1).expand(tokens.shape)
        count = weight.sum().clamp(min=1)
        missed = -(self._target(tokens) * logs).sum(-1)
        right = (logs.argmax(-1) == tokens) & weight
        return torch.where(weight, missed, 0.0).sum() / count, {"accuracy": right.sum() / count}

    def log_prob(self, features: Tensor, chunk: Tensor, mask: Tensor) -> Tensor:
        """(B,) log density, constant within a bin and 0 outside all, of the actions that `mask` (B, H) leaves."""
        shown, edges = torch.where(mask.unsqueeze(-1), chunk, 0.0), self.get_buffer("edges")
        tokens = self.tokens(shown)
        logs = self._logits(features, tokens).log_softmax(-1).gather(-1, tokens.unsqueeze(-1)).squeeze(-1)
        widths = (edges[:, 1:] - edges[:, :-1])[torch.arange(self.shape[1], device=tokens.device), tokens]
        within = (shown >= edges[:, 0]) & (shown <= edges[:, -1])
        each = torch.where(within, logs - widths.log(), -torch.inf)
        total: Tensor = torch.where(mask.unsqueeze(-1), each, 0.0).sum((1, 2))
        return total

    def sample(self, features: Tensor, generator: Generators, guidance: Guidance | None = None) -> Tensor:
        normal = draw_noise((len(features), *self.shape), generator, features.device)
        uniforms = torch.special.ndtr(normal).flatten(
            1
        )  # uniform in (0, 1): where in the cumulated shares the draw falls

        def choose(logits: Tensor, first: int) -> Tensor:
            share = top((logits / self.config.temperature).softmax(-1), self.config.top_p)
            drawn = uniforms[:, first : first + logits.shape[1], None]
            below = share.cumsum(-1)
            # a draw beyond what rounding left of the sum falls into the last bin
            return torch.searchsorted(below, drawn * below[..., -1:]).squeeze(-1).clamp_(max=self.config.bins - 1)

        return self._decode(features, guidance, choose)

    def mode(self, features: Tensor, guidance: Guidance | None = None) -> Tensor:
        """The likeliest number at each turn, given those before it."""
        return self._decode(features, guidance, lambda logits, _: logits.argmax(-1))

    def _decode(self, features: Tensor, guidance: Guidance | None, choose: Callable[[Tensor, int], Tensor]) -> Tensor:
        """choose: from logits (B, n, K) of the numbers from `first` on to their bins (B, n)."""
        count, (steps, actions) = len(features), self.shape
        given = self.in_proj(features if guidance is None else torch.cat([features, guidance.features]))
        if self.config.order == "parallel":
            logits = self._out(self._pass(given.unsqueeze(1) + self.pos_embedding))
            return self.numbers(choose(guided(logits, guidance).flatten(1, 2), 0).view(count, steps, actions))
        weights = self.out_proj.view(-1, self.unit * self.config.bins, self.config.width).unbind()  # by the turn
        token_embedding = self.token_embedding.weight.view(-1, self.unit, self.config.bins, self.config.width)
        tables = [[table.contiguous() for table in turn] for turn in token_embedding]
        turns = self.decoder.steps(len(given), len(self.pos_embedding))
        chosen: list[Tensor] = []
        hidden = given
        for place, here in enumerate(self.pos_embedding.unbind()):
            turn = place % len(weights)
            logits = functional.linear(turns.next(hidden + here), weights[turn])
            logits = guided(logits.view(len(given), self.unit, -1), guidance)
            tokens = choose(logits, place * self.unit)  # (B, unit)
            chosen.append(tokens)
            hidden = given
            for table, word in zip(tables[turn], tokens.unbind(1), strict=True):
                before = functional.embedding(word, table)
                hidden = hidden + (before if guidance is None else before.repeat(2, 1))
        return self.numbers(torch.cat(chosen, dim=1).view(count, steps, actions))

    def _logits(self, features: Tensor, tokens: Tensor) -> Tensor:
        """(B, H, A, K) of every number given the true ones before it."""
        hidden = self.in_proj(features).unsqueeze(1) + self.pos_embedding  # (B, positions, W)
        if self.config.order != "parallel":
            actions = torch.arange(self.shape[1], device=tokens.device) * self.config.bins
            tables = self.token_embedding(tokens + actions)  # (B, H, A, W)
            tables = tables.flatten(1, 2) if self.unit == 1 else tables.sum(2)
            hidden = hidden + functional.pad(tables[:, :-1], (0, 0, 1, 0))
        return self._out(self._pass(hidden))

    def _pass(self, hidden: Tensor) -> Tensor:
        out: Tensor = self.decoder(hidden, causal=self.config.order != "parallel")
        return out

    def _out(self, hidden: Tensor) -> Tensor:
        """(B, positions, W) -> (B, H, A, K)."""
        if self.unit == 1:
            return torch.einsum("bhaw,akw->bhak", hidden.unflatten(1, self.shape), self.out_proj)
        return torch.einsum("bhw,akw->bhak", hidden, self.out_proj)

    def _target(self, tokens: Tensor) -> Tensor:
        """(B, H, A, K) the share of each bin in what is to be predicted."""
        bins = torch.arange(self.config.bins, device=tokens.device)
        off = (bins - tokens.unsqueeze(-1)).float()
        if self.config.label_smoothing_bins == 0:
            return (off == 0).float()
        return (-0.5 * (off / self.config.label_smoothing_bins).square()).softmax(-1)


def guided(logits: Tensor, guidance: Guidance | None) -> Tensor:
    """With guidance the batch holds every example twice: with its goal, then without."""
    if guidance is None:
        return logits
    return guidance.combine(*logits.chunk(2))


def top(share: Tensor, top_p: float) -> Tensor:
    """Only the likeliest bins that together have `top_p` of all (nucleus sampling, Holtzman et al. 2020)."""
    if top_p >= 1:
        return share
    ordered, order = share.sort(-1, descending=True)
    kept = torch.where(ordered.cumsum(-1) - ordered < top_p, ordered, 0.0)
    return torch.zeros_like(share).scatter(-1, order, kept)
