"""The network of design parameters: what it ignores, that its answers can be sewn, and that it learns."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from benchmarks.reconstruction.derived import CENTRE, DERIVED, derived_arrays
from benchmarks.reconstruction.design_codes import PARAMETERS, decode_design, encode_design, have_effect, options_of
from benchmarks.reconstruction.design_net import Answer, DesignAugmentation, DesignTargets, drawn
from benchmarks.reconstruction.garments import GarmentSet, Ragged
from benchmarks.reconstruction.models.parameters import MOST_GROWTH, SMALL, ParameterNet, build
from benchmarks.reconstruction.panel_targets import UNIT
from benchmarks.reconstruction.propose import WEIGHTS, network
from gcd_dataset.curves import sample_curve
from gcd_dataset.errors import ConfigError, GcdError, PatternError
from gcd_dataset.faults import Severity, check_pattern
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.garments import GarmentDesign, design_from_dict, design_to_dict, draw_garment, sample_design
from gcd_dataset.generator.garments.parameter import Choice, plain
from gcd_dataset.loaders import GeneratedGarments, Scan
from gcd_dataset.measurements import MEASURES, Measurements
from gcd_dataset.metrics import score_pattern
from gcd_dataset.metrics.answers import PANEL_CLASSES
from gcd_dataset.records import Pattern
from gcd_dataset.scoring.inputs import POINTS, SCAN_SIZE
from gcd_dataset.tensors import EDGE_LABELS
from tests.benchmarks.reconstruction.toys import loss_of

CPU = torch.device("cpu")
PATHS = [leaf.path for leaf in PARAMETERS]


def learner(**sizes: int) -> ParameterNet:
    torch.manual_seed(0)
    return build({**SMALL, "points": 128, "stored_points": 512, "tokens": 16, **sizes})


def test_the_true_parameters_and_measures_draw_the_true_pattern(six: GarmentSet) -> None:
    for k in range(len(six)):
        sizes = six.measures[k].astype(float)
        score = score_pattern(drawn(Answer(six.ragged["design"][k][0], sizes, sizes)), six.pattern(k))
        assert score.combinatorial == 1
        assert score.iou > 0.999
        assert score.transl_cm < 0.01


def test_parameters_without_effect_change_no_loss(six: GarmentSet) -> None:
    network = learner().eval()
    batch = network.prepare(six, device=CPU).batch(torch.arange(6))
    shirt = torch.tensor([path.startswith("shirt.") for path in PATHS])
    assert not batch.effective[:, shirt].any()
    assert loss_of(network, replace(batch, codes=torch.where(shirt, torch.nan, batch.codes))) == loss_of(network, batch)
    bottom = PATHS.index("meta.bottom")
    other = batch.codes.clone()
    other[:, bottom] = 3.0
    assert loss_of(network, replace(batch, codes=other)) != loss_of(network, batch)


def test_numbers_are_told_the_choices(six: GarmentSet) -> None:
    network = learner().eval()
    batch = network.prepare(six, device=CPU).batch(torch.arange(6))
    other = batch.codes.clone()
    other[:, PATHS.index("meta.wb")] = 1.0 - other[:, PATHS.index("meta.wb")].clamp(max=1)
    one, told = (network.loss(replace(batch, codes=codes)) for codes in (batch.codes, other))
    assert one["numbers"].item() != told["numbers"].item()
    assert one["measures"].item() != told["measures"].item()


def test_any_numbers_draw_a_garment_that_can_be_sewn() -> None:
    rng = np.random.default_rng(0)
    neutral = measure(build_body(neutral_shape())).to_file_values()
    usual = np.array([neutral[name] for name in MEASURES])
    for _ in range(12):
        codes = np.array([
            rng.integers(9) if isinstance(space, Choice) else rng.uniform(*(np.array(space.range) * 1.2))
            for _, space in PARAMETERS
        ], np.float32)  # fmt: skip
        pattern = drawn(Answer(codes, usual * rng.uniform(0.6, 1.5, len(usual)), usual))
        assert pattern.panels
        assert not [fault for fault in check_pattern(pattern) if fault.severity is Severity.ERROR]


def test_answers_before_training_exist_and_do_not_depend_on_their_batch(six: GarmentSet) -> None:
    network = learner().eval()
    examples = network.prepare(six.select([0, 1]), device=CPU)
    whole, alone = (list(network.answers(examples, 2, batch=size)) for size in (2, 1))
    assert len(whole) == 2
    assert all(score_pattern(one, other).iou > 0.99 for one, other in zip(whole, alone, strict=True))


def test_upper_and_bottom_are_chosen_among_outfits_that_exist(six: GarmentSet) -> None:
    network = learner().eval()
    batch = network.prepare(six, device=CPU).batch(torch.arange(6))
    with torch.no_grad():
        biases = network.decoder.biases
        biases[PATHS.index("meta.upper"), 4] = biases[PATHS.index("meta.bottom"), 8] = 50.0
        biases[PATHS.index("meta.bottom"), 3] = 40.0
    for answer in network._said(batch):
        meta = decode_design(answer.codes).meta
        assert (meta.upper, meta.bottom.value if meta.bottom else "") == (None, "Pants")


def test_a_closure_is_never_answered_as_no_random_design_has_one(six: GarmentSet) -> None:
    """Its rows are not trained: three trainings answered fronts with a zip or buttons, whose bands have three parts."""
    network = learner().eval()
    batch = network.prepare(six, device=CPU).batch(torch.arange(6))
    with torch.no_grad():
        network.decoder.biases[PATHS.index("front.closure"), 2] = 50.0
    assert all(decode_design(answer.codes).front == GarmentDesign().front for answer in network._said(batch))


def outline(pattern: Pattern) -> np.ndarray:
    """Points on the edges of placed panels, sorted by place [cm]."""
    found = []
    for panel in pattern.panels:
        loop = [sample_curve(*panel.edge_ends(k), edge.curve, 9) for k, edge in enumerate(panel.edges)]
        flat = np.pad(np.concatenate(loop), ((0, 0), (0, 1)))
        found.append(flat @ panel.placement.matrix.T + panel.placement.translation)
    return np.concatenate(found)


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Greatest distance of a point to the other points [cm]."""
    return float(max(cKDTree(a).query(b)[0].max() for a, b in ((one, other), (other, one))))


