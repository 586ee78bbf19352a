"""Layers of torch's transformers with fewer kernels and less memory traffic: the same parameters, the same numbers.

The queries, keys and values of all heads are views of one product, in the layout that fused attention reads and writes
(Dao et al., FlashAttention, NeurIPS 2022), instead of copies. Layers normalise first, without dropout.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional


def hiding(hidden: Bool[Tensor, "b t"]) -> Float[Tensor, "b t"]:
    """The mask of tokens that others do not attend to: -inf for these, else 0."""
    return torch.zeros_like(hidden, dtype=torch.float32).masked_fill(hidden, -torch.inf)


class EncoderLayer(nn.TransformerEncoderLayer):
    """``nn.TransformerEncoderLayer``, batch and norm first."""

    def __init__(self, width: int, heads: int, inner: int) -> None:
        """``inner``: features between the two linear maps."""
        super().__init__(width, heads, inner, dropout=0.0, activation="gelu", batch_first=True, norm_first=True)

    def forward(
        self,
        src: Float[Tensor, "b t w"],
        src_mask: Tensor | None = None,
        src_key_padding_mask: Tensor | None = None,
        is_causal: bool = False,
    ) -> Float[Tensor, "b t w"]:
        """``src_key_padding_mask``: as ``hiding`` returns it; ``src_mask`` and ``is_causal`` have no effect."""
        src = src + _among(self.self_attn, self.norm1(src), src_key_padding_mask)
        return src + self.linear2(functional.gelu(self.linear1(self.norm2(src))))


class DecoderLayer(nn.TransformerDecoderLayer):
    """``nn.TransformerDecoderLayer``, batch and norm first."""

    def __init__(self, width: int, heads: int, inner: int) -> None:
        """``inner``: features between the two linear maps."""
        super().__init__(width, heads, inner, dropout=0.0, activation="gelu", batch_first=True, norm_first=True)

    def forward(  # type: ignore[override]
        self,
        tgt: Float[Tensor, "b q w"],
        memory: Float[Tensor, "b t w"],
        tgt_key_padding_mask: Float[Tensor, "b q"] | None = None,
    ) -> Float[Tensor, "b q w"]:
        """``tgt_key_padding_mask``: as ``hiding`` returns it."""
        tgt = tgt + _among(self.self_attn, self.norm1(tgt), tgt_key_padding_mask)
        tgt = tgt + _across(self.multihead_attn, self.norm2(tgt), memory)
        return tgt + self.linear2(functional.gelu(self.linear1(self.norm3(tgt))))


def _among(
    attention: nn.MultiheadAttention, tokens: Float[Tensor, "b t w"], hidden: Float[Tensor, "b t"] | None
) -> Float[Tensor, "b t w"]:
    """Attention of tokens to each other."""
    query, key, value = _heads(attention, tokens, attention.in_proj_weight, attention.in_proj_bias)
    return _attended(attention, query, key, value, hidden)


def _across(
    attention: nn.MultiheadAttention, tokens: Float[Tensor, "b q w"], others: Float[Tensor, "b t w"]
) -> Float[Tensor, "b q w"]:
    """Attention of tokens to others."""
    sizes = [tokens.shape[-1], 2 * tokens.shape[-1]]
    weights = torch.split_with_sizes(attention.in_proj_weight, sizes)
    biases = torch.split_with_sizes(attention.in_proj_bias, sizes)
    (query,) = _heads(attention, tokens, weights[0], biases[0])
    key, value = _heads(attention, others, weights[1], biases[1])
    return _attended(attention, query, key, value, None)


def _heads(
    attention: nn.MultiheadAttention, tokens: Float[Tensor, "b t w"], weight: Tensor, bias: Tensor
) -> tuple[Float[Tensor, "b h t d"], ...]:
    """Views of one product: its parts, such as queries or keys, by head."""
    width = tokens.shape[-1]
    parts = functional.linear(tokens, weight, bias)
    shape = (len(weight) // width, attention.num_heads, width // attention.num_heads)
    return parts.view(*parts.shape[:2], *shape).permute(2, 0, 3, 1, 4).unbind(0)


def _attended(
    attention: nn.MultiheadAttention,
    query: Float[Tensor, "b h q d"],
    key: Float[Tensor, "b h t d"],
    value: Float[Tensor, "b h t d"],
    hidden: Float[Tensor, "b t"] | None,
) -> Float[Tensor, "b q w"]:
    mask = None if hidden is None else hidden.to(query.dtype)[:, None, None].expand(-1, -1, query.shape[2], -1)
    seen = functional.scaled_dot_product_attention(query, key, value, attn_mask=mask)
    return attention.out_proj(seen.transpose(1, 2).flatten(2))
