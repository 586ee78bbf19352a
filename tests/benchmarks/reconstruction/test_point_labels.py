"""Labels of surface points: where the points lie that have a label, what a network says of them, and their mirror."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from benchmarks.reconstruction.derived import DERIVED, PANEL_CLASSES, derived_arrays
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.models.parameters import build, label_losses
from benchmarks.reconstruction.point_net import regions_of
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
def dress() -> dict[str, Any]:
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


def test_points_have_edge_and_seam_of_the_nearest_vertex() -> None:
    item, labels = dress(), labels_of(dress())
    points, box = (item[name].numpy().astype(float)[:, :3] for name in ("points", "box"))
    distance = cKDTree(box).query(points)[0]
    on_seams = cKDTree(box[item["seams"].numpy()[:, 0]]).query(points)[0]
    assert np.array_equal(labels[:, 2] == 1, on_seams <= distance + 1e-9)
    rows = item["labels"].numpy()
    collar = EDGE_LABELS.index("left_collar")
    near_collar = cKDTree(box[rows[rows[:, 1] == collar, 0]]).query(points)[0]
    assert (labels[:, 1] == collar).sum() > 5
    assert (near_collar[labels[:, 1] == collar] <= distance[labels[:, 1] == collar] + 1e-9).all()


def test_a_drape_that_failed_has_labels_too() -> None:
    item = {**dress(), "verts": torch.full_like(dress()["box"], torch.nan)}
    assert DERIVED["draped_labels"].of(item).shape == (4096, 3)


def test_tokens_learn_what_their_points_belong_to(six: GarmentSet) -> None:
    torch.manual_seed(0)
    network = build(smoke=True, options={**SIZES, "labelled": 1})
    config = TrainConfig(steps=60, batch=6, lr=4e-3, log_every=5, weight_decay=0.0)
    curve = train(network, network.prepare(six, device=CPU), config, device=CPU).curve
    assert curve[-1]["panels"] < curve[0]["panels"] / 2
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


def test_garments_without_labels_are_refused(six: GarmentSet) -> None:
    bare = replace(six, ragged={name: rows for name, rows in six.ragged.items() if name != "box_labels"})
    network = build(smoke=True, options={**SIZES, "labelled": 1})
    with pytest.raises(ConfigError, match="labelled 1: these garments have no labels of points"):
        network.prepare(bare, device=CPU)
    assert network.prepare(six, device=CPU).whole.labels.shape == (6, 512, 3)