def targets_of(design: GarmentDesign) -> DesignTargets:
    codes = torch.from_numpy(encode_design(design_to_dict(design)))[None]
    return DesignTargets(codes, torch.from_numpy(have_effect(design))[None], torch.ones(1, len(MEASURES)))


def test_mirrored_codes_draw_the_mirror_image() -> None:
    """The origin of a pattern lies a little off the middle, of one with godets up to a centimetre."""
    augmentation, sizes = DesignAugmentation(CPU), measure(build_body(neutral_shape()))
    kinds, cuts, reasons = set(), 0, set()
    for seed in range(40):
        design = sample_design(np.random.default_rng(seed))
        targets = targets_of(design)
        try:
            image = outline(draw_garment(sizes, design)) * [-1, 1, 1]
        except GcdError:
            continue
        if augmentation.can_mirror(targets).item():
            codes = augmentation.mirrored(targets, torch.tensor([True])).codes[0].numpy()
            bottom = plain(design.meta.bottom)
            limit = 1.1 if bottom == "GodetSkirt" else 0.5
            assert apart(outline(draw_garment(sizes, decode_design(codes))), image) < limit
            kinds.add(bottom)
            cuts += bool(targets.effective[0, PATHS.index("flare-skirt.cut.place")])
        else:
            reasons.add("halves" if design.left.enable_asym and design.halves() else plain(design.meta.bottom))
    assert kinds >= {None, "Pants", "PencilSkirt", "Skirt2", "SkirtCircle", "GodetSkirt", "SkirtLevels"}
    assert cuts > 1
    assert "halves" in reasons
    assert reasons <= {"halves", "SkirtManyPanels", "GodetSkirt", "SkirtLevels"}


def test_scaled_codes_draw_the_scaled_panels_on_the_scaled_body() -> None:
    """Of nearly all garments: some limits of the programs are lengths."""
    body, factor = measure(build_body(neutral_shape())).to_file_values(), 1.04
    augmentation, fits = DesignAugmentation(CPU), []
    for seed in range(16):
        design = sample_design(np.random.default_rng(seed))
        targets = replace(targets_of(design), measures=torch.tensor([[body[name] for name in MEASURES]]))
        scaled = augmentation.scaled(targets, torch.tensor([factor]))
        larger = Measurements.from_file_values(dict(zip(MEASURES, scaled.measures[0].tolist(), strict=True)))
        try:
            small = draw_garment(Measurements.from_file_values(body), design)
            large = draw_garment(larger, decode_design(scaled.codes[0].numpy()))
        except GcdError:
            continue
        names = sorted(panel.name for panel in small.panels)  # the order of panels depends on their places
        sizes = [[np.ptp(pattern.panel(name).vertices, axis=0).max() for name in names] for pattern in (small, large)]
        apart_cm = np.abs(factor * np.array(sizes[0]) - sizes[1])
        fits.append(bool((apart_cm < 0.02 * np.array(sizes[1]) + 0.6).all()))  # some lengths are whole centimetres
    assert len(fits) > 10
    assert np.mean(fits) > 0.85


