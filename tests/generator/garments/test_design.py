"""Design spaces, overlays that narrow them, and design files."""

import json
import pickle
import pydoc
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.garments import GarmentDesign, design_from_dict, design_to_dict
from gcd_dataset.generator.garments.collar import Collar, CollarDesign
from gcd_dataset.generator.garments.design import MetaDesign, design_tree, read_design, write_design
from gcd_dataset.generator.garments.overlay import Overlay, read_overlay
from gcd_dataset.generator.garments.pants import PantsDesign
from gcd_dataset.generator.garments.parameter import Real
from gcd_dataset.generator.garments.shirt import ShirtDesign
from gcd_dataset.generator.garments.sleeve import LeftSleeveDesign
from gcd_dataset.generator.garments.space import (
    Design,
    DesignSpace,
    choice,
    draw,
    flag,
    integer,
    leaves,
    meanings,
    part,
    read_values,
    real,
    redrawn,
    to_dict,
)
from gcd_dataset.generator.garments.waistband import Waistband
from gcd_dataset.generator.garments.wardrobe import Bottom, Upper


class Shape(Enum):
    ROUND = "round"
    POINTED = "pointed"


@dataclass(frozen=True)
class HemDesign(Design):
    depth: float = real(2.0, 1.0, 5.0, keep=0.7)
    rows: int = integer(2, 1, 4, keep=0.5)
    stitched: bool = flag(True, keep=0.8)
    shape: Shape | None = choice(None, *Shape, None)


@dataclass(frozen=True)
class ApronDesign(Design):
    hem: HemDesign = part(HemDesign)
    upper_hem: HemDesign = part(HemDesign, key="upper-hem")
    width: float = real(40.0, 20.0, 80.0)


def test_help_names_every_parameter_with_its_meaning() -> None:
    space = DesignSpace.declared(GarmentDesign)
    documented = {leaf.path: text for leaf, text in meanings(space)}
    assert list(documented) == [leaf.path for leaf in leaves(space, added=True)]
    assert [path for path, text in documented.items() if not text.endswith(".")] == []
    shown = " ".join(pydoc.plain(pydoc.render_doc(PantsDesign)).replace("|", "").split())
    for path, text in documented.items():
        if path.startswith("pants."):
            assert f"{path.removeprefix('pants.')}: " in shown
            assert text in shown
    assert "cuff.cuff_len: a number from 0.05 to 0.9; default 0.1 with probability 0.3. Length, as a frac" in shown


def test_defaults_keep_their_probability_and_other_values_are_equally_likely() -> None:
    rng = np.random.default_rng(3)
    drawn = [draw(HemDesign, rng) for _ in range(2000)]
    assert np.mean([d.depth == 2.0 for d in drawn]) == pytest.approx(0.7, abs=0.03)
    assert np.mean([d.rows == 2 for d in drawn]) == pytest.approx(0.5, abs=0.03)
    assert np.mean([d.stitched for d in drawn]) == pytest.approx(0.8, abs=0.03)
    rows = [d.rows for d in drawn if d.rows != 2]
    assert [rows.count(n) / len(rows) for n in (1, 3, 4)] == pytest.approx([1 / 3] * 3, abs=0.04)
    shapes = [d.shape for d in drawn]
    assert [shapes.count(s) / len(shapes) for s in (None, *Shape)] == pytest.approx([1 / 3] * 3, abs=0.03)


def test_narrowed_ranges_hold_and_limits_outside_give_the_nearest_value() -> None:
    space, rng = DesignSpace.declared(HemDesign), np.random.default_rng(0)
    assert all(3.0 <= redrawn(space, HemDesign(), "depth", rng, 3.0, 4.0).depth <= 4.0 for _ in range(50))
    assert redrawn(space, HemDesign(), "rows", rng, high=1.0).rows == 1
    assert redrawn(space, HemDesign(), "depth", rng, high=-3.0).depth == 1.0
    assert redrawn(space, HemDesign(), "depth", rng, 7.0, 9.0).depth == 5.0


