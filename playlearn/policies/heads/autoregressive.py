"""Actions as tokens (RT-1, Brohan et al. 2022): every number of a chunk is one of `bins`, predicted in order.

order     positions   one forward pass gives        passes to sample
token     H A         the next number               H A, with a key-value cache
step      H           the A numbers of a step       H, with a key-value cache
parallel  H           all numbers                   1
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from playlearn.policies.heads.base import Generators, Head, HeadConfig, draw_noise
from playlearn.policies.heads.decoder import Decoder
from playlearn.policies.heads.guidance import Guidance, GuidedRows
from playlearn.policies.heads.nucleus import draw_tokens

LIMIT = 5.0  # standard deviations that the bins span before `fit_action_statistics`


@HeadConfig.register_subclass("autoregressive")
@dataclass(frozen=True)
class AutoregressiveConfig(HeadConfig):
    """Chunks as tokens, one a number.

    bins: values a number can take.
    binning: bins of equal width, or each with an equal fraction of the data.
    order: what one forward pass predicts; see the module.
    width: of the causal decoder.
    layers: of the causal decoder.
    heads: attention heads of the causal decoder.
    label_smoothing_bins: standard deviation, in bins, of the target around the true bin (0: the true bin alone).
    temperature: of sampling.
    top_p: sampling draws among the likeliest bins that together have this probability.
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
        self.unit = 1 if config.order == "token" else actions  # numbers per position
        self.register_buffer("edges", torch.linspace(-LIMIT, LIMIT, config.bins + 1).repeat(actions, 1))  # (A, K + 1)
        positions = chunk * actions // self.unit
        self.in_proj = nn.Linear(width, config.width)
        self.token_embedding = nn.Embedding(actions * config.bins, config.width)
        self.pos_embedding = nn.Parameter(torch.randn(positions, config.width) * 0.1)
        self.decoder = Decoder(config.width, config.layers, config.heads)
        self.out_proj = nn.Parameter(torch.randn(actions, config.bins, config.width) * config.width**-0.5)

    def fit_action_statistics(self, chunks: Tensor) -> None:
        """Let each action's bins span the range of the data."""
        values = chunks.flatten(0, -2).T.contiguous()  # (A, n)
        edges = self.get_buffer("edges")
        fraction = torch.linspace(0, 1, self.config.bins + 1)
        if self.config.binning == "uniform":
            low, high = values.min(1, keepdim=True).values, values.max(1, keepdim=True).values
            fitted = low + (high - low).clamp(min=1e-3) * fraction
        else:
            ranked = values.sort(1).values
            fitted = ranked[:, (fraction * (ranked.shape[1] - 1)).round().long()]
            # a frequent value fills several bins: keep each a little wider than 0
            fitted = fitted + 1e-5 * torch.arange(self.config.bins + 1)
        edges.copy_(fitted)

    def tokens(self, chunk: Tensor) -> Tensor:
        """(B, H, A) numbers -> (B, H, A) bins."""
        edges = self.get_buffer("edges")
        inner = edges[:, 1:-1].contiguous()  # (A, K - 1)
        values = chunk.detach().flatten(0, 1).T.contiguous()  # (A, B H)
        tokens: Tensor = torch.searchsorted(inner, values, right=True).T.view(chunk.shape)
        return tokens

    def numbers(self, tokens: Tensor) -> Tensor:
        """(B, H, A) bins -> (B, H, A), their centers."""
        edges = self.get_buffer("edges")
        centers = (edges[:, 1:] + edges[:, :-1]) / 2
        return centers[torch.arange(self.shape[1], device=tokens.device), tokens]

    def loss(
        self, features: Tensor, chunk: Tensor, mask: Tensor, generator: torch.Generator, updates: int | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Cross-entropy in nats a number."""
        tokens = self.tokens(torch.where(mask.unsqueeze(-1), chunk, 0.0))
        logs = self._logits(features, tokens).log_softmax(-1)  # (B, H, A, K)
        weight = mask.unsqueeze(-1).expand(tokens.shape)
        count = weight.sum().clamp(min=1)
        nats = -(self._target(tokens) * logs).sum(-1)  # (B, H, A)
        correct = (logs.argmax(-1) == tokens) & weight
        return torch.where(weight, nats, 0.0).sum() / count, {"accuracy": correct.sum() / count}

    def log_prob(self, features: Tensor, chunk: Tensor, mask: Tensor) -> Tensor:
        """(B,) log density of the actions whose `mask` (B, H) is True; constant within a bin, 0 outside all bins."""
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
        uniforms = torch.special.ndtr(normal).flatten(1)  # (B, H A), in (0, 1)

        def choose(logits: Tensor, first: int) -> Tensor:
            drawn = uniforms[:, first : first + logits.shape[1]]
            return draw_tokens(logits, drawn, self.config.temperature, self.config.top_p)

        return self._decode(features, guidance, choose)

    def mode(self, features: Tensor, guidance: Guidance | None = None) -> Tensor:
        """The likeliest number at each pass, given those before it."""
        return self._decode(features, guidance, lambda logits, _: logits.argmax(-1))

    def _decode(self, features: Tensor, guidance: Guidance | None, choose: Callable[[Tensor, int], Tensor]) -> Tensor:
        """choose: from the logits (B, n, K) of n numbers, and the index of the first, to their bins (B, n)."""
        count, (steps, actions) = len(features), self.shape
        rows = GuidedRows(features, guidance)
        given = self.in_proj(rows.features)  # (R, W)
        if self.config.order == "parallel":
            logits = self._out(self._pass(given.unsqueeze(1) + self.pos_embedding))
            return self.numbers(choose(rows.combine(logits).flatten(1, 2), 0).view(count, steps, actions))
        # one matrix, and one list of embedding tables, for each position of a step
        weights = self.out_proj.view(-1, self.unit * self.config.bins, self.config.width).unbind()
        embeddings = self.token_embedding.weight.view(-1, self.unit, self.config.bins, self.config.width)
        tables = [[table.contiguous() for table in part] for part in embeddings]
        decoder = self.decoder.steps(len(given), len(self.pos_embedding))
        chosen: list[Tensor] = []
        hidden = given
        for position, embedding in enumerate(self.pos_embedding.unbind()):
            part = position % len(weights)
            logits = functional.linear(decoder.next(hidden + embedding), weights[part])
            logits = rows.combine(logits.view(len(given), self.unit, -1))
            tokens = choose(logits, position * self.unit)  # (B, unit)
            chosen.append(tokens)
            hidden = given
            for table, token in zip(tables[part], tokens.unbind(1), strict=True):
                hidden = hidden + rows.expand(functional.embedding(token, table))
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
        """(B, H, A, K) the probability of each bin in the target."""
        bins = torch.arange(self.config.bins, device=tokens.device)
        off = (bins - tokens.unsqueeze(-1)).float()
        if self.config.label_smoothing_bins == 0:
            return (off == 0).float()
        return (-0.5 * (off / self.config.label_smoothing_bins).square()).softmax(-1)
