"""Overlays narrow the design space, and change nothing else."""

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.garments.collar import Collar
from gcd_dataset.generator.garments.design import GarmentDesign, MetaDesign
from gcd_dataset.generator.garments.overlay import Overlay, read_overlay
from gcd_dataset.generator.garments.pants import PantsDesign
from gcd_dataset.generator.garments.space import draw, leaves
from gcd_dataset.generator.garments.waistband import Waistband
from gcd_dataset.generator.garments.wardrobe import Bottom

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


def drawn(overlay: Overlay, count: int = 400) -> list[GarmentDesign]:
    rng = np.random.default_rng(5)
    return [draw(overlay.space, rng) for _ in range(count)]


def test_draws_stay_within_the_overlay(workwear: Overlay) -> None:
    designs = drawn(workwear)
    assert {design.meta.bottom for design in designs} == {Bottom.PANTS}  # none is the default, never kept
    assert {design.collar.component.style for design in designs} == {Collar.HOOD}
    assert not any(design.left.enable_asym for design in designs)
    lengths = [design.pants.length for design in designs]
    assert 0.7 <= min(lengths) < 0.72 and 0.88 < max(lengths) <= 0.9
    angles = [design.sleeve.sleeve_angle for design in designs]
    assert set(angles) == set(range(10, 21))
    assert np.mean([angle == 10 for angle in angles]) == pytest.approx(0.5, abs=0.08)
    assert np.mean([design.meta.wb is None for design in designs]) == pytest.approx(0.25, abs=0.07)


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
    rng = np.random.default_rng(2)
    lengths = [draw(workwear.space.of(PantsDesign), rng, within={"length": (-np.inf, 0.75)}).length for _ in range(50)]
    assert all(0.7 <= length <= 0.75 for length in lengths)
    assert draw(workwear.space.of(MetaDesign), rng).bottom is Bottom.PANTS
    # Limits outside the overlay's range give the nearest value of that range.
    assert draw(workwear.space.of(PantsDesign), rng, within={"length": (-np.inf, 0.3)}).length == 0.7


def test_an_overlay_survives_json_and_pickle(workwear: Overlay) -> None:
    again = Overlay.from_dict(json.loads(json.dumps(workwear.to_dict())))
    assert again == workwear
    assert again.space == workwear.space
    assert hash(again) == hash(workwear)
    assert pickle.loads(pickle.dumps(workwear)) == workwear


def test_every_change_survives_a_dict() -> None:
    overlays: list[dict[str, Any]] = [
        {"pants": {"length": {"range": [0.7, 0.9], "keep": 0.1}}},
        {"pants": {"length": {"range": [0.7, 0.9], "keep": 0}}},
        {"pants": {"length": 0.5}},
        {"pants": {"length": {"keep": 0.5}}},
        {"meta": {"wb": "none", "upper": {"options": ["Shirt", "none"], "keep": 1}}},
        {"flare-skirt": {"cut": {"add": True}, "skirt-many-panels": {"panel_curve": {"options": [0, 0.15]}}}},
        {"godet-skirt": {"num_inserts": 8, "insert_w": {"range": [10, 10]}}},
    ]
    for values in overlays:
        overlay = Overlay.from_dict(values)
        assert Overlay.from_dict(overlay.to_dict()) == overlay
        assert drawn(overlay, 3)
    assert Overlay().to_dict() == {}


def test_the_order_of_a_file_does_not_matter() -> None:
    one = {"pants": {"length": 0.5, "rise": 1}, "meta": {"wb": "FittedWB"}}
    other = {"meta": {"wb": "FittedWB"}, "pants": {"rise": 1.0, "length": 0.5}}
    assert Overlay.from_dict(one) == Overlay.from_dict(other)
    assert json.dumps(Overlay.from_dict(one).to_dict()) == json.dumps(Overlay.from_dict(other).to_dict())


def test_an_overlay_can_fix_none() -> None:
    overlay = Overlay.from_dict({"meta": {"wb": {"options": ["none", "FittedWB"], "keep": 0.5}, "upper": "none"}})
    assert {design.meta.wb for design in drawn(overlay, 50)} == {None, Waistband.FITTED}
    assert {design.meta.upper for design in drawn(overlay, 50)} == {None}