def test_a_value_out_of_range_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"HemDesign: depth is 9\.0, not a number from 1 to 5"):
        HemDesign(depth=9.0)
    _, faults = read_values(DesignSpace.declared(HemDesign), {"rows": 1.5})
    assert faults == ["rows is 1.5, not a whole number from 1 to 4"]


def test_a_file_holds_plain_values_under_the_reference_names() -> None:
    values = design_to_dict(GarmentDesign())
    assert values["meta"] == {"upper": None, "wb": None, "bottom": None}
    assert values["flare-skirt"]["suns"] == 0.75
    assert values["collar"]["f_collar"] == "CircleNeckHalf"
    assert to_dict(HemDesign()) == {"depth": 2.0, "rows": 2, "stitched": True, "shape": None}


def test_numbers_of_a_file_get_the_type_of_the_parameter() -> None:
    hem, _ = read_values(DesignSpace.declared(HemDesign), {"depth": 3, "rows": 3.0, "shape": "round"})
    assert (type(hem.depth), type(hem.rows), hem.shape) == (float, int, Shape.ROUND)


def test_leaves_hold_everything_in_a_design_file() -> None:
    told = [(leaf.path, leaf.space.kind, leaf.space.range, leaf.space.keep) for leaf in leaves(ApronDesign)]
    hem = [
        ("depth", "float", [1.0, 5.0], 0.7),
        ("rows", "int", [1, 4], 0.5),
        ("stitched", "bool", [True, False], 0.8),
        ("shape", "select_null", ["round", "pointed", None], None),
    ]
    below = [(f"{above}.{path}", *rest) for above in ("hem", "upper-hem") for path, *rest in hem]
    assert told == [*below, ("width", "float", [20.0, 80.0], None)]
    assert len(list(leaves(GarmentDesign))) == 122


def test_draws_follow_a_changed_space_and_its_parts() -> None:
    deep = {"upper-hem.depth": Real(4.5, 1.0, 4.0, 5.0)}
    apron = draw(DesignSpace.declared(ApronDesign).changed(deep), np.random.default_rng(1))
    assert apron.upper_hem.depth == 4.5
    with pytest.raises(ConfigError, match=r"no design parameter is called hem\.width"):
        DesignSpace.declared(ApronDesign).changed({"hem.width": Real(1.0, None, 1.0, 1.0)})
    long = DesignSpace.declared(GarmentDesign).changed({"left.sleeve.length": Real(1.0, None, 1.0, 1.0)})
    assert draw(long.of(LeftSleeveDesign), np.random.default_rng(1)).length == 1.0
    assert long.of(ShirtDesign) == DesignSpace.declared(ShirtDesign)
    assert draw(long.of(CollarDesign), np.random.default_rng(1)) == draw(CollarDesign, np.random.default_rng(1))


def test_a_part_must_be_the_only_one_of_its_kind() -> None:
    with pytest.raises(ConfigError, match="ApronDesign has 2 parts of kind HemDesign"):
        DesignSpace.declared(ApronDesign).of(HemDesign)
    with pytest.raises(ConfigError, match="HemDesign has 0 parts of kind ApronDesign"):
        DesignSpace.declared(HemDesign).of(ApronDesign)


WORKWEAR = """
[meta]
bottom = { options = ["Pants", "none"], keep = 0 }
wb = { keep = 0.25 }

[collar.component]
style = "Hood2Panels"

[left]
enable_asym = false

[pants]
length = { range = [0.7, 0.9] }

[sleeve]
sleeve_angle = { range = [10, 20], keep = 0.5 }
"""


@pytest.fixture
def workwear(tmp_path: Path) -> Overlay:
    file = tmp_path / "workwear.toml"
    file.write_text(WORKWEAR)
    return read_overlay(file)


def drawn_from(overlay: Overlay, count: int = 200) -> list[GarmentDesign]:
    rng = np.random.default_rng(5)
    return [draw(overlay.space, rng) for _ in range(count)]


