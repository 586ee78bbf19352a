"""The layers compute what torch's layers compute from the same parameters, and so are their gradients."""

import torch
from torch import Tensor, nn

from benchmarks.reconstruction.attention import DecoderLayer, EncoderLayer, hiding

OPTIONS = {"activation": "gelu", "batch_first": True, "norm_first": True, "dropout": 0.0}


def gradients(network: nn.Module, found: Tensor) -> list[Tensor]:
    return list(torch.autograd.grad(found.square().sum(), list(network.parameters())))


def test_tokens_attend_to_each_other_as_in_torch() -> None:
    torch.manual_seed(0)
    own, theirs = EncoderLayer(32, 4, 64), nn.TransformerEncoderLayer(32, 4, 64, **OPTIONS)  # type: ignore[arg-type]
    theirs.load_state_dict(own.state_dict())
    tokens, hidden = torch.randn(3, 7, 32), torch.rand(3, 7) < 0.4
    hidden[:, 0] = False
    ours = own(tokens, src_key_padding_mask=hiding(hidden))
    peer = theirs(tokens, src_key_padding_mask=hidden)
    assert torch.allclose(ours, peer, atol=1e-5)
    pairs = zip(gradients(own, ours), gradients(theirs, peer), strict=True)
    assert all(torch.allclose(one, other, atol=1e-4) for one, other in pairs)
    assert torch.allclose(own(tokens), theirs(tokens), atol=1e-5)


def test_tokens_attend_to_others_as_in_torch() -> None:
    torch.manual_seed(0)
    own, theirs = DecoderLayer(32, 4, 64), nn.TransformerDecoderLayer(32, 4, 64, **OPTIONS)  # type: ignore[arg-type]
    theirs.load_state_dict(own.state_dict())
    tokens, others, hidden = torch.randn(3, 7, 32), torch.randn(3, 5, 32), torch.rand(3, 7) < 0.4
    hidden[:, 0] = False
    ours = own(tokens, others, tgt_key_padding_mask=hiding(hidden))
    peer = theirs(tokens, others, tgt_key_padding_mask=hidden)
    assert torch.allclose(ours, peer, atol=1e-5)
    pairs = zip(gradients(own, ours), gradients(theirs, peer), strict=True)
    assert all(torch.allclose(one, other, atol=1e-4) for one, other in pairs)
    assert torch.allclose(own(tokens, others), theirs(tokens, others), atol=1e-5)
