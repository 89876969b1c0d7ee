"""A chunk as a short sentence (FAST, Pertsch et al. 2025): its frequencies, rounded, as words of varying length.

Each action dimension goes through a discrete cosine transform along the chunk; the coefficients are rounded, laid out
from the lowest frequency to the highest, and byte pair encoding, learned from the training chunks, makes words of what
often stands together. A smooth chunk, nearly all of it zeros, is then a few words, where one word a number takes H A.
"""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from playlearn.policies.heads.autoregressive import guided, top
from playlearn.policies.heads.base import Generators, Guidance, Head, HeadConfig, draw_noise
from playlearn.policies.heads.decoder import Decoder

MOST = 127  # a rounded coefficient lies between -MOST and MOST
FIRST = 0x4E00  # the letter that stands for -MOST: a block of letters that no tokenizer splits or changes
CHUNKS = 4096  # that the words are learned from
BYTES = 1 << 16  # kept for the words in a checkpoint


@HeadConfig.register_subclass("fast")
@dataclass(frozen=True)
class FastConfig(HeadConfig):
    """scale: steps in which a coefficient is rounded, to a standard deviation of the data. vocabulary: words.

    width, layers, heads: of the causal decoder. temperature, top_p: of sampling, as of the autoregressive head.
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
    def __init__(self, config: FastConfig, width: int, chunk: int, actions: int) -> None:
        super().__init__()
        self.config, self.shape = config, (chunk, actions)
        self.end = config.vocabulary
        self.longest = chunk * actions + 1  # every letter a word, and the end
        self.register_buffer("cosines", _cosines(chunk), persistent=False)
        self.register_buffer("words", torch.zeros(BYTES, dtype=torch.uint8))  # the tokenizer's JSON, then zeros
        self.in_proj = nn.Linear(width, config.width)
        self.token_embedding = nn.Embedding(config.vocabulary + 1, config.width)
        self.pos_embedding = nn.Parameter(torch.randn(self.longest, config.width) * 0.1)
        self.decoder = Decoder(config.width, config.layers, config.heads)
        self.out_proj = nn.Linear(config.width, config.vocabulary + 1)
        self._learn([])
        self.register_load_state_dict_post_hook(lambda head, _: head._read())  # type: ignore[no-untyped-call]

    def fit_action_statistics(self, chunks: Tensor) -> None:
        """Learn the words; of single actions, those that follow one another make a chunk."""
        steps, count = chunks.flatten(0, 1), chunks.shape[0] * chunks.shape[1] // self.shape[0]
        whole = steps[: count * self.shape[0]].reshape(count, *self.shape)
        self._learn(self._texts(whole[:: max(1, len(whole) // CHUNKS)]))

    def token_ids_of(self, chunk: Tensor) -> Tensor:
        """(B, H, A) -> (B, L) words and the end, which also fills up the shorter ones."""
        token_ids = [encoding.ids for encoding in self._tokenizer.encode_batch(self._texts(chunk))]
        rows = [ids + [self.end] * (max(map(len, token_ids)) + 1 - len(ids)) for ids in token_ids]
        return torch.tensor(rows, device=chunk.device)

    def numbers(self, token_ids: Tensor) -> Tensor:
        """(B, L) words -> (B, H, A); what is too short goes on with zeros, what is too long is cut."""
        rows = []
        for ids in token_ids.tolist():
            ids = ids[: ids.index(self.end)] if self.end in ids else ids
            letters = [letter for token_id in ids for letter in self._spelled[token_id]][: self.longest - 1]
            rows.append(letters + [0] * (self.longest - 1 - len(letters)))
        found = (
            torch.tensor(rows, dtype=torch.float32, device=token_ids.device).view(-1, *self.shape) / self.config.scale
        )
        return torch.einsum("fh,bfa->bha", self.get_buffer("cosines"), found)

    def loss(
        self, features: Tensor, chunk: Tensor, mask: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Cross-entropy in nats a word; a chunk cut short goes on as its last action, an empty one is left out."""
        token_ids = self.token_ids_of(_held(chunk.detach(), mask))
        before = functional.pad(self.token_embedding(token_ids[:, :-1]), (0, 0, 1, 0))
        hidden = self.in_proj(features).unsqueeze(1) + self.pos_embedding[: token_ids.shape[1]] + before
        logits = self.out_proj(self.decoder(hidden))  # (B, L, V + 1)
        missed = functional.cross_entropy(logits.transpose(1, 2), token_ids, reduction="none")
        ended = (token_ids == self.end).cumsum(1)
        weight = (ended <= 1) & mask.any(1, keepdim=True)  # the end itself is to be said, once
        count = weight.sum().clamp(min=1)
        tokenizer_bytes = count / mask.any(1).sum().clamp(min=1)
        return torch.where(weight, missed, 0.0).sum() / count, {"words": tokenizer_bytes}

    def sample(self, features: Tensor, generator: Generators, guidance: Guidance | None = None) -> Tensor:
        uniforms = torch.special.ndtr(draw_noise((len(features), self.longest), generator, features.device))

        def choose(logits: Tensor, place: int) -> Tensor:
            below = top((logits / self.config.temperature).softmax(-1), self.config.top_p).cumsum(-1)
            drawn = uniforms[:, place, None] * below[:, -1:]
            return torch.searchsorted(below, drawn).squeeze(-1).clamp_(max=self.end)

        return self._decode(features, guidance, choose)

    def mode(self, features: Tensor, guidance: Guidance | None = None) -> Tensor:
        """The likeliest word at each turn, given those before it."""
        return self._decode(features, guidance, lambda logits, _: logits.argmax(-1))

    def _decode(self, features: Tensor, guidance: Guidance | None, choose: Callable[[Tensor, int], Tensor]) -> Tensor:
        given = self.in_proj(features if guidance is None else torch.cat([features, guidance.features]))
        turns = self.decoder.steps(len(given), self.longest)
        token_ids: list[Tensor] = []
        hidden, ended = given, torch.zeros(len(features), dtype=torch.bool, device=features.device)
        for place, here in enumerate(self.pos_embedding.unbind()):
            token_id = choose(guided(self.out_proj(turns.next(hidden + here)), guidance), place)
            token_ids.append(token_id)
            ended = ended | (token_id == self.end)
            if ended.all():
                break
            before = self.token_embedding(token_id)
            hidden = given + (before if guidance is None else before.repeat(2, 1))
        return self.numbers(torch.stack(token_ids, dim=1))

    def _texts(self, chunk: Tensor) -> list[str]:
        """A letter for each rounded coefficient, the lowest frequency of every action first."""
        found = torch.einsum("fh,bha->bfa", self.get_buffer("cosines"), chunk) * self.config.scale
        letters = found.round().clamp(-MOST, MOST).long().flatten(1) + MOST + FIRST
        return ["".join(map(chr, row)) for row in letters.tolist()]

    def _learn(self, texts: list[str]) -> None:
        from tokenizers import Tokenizer, models, trainers

        made = Tokenizer(models.BPE())
        alphabet = [chr(FIRST + place) for place in range(2 * MOST + 1)]
        trainer = trainers.BpeTrainer(
            vocab_size=self.config.vocabulary, initial_alphabet=alphabet, show_progress=False, max_token_length=64
        )
        made.train_from_iterator(texts, trainer)
        written = json.dumps(json.loads(made.to_str()), ensure_ascii=False, separators=(",", ":")).encode()
        self.get_buffer("words").zero_()[: len(written)] = torch.frombuffer(bytearray(written), dtype=torch.uint8)
        self._read()

    def _read(self) -> None:
        from tokenizers import Tokenizer

        written = bytes(self.get_buffer("words").cpu().numpy()).rstrip(b"\0").decode()
        self._tokenizer: Any = Tokenizer.from_str(written)
        tokenizer_bytes = {number: token_id for token_id, number in self._tokenizer.get_vocab().items()}
        # a word that was never made spells nothing
        self._spelled = [[ord(c) - FIRST - MOST for c in tokenizer_bytes.get(i, "")] for i in range(self.end + 1)]


def _held(chunk: Tensor, mask: Tensor) -> Tensor:
    """(B, H, A), a masked action as the last one before it that counts; 0 where none does."""
    place = torch.arange(mask.shape[1], device=mask.device).expand_as(mask)
    last = torch.where(mask, place, -1).cummax(1).values  # (B, H)
    held = chunk.gather(1, last.clamp(min=0).unsqueeze(-1).expand_as(chunk))
    return torch.where((last >= 0).unsqueeze(-1), held, 0.0)


def _cosines(length: int) -> Tensor:
    """(F, H) the orthonormal discrete cosine transform of type two."""
    moment, frequency = torch.arange(length) + 0.5, torch.arange(length)[:, None]
    made = torch.cos(math.pi / length * frequency * moment) * math.sqrt(2 / length)
    made[0] /= math.sqrt(2)
    return made
