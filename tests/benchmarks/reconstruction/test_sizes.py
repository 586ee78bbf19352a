"""Sizes of networks: an unusable one is one error that names it."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.models import MODELS, load_model
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