def test_draws_stay_within_the_overlay(workwear: Overlay) -> None:
    designs = drawn_from(workwear)
    assert {design.meta.bottom for design in designs} == {Bottom.PANTS}  # none is the default, never kept
    assert {design.collar.component.style for design in designs} == {Collar.HOOD}
    assert not any(design.left.enable_asym for design in designs)
    lengths = [design.pants.length for design in designs]
    assert 0.7 <= min(lengths) < 0.72 and 0.88 < max(lengths) <= 0.9
    angles = [design.sleeve.sleeve_angle for design in designs]
    assert set(angles) == set(range(10, 21))
    assert np.mean([angle == 10 for angle in angles]) == pytest.approx(0.5, abs=0.12)
    assert np.mean([design.meta.wb is None for design in designs]) == pytest.approx(0.25, abs=0.1)


def test_other_parameters_are_drawn_as_without_the_overlay(workwear: Overlay) -> None:
    changed = {path for path, _ in workwear.changes}
    assert changed == {
        "meta.wb", "meta.bottom", "collar.component.style", "sleeve.sleeve_angle", "left.enable_asym", "pants.length",
    }  # fmt: skip
    before, after = (dict(leaves(kind)) for kind in (GarmentDesign, workwear.space))
    assert list(before) == list(after)
    assert {path for path in before if before[path] != after[path]} == changed
    assert Overlay().space == Overlay.from_dict({}).space
    same = [draw(kind, np.random.default_rng(1)) for kind in (GarmentDesign, Overlay().space)]
    assert same[0] == same[1]


def test_a_part_is_drawn_alone_within_limits(workwear: Overlay) -> None:
    rng, pants = np.random.default_rng(2), workwear.space.of(PantsDesign)
    lengths = [redrawn(pants, draw(pants, rng), "length", rng, high=0.75).length for _ in range(50)]
    assert all(0.7 <= length <= 0.75 for length in lengths)
    assert draw(workwear.space.of(MetaDesign), rng).bottom is Bottom.PANTS
    # Limits outside the overlay's range give the nearest value of that range.
    assert redrawn(pants, draw(pants, rng), "length", rng, high=0.3).length == 0.7


def test_every_change_survives_json_and_pickle(workwear: Overlay) -> None:
    overlays: list[dict[str, Any]] = [
        {"pants": {"length": {"range": [0.7, 0.9], "keep": 0.1}}},
        {"pants": {"length": {"range": [0.7, 0.9], "keep": 0}}},
        {"pants": {"length": 0.5}},
        {"pants": {"length": {"keep": 0.5}}},
        {"meta": {"wb": "none", "upper": {"options": ["Shirt", "none"], "keep": 1}}},
        {"flare-skirt": {"cut": {"add": True}, "skirt-many-panels": {"panel_curve": {"options": [0, 0.15]}}}},
        {"godet-skirt": {"num_inserts": 8, "insert_w": {"range": [10, 10]}}},
    ]
    for overlay in (workwear, *map(Overlay.from_dict, overlays)):
        again = Overlay.from_dict(json.loads(json.dumps(overlay.to_dict())))
        assert overlay == again == pickle.loads(pickle.dumps(overlay))
        assert (again.space, hash(again)) == (overlay.space, hash(overlay))
        assert drawn_from(overlay, 3)


def test_the_order_of_a_file_does_not_matter() -> None:
    one = {"pants": {"length": 0.5, "rise": 1}, "meta": {"wb": "FittedWB"}}
    other = {"meta": {"wb": "FittedWB"}, "pants": {"rise": 1.0, "length": 0.5}}
    assert Overlay.from_dict(one) == Overlay.from_dict(other)
    assert json.dumps(Overlay.from_dict(one).to_dict()) == json.dumps(Overlay.from_dict(other).to_dict())


def test_an_overlay_can_fix_none() -> None:
    overlay = Overlay.from_dict({"meta": {"wb": {"options": ["none", "FittedWB"], "keep": 0.5}, "upper": "none"}})
    drawn = {(design.meta.upper, design.meta.wb) for design in drawn_from(overlay, 50)}
    assert drawn == {(None, None), (None, Waistband.FITTED)}


