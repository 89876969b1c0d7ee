"""Chunks as few tokens (FAST, Pertsch et al. 2025): rounded frequencies under byte pair encoding.

Each action dimension goes through a discrete cosine transform along the chunk. The coefficients are rounded and laid
out from the lowest frequency to the highest, a letter each. Byte pair encoding, learned from the training chunks, makes
one token of letters that often follow one another. A smooth chunk, nearly all of it zeros, is then a few tokens, where
one token a number takes H A.
"""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from playlearn.policies.heads.base import Generators, Head, HeadConfig, draw_noise
from playlearn.policies.heads.decoder import Decoder
from playlearn.policies.heads.guidance import Guidance, GuidedRows
from playlearn.policies.heads.nucleus import draw_tokens

MOST = 127  # a rounded coefficient lies between -MOST and MOST
FIRST = 0x4E00  # the letter that stands for -MOST: a block of letters that no tokenizer splits or changes
CHUNKS = 4096  # that the vocabulary is learned from
BYTES = 1 << 16  # kept for the tokenizer in a checkpoint


@HeadConfig.register_subclass("fast")
@dataclass(frozen=True)
class FastConfig(HeadConfig):
    """Chunks as tokens of their frequencies.

    scale: rounding steps of a coefficient in a standard deviation of the data; fewer where the data reach so far that
        they would not be enough.
    vocabulary: tokens of the byte pair encoding.
    width: of the causal decoder.
    layers: of the causal decoder.
    heads: attention heads of the causal decoder.
    temperature: of sampling.
    top_p: sampling draws among the likeliest tokens that together have this probability.
    """

    scale: float = 10.0
    vocabulary: int = 1024
    width: int = 128
    layers: int = 2
    heads: int = 4
    temperature: float = 1.0
    top_p: float = 0.95

    def build(self, width: int, chunk: int, actions: int) -> "FastHead":
        return FastHead(self, width, chunk, actions)


