"""Outfits that are drawn: their files, their garments in order, and the samples made of them."""

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcd_dataset.cli import main
from gcd_dataset.errors import ConfigError, DrapeError
from gcd_dataset.generator import build_pattern, fitting
from gcd_dataset.generator.body import build_body, neutral_shape
from gcd_dataset.generator.drape import DrapeJob
from gcd_dataset.generator.garments import design_from_dict
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.outfits import order_fault, read_outfits, worn_open
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.loaders import GeneratedGarments, Views
from gcd_dataset.making.garments import generate
from gcd_dataset.records import Closure, Outcome, Pattern, Sample
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards import ShardReader, encode_sample
from gcd_dataset.spec import write_pattern
from tests.generator.test_pipeline import NEUTRAL, Failing

TEXT = """
[designs.shirt]
meta = { upper = "Shirt", wb = "none", bottom = "none" }
left.enable_asym = false
shirt = { length = 1.25, width = 1.05, flare = 1.0 }
collar = { width = 0.2, fc_depth = 0.4, bc_depth = 0.0, component.style = "none" }
sleeve.sleeveless = true

[designs.skirt]
meta = { upper = "none", wb = "none", bottom = "SkirtCircle" }
flare-skirt = { length = { range = [0.3, 0.5] }, suns = 0.4, rise = 1.0, cut.add = false }

[[outfits]]
worn = [{ design = "shirt", tucked = 1 }, { design = "skirt" }]
"""
THREE = """
[[outfits]]
weight = 3
worn = [{ design = "shirt", tucked = 0 }, { design = "skirt" }, { design = "vest", closed = 0 }]
[designs.vest]
meta = { upper = "Shirt", wb = "none", bottom = "none" }
front.closure = "zip"
"""


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> MakeConfig:
    path = tmp_path_factory.mktemp("outfits") / "two.toml"
    path.write_text(TEXT)
    small: dict[str, Any] = {"resolution": 4.0, "device": "cpu", "picture": 16, "points": 64}
    return MakeConfig(bodies="neutral", outfits=str(path), captions=True, **small)


@pytest.fixture(scope="module")
def alone(config: MakeConfig) -> Sample:
    return next(produce(3, [1], config))


