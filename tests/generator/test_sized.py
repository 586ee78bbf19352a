"""Garments cut for a size of a chart and worn by another body."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gcd_dataset import generate
from gcd_dataset.check import checks
from gcd_dataset.check.garments import CheckedGarment, garment_faults
from gcd_dataset.errors import BodyError, ConfigError
from gcd_dataset.generator.body import build_body, measure
from gcd_dataset.generator.body.shape import draw_from
from gcd_dataset.generator.body.sizes import read_chart
from gcd_dataset.generator.garments import GarmentDesign, design_from_dict
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.garments.rules import neckline_girth
from gcd_dataset.generator.garments.sewable import CLOTH_GIVES
from gcd_dataset.generator.garments.tightness import rings
from gcd_dataset.generator.maker import make, produce
from gcd_dataset.generator.pipeline import all_replies, build_pattern, drape_jobs, prepare, rejection
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.generator.sized import Cut, draw_cut, lifted, size_or_none
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.records import MISFITS, Fit, Measurements, Outcome
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards import ShardReader
from gcd_dataset.shards.codec import decode_sample, encode_sample

WOMEN = read_chart("women")
SIZED = MakeConfig(stage="pattern", bodies="female", sizes="women", misfit="-3:3")
SHIRT = design_from_dict({"meta": {"upper": "Shirt"}})
DRESS = design_from_dict({"meta": {"upper": "FittedShirt", "bottom": "PencilSkirt"}})
SKIRT = design_from_dict({"meta": {"bottom": "PencilSkirt"}})
TROUSERS = design_from_dict({"meta": {"bottom": "Pants", "wb": "StraightWB"}})
DESIGNS = {"shirt": SHIRT, "dress": DRESS, "skirt": SKIRT, "trousers": TROUSERS}


def fit_of(design: GarmentDesign, size: str, wearer: Measurements) -> Fit:
    cut = Cut(WOMEN, size, size_or_none(WOMEN, wearer))
    return cut.fit(build_pattern(cut.measures, design), design, wearer)


@pytest.mark.parametrize("design", DESIGNS.values(), ids=DESIGNS)
def test_two_sizes_larger_every_ring_is_longer_round_the_same_wearer(design: GarmentDesign) -> None:
    wearer = WOMEN.body("96")
    small, large = (list(rings(WOMEN.body(size), design, wearer)) for size in ("92", "100"))
    assert [ring.name for ring in small] == [ring.name for ring in large]
    assert small and all(a.cloth < b.cloth for a, b in zip(small, large, strict=True))
    at_fixed_places = ("a shirt at the bust", "a top edge", "trousers at the hips")
    assert all(a.body == b.body for a, b in zip(small, large, strict=True) if a.name in at_fixed_places)


@pytest.mark.parametrize("design", DESIGNS.values(), ids=DESIGNS)
def test_a_garment_of_the_wearers_size_fits_and_labels_tell_the_cloth_from_the_body(design: GarmentDesign) -> None:
    assert fit_of(design, "96", WOMEN.body("96")) == Fit("women", "96", "96", 0)
    tight = fit_of(design, "76", WOMEN.body("96"))
    assert tight.step == -5
    assert tight.obstacle is not None
    for label in tight.labels:
        assert label.rule in ("too_tight", "cannot_be_put_on")
        assert label.figures["ring_cm"] * CLOTH_GIVES < label.figures["body_cm"]


def test_a_ring_that_closes_with_a_fastening_need_not_pass_the_bust() -> None:
    """The waist of a fitted dress is narrower than any bust; a jumper's hem is not, and must pass it."""
    wearer = WOMEN.body("96")
    assert not fit_of(DRESS, "88", wearer).labels
    wide = replace(wearer, bust=1.3 * wearer.bust)
    obstacle = Cut(WOMEN, "96", "96").fit(build_pattern(wearer, SHIRT), SHIRT, wide).obstacle
    assert obstacle is not None and obstacle.figures["body_cm"] == wide.bust


def test_a_neckline_must_pass_the_head() -> None:
    pattern, wearer = build_pattern(WOMEN.body("96"), SHIRT), WOMEN.body("96")
    girth = neckline_girth(pattern)
    assert girth == pytest.approx(2 * np.pi * 9, rel=0.5)
    obstacle = Cut(WOMEN, "96", "96").fit(pattern, SHIRT, replace(wearer, head_l=girth)).obstacle
    assert obstacle is not None and obstacle.reason.startswith("a neckline that passes the head")


