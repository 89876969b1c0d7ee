"""A causal Transformer over goal and history tokens; the last token's output is the feature."""

from dataclasses import dataclass

from torch import Tensor

from playlearn.policies.trunks.base import Trunk, TrunkConfig


@TrunkConfig.register_subclass("transformer")
@dataclass(frozen=True)
class TransformerConfig(TrunkConfig):
    """A causal Transformer.

    width: D, of tokens and features.
    layers: Transformer blocks.
    heads: attention heads of each.
    expansion: units of a feed-forward layer over `width`.
    """

    layers: int = 3
    heads: int = 4
    expansion: float = 2.5

    def build(self, tokens: int) -> "Transformer":
        return Transformer(self, tokens)


class Transformer(Trunk):
    """The Llama blocks of `transformers` (rotary positions, RMS norm, gated feed-forward), without dropout.

    Of the causal models of `transformers` it is the quickest on a CPU at a handful of tokens.
    """

    def __init__(self, config: TransformerConfig, tokens: int) -> None:
        super().__init__()
        # transformers takes seconds to import: only this trunk pays
        from transformers.models.llama.configuration_llama import LlamaConfig
        from transformers.models.llama.modeling_llama import LlamaModel

        self.model = LlamaModel(
            LlamaConfig(
                vocab_size=1,  # tokens come as embeddings
                hidden_size=config.width,
                intermediate_size=int(config.width * config.expansion),
                num_hidden_layers=config.layers,
                num_attention_heads=config.heads,
                max_position_embeddings=tokens,
                use_cache=False,
                pad_token_id=None,
                attn_implementation="sdpa",
            )
        )
        del self.model.embed_tokens

    def forward(self, tokens: Tensor, mask: Tensor | None) -> Tensor:
        hidden: Tensor = self.model(inputs_embeds=tokens, attention_mask=mask, use_cache=False).last_hidden_state
        return hidden[:, -1]  # (B, D)
