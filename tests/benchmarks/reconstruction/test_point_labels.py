"""Labels of surface points: they are true to the mesh, tokens learn them, and mirror images swap the sides."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode

from benchmarks.reconstruction.derived import DERIVED, PANEL_CLASSES, derived_arrays
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.models.parameters import build, label_losses
from benchmarks.reconstruction.point_net import regions_of
from benchmarks.reconstruction.train import main
from benchmarks.reconstruction.training import TrainConfig, train
from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders import GeneratedGarments
from gcd_dataset.tensors import EDGE_LABELS

CPU = torch.device("cpu")
SIZES = {"points": 128, "stored_points": 512, "tokens": 16}
DRESS: dict[str, Any] = {
    "meta": {"upper": "Shirt", "bottom": "SkirtCircle", "wb": "StraightWB"},
    "shirt": {"strapless": False},
    "sleeve": {"sleeveless": False, "length": 0.6},
}


@cache
def dress() -> Any:
    return GeneratedGarments(1, 0, drape=None, resolution=3.0, points=4096, dtype=None, design=DRESS)[0]


def labels_of(item: dict[str, Any]) -> np.ndarray:
    return derived_arrays(item, ["box_labels"])["box_labels"]


def test_points_have_the_panel_on_which_they_lie() -> None:
    points = dress()["points"].numpy().astype(float)
    names = np.array(PANEL_CLASSES)[labels_of(dress())[:, 0]]
    across = {name: points[names == name, 0] for name in np.unique(names)}
    assert {"left_ftorso", "right_btorso", "left_sleeve_f", "right_sleeve_b", "wb_front", "skirt_back"} <= set(across)
    assert all((across[name] > -0.5).all() for name in across if name.startswith("left"))
    assert all((across[name] < 0.5).all() for name in across if name.startswith("right"))
    height = {name: points[names == name, 1].mean() for name in across}
    assert height["left_ftorso"] > height["wb_front"] > height["skirt_front"]
    behind = {name: points[names == name, 2].mean() for name in across}
    assert behind["left_ftorso"] > behind["left_btorso"]
    assert behind["skirt_front"] > behind["skirt_back"]


def test_points_of_two_flat_panels_have_their_labels() -> None:
    """Two panels are sewn along x = 0, and their upper edge, at y = 10, is a collar; the triangles are 1 cm wide."""
    names, collar = ["right_ftorso", "left_ftorso"], EDGE_LABELS.index("left_collar")
    grid = np.stack(np.meshgrid(np.arange(-5.0, 6.0), np.arange(0.0, 11.0), indexing="ij"), axis=-1).reshape(-1, 2)
    first = np.arange(121).reshape(11, 11)[:-1, :-1].ravel()
    faces = np.concatenate([first[:, None] + [0, 11, 12], first[:, None] + [0, 12, 1]])
    points = np.random.default_rng(0).uniform([-5, 0], [5, 10], (2000, 2))
    upper, seam = np.flatnonzero(grid[:, 1] == 10), np.flatnonzero(grid[:, 0] == 0)
    item = {
        "meta": {"panel_names": names},
        "box": torch.from_numpy(np.pad(grid, ((0, 0), (0, 1)))),
        "points": torch.from_numpy(np.pad(points, ((0, 0), (0, 4)))),
        "faces": torch.from_numpy(faces),
        "panel_id": torch.from_numpy((grid[faces, 0].mean(axis=1) > 0).astype(np.int64)),
        "labels": torch.from_numpy(np.stack([upper, np.full(11, collar)], axis=1)),
        "seams": torch.from_numpy(np.stack([seam, np.zeros(11, np.int64)], axis=1)),
    }
    panels, edges, seams = labels_of(item).T
    assert [PANEL_CLASSES[row] for row in panels] == [names[int(x > 0)] for x in points[:, 0]]
    assert (edges[points[:, 1] > 9.7] == collar).all()
    assert not edges[points[:, 1] < 9].any()
    assert seams[np.abs(points[:, 0]) < 0.3].all()
    assert not seams[np.abs(points[:, 0]) > 1].any()


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_a_drape_that_failed_has_labels_too(value: float) -> None:
    vertices = dress()["box"].clone()
    vertices[::7] = value
    assert DERIVED["draped_labels"].of({**dress(), "verts": vertices}).shape == (4096, 3)


def test_tokens_learn_what_their_points_belong_to(six: GarmentSet) -> None:
    torch.manual_seed(0)
    network = build(smoke=True, options={**SIZES, "labelled": 1})
    config = TrainConfig(steps=30, batch=6, lr=4e-3, log_every=5, weight_decay=0.0)
    curve = train(network, network.prepare(six, device=CPU), config, device=CPU).curve
    classes = np.concatenate([six.ragged["box_labels"][k][:, 0] for k in range(len(six))])
    shares = np.unique(classes, return_counts=True)[1] / len(classes)
    of_all = -(shares * np.log(shares)).sum()  # cross-entropy of an answer that is the same for all tokens
    assert curve[-1]["panels"] < 0.95 * of_all
    assert curve[-1]["borders"] < curve[0]["borders"]


def test_right_shares_cost_least() -> None:
    """The loss of the true shares is the entropy of the labels; any other answer costs more."""
    torch.manual_seed(0)
    labels = torch.tensor([[3.0, 0, 0], [3.0, 0, 1], [3.0, 2, 0], [5.0, 0, 1]]).expand(1, 2, -1, -1)
    panels, edges = torch.full((len(PANEL_CLASSES),), -30.0), torch.full((len(EDGE_LABELS),), -30.0)
    panels[[3, 5]] = torch.tensor([0.75, 0.25]).log()
    edges[1] = torch.logit(torch.tensor(0.25))  # label 2; label 0 has no column
    edges[-1] = 0.0  # half of the points are on a seam
    said = torch.cat([panels, edges]).expand(1, 2, -1)
    best = label_losses(said, labels)
    entropy = -(0.75 * np.log(0.75) + 0.25 * np.log(0.25))
    assert best["panels"].item() == pytest.approx(entropy, rel=1e-4)
    for _ in range(5):
        worse = label_losses(said + 0.5 * torch.randn_like(said), labels)
        assert all(worse[name] > best[name] for name in best)


def test_labels_stay_with_their_points() -> None:
    """Regions hold whole rows, so a label that tells the place of its point tells it in its region, too."""
    points = torch.randn(2, 64, 6, generator=torch.Generator().manual_seed(0))
    regions = regions_of(torch.cat([points, 2 * points[..., :1]], dim=-1), 8)
    assert torch.equal(regions[..., 6], 2 * regions[..., 0])


def test_mirror_images_have_the_labels_of_the_other_side(six: GarmentSet) -> None:
    network = build(smoke=True, options={**SIZES, "labelled": 1, "augmented": 1})
    examples = network.prepare(six, device=CPU)
    names = [PANEL_CLASSES.index(name) for name in ("left_ftorso", "right_ftorso", "skirt_front")]
    edges = [EDGE_LABELS.index(name) for name in ("left_collar", "right_collar", "")]
    own = torch.tensor([[a, b, 1] for a, b in zip(names, edges, strict=True)], dtype=torch.uint8)
    images = own[[1, 0, 2]]
    labels = own[torch.arange(512) % 3].expand(6, -1, -1)
    examples = replace(examples, whole=replace(examples.whole, labels=labels))
    rows = torch.arange(6)
    found = examples.batch(rows, torch.Generator().manual_seed(3))
    same = replace(examples, augmented=False).batch(rows, torch.Generator().manual_seed(3))
    mirrored = (found.points[..., 3] == -same.points[..., 3]).all(dim=1)
    assert 0 < mirrored.sum() < 6
    as_image = dict(zip(map(tuple, own.tolist()), map(tuple, images.tolist()), strict=True))
    for k in range(6):
        expected = [as_image[tuple(row)] if mirrored[k] else tuple(row) for row in same.labels[k].tolist()]
        assert [tuple(row) for row in found.labels[k].tolist()] == expected


def test_drawn_points_keep_their_labels(six: GarmentSet) -> None:
    """A label that tells the place of its point tells it in training batches, too."""
    network = build(smoke=True, options={**SIZES, "labelled": 1})
    examples = network.prepare(six, device=CPU)
    labels = torch.zeros(6, 512, 3, dtype=torch.uint8)
    labels[..., 2] = examples.whole.points[..., 0] > 0
    found = replace(examples, whole=replace(examples.whole, labels=labels)).batch(
        torch.tensor([4, 1, 2]), torch.Generator().manual_seed(5)
    )
    assert found.points.shape[1] == found.labels.shape[1] == 128
    assert torch.equal(found.labels[..., 2] == 1, found.points[..., 0] > 0)
    assert 0 < found.labels[..., 2].float().mean() < 1


def test_garments_without_labels_can_be_answered_but_not_learned_from(
    six: GarmentSet, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = replace(six, ragged={name: rows for name, rows in six.ragged.items() if name != "box_labels"})
    network = build(smoke=True, options={**SIZES, "labelled": 1})
    batch = network.prepare(bare, device=CPU).batch(torch.arange(6))
    with pytest.raises(ConfigError, match="labelled=1: the points of these garments have no labels"):
        network.loss(batch)
    network.eval()
    assert "borders" not in network.loss(batch)
    assert len(network.predict(batch)) == 6
    flags = ["--smoke", "--steps", "1", "--set", "labelled=1", "--out", str(tmp_path)]
    assert main(["parameters", "--task", "T1-scan", *flags]) == 1
    assert "the points of these garments have no labels" in capsys.readouterr().err


def test_labels_of_fresh_garments_are_encoded(six: GarmentSet) -> None:
    network = build(smoke=True, options={**SIZES, "labelled": 1})
    encode = network.encoder()
    assert encode is not None
    fresh = encode(six)
    assert torch.equal(fresh.labels, network.prepare(six, device=CPU).whole.labels)
    assert fresh.labels.shape == (6, 512, 3)


def test_a_labelled_step_never_reads_a_value_of_the_device(six: GarmentSet) -> None:
    network = build(smoke=True, options={**SIZES, "labelled": 1})
    batch = network.prepare(six, device=CPU).batch(torch.arange(6))
    with FakeTensorMode(allow_non_fake_inputs=True):  # its tensors have no values; reading one raises
        parts = network.loss(batch)
    assert {"panels", "borders"} < set(parts)