def test_an_excluded_default_loses_its_probability_or_becomes_the_nearest_value() -> None:
    free = drawn_from(Overlay.from_dict({"shirt": {"length": {"range": [2.0, 3.0]}}}), 100)
    assert len({design.shirt.length for design in free}) == 100
    kept = drawn_from(Overlay.from_dict({"shirt": {"length": {"range": [2.0, 3.0], "keep": 0.5}}}))
    assert np.mean([design.shirt.length == 2.0 for design in kept]) == pytest.approx(0.5, abs=0.12)


def test_an_overlay_without_any_garment_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"meta\.upper and meta\.bottom are both none"):
        Overlay.from_dict({"meta": {"upper": "none", "bottom": "none"}})
    Overlay.from_dict({"meta": {"upper": "none"}})


def leaves_in(path: Path) -> dict[str, Mapping[str, Any]]:
    """The leaves of a design file by their paths, in its order."""
    return dict(_leaves(yaml.safe_load(path.read_text())["design"], ""))


def _leaves(tree: Mapping[str, Any], above: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for key, node in tree.items():
        if "range" in node:
            yield above + key, node
        else:
            yield from _leaves(node, f"{above}{key}.")


def test_the_default_file_equals_the_references_leaf_by_leaf(examples: Path, tmp_path: Path) -> None:
    write_design(GarmentDesign(), tmp_path / "ours.yaml")
    ours, theirs = leaves_in(tmp_path / "ours.yaml"), leaves_in(examples / "default.yaml")
    assert list(ours) == list(theirs)
    cut = "pencil-skirt.style_side_cut"  # the reference's range lacks null, which its sampler adds
    assert ours[cut] == {**theirs[cut], "range": [*theirs[cut]["range"], None]}
    for path in theirs.keys() - {cut}:
        assert ours[path] == theirs[path], path
        assert list(ours[path]) == list(theirs[path])


def test_the_references_designs_survive_a_file_to_the_last_digit(examples: Path, tmp_path: Path) -> None:
    files = sorted(examples.glob("patterns/*/*/design_params.yaml"))
    assert len(files) == 24
    for file in files[::5]:
        design = read_design(file)
        write_design(design, tmp_path / "design.yaml")
        assert read_design(tmp_path / "design.yaml") == design
        ours, theirs = leaves_in(tmp_path / "design.yaml"), leaves_in(file)
        assert {path: leaf["v"] for path, leaf in ours.items()} == {path: leaf["v"] for path, leaf in theirs.items()}


def test_any_design_survives_its_file_to_the_last_digit(tmp_path: Path) -> None:
    for seed in range(10):
        design = draw(GarmentDesign, np.random.default_rng(seed))
        write_design(design, tmp_path / "design.yaml")
        assert read_design(tmp_path / "design.yaml") == design
    for length in (0.1 + 0.2, 5e-17, -1e-5, np.nextafter(0.95, 0)):
        design = design_from_dict({"skirt": {"length": length}})
        write_design(design, tmp_path / "design.yaml")
        assert read_design(tmp_path / "design.yaml").skirt.length == length


def test_omitted_parameters_keep_their_defaults_and_bare_values_are_read(tmp_path: Path) -> None:
    file = tmp_path / "design.yaml"
    file.write_text("design:\n  meta:\n    upper: {v: Shirt}\n  shirt:\n    length: 2\n")
    design = read_design(file)
    assert (design.meta.upper, design.shirt.length) == (Upper.SHIRT, 2.0)
    assert design.pants == GarmentDesign().pants
    (tmp_path / "design.yaml").write_text('{"skirt": {"bottom_cut": {"v": 1e-05}}}')  # YAML 1.1 wants 1.0e-05
    assert read_design(tmp_path / "design.yaml").skirt.bottom_cut == 1e-5


def entry(value: Any) -> dict[str, Any]:
    """A parameter as GarmentCode writes it."""
    return {"v": value, "range": [value], "type": "float", "default_prob": 0.5}


BELT: dict[str, Any] = {"meta": {"upper": entry("Shirt"), "wb": entry(None)}, "shirt": {"length": entry(2)}}
FORMS = {
    "entries.yaml": yaml.safe_dump({"design": BELT}),
    "no_level.yml": yaml.safe_dump(BELT),
    "bom.yaml": "\ufeff" + yaml.safe_dump(BELT),
    "member.txt": '{"meta": {"upper": "Shirt", "wb": null}, "shirt": {"length": 2e0}}',
    "tabs.json": '{\n\t"design": {"meta": {"upper": "Shirt"}, "shirt": {"length": 2}}}',
    "overlay.toml": '[design.meta]\nupper = "Shirt"\nwb = "none"\n[design.shirt]\nlength = 2',
    "texts.yaml": "meta: {upper: {v: Shirt}, wb: {v: None}}\nshirt: {length: {v: '2.0'}}",
}


@pytest.mark.parametrize("name", FORMS)
def test_every_form_of_a_design_file_gives_the_same_design(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(FORMS[name])
    assert read_design(tmp_path / name) == design_from_dict(BELT) == design_from_dict({"design": BELT})
    assert design_from_dict(BELT).shirt.length == 2.0


def test_all_faults_of_a_file_are_named_at_once(tmp_path: Path) -> None:
    (tmp_path / "design.yaml").write_text("{shirt: {lenght: 1, width: 9}, pant: {}, pants: {rise: low}}")
    with pytest.raises(ConfigError) as caught:
        read_design(tmp_path / "design.yaml")
    assert str(caught.value).partition("design.yaml: ")[2] == (
        "no design parameter is called shirt.lenght: did you mean shirt.length?; "
        "no design parameter is called pant: did you mean pants?; "
        "shirt.width is 9, not a number from 1 to 1.3; pants.rise is 'low', not a number from 0.5 to 1"
    )


def test_parameters_of_other_versions_that_change_nothing_are_named_in_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    tree = design_tree(design_from_dict(BELT))
    others = {
        "meta": {**tree["meta"], "connected": entry(False)},  # neutral
        "pants": {**tree["pants"], "pockets": entry(2)},  # of a garment that is not worn
        "layers-skirt": {"base": entry("SkirtCircle"), "more": {"depth": entry(0.5)}},  # of one that we lack
    }
    assert design_from_dict({**tree, **others}) == design_from_dict(BELT)
    for listed in ("meta.connected = False", "pants.pockets = 2", "layers-skirt.more.depth = 0.5"):
        assert listed in caplog.text


@pytest.mark.parametrize(
    ("others", "message"),
    [
        ({"shirt": {"openfront": entry(True)}}, r"called shirt\.openfront"),
        ({"meta": {"upper": "Shirt", "connected": entry(True)}}, r"called meta\.connected"),
        ({"level-skirt": {"base": "SkirtCircle"}}, r"level-skirt: did you mean levels-skirt\?"),
        ({"shirt": {"openfront": False}}, r"called shirt\.openfront"),  # without a range it may be misspelt
    ],
)
def test_parameters_that_may_change_the_garment_are_refused(others: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        design_from_dict({"meta": {"upper": "Shirt"}, **others})


def test_names_and_values_beyond_number_end_at_once() -> None:
    level: Any = entry(0)
    for _ in range(4):
        level = dict.fromkeys(map(str, range(1000)), level)
    many = {"meta": {"upper": [level]}, "zzz": level, **dict.fromkeys("abcdefghijklmnopq", level)}
    with pytest.raises(ConfigError, match="; and more") as caught:
        design_from_dict(many)
    assert len(str(caught.value)) < 3000
    with pytest.raises(ConfigError, match="; and more"):  # the last one may change the garment
        design_from_dict({"meta": {"upper": "Shirt"}, **dict.fromkeys(map(str, range(100)), entry(0)), "zzz": 1})


BAD_OVERLAYS = {
    "[pants]\nlenght = 0.5": r"no design parameter is called pants\.lenght: did you mean pants\.length\?",
    "[pnats]\nlength = 0.5": r"is called pnats: did you mean pants\?",
    "pants = 3": r"pants is 3, not a table of parameters",
    "[pants]\nlength = 0.95": r"pants\.length is 0\.95, not a number from 0\.2 to 0\.9",
    "[pants]\nlength = 'long'": r"pants\.length is 'long', not a number",
    "[pants]\nlength = { range = [0.1, 0.5] }": r"pants\.length is 0\.1, not a number from 0\.2 to 0\.9",
    "[pants]\nlength = { range = [0.8, 0.5] }": r"pants\.length has a range in descending .*: write \[0\.5, 0\.8\]",
    "[pants]\nlength = { range = 0.5 }": r"pants\.length has range = 0\.5, not a list: write range = \[0\.5\]",
    "[pants]\nlength = { options = [0.5] }": r"pants\.length takes no options: .*, so give range, keep, or a value",
    "[pants]\nlength = { rnage = [0.5, 0.6] }": r"pants\.length takes no rnage",
    "[pants]\nlength = { keep = 1.5 }": r"pants\.length has keep = 1\.5, not a probability from 0 to 1",
    "[pants]\nlength = { range = [0.3, 0.3], keep = 0 }": r"pants\.length has no value left",
    "[sleeve]\nsleeve_angle = { range = [10, 12.5] }": r"sleeve_angle is 12\.5, not a whole number from 10 to 50",
    "[meta]\nbottom = 'Kilt'": r"meta\.bottom is 'Kilt', not one of SkirtCircle, .*, None",
    "[meta]\nbottom = { options = [] }": r"meta\.bottom has no option left: name one or more",
    "[meta]\nbottom = { options = ['none'], keep = 0 }": r"meta\.bottom has no option left: keep is 0",
    "[meta]\nbottom = { options = ['Pants'], keep = 0.5 }": r"meta\.bottom has keep, but no option None, its default",
    "[left]\nenable_asym = 'no'": r"left\.enable_asym is 'no', not one of True, False",
    "[pants\nlength = 1": r"line 1, column 7.*: correct the TOML",
}
BAD_FILES = {
    "design:\n  shirt:\n    suns: {v: 1.0}": r"called shirt\.suns: did you mean flare-skirt\.suns\?",
    "design:\n  zzz: {v: 1.0}": r"called zzz: there are meta, waistband",
    "design:\n  shirt:\n    length: {range: [0, 1]}": r"shirt\.length has no value: write it as v",
    "design:\n  shirt:\n    strapless: {v: 1}": r"shirt\.strapless is 1, not one of True, False",
    "design:\n  shirt: 5": r"shirt is 5, not a table of parameters",
    "design:\n  flare-skirt: {cut: {depth: 3}}": r"flare-skirt\.cut\.depth is 3, not a number from 0\.05 to 0\.95",
    "design:\n  shirt: {length: [\n": r"line \d+, column \d+: .*: correct it, or give a design file",
    "design: {date: 2001-02-30}": r"day is out of range.*: correct it",
    "design: \x01": r"control characters|special characters",
    "a: 1": r"holds \['a'\], no design: give GarmentCode's design_params\.yaml",
    "": r"holds None, no design: give",
    "[" * 100_000 + "]" * 100_000: r"nested too deep",
}


@pytest.mark.parametrize("text", [*BAD_OVERLAYS, *BAD_FILES], ids=lambda text: text[:40].replace("\n", " "))
def test_a_bad_overlay_or_design_file_gives_one_line_with_its_name(text: str, tmp_path: Path) -> None:
    file, read = (tmp_path / "bad.toml", read_overlay) if text in BAD_OVERLAYS else (tmp_path / "bad.yaml", read_design)
    file.write_text(text)
    with pytest.raises(ConfigError, match=(BAD_OVERLAYS | BAD_FILES)[text]) as caught:
        read(file)
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)