def test_training_batches_are_mirrored_and_scaled(six: GarmentSet) -> None:
    tilted = {"meta": {"bottom": "PencilSkirt"}, "pencil-skirt": {"low_angle": 12}}
    uneven = {"meta": {"upper": "Shirt"}, "left": {"enable_asym": True}}
    codes = [encode_design(design_to_dict(design_from_dict(tilted if k < 4 else uneven))) for k in range(6)]
    made = replace(six, ragged={**six.ragged, "design": Ragged.of([code[None] for code in codes])})
    network = learner(augmented=1)
    examples = network.prepare(made, device=CPU)
    rows = torch.arange(6)
    found, same = (
        e.batch(rows, torch.Generator().manual_seed(3)) for e in (examples, replace(examples, augmented=False))
    )
    height, angle = MEASURES.index("height"), MEASURES.index("shoulder_incl")
    scales = found.measures[:, height] / same.measures[:, height]
    assert 1 - MOST_GROWTH <= scales.min() < 0.99
    assert 1.01 < scales.max() <= 1 + MOST_GROWTH
    assert torch.equal(found.measures[:, angle], same.measures[:, angle])
    mirrored = found.codes[:, PATHS.index("pencil-skirt.low_angle")] == -12
    assert 0 < mirrored[:4].sum() < 4
    assert not mirrored[4:].any()
    sign = torch.where(mirrored, -1.0, 1.0)
    place = [one.points[..., :3].double() * UNIT + torch.from_numpy(CENTRE) for one in (found, same)]
    expected = place[1] * scales[:, None, None]
    expected[..., 0] *= sign[:, None]
    assert (place[0] - expected).abs().max() < 0.1  # positions are stored in half precision
    assert torch.equal(found.points[..., 3], same.points[..., 3] * sign[:, None].half())
    assert torch.equal(found.points[..., 4:], same.points[..., 4:])
    alone = examples.batch(rows[2:3], torch.Generator().manual_seed(3))
    assert torch.equal(alone.points[0], found.points[2])
    assert network.drawn_from(examples.whole).augmented


# --------------------------------------------------------------------------------------------------------- design codes


def row_of(design: GarmentDesign) -> np.ndarray:
    return encode_design(design_to_dict(design))


@pytest.mark.parametrize("seed", range(3))
def test_a_design_comes_back_from_its_row(seed: int) -> None:
    design = sample_design(np.random.default_rng(seed))
    again = decode_design(row_of(design))
    assert np.array_equal(row_of(again), row_of(design), equal_nan=True)
    assert again.meta == design.meta
    assert again.shirt.length == pytest.approx(design.shirt.length, rel=1e-6)


def test_missing_and_impossible_values_are_unknown_and_become_defaults() -> None:
    row = encode_design({"meta": {"upper": "Shirt", "wb": "Rope"}, "shirt": {"length": 99.0, "width": 1.2}})
    known = {path for path, code in zip(PATHS, row, strict=True) if not np.isnan(code)}
    assert known == {"meta.upper", "shirt.width"}
    assert decode_design(row).shirt.length == GarmentDesign().shirt.length
    assert decode_design(row).shirt.width == pytest.approx(1.2)


def test_garments_drawn_on_request_have_no_rows() -> None:
    """So new ones leave the networks' sizes, and the rows of kept weights, as they are."""
    row = encode_design({"meta": {"bottom": "PleatedSkirt"}, "pleated-skirt": {"count": 4}})
    assert np.isnan(row).all()
    assert not any(path.startswith("pleated-skirt") for path in PATHS)
    assert network(WEIGHTS).decoder.queries.shape[0] == len(PATHS) + len(MEASURES)


DESIGNS: dict[str, dict[str, Any]] = {
    "strapless": {"meta": {"upper": "FittedShirt"}, "shirt": {"strapless": True}},
    "lapel": {
        "meta": {"upper": "Shirt", "bottom": "GodetSkirt", "wb": "FittedWB"},
        "collar": {"f_collar": "Bezier2NeckHalf", "component": {"style": "SimpleLapel"}},
        "sleeve": {"sleeveless": False, "cuff": {"type": "CuffBandSkirt"}},
    },
    "levels": {"meta": {"upper": "FittedShirt", "bottom": "SkirtLevels"}, "levels-skirt": {"base": "SkirtCircle"}},
    "ruffled levels": {
        "meta": {"bottom": "SkirtLevels"},
        "levels-skirt": {"base": "Skirt2", "level": "SkirtCircle"},
        "skirt": {"bottom_cut": 0.3, "ruffle": 1.4},
        "flare-skirt": {"cut": {"add": True}},
    },
    "godets": {
        "meta": {"bottom": "GodetSkirt", "wb": "FittedWB"},
        "godet-skirt": {"base": "PencilSkirt"},
        "pencil-skirt": {"length": 0.7, "left_slit": 0.4, "front_slit": 0.3},
    },
    "pants": {"meta": {"bottom": "Pants"}, "pants": {"cuff": {"type": "CuffBand"}}},
    "poncho": {"meta": {"upper": "Poncho"}},
}