def test_an_excluded_default_loses_its_probability_or_becomes_the_nearest_value() -> None:
    free = drawn(Overlay.from_dict({"shirt": {"length": {"range": [2.0, 3.0]}}}), 100)
    assert len({design.shirt.length for design in free}) == 100
    kept = drawn(Overlay.from_dict({"shirt": {"length": {"range": [2.0, 3.0], "keep": 0.5}}}))
    assert np.mean([design.shirt.length == 2.0 for design in kept]) == pytest.approx(0.5, abs=0.08)


BAD = {
    "[pants]\nlenght = 0.5": r"no design parameter is called pants\.lenght: did you mean pants\.length\?",
    "[pnats]\nlength = 0.5": r"is called pnats: did you mean pants\?",
    "[skirt]\nsuns = 0.5": r"is called skirt\.suns: did you mean flare-skirt\.suns\?",
    "pants = 3": r"pants is 3, not a table of parameters",
    "[pants]\nlength = 0.95": r"pants\.length is 0\.95, not a number from 0\.2 to 0\.9",
    "[pants]\nlength = nan": r"pants\.length is nan, not a number",
    "[pants]\nlength = 'long'": r"pants\.length is 'long', not a number",
    "[pants]\nlength = 2001-01-01": r"pants\.length is datetime.*, not a number",
    "[pants]\nlength = [0.5, 0.6]": r"pants\.length is \[0\.5, 0\.6\], not a number",
    "[pants]\nlength = { range = [0.1, 0.5] }": r"pants\.length is 0\.1, not a number from 0\.2 to 0\.9",
    "[pants]\nlength = { range = [0.8, 0.5] }": r"pants\.length has a range in descending .*: write \[0\.5, 0\.8\]",
    "[pants]\nlength = { range = [0.5] }": r"pants\.length has a range of 1 values: give two",
    "[pants]\nlength = { range = 0.5 }": r"pants\.length has range = 0\.5, not a list: write range = \[0\.5\]",
    "[pants]\nlength = { options = [0.5] }": r"pants\.length takes no options: .*, so give range, keep, or a value",
    "[pants]\nlength = { rnage = [0.5, 0.6] }": r"pants\.length takes no rnage",
    "[pants]\nlength = {}": r"pants\.length is an empty table",
    "[pants]\nlength = { keep = 1.5 }": r"pants\.length has keep = 1\.5, not a probability from 0 to 1",
    "[pants]\nlength = { keep = true }": r"pants\.length has keep = True, not a probability",
    "[pants]\nlength = { range = [0.3, 0.3], keep = 0 }": r"pants\.length has no value left",
    "[sleeve]\nsleeve_angle = { range = [10, 12.5] }": r"sleeve_angle is 12\.5, not a whole number from 10 to 50",
    "[meta]\nbottom = 'Kilt'": r"meta\.bottom is 'Kilt', not one of SkirtCircle, .*, None",
    "[meta]\nbottom = { options = [] }": r"meta\.bottom has no option left: name one or more",
    "[meta]\nbottom = { options = ['none'], keep = 0 }": r"meta\.bottom has no option left: keep is 0",
    "[meta]\nbottom = { options = ['Pants'], keep = 0.5 }": r"meta\.bottom has keep, but no option None, its default",
    "[meta]\nbottom = { range = ['Pants', 'Pants'] }": r"meta\.bottom takes no range: .*, so give options, keep",
    "[left]\nenable_asym = 'no'": r"left\.enable_asym is 'no', not one of True, False",
    "[left]\nenable_asym = 0": r"left\.enable_asym is 0, not one of True, False",
    "[levels-skirt]\nbase = 'none'": r"levels-skirt\.base is 'none', not one of",
    "[pants\nlength = 1": r"line 1, column 7.*: correct the TOML",
}


@pytest.mark.parametrize("text", BAD, ids=lambda text: text.replace("\n", " "))
def test_a_bad_overlay_gives_one_line_with_its_name(text: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=BAD[text]) as caught:
        read_overlay(file)
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)


def test_a_missing_overlay_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"missing\.toml: no such file: give the path of a TOML file"):
        read_overlay(tmp_path / "missing.toml")


def test_an_overlay_without_any_garment_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"meta\.upper and meta\.bottom are both none"):
        Overlay.from_dict({"meta": {"upper": "none", "bottom": "none"}})
    Overlay.from_dict({"meta": {"upper": "none"}})
