"""The network of design parameters: what it ignores, that its answers can be sewn, and that it learns."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from torch._subclasses.fake_tensor import FakeTensorMode

from benchmarks.reconstruction.derived import CENTRE
from benchmarks.reconstruction.design_codes import PARAMETERS, decode_design, encode_design, have_effect
from benchmarks.reconstruction.design_net import Answer, DesignAugmentation, DesignTargets, drawn
from benchmarks.reconstruction.garments import GarmentSet, Ragged
from benchmarks.reconstruction.models.parameters import MOST_GROWTH, Designs, ParameterNet, build
from benchmarks.reconstruction.panel_targets import UNIT
from benchmarks.reconstruction.training import TrainConfig, train
from gcd_dataset.curves import sample_curve
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.faults import Severity, check_pattern
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.garments import GarmentDesign, design_from_dict, design_to_dict, draw_garment, sample_design
from gcd_dataset.generator.garments.parameter import Choice, plain
from gcd_dataset.measurements import MEASURES, Measurements
from gcd_dataset.metrics import score_pattern
from gcd_dataset.records import Pattern

CPU = torch.device("cpu")
PATHS = [leaf.path for leaf in PARAMETERS]


def learner(**sizes: int) -> ParameterNet:
    torch.manual_seed(0)
    return build(smoke=True, options={"points": 128, "stored_points": 512, "tokens": 16, **sizes})


def loss_of(network: ParameterNet, batch: Designs) -> float:
    with torch.no_grad():
        return float(sum(part.item() for part in network.loss(batch).values()))


def test_the_true_parameters_and_measures_draw_the_true_pattern(six: GarmentSet) -> None:
    for k in range(len(six)):
        sizes = six.measures[k].astype(float)
        pattern = drawn(Answer(six.ragged["design"][k][0], sizes, sizes))
        score = score_pattern(pattern, six.pattern(k))
        assert score.topology_exact == 1
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


def test_measures_that_are_unknown_teach_nothing(six: GarmentSet) -> None:
    network = learner()
    batch = network.prepare(six, device=CPU).batch(torch.arange(6))
    unknown = replace(batch, measures=torch.full_like(batch.measures, torch.nan))
    assert network.loss(unknown)["measures"].item() == 0.0


def test_any_numbers_draw_a_garment_that_can_be_sewn() -> None:
    rng = np.random.default_rng(0)
    usual = np.array([neutral()[name] for name in MEASURES])
    for _ in range(12):
        codes = np.array([
            rng.integers(9) if isinstance(space, Choice) else rng.uniform(*(np.array(space.range) * 1.2))
            for _, space in PARAMETERS
        ], np.float32)  # fmt: skip
        pattern = drawn(Answer(codes, usual * rng.uniform(0.6, 1.5, len(usual)), usual))
        assert pattern.panels
        assert not [fault for fault in check_pattern(pattern) if fault.severity is Severity.ERROR]


def neutral() -> dict[str, float]:
    return measure(build_body(neutral_shape())).to_file_values()


def test_answers_before_training_exist_and_do_not_depend_on_their_batch(six: GarmentSet) -> None:
    network = learner().eval()
    examples = network.prepare(six, device=CPU)
    whole, alone = (list(network.answers(examples, 6, batch=size)) for size in (6, 1))
    assert len(whole) == 6
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


def test_a_step_never_reads_a_value_of_the_device(six: GarmentSet) -> None:
    network = learner()
    batch = network.prepare(six, device=CPU).batch(torch.arange(6))
    with FakeTensorMode(allow_non_fake_inputs=True):  # its tensors have no values; reading one raises
        parts = network.loss(batch)
    assert all(part.shape == () for part in parts.values())


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
    for seed in range(60):
        design = sample_design(np.random.default_rng(seed))
        targets = targets_of(design)
        try:
            image = outline(draw_garment(sizes, design)) * [-1, 1, 1]
        except GcdError:
            continue
        if augmentation.can_mirror(targets).item():
            codes = augmentation.mirrored(targets, torch.tensor([True])).codes[0].numpy()
            bottom = plain(design.meta.bottom)
            assert apart(outline(draw_garment(sizes, decode_design(codes))), image) < (
                1.1 if bottom == "GodetSkirt" else 0.5
            )
            kinds.add(bottom)
            cuts += bool(targets.effective[0, PATHS.index("flare-skirt.cut.place")])
        else:
            reasons.add("halves" if design.left.enable_asym and design.halves() else plain(design.meta.bottom))
    assert kinds >= {None, "Pants", "PencilSkirt", "Skirt2", "SkirtCircle", "GodetSkirt", "SkirtLevels"}
    assert cuts > 2
    assert "halves" in reasons
    assert reasons <= {"halves", "SkirtManyPanels", "GodetSkirt", "SkirtLevels"}


def test_scaled_codes_draw_the_scaled_panels_on_the_scaled_body() -> None:
    """Of nearly all garments: some limits of the programs are lengths."""
    body, factor = measure(build_body(neutral_shape())).to_file_values(), 1.04
    augmentation, fits = DesignAugmentation(CPU), []
    for seed in range(30):
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
    assert len(fits) > 20
    assert np.mean(fits) > 0.85


def test_answers_use_all_stored_points(six: GarmentSet) -> None:
    """Also those beyond as many as a training step sees."""
    network = learner().eval()
    network.decoder.learn_range(six)
    examples = network.prepare(six, device=CPU)
    moved = examples.whole.points.clone()
    moved[:, network.config.points :, 0] += 0.5
    one, other = (
        [answer.measures for answer in network._said(some.batch(torch.arange(6)))]
        for some in (examples, replace(examples, whole=replace(examples.whole, points=moved)))
    )
    assert not np.allclose(one, other)


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


def test_the_loss_is_finite_in_half_precision(six: GarmentSet) -> None:
    network = learner()
    batch = network.prepare(six, device=CPU).batch(torch.arange(6))
    with torch.autocast("cpu", torch.bfloat16):
        found = loss_of(network, batch)
    assert found == pytest.approx(loss_of(network, batch), rel=0.1)


def test_the_loss_falls(six: GarmentSet) -> None:
    network = learner()
    config = TrainConfig(steps=15, batch=6, lr=4e-3, log_every=5, weight_decay=0.0)
    curve = train(network, network.prepare(six, device=CPU), config, device=CPU).curve
    assert curve[-1]["loss"] < 0.8 * curve[0]["loss"]


def test_wrong_sizes_are_refused() -> None:
    with pytest.raises(ConfigError, match="24 tokens of 128 points: give a power of 2"):
        learner(tokens=24)
