"""Design spaces: declared ranges, and random draws from them."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.garments import GarmentDesign, design_from_dict, design_to_dict
from gcd_dataset.generator.garments.collar import CollarDesign
from gcd_dataset.generator.garments.parameter import Real
from gcd_dataset.generator.garments.shirt import ShirtDesign
from gcd_dataset.generator.garments.sleeve import LeftSleeveDesign
from gcd_dataset.generator.garments.space import (
    Design,
    DesignSpace,
    choice,
    draw,
    flag,
    from_dict,
    integer,
    leaves,
    part,
    real,
    to_dict,
)


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


def many(count: int = 4000) -> list[HemDesign]:
    rng = np.random.default_rng(3)
    return [draw(HemDesign, rng) for _ in range(count)]


def test_defaults_are_kept_with_their_probability() -> None:
    drawn = many()
    assert np.mean([d.depth == 2.0 for d in drawn]) == pytest.approx(0.7, abs=0.03)
    assert np.mean([d.rows == 2 for d in drawn]) == pytest.approx(0.5, abs=0.03)
    assert np.mean([d.stitched for d in drawn]) == pytest.approx(0.8, abs=0.03)


def test_other_values_are_equally_likely() -> None:
    rows = [d.rows for d in many() if d.rows != 2]
    assert [rows.count(n) / len(rows) for n in (1, 3, 4)] == pytest.approx([1 / 3] * 3, abs=0.04)
    shapes = [d.shape for d in many()]
    assert [shapes.count(s) / len(shapes) for s in (None, *Shape)] == pytest.approx([1 / 3] * 3, abs=0.03)


def test_the_same_seed_draws_the_same_design() -> None:
    first, second = (draw(GarmentDesign, np.random.default_rng(7)) for _ in range(2))
    assert first == second


def test_narrowed_ranges_hold() -> None:
    rng = np.random.default_rng(0)
    drawn = [draw(HemDesign, rng, within={"depth": (3.0, 4.0), "rows": (-np.inf, 1.0)}) for _ in range(50)]
    assert all(3.0 <= d.depth <= 4.0 and d.rows == 1 for d in drawn)


def test_limits_outside_the_range_give_its_nearest_value() -> None:
    rng = np.random.default_rng(0)
    assert draw(HemDesign, rng, within={"depth": (-np.inf, -3.0)}).depth == 1.0
    assert draw(HemDesign, rng, within={"depth": (7.0, 9.0)}).depth == 5.0


def test_a_value_out_of_range_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"HemDesign: depth is 9\.0, not a number from 1 to 5"):
        HemDesign(depth=9.0)
    with pytest.raises(ConfigError, match=r"rows is 1\.5, not a whole number from 1 to 4"):
        from_dict(HemDesign, {"rows": 1.5})


def test_errors_name_the_path_of_a_parameter() -> None:
    with pytest.raises(ConfigError, match=r"no design parameter is called shirt\.lenght: did you mean shirt\.length"):
        design_from_dict({"shirt": {"lenght": 1.0}})
    with pytest.raises(ConfigError, match=r"flare-skirt\.cut\.depth is 3, not a number from 0\.05 to 0\.95"):
        design_from_dict({"flare-skirt": {"cut": {"depth": 3}}})
    with pytest.raises(ConfigError, match=r"collar is 'VNeckHalf', not a table of parameters"):
        design_from_dict({"collar": "VNeckHalf"})
    with pytest.raises(ConfigError, match=r"meta\.upper is 'Toga', not one of FittedShirt, Shirt, Cape, Poncho, None"):
        design_from_dict({"meta": {"upper": "Toga"}})


def test_a_file_holds_plain_values_under_the_reference_names() -> None:
    values = design_to_dict(GarmentDesign())
    assert values["meta"] == {"upper": None, "wb": None, "bottom": None}
    assert values["flare-skirt"]["suns"] == 0.75
    assert values["collar"]["f_collar"] == "CircleNeckHalf"
    assert to_dict(HemDesign()) == {"depth": 2.0, "rows": 2, "stitched": True, "shape": None}


def test_an_unknown_name_unlike_any_other_lists_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"no design parameter is called hem\.colour: there are depth, rows"):
        from_dict(ApronDesign, {"hem": {"colour": "red"}})


def test_numbers_of_a_file_get_the_type_of_the_parameter() -> None:
    hem = from_dict(HemDesign, {"depth": 3, "rows": 3.0, "shape": "round"})
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
