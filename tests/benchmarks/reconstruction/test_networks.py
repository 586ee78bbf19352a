"""Parts of networks, and their sizes: an unusable one is one error that names it."""

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor, nn

from benchmarks.reconstruction.assignment import least_cost
from benchmarks.reconstruction.attention import DecoderLayer, EncoderLayer, hiding
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.models import MODELS, edge_tokens, load_model, panel_set, parameters
from benchmarks.reconstruction.stitching.run import main as stitching
from gcd_dataset.errors import ConfigError

NETWORKS = [name for name in MODELS if hasattr(load_model(name), "build")]
NEEDED = {
    "panel_set": "width heads layers queries slots edges edge_width edge_heads seam_layers tokens points stored_points",
    "edge_tokens": "width heads layers decoder_layers queries slots edges tokens points stored_points",
    "parameters": "width heads layers tokens points stored_points",
    "picture_set": "width heads layers queries slots edges edge_width edge_heads seam_layers views",
    "picture_parameters": "width heads layers views",
    "stitches": "width heads layers pair_width rounds confident",
    "segmentation": "width rounds tokens token_width heads panels seams",
    "drape_surrogate": "width rounds tokens token_width heads body second_rounds",
    "measures": "width heads layers tokens neighbours points",
}


@pytest.mark.parametrize(("model", "name"), [(model, name) for model in NETWORKS for name in NEEDED[model].split()])
def test_a_network_has_some_of_what_it_needs(model: str, name: str) -> None:
    with pytest.raises(ConfigError, match=rf"^{name} 0"):
        load_model(model).build(smoke=True, options={name: 0})


@pytest.mark.parametrize("model", NETWORKS)
def test_heads_share_the_width(model: str) -> None:
    for name in {"width", "edge_width", "token_width"} & set(NEEDED[model].split()):
        if "heads" in NEEDED[model] and not (name == "width" and "token_width" in NEEDED[model]):
            with pytest.raises(ConfigError, match=rf"{name} 33 is no multiple of (edge_)?heads 4"):
                load_model(model).build(smoke=True, options={name: 33})


@pytest.mark.parametrize("model", NETWORKS)
def test_an_unknown_size_is_refused(model: str) -> None:
    with pytest.raises(ConfigError, match=rf"^no size tables of {model}: choose of \w+, "):
        load_model(model).build(smoke=True, options={"tables": 3})


@pytest.mark.parametrize("model", ["panel_set", "edge_tokens", "parameters"])
def test_garments_have_a_point_for_each_token(model: str, six: GarmentSet) -> None:
    few = replace(six, points=six.points[:, :16])
    with pytest.raises(ConfigError, match="32 tokens of 16 points: give a power of 2, at most the points"):
        load_model(model).build(smoke=True, options={}).prepare(few, device=torch.device("cpu"))


@pytest.mark.parametrize("model", ["picture_set", "picture_parameters"])
def test_networks_of_pictures_have_no_sizes_of_points(model: str) -> None:
    with pytest.raises(ConfigError, match="no size region_width"):
        load_model(model).build(smoke=True, options={"region_width": 32})
    with pytest.raises(ConfigError, match="width 36: give a multiple of 32"):
        load_model(model).build(smoke=True, options={"width": 36})


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (["--width", "0"], "width 0 of stitches: give 1 or more"),
        (["--width", "33"], "width 33 is no multiple of heads 4 of stitches"),
        (["--heads", "0"], "heads 0 of stitches"),
        (["--pair-width", "0"], "pair_width 0 of stitches"),
        (["--foreign", "0.5"], "foreign is 0.5: give a share"),
    ],
)
def test_stitching_refuses_sizes_before_patterns_are_drawn(
    flags: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert stitching(["--smoke", "--device", "cpu", "--out", str(tmp_path / "out"), *flags]) == 1
    assert expected in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("module", [edge_tokens, panel_set, parameters])
def test_every_trained_parameter_has_a_gradient(module: ModuleType, six: GarmentSet) -> None:
    torch.manual_seed(0)
    learner = module.build(smoke=True, options={"points": 128, "stored_points": 512})
    batch = learner.prepare(six, device=torch.device("cpu")).batch(torch.arange(6))
    torch.autograd.backward(torch.stack(list(learner.loss(batch).values())).sum())
    assert [name for name, p in learner.named_parameters() if p.requires_grad and p.grad is None] == []


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


def test_the_total_cost_is_that_of_scipy() -> None:
    chance = torch.Generator().manual_seed(0)
    cost = 4.0 * torch.randn(24, 9, 13, generator=chance)
    asked = torch.rand(24, 9, generator=chance) < 0.7
    asked[:2] = torch.tensor([[True], [False]])
    found = least_cost(cost, asked)
    for table, rows, columns in zip(cost.numpy(), asked.numpy(), found.numpy(), strict=True):
        best = table[rows][linear_sum_assignment(table[rows])].sum()
        assert len(set(columns[rows].tolist())) == rows.sum()
        np.testing.assert_allclose(table[rows, columns[rows]].sum(), best, atol=1e-4)
        assert not columns[~rows].any()


def test_costs_that_are_no_numbers_are_avoided() -> None:
    nan = float("nan")
    cost = torch.tensor([[[nan, 1.0, 2.0], [nan, 0.0, 5.0]], [[nan] * 3, [nan] * 3]])
    found = least_cost(cost, torch.ones(2, 2, dtype=torch.bool))
    assert found[0].tolist() == [2, 1]
    assert len(set(found[1].tolist())) == 2