def test_large_trousers_slide_off_and_a_long_dress_reaches_the_floor() -> None:
    slim = replace(WOMEN.body("96"), waist=70.0, hips=74.0)
    cut = Cut(WOMEN, "96", "96")
    found = cut.fit(build_pattern(cut.measures, TROUSERS), TROUSERS, slim).labels
    assert {label.rule for label in found} == {"slides_off"}
    assert found[0].figures == pytest.approx({"girth_cm": WOMEN.body("96").waist, "trunk_cm": 74.0}, rel=0.1)
    short = replace(WOMEN.body("96"), height=70.0)
    found = cut.fit(build_pattern(cut.measures, DRESS), DRESS, short).labels
    assert "reaches_floor" in {label.rule for label in found}


def test_a_wearer_without_a_measure_is_refused() -> None:
    """A measure that is unsure on a mesh is NaN."""
    with pytest.raises(BodyError, match="measures bust are missing"):
        fit_of(SHIRT, "96", replace(WOMEN.body("96"), bust=np.nan))


def test_a_garment_is_placed_by_the_wearers_nape_or_waist() -> None:
    small = WOMEN.body("84")
    tall = replace(small, height=small.height + 9.0, waist_line=small.waist_line + 2.0)
    for design, rise in ((SHIRT, 9.0), (SKIRT, 7.0)):
        pattern = build_pattern(small, design)
        at_height = lifted(pattern, design, cut_for=small, wearer=tall)
        for before, after in zip(pattern.panels, at_height.panels, strict=True):
            assert after.placement.translation - before.placement.translation == pytest.approx([0.0, rise, 0.0])


def test_step_0_is_the_pattern_of_the_charts_body_and_a_step_changes_the_size_alone() -> None:
    own, moved = (make(4, 3, replace(SIZED, misfit=steps)) for steps in ("0:0", "1:1"))
    assert own.fit is not None and moved.fit is not None
    assert (own.fit.cut_for, own.fit.step, moved.fit.step) == (WOMEN.size_of(own.measurements), 0, 1)
    assert own.measurements == moved.measurements
    drawn = build_pattern(WOMEN.body(own.fit.cut_for), design_from_dict(own.design))
    for panel, worn in zip(drawn.panels, own.pattern.panels, strict=True):
        assert np.array_equal(panel.vertices, worn.vertices) and panel.edges == worn.edges
    assert drawn.seams == own.pattern.seams


def test_steps_are_uniform_and_stay_in_the_chart() -> None:
    sizes = list(WOMEN.bodies)
    drawn = Counter(draw_cut(WOMEN, "96", (-3, 3), rng(1, index, Stage.MISFIT)).size for index in range(700))
    assert drawn.keys() == {*sizes[2:9]}
    assert all(count == pytest.approx(100, abs=40) for count in drawn.values())
    ends = {draw_cut(WOMEN, sizes[0], (-3, 1), rng(1, index, Stage.MISFIT)).size for index in range(20)}
    assert ends == {*sizes[:2]}
    assert draw_cut(WOMEN, sizes[-1], (2, 3), rng(1, 0, Stage.MISFIT)).size == sizes[-1]


def test_a_body_outside_the_chart_is_drawn_again(tmp_path: Path) -> None:
    """The first of the bodies that would be drawn for the design, with a size in the chart."""
    text, chart = Path(WOMEN.source).read_text(), tmp_path / "few.toml"
    chart.write_text(text[text.index("[sizes.84]") : text.index("[sizes.96]")])
    config = replace(SIZED, sizes=str(chart))
    again = 0
    for sample in produce(2, range(5), config):
        assert sample.fit is not None and sample.fit.chart == "few.toml"
        assert sample.fit.wearer_size in ("84", "88", "92") and sample.fit.cut_for in ("84", "88", "92")
        _, _, number, *place = sample.provenance.body_name.split(":")
        _, shape = draw_from("female", rng(2, int(number), Stage.BODY, int(place[0]) if place else 0))
        assert measure(build_body(shape)) == sample.measurements
        again += bool(place)
    assert again
    with pytest.raises(ConfigError, match=r"the neutral body has no size in .*few.toml: choose other bodies"):
        make(2, 0, replace(config, bodies="both"))