def changed_rows(row: np.ndarray, *, effective: bool) -> Iterator[tuple[str, np.ndarray]]:
    """Rows with another value of one parameter with or without effect, in the sections that the design uses."""
    design = decode_design(row)
    for k in np.flatnonzero(have_effect(design) == effective).tolist():
        path, space = PARAMETERS[k]
        section = path.partition(".")[0].replace("-", "_")
        if np.isnan(row[k]) or section == "meta" or section not in design.sections_used():
            continue
        other = row.copy()
        if isinstance(space, Choice):
            other[k] = (row[k] + 1) % len(options_of(space))
        else:
            low, high = space.range
            other[k] = low if row[k] - low > high - row[k] else high
        yield path, other


@pytest.mark.parametrize("name", DESIGNS)
def test_parameters_without_effect_change_no_pattern(name: str) -> None:
    size = measure(build_body(neutral_shape()))
    row = row_of(design_from_dict(DESIGNS[name]))

    def pattern_text(codes: np.ndarray) -> str:
        pattern = draw_garment(size, decode_design(codes))
        return repr((pattern.panels, pattern.seams))

    truth = pattern_text(row)
    for path, other in changed_rows(row, effective=False):
        try:
            assert pattern_text(other) == truth, path
        except PatternError as error:
            pytest.fail(f"{path}: {error}")


@pytest.mark.parametrize("name", [name for name in DESIGNS if name not in ("lapel", "strapless", "poncho")])
def test_parameters_with_effect_change_the_pattern(name: str) -> None:
    size = measure(build_body(neutral_shape()))
    row = row_of(design_from_dict(DESIGNS[name]))
    truth = draw_garment(size, decode_design(row)).panels
    unchanged = []
    for path, other in changed_rows(row, effective=True):
        try:
            unchanged += [path] if repr(draw_garment(size, decode_design(other)).panels) == repr(truth) else []
        except PatternError:  # an ornament, which is not pattern_text
            assert path == "pencil-skirt.style_side_cut"
    assert not unchanged
    assert len(list(changed_rows(row, effective=True))) >= 7


# --------------------------------------------------------------------------------------------------------- point labels


LABEL_SIZES = {"points": 128, "stored_points": 512, "tokens": 16}
DRESS: dict[str, Any] = {
    "meta": {"upper": "Shirt", "bottom": "SkirtCircle", "wb": "StraightWB"},
    "shirt": {"strapless": False},
    "sleeve": {"sleeveless": False, "length": 0.6},
}


@cache
def dress() -> Any:
    return GeneratedGarments(1, 0, drape=None, resolution=3.0, points=4096, dtype=None, design=DRESS)[0]


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
    panels, edges, seams = derived_arrays(item, ["box_labels"])["box_labels"].T
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


def test_mirror_images_have_the_labels_of_the_other_side(six: GarmentSet) -> None:
    examples = build({**SMALL, **LABEL_SIZES, "labelled": 1, "augmented": 1}).prepare(six, device=CPU)
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


def test_points_of_a_scan_have_the_panel_that_its_camera_saw() -> None:
    item = {**dress(), "verts": dress()["box"]}
    names, labels = item["meta"]["panel_names"], derived_arrays(item, ["scan", "scan_labels"])["scan_labels"]
    seen = Scan(n=1, points=POINTS, size=SCAN_SIZE)(item)["scan_panel_id"].numpy()
    right = [PANEL_CLASSES[row] == names[panel] for row, panel in zip(labels[:, 0], seen, strict=True)]
    assert np.mean(right) > 0.95  # noise moves points by millimetres, over seams, too


def test_garments_without_labels_can_be_answered_but_not_learned_from(six: GarmentSet) -> None:
    bare = replace(six, ragged={name: rows for name, rows in six.ragged.items() if name != "box_labels"})
    network = build({**SMALL, **LABEL_SIZES, "labelled": 1})
    batch = network.prepare(bare, device=CPU).batch(torch.arange(6))
    with pytest.raises(ConfigError, match="labelled=1: the points of these garments have no labels"):
        network.loss(batch)
    network.eval()
    assert "borders" not in network.loss(batch)
    assert len(network.predict(batch)) == 6
