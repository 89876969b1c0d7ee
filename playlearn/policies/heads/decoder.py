"""A small causal decoder: all positions in one pass for training, or one after the other with a key-value cache."""

import torch
from torch import Tensor, nn
from torch.nn import functional


class Decoder(nn.Module):
    """Pre-norm layers of attention and feed-forward networks with residual connections, and a norm at the end."""

    def __init__(self, width: int, layers: int, heads: int) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(_Layer(width, heads) for _ in range(layers))
        self.norm = nn.LayerNorm(width)

    def forward(self, hidden: Tensor, *, causal: bool = True) -> Tensor:
        """(B, L, W) -> (B, L, W)."""
        for layer in self.blocks:
            hidden = layer(hidden, causal=causal)
        out: Tensor = self.norm(hidden)
        return out

    def steps(self, batch: int, positions: int) -> "Steps":
        """Decodes up to `positions` positions, one at a time."""
        return Steps(self, batch, positions)


class Steps:
    """A decoder that is given its positions one after the other, with a key-value cache.

    At a hundred steps a plan, overhead costs more time than arithmetic. So every weight is looked up once, and every
    step is plain function calls.
    """

    def __init__(self, decoder: Decoder, batch: int, positions: int) -> None:
        self._layers = [_Step(layer, batch, positions) for layer in decoder.blocks]  # type: ignore[arg-type]
        self._norm = _norm(decoder.norm)
        self._position = 0

    def next(self, hidden: Tensor) -> Tensor:
        """(B, W) -> (B, W): one more position, beside those before it."""
        for layer in self._layers:
            hidden = layer.next(hidden, self._position)
        self._position += 1
        return functional.layer_norm(hidden, *self._norm)


class _Layer(nn.Module):
    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.before, self.between = nn.LayerNorm(width), nn.LayerNorm(width)
        self.project = nn.Linear(width, 3 * width)
        self.attn_out = nn.Linear(width, width)
        self.mlp_up, self.mlp_down = nn.Linear(width, 4 * width), nn.Linear(4 * width, width)

    def forward(self, hidden: Tensor, *, causal: bool) -> Tensor:
        parts = self.project(self.before(hidden)).unflatten(-1, (3, self.heads, -1)).transpose(1, 3)  # (B, h, 3, L, d)
        query, key, value = parts.unbind(2)
        attended = functional.scaled_dot_product_attention(query, key, value, is_causal=causal)
        hidden = hidden + self.attn_out(attended.transpose(1, 2).flatten(2))
        out: Tensor = hidden + self.mlp_down(functional.gelu(self.mlp_up(self.between(hidden))))
        return out


class _Step:
    """A layer at one position; past (2, B h, positions, d) holds the keys and values of the positions so far."""

    def __init__(self, layer: _Layer, batch: int, positions: int) -> None:
        like = layer.attn_out.weight
        self._rows, self._width = batch * layer.heads, like.shape[0]
        self._depth = self._width // layer.heads
        self._shape = batch, 3, layer.heads, self._depth
        self._past = like.new_empty(2, self._rows, positions, self._depth)
        self._before, self._between = _norm(layer.before), _norm(layer.between)
        self._project, self._attn_out = _linear(layer.project), _linear(layer.attn_out)
        self._mlp_up, self._mlp_down = _linear(layer.mlp_up), _linear(layer.mlp_down)

    def next(self, hidden: Tensor, position: int) -> Tensor:
        parts = _times(functional.layer_norm(hidden, *self._before), self._project)
        parts = parts.view(self._shape).transpose(0, 1).reshape(3, self._rows, self._depth)
        self._past[:, :, position] = parts[1:]
        keys, values = self._past[:, :, : position + 1].unbind()  # (B h, n, d)
        weights = torch.bmm(keys, parts[0].unsqueeze(-1)).mul_(self._depth**-0.5).softmax(1)  # (B h, n, 1)
        attended = torch.bmm(weights.transpose(1, 2), values).view(-1, self._width)
        hidden = hidden + _times(attended, self._attn_out)
        inner = functional.gelu(_times(functional.layer_norm(hidden, *self._between), self._mlp_up))
        return hidden + _times(inner, self._mlp_down)


Linear = tuple[Tensor, Tensor]  # bias, and the weight transposed


def _linear(layer: nn.Linear) -> Linear:
    return layer.bias, layer.weight.t()


def _times(values: Tensor, linear: Linear) -> Tensor:
    return torch.addmm(linear[0], values, linear[1])


def _norm(norm: nn.LayerNorm) -> tuple[tuple[int, ...], Tensor, Tensor, float]:
    return norm.normalized_shape, norm.weight, norm.bias, norm.eps
