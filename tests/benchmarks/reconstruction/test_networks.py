"""Parts of networks, and their sizes: an unusable one is one error that names it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from benchmarks.reconstruction.derived import FIRST_PANEL
from benchmarks.reconstruction.garments import GarmentSet, Ragged
from benchmarks.reconstruction.learners import Learner, least_cost
from benchmarks.reconstruction.models import MODELS, load_model
from benchmarks.reconstruction.options import Config
from benchmarks.reconstruction.point_net import DecoderLayer, EncoderLayer, hiding
from benchmarks.reconstruction.train import train
from gcd_dataset.errors import ConfigError
from gcd_dataset.scoring.inputs import PICTURE_SIZE, PICTURES
from tests.benchmarks.reconstruction.toys import loss_of, small

CPU = torch.device("cpu")
NETWORKS = [name for name in MODELS if hasattr(load_model(name), "build")]
NEEDED = {
    "panel_set": "width heads layers queries slots edges edge_width edge_heads seam_layers tokens points stored_points",
    "edge_tokens": "width heads layers decoder_layers queries slots edges tokens points stored_points",
    "parameters": "width heads layers tokens points stored_points",
    "picture_parameters": "width heads layers views",
    "stitches": "width heads layers pair_width rounds confident",
    "segmentation": "width rounds tokens token_width heads panels seams",
    "drape_surrogate": "width rounds tokens token_width heads body second_rounds",
    "measures": "width heads layers tokens neighbours points",
}


def needed(model: str) -> list[str]:
    """Sizes that cannot be 0."""
    return NEEDED.get(model, "width").split()


REFUSED: list[tuple[str, dict[str, Any], str]] = [
    *((model, {name: 0}, rf"^{name} 0") for model in NETWORKS for name in needed(model)),
    *((model, {"tables": 3}, rf"^no size tables of {model}: choose of \w+, ") for model in NETWORKS),
    ("picture_parameters", {"width": 36}, "width 36: give a multiple of 32"),
    ("stitches", {"foreign": 0.5}, r"foreign is 0\.5: give a share"),
]


@pytest.mark.parametrize(("model", "sizes", "message"), REFUSED)
def test_sizes_that_a_network_cannot_have_are_refused(model: str, sizes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        small(model, **sizes)


@pytest.mark.parametrize("model", NETWORKS)
def test_heads_share_the_width(model: str) -> None:
    names = needed(model)
    for name in {"width", "edge_width", "token_width"} & {*names}:
        if "heads" in names and not (name == "width" and "token_width" in names):
            with pytest.raises(ConfigError, match=rf"{name} 33 is no multiple of (edge_)?heads 4"):
                small(model, **{name: 33})


@pytest.mark.parametrize("model", ["panel_set", "edge_tokens", "parameters"])
def test_garments_have_a_point_for_each_token(model: str, six: GarmentSet) -> None:
    few = replace(six, points=six.points[:, :16])
    with pytest.raises(ConfigError, match="32 tokens of 16 points: give a power of 2, at most the points"):
        small(model).prepare(few, device=torch.device("cpu"))


FEW = {"points": 128, "stored_points": 512}
SIZES: dict[str, dict[str, int]] = {
    "panel_set": FEW, "edge_tokens": {**FEW, "noise_mm": 0}, "parameters": {**FEW, "labelled": 1},
    "picture_parameters": {"views": 1},
}  # fmt: skip


@pytest.fixture(scope="module")
def pictured(six: GarmentSet) -> GarmentSet:
    """The skirts with pictures of noise."""
    rng = np.random.default_rng(0)
    shape = (PICTURES, PICTURE_SIZE, PICTURE_SIZE)
    pictures = [rng.integers(256, size=(*shape, 3), dtype=np.uint8) for _ in range(len(six))]
    shown = [rng.integers(FIRST_PANEL + 8, size=shape, dtype=np.uint8) for _ in range(len(six))]
    return replace(six, ragged={**six.ragged, "pictures": Ragged.of(pictures), "shown": Ragged.of(shown)})


def network(model: str) -> Learner[Any, Any]:
    return small(model, **SIZES[model])


@pytest.mark.parametrize("model", SIZES)
def test_every_trained_parameter_has_a_gradient(model: str, pictured: GarmentSet) -> None:
    learner = network(model)
    batch = learner.prepare(pictured, device=CPU).batch(torch.arange(2))
    torch.autograd.backward(torch.stack(list(learner.loss(batch).values())).sum())
    assert [name for name, p in learner.named_parameters() if p.requires_grad and p.grad is None] == []


@pytest.mark.parametrize("model", ["panel_set", "edge_tokens"])
def test_empty_rows_and_garments_beyond_the_sizes_teach_nothing(model: str, six: GarmentSet) -> None:
    learner = network(model).eval()
    examples = learner.prepare(six, device=CPU)
    batch = examples.batch(torch.arange(6))
    whole = replace(examples.whole[torch.arange(6)], points=batch.points)  # type: ignore[attr-defined]
    assert batch.edge_panels.shape[1] < whole.edge_panels.shape[1]
    assert loss_of(learner, batch) == pytest.approx(loss_of(learner, whole), rel=1e-4)
    gone = torch.arange(6)[:, None] == 0
    columns = {name: torch.where(gone, -1, getattr(batch, name)) for name in ("edge_panels", "partners")}
    empty = replace(batch, exists=batch.exists & ~gone, **columns)
    gradients = []
    for some in (empty, empty[1:]):
        learner.zero_grad()
        torch.autograd.backward(torch.stack(list(learner.loss(some).values())).sum())
        gradients.append([p.grad.clone() for p in learner.parameters() if p.grad is not None])
    assert all(torch.allclose(one, other, atol=1e-4) for one, other in zip(*gradients, strict=True))


def test_a_network_learns(six: GarmentSet) -> None:
    """The others learn in tests/extras."""
    learner = network("panel_set")
    config = Config(steps=20, batch=6, lr=4e-3, log_every=5, weight_decay=0.0)
    curve = train(learner, learner.prepare(six, device=CPU), config, device=CPU).curve
    assert curve[-1]["loss"] < 0.8 * curve[0]["loss"]


OPTIONS = {"activation": "gelu", "batch_first": True, "norm_first": True, "dropout": 0.0}


def gradients(network: nn.Module, found: Tensor) -> list[Tensor]:
    return list(torch.autograd.grad(found.square().sum(), list(network.parameters())))


@pytest.mark.parametrize(
    ("layer", "peer", "mask"),
    [
        (EncoderLayer, nn.TransformerEncoderLayer, "src_key_padding_mask"),
        (DecoderLayer, nn.TransformerDecoderLayer, "tgt_key_padding_mask"),
    ],
)
def test_tokens_attend_to_each_other_and_to_others_as_in_torch(layer: Any, peer: Any, mask: str) -> None:
    torch.manual_seed(0)
    own, theirs = layer(32, 4, 64), peer(32, 4, 64, **OPTIONS)
    theirs.load_state_dict(own.state_dict())
    hidden = torch.rand(3, 7) < 0.4
    hidden[:, 0] = False
    tokens = [torch.randn(3, 7, 32)] if layer is EncoderLayer else [torch.randn(3, 7, 32), torch.randn(3, 5, 32)]
    ours, expected = own(*tokens, **{mask: hiding(hidden)}), theirs(*tokens, **{mask: hidden})
    assert torch.allclose(ours, expected, atol=1e-5)
    pairs = zip(gradients(own, ours), gradients(theirs, expected), strict=True)
    assert all(torch.allclose(one, other, atol=1e-4) for one, other in pairs)
    assert torch.allclose(own(*tokens), theirs(*tokens), atol=1e-5)


def test_costs_that_are_no_numbers_are_avoided() -> None:
    nan = float("nan")
    cost = torch.tensor([[[nan, 1.0, 2.0], [nan, 0.0, 5.0]], [[nan] * 3, [nan] * 3]])
    found = least_cost(cost, torch.ones(2, 2, dtype=torch.bool))
    assert found[0].tolist() == [2, 1]
    assert len(set(found[1].tolist())) == 2