def test_the_recipe_holds_the_content_of_a_chart_and_omits_defaults(tmp_path: Path) -> None:
    assert not {"sizes", "misfit"} & recipe_of(MakeConfig()).keys()
    copy = tmp_path / "copy.toml"
    copy.write_bytes(Path(WOMEN.source).read_bytes())
    recipe = recipe_of(replace(SIZED, sizes=str(copy)))
    (tmp_path / "other").mkdir()
    moved = replace(SIZED, sizes=str(copy.rename(tmp_path / "other" / "copy.toml")))
    assert recipe_of(moved) == recipe
    renamed = replace(SIZED, sizes=str(Path(moved.sizes).rename(tmp_path / "renamed.toml")))
    assert make(4, 3, renamed) != make(4, 3, moved)  # fit.chart
    assert recipe_of(renamed) != recipe
    assert recipe_of(SIZED)["sizes"] == "women"
    assert recipe_of(replace(SIZED, misfit="-03:+3")) == recipe_of(SIZED)
    assert "misfit" not in recipe_of(replace(SIZED, misfit="+0:-0"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"misfit": "-1:1"}, "misfit is -1:1, but there is no size chart: give sizes"),
        ({"sizes": "women", "misfit": "3:-3"}, "the smaller first, such as -3:3"),
        ({"sizes": "women", "misfit": "3"}, "misfit is '3': give two whole numbers"),
        ({"sizes": "wome"}, "no chart wome"),
    ],
)
def test_bad_options_are_refused(options: dict[str, str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        MakeConfig(**options)  # type: ignore[arg-type]


SLIM = Overlay.from_dict({"meta": {"upper": "FittedShirt", "bottom": "PencilSkirt", "wb": "none"}})
MISFIT = replace(SIZED, stage="drape", misfit="-9:2", resolution=8.0, points=64, picture=48, device="cpu", design=SLIM)
TINY = replace(MISFIT, misfit="-9:-9")


def test_a_garment_that_cannot_be_put_on_is_stored_undraped_and_read_again(tmp_path: Path) -> None:
    generate(tmp_path, 2, config=replace(TINY, views=1, view_size=32), workers=0)
    for item in GarmentDataset(tmp_path):
        assert item["meta"]["drape"]["outcome"] == "CANNOT_BE_PUT_ON"
        assert item["meta"]["drape"]["frames"] == 0
        assert item["meta"]["grade"] == "failed"
        [*_, label] = item["meta"]["fit"]["labels"]
        assert label["figures"]["ring_cm"] * CLOTH_GIVES < label["figures"]["body_cm"]
        assert (item["verts"] - item["box"]).abs().max() < 0.01
        assert checks.FAILED_DRAPE not in {kind for kind, _ in garment_faults(CheckedGarment.of(item))}
    sample = ShardReader(tmp_path, "train").sample(1)
    assert sample.fit is not None and sample.fit.obstacle is not None
    assert not sample.front and not sample.views[0].picture
    assert encode_sample(decode_sample(encode_sample(sample))) == encode_sample(sample)


def test_pictures_are_read_where_the_first_garment_cannot_be_put_on(tmp_path: Path) -> None:
    obstacles = ((seed, [prepare(seed, n, MISFIT).dressed[0].obstacle for n in (0, 1)]) for seed in range(4, 30))
    seed = next(seed for seed, (first, second) in obstacles if first and not second)
    generate(tmp_path, 2, seed=seed, config=MISFIT, workers=0)
    sizes = [item["front"].shape[-1] for item in GarmentDataset(tmp_path, fields=["front"])]
    assert sizes == [0, MISFIT.picture]
    assert "back" in GarmentDataset(tmp_path).fields


def test_misfits_are_no_failed_drapes() -> None:
    design = next(design for number in range(9) if (design := prepare(3, number, TINY)).dressed[0].obstacle)
    assert drape_jobs(design, TINY) == ()
    [reply] = all_replies(design, (), TINY)
    assert reply.drape.outcome is Outcome.CANNOT_BE_PUT_ON
    for outcome in Outcome:
        drape = replace(reply.drape, outcome=outcome)
        assert (rejection(design, [drape], TINY) is None) == (outcome in MISFITS | {Outcome.SETTLED})
        made_to_measure = rejection(design, [drape], replace(TINY, sizes="", misfit="0:0"))
        assert (made_to_measure is None) == (outcome is Outcome.SETTLED)


@pytest.mark.long
def test_workers_change_no_byte_where_some_wearers_can_put_on_a_design() -> None:
    config = replace(MISFIT, bodies_each=2, captions=True, views=1, view_size=32)
    alone, shared = (list(produce(4, range(3), config, finished=encode_sample, workers=n)) for n in (0, 2))
    assert alone == shared
    outcomes = Counter(decode_sample(members).drape.outcome for members in alone)  # type: ignore[union-attr]
    assert len(outcomes) > 1 and Outcome.CANNOT_BE_PUT_ON in outcomes