class FastHead(Head):
    """scale (A,): rounding steps of a coefficient of each action."""

    scale: Tensor

    def __init__(self, config: FastConfig, width: int, chunk: int, actions: int) -> None:
        super().__init__()
        self.config, self.shape = config, (chunk, actions)
        self.end = config.vocabulary
        self.longest = chunk * actions + 1  # a token for every letter, and the end token
        self.register_buffer("cosines", _cosines(chunk), persistent=False)
        self.register_buffer("scale", torch.full((actions,), config.scale))
        self.register_buffer(
            "tokenizer_bytes", torch.zeros(BYTES, dtype=torch.uint8)
        )  # the tokenizer's JSON, then zeros
        self.in_proj = nn.Linear(width, config.width)
        self.token_embedding = nn.Embedding(config.vocabulary + 1, config.width)
        self.pos_embedding = nn.Parameter(torch.randn(self.longest, config.width) * 0.1)
        self.decoder = Decoder(config.width, config.layers, config.heads)
        self.out_proj = nn.Linear(config.width, config.vocabulary + 1)
        self._learn([])
        self.register_load_state_dict_post_hook(lambda head, _: head._read())  # type: ignore[no-untyped-call]

    def fit_action_statistics(self, chunks: Tensor) -> None:
        """Learn the reach of coefficients and the vocabulary; single actions (H = 1) in a row make a chunk."""
        steps, count = chunks.flatten(0, 1), chunks.shape[0] * chunks.shape[1] // self.shape[0]
        whole = steps[: count * self.shape[0]].reshape(count, *self.shape)
        if len(whole):
            furthest = self._coefficients(whole).abs().amax((0, 1))  # (A,)
            self.scale.copy_((MOST / furthest).clamp(max=self.config.scale))
        self._learn(self._texts(whole[:: max(1, len(whole) // CHUNKS)]))

    def token_ids_of(self, chunk: Tensor) -> Tensor:
        """(B, H, A) -> (B, L) tokens and the end token, which also pads the shorter rows."""
        token_ids = [encoding.ids for encoding in self._tokenizer.encode_batch(self._texts(chunk))]
        rows = [ids + [self.end] * (max(map(len, token_ids)) + 1 - len(ids)) for ids in token_ids]
        return torch.tensor(rows, device=chunk.device)

    def numbers(self, token_ids: Tensor) -> Tensor:
        """(B, L) tokens -> (B, H, A); too few letters are padded with zeros, too many are cut."""
        rows = []
        for ids in token_ids.tolist():
            ids = ids[: ids.index(self.end)] if self.end in ids else ids
            letters = [letter for token_id in ids for letter in self._letters[token_id]][: self.longest - 1]
            rows.append(letters + [0] * (self.longest - 1 - len(letters)))
        rounded = torch.tensor(rows, dtype=torch.float32, device=token_ids.device).view(-1, *self.shape)  # (B, F, A)
        return torch.einsum("fh,bfa->bha", self.get_buffer("cosines"), rounded / self.scale)

    def loss(
        self, features: Tensor, chunk: Tensor, mask: Tensor, generator: torch.Generator, updates: int | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Cross-entropy in nats a token.

        A chunk that ends early is padded with its last action; a chunk with no action does not contribute.
        """
        token_ids = self.token_ids_of(_held(chunk.detach(), mask))
        before = functional.pad(self.token_embedding(token_ids[:, :-1]), (0, 0, 1, 0))
        hidden = self.in_proj(features).unsqueeze(1) + self.pos_embedding[: token_ids.shape[1]] + before
        logits = self.out_proj(self.decoder(hidden))  # (B, L, V + 1)
        nats = functional.cross_entropy(logits.transpose(1, 2), token_ids, reduction="none")  # (B, L)
        ended = (token_ids == self.end).cumsum(1)
        weight = (ended <= 1) & mask.any(1, keepdim=True)  # the first end token counts
        count = weight.sum().clamp(min=1)
        length = count / mask.any(1).sum().clamp(min=1)
        return torch.where(weight, nats, 0.0).sum() / count, {"tokens_per_chunk": length}

    def sample(self, features: Tensor, generator: Generators, guidance: Guidance | None = None) -> Tensor:
        uniforms = torch.special.ndtr(draw_noise((len(features), self.longest), generator, features.device))

        def choose(logits: Tensor, position: int) -> Tensor:
            return draw_tokens(logits, uniforms[:, position], self.config.temperature, self.config.top_p)

        return self._decode(features, guidance, choose)

    def mode(self, features: Tensor, guidance: Guidance | None = None) -> Tensor:
        """The likeliest token at each position, given those before it."""
        return self._decode(features, guidance, lambda logits, _: logits.argmax(-1))

    def _decode(self, features: Tensor, guidance: Guidance | None, choose: Callable[[Tensor, int], Tensor]) -> Tensor:
        """choose: from the logits (B, V + 1) of a position, and its index, to tokens (B,)."""
        rows = GuidedRows(features, guidance)
        given = self.in_proj(rows.features)  # (R, W)
        decoder = self.decoder.steps(len(given), self.longest)
        token_ids: list[Tensor] = []
        hidden, ended = given, torch.zeros(len(features), dtype=torch.bool, device=features.device)
        for position, embedding in enumerate(self.pos_embedding.unbind()):
            token_id = choose(rows.combine(self.out_proj(decoder.next(hidden + embedding))), position)
            token_ids.append(token_id)
            ended = ended | (token_id == self.end)
            if ended.all():
                break
            hidden = given + rows.expand(self.token_embedding(token_id))
        return self.numbers(torch.stack(token_ids, dim=1))

    def _coefficients(self, chunk: Tensor) -> Tensor:
        """(B, H, A) -> (B, F, A)."""
        return torch.einsum("fh,bha->bfa", self.get_buffer("cosines"), chunk)

    def _texts(self, chunk: Tensor) -> list[str]:
        """A letter for each rounded coefficient, the lowest frequency of every action first."""
        letters = (self._coefficients(chunk) * self.scale).round().clamp(-MOST, MOST).long().flatten(1) + MOST + FIRST
        return ["".join(map(chr, row)) for row in letters.tolist()]

    def _learn(self, texts: list[str]) -> None:
        from tokenizers import Tokenizer, models, trainers

        tokenizer = Tokenizer(models.BPE())
        alphabet = [chr(FIRST + letter) for letter in range(2 * MOST + 1)]
        trainer = trainers.BpeTrainer(
            vocab_size=self.config.vocabulary, initial_alphabet=alphabet, show_progress=False, max_token_length=64
        )
        tokenizer.train_from_iterator(texts, trainer)
        written = json.dumps(json.loads(tokenizer.to_str()), ensure_ascii=False, separators=(",", ":")).encode()
        self.get_buffer("tokenizer_bytes").zero_()[: len(written)] = torch.frombuffer(
            bytearray(written), dtype=torch.uint8
        )
        self._read()

    def _read(self) -> None:
        from tokenizers import Tokenizer

        written = bytes(self.get_buffer("tokenizer_bytes").cpu().numpy()).rstrip(b"\0").decode()
        self._tokenizer: Any = Tokenizer.from_str(written)
        texts = {token_id: text for text, token_id in self._tokenizer.get_vocab().items()}
        # a token beyond the vocabulary that was learned is an empty text
        self._letters = [[ord(c) - FIRST - MOST for c in texts.get(i, "")] for i in range(self.end + 1)]


def _held(chunk: Tensor, mask: Tensor) -> Tensor:
    """(B, H, A), a masked action as the last one before it that is not masked; 0 where there is none."""
    step = torch.arange(mask.shape[1], device=mask.device).expand_as(mask)
    last = torch.where(mask, step, -1).cummax(1).values  # (B, H)
    held = chunk.gather(1, last.clamp(min=0).unsqueeze(-1).expand_as(chunk))
    return torch.where((last >= 0).unsqueeze(-1), held, 0.0)


def _cosines(length: int) -> Tensor:
    """(F, H) the orthonormal discrete cosine transform of type two."""
    moment, frequency = torch.arange(length) + 0.5, torch.arange(length)[:, None]
    cosines = torch.cos(math.pi / length * frequency * moment) * math.sqrt(2 / length)
    cosines[0] /= math.sqrt(2)
    return cosines