def test_kinds_are_drawn_by_weight_and_a_shirt_that_is_not_tucked_is_worn_over_the_next(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(TEXT + THREE)
    outfits = read_outfits(tmp_path / "own.toml")
    drawn = [outfits.draw(rng(0, number, Stage.OUTFIT)) for number in range(400)]
    counts = [len(one) for one in drawn]
    assert counts.count(3) == pytest.approx(300, abs=30)
    tucked, over = drawn[counts.index(2)], drawn[counts.index(3)]
    shirt, skirt = (one.design for one in tucked)
    assert [one.design for one in over[:2]] == [skirt, shirt]
    assert [one.tucked for one in (*tucked, *over)] == [True, False, False, False, False]
    assert [one.closed for one in over] == [True, True, False]
    assert not any(one.may_have_legs for one in over)


def test_no_skirt_is_drawn_for_hips_that_hold_none() -> None:
    slim, outfits = replace(NEUTRAL, hips=NEUTRAL.waist + 5.0), read_outfits("everyday")
    drawn = [[outfits.draw(rng(0, n, Stage.OUTFIT), wearers) for n in range(50)] for wearers in ([slim], [NEUTRAL])]
    skirts = [sum(one.is_skirt for outfit in outfits for one in outfit) for outfits in drawn]
    assert skirts[0] == 0 < skirts[1]


@pytest.mark.parametrize(
    ("change", "to", "message"),
    [
        (', { design = "skirt" }', "", "outfit 1: an outfit of 1 garment: give 2 to 8"),
        ('{ design = "skirt" }', '{ design = "shirt" }', "outfit 1: shirt is worn twice"),
        ('{ design = "skirt" }', '{ design = "skrt" }', "outfit 1: no design skrt: there are shirt, skirt"),
        ('{ design = "skirt" }', '{ design = "skirt", tucked = 0.5 }', "skirt is the outermost garment"),
        ("tucked = 1", "tucked = 2", "shirt has tucked = 2: give tucked or closed, from 0 to 1"),
        ("tucked = 1", "fabric = 2", "shirt has fabric = 2"),
        ("[[outfits]]", "[[outfits]]\nweight = 0", "weight is 0: give a number above 0"),
        ("[[outfits]]", "[[outfit]]", "no entry outfit: there are designs and outfits"),
        ("suns = 0.4", "sun = 0.4", "designs.skirt: no design parameter is called flare-skirt.sun"),
    ],
)  # fmt: skip
def test_a_fault_in_a_file_of_outfits_is_one_line(tmp_path: Path, change: str, to: str, message: str) -> None:
    path = tmp_path / "own.toml"
    assert change in TEXT
    path.write_text(TEXT.replace(change, to))
    with pytest.raises(ConfigError, match=f"own.toml: .*{message}"):
        MakeConfig(outfits=str(path))


def test_outfits_are_part_of_the_recipe_and_name_their_designs(config: MakeConfig) -> None:
    assert "outfits" not in recipe_of(replace(config, outfits=""))
    assert recipe_of(replace(config, outfits="everyday"))["outfits"] == "everyday"
    assert len(recipe_of(config)["outfits"]) == 64  # the hash of the content, wherever the file lies
    with pytest.raises(ConfigError, match=r"no outfits everyda: .*: did you mean everyday\?"):
        replace(config, outfits="everyda")
    with pytest.raises(ConfigError, match="sizes is for single garments"):
        replace(config, sizes="women")


def test_an_outfit_lies_in_order_and_each_garment_draws_for_itself(alone: Sample, config: MakeConfig) -> None:
    assert alone.outfit is not None
    shirt, skirt = alone.outfit.garments
    assert (shirt.tucked, skirt.tucked) == (True, False)
    assert [one.drape.outcome for one in (shirt, skirt) if one.drape] == [Outcome.SETTLED] * 2
    [layer] = alone.outfit.layers
    assert (layer.inner, layer.outer, layer.wrong_order < 0.05) == (0, 1, True)
    assert layer.covered > 0
    assert alone.pattern is shirt.pattern
    assert {"top", "skirt"} <= set(alone.tags)
    assert " tucked into " in str(alone.caption).splitlines()[0]
    made = list(produce(3, [1, 2], replace(config, fabric="random", picture=0), draper=Failing(0)))
    for sample in made:
        assert sample.outfit is not None
        assert sample.outfit.garments[0].fabric != sample.outfit.garments[1].fabric
    lengths = {one.outfit.garments[1].design["flare-skirt"]["length"] for one in made if one.outfit}
    assert len(lengths) == 2


@pytest.mark.long
def test_workers_make_the_same_outfits_and_shards_give_them_back(
    alone: Sample, config: MakeConfig, tmp_path: Path
) -> None:
    generate(tmp_path / "set", 2, seed=3, config=config, workers=2)
    reader, members = ShardReader(tmp_path / "set"), encode_sample(alone, garments=2)
    assert {name: bytes(data) for name, data in reader.read(1, members).items()} == members
    read = reader.sample(1)
    assert read.outfit is not None and alone.outfit is not None
    assert read.outfit.layers == alone.outfit.layers
    assert main(["check", str(tmp_path / "set")]) == 0


def test_pictures_show_the_whole_outfit(config: MakeConfig) -> None:
    options: dict[str, Any] = {"bodies": "neutral", "outfits": config.outfits, "resolution": 4.0, "device": "cpu"}
    made: dict[str, Any] = dict(GeneratedGarments(2, seed=3, picture=16, views=1, view_size=48, **options)[1])
    bare = {name: value for name, value in made.items() if not name.startswith("g1_")}
    bare["meta"] = {name: value for name, value in made["meta"].items() if name not in ("outfit", "layers")}
    views = Views(1, 48, seed=3, device="cpu")
    stored = made["view_0"].permute(1, 2, 0).float()
    whole, first = ((views(item)["views"][0].float() - stored).abs().mean() for item in (made, bare))
    assert whole < 4.0 < first  # the stored one is a JPEG


def test_a_garment_that_fails_is_drawn_again_and_one_over_a_failed_one_is_refused(config: MakeConfig) -> None:
    plain = replace(config, picture=0, views=1)
    [sample] = produce(3, [1], plain, draper=Failing(1))
    assert sample.provenance.rejects == ("drape: not_settled",)
    assert sample.outfit is not None and sample.provenance.attempts == 2
    [kept] = produce(3, [1], replace(plain, on_fail="keep"), draper=Failing(1))
    assert kept.outfit is not None and kept.grade is not None
    outcomes = [one.drape and (one.drape.outcome, one.drape.reason) for one in kept.outfit.garments]
    assert outcomes == [(Outcome.NOT_SETTLED, ""), (Outcome.REFUSED, "a garment under it is NOT_SETTLED")]
    assert (kept.grade.value, kept.outfit.layers, len(kept.views)) == ("failed", (), 1)


def worn(name: str, **design: Any) -> Pattern:
    return build_pattern(NEUTRAL, design_from_dict({"meta": {}, **design}), name=name)


@pytest.fixture(scope="module")
def garments() -> dict[str, Pattern]:
    arm = {"sleeveless": False, "length": 0.9, "connecting_width": 0.6}
    return {
        "shirt": worn("shirt", meta={"upper": "Shirt"}, shirt={"length": 1.25}),
        "skirt": worn("skirt", meta={"bottom": "SkirtCircle", "wb": "StraightWB"}, **{"flare-skirt": {"length": 0.4}}),
        "trousers": worn("trousers", meta={"bottom": "Pants"}, pants={"length": 0.6}),
        "coat": worn("coat", meta={"upper": "Shirt"}, shirt={"length": 2.5, "width": 1.3}, sleeve=arm),
        "jacket": worn("jacket", meta={"upper": "Shirt"}, front={"closure": "zip"}, sleeve=arm),
    }


@pytest.mark.parametrize(
    ("under", "outer", "fault"),
    [
        ("shirt", "trousers", ""),
        ("trousers shirt", "coat", ""),
        ("trousers", "skirt", ""),
        ("trousers", "trousers", ""),
        ("skirt", "trousers", "trousers over skirt, which hangs"),
        ("shirt coat", "skirt", r"skirt over coat, which hangs \d+ cm below the crotch: .* give skirt before it"),
    ],
)
def test_a_skirt_or_trousers_go_over_what_their_waist_holds(
    garments: dict[str, Pattern], under: str, outer: str, fault: str
) -> None:
    found = order_fault([garments[name] for name in under.split()], garments[outer], NEUTRAL)
    assert re.match(fault, found) if fault else not found


def test_a_jacket_worn_open_is_not_tucked(garments: dict[str, Pattern]) -> None:
    opened = worn_open(garments["jacket"])
    assert [seam.joined for seam in opened.seams if seam.closure == Closure.ZIP] == [(0.0, 0.0)]
    assert order_fault([garments["jacket"]], garments["trousers"], NEUTRAL) == ""
    assert "whose front is open" in order_fault([opened], garments["trousers"], NEUTRAL)


def test_outfits_end_with_a_stage_before_the_drape(config: MakeConfig, alone: Sample) -> None:
    [meshed] = produce(3, [1], replace(config, stage="mesh"))
    assert meshed.outfit is not None and alone.outfit is not None
    for found, draped in zip(meshed.outfit.garments, alone.outfit.garments, strict=True):
        assert (found.box_mesh, found.drape) == (draped.box_mesh, None)
    assert meshed.outfit.layers == ()


def test_a_shirt_is_tucked_below_the_top_edge_of_the_skirt_over_it(
    garments: dict[str, Pattern], monkeypatch: pytest.MonkeyPatch
) -> None:
    skirt, jobs = garments["skirt"], list[DrapeJob]()
    raised = [replace(p.placement, translation=p.placement.translation + [0.0, 8.0, 0.0]) for p in skirt.panels]
    panels = zip(skirt.panels, raised, strict=True)
    high = replace(skirt, panels=tuple(replace(panel, placement=to) for panel, to in panels))

    def stop(given: Sequence[DrapeJob], *, device: str) -> None:
        jobs.extend(given)
        raise DrapeError("seen")

    monkeypatch.setattr(fitting, "drape_outfit", stop)
    body = build_body(neutral_shape())
    with pytest.raises(DrapeError, match="seen"):
        fitting.drape_together([garments["shirt"], high], lambda _: (body, NEUTRAL), resolution=4.0, device="cpu")
    assert [job.tucked_below for job in jobs] == [pytest.approx(NEUTRAL.waist_level + 8.0, abs=0.1), -np.inf]


def test_drape_wears_files_in_the_order_given(
    garments: dict[str, Pattern], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, pattern in garments.items():
        write_pattern(pattern, tmp_path / f"{name}.json")

    def drape(*names: str, options: str = "") -> tuple[int, str]:
        files = [str(tmp_path / f"{name}.json") for name in names]
        code = main(
            ["drape", *files, *options.split(), "--outfit", "--out", str(tmp_path / "out")]
            + ["--resolution", "4", "--device", "cpu", "--quiet", "--glb"]
        )
        return code, capsys.readouterr().err

    for names, options, code, message in (
        (["coat", "skirt"], "", 1, "the garments cannot be worn in this order: skirt over coat"),
        (["shirt", "shirt"], "", 2, "shirt.json is given twice"),
        (["shirt"], "", 2, "an outfit of 1 garment: give 2 to 8"),
        (["shirt", "skirt"], "--maps", 2, "leave it out with --outfit"),
        (["shirt", "none"], "", 1, "none.json: no such file"),
    ):
        found = drape(*names, options=options)
        assert (found[0], found[1].count("\n"), message in found[1]) == (code, 1, True), found
    assert not (tmp_path / "out").exists()
    assert drape("shirt", "skirt")[0] == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert [row["outcome"] for row in report["garments"]] == ["SETTLED"] * 2
    assert [(row["inner"], row["outer"]) for row in report["layers"]] == [(0, 1)]
    assert b"garment_1" in (tmp_path / "out" / "outfit.glb").read_bytes()
    assert "o garment_1\n" in (tmp_path / "out" / "outfit.obj").read_text()
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"outfit.ply", "outfit_front.png", "outfit_side.png", "outfit_back.png"} <= written
