"""Cusick's drapemeter, and the published targets of the fabric tests."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.drapemeter import SPECIMEN, disc, drape_coefficient, drape_disc, folds, shadow
from benchmarks.fabric_tests import TARGETS, read_targets, results
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape import FABRICS, Fabric

CLOTH = Fabric(density=0.2, tensile=100.0, bending=2e-5)


def test_a_flat_disc_has_its_whole_shadow() -> None:
    mesh = disc(1.0)
    assert shadow(mesh.vertices, mesh) == pytest.approx(np.pi * SPECIMEN**2, rel=2e-3)
    assert folds(mesh.vertices, mesh) == 0


def test_layers_count_once_in_a_shadow() -> None:
    """A disc folded over a diameter has half its shadow."""
    mesh = disc(0.5)
    folded = np.array(mesh.vertices)
    folded[:, 0] = np.abs(folded[:, 0])
    assert shadow(folded, mesh) == pytest.approx(np.pi * SPECIMEN**2 / 2, rel=0.02)


def test_a_wavy_rim_has_as_many_folds_as_waves() -> None:
    mesh = disc(1.0)
    wavy = np.array(mesh.vertices)
    angle = np.arctan2(wavy[:, 2], wavy[:, 0])
    wavy[:, [0, 2]] *= 0.8 + 0.1 * np.sin(7 * angle)[:, None]
    assert folds(wavy, mesh) == 7


def test_the_drape_coefficient_of_a_rigid_disc_is_100() -> None:
    rigid = replace(CLOTH, bending=1.0, tensile=1e4)
    assert drape_coefficient(rigid, spacing=2.0) == pytest.approx(100.0, abs=0.2)


def test_a_stiffer_disc_has_a_larger_coefficient_and_fewer_folds() -> None:
    limp, stiff = (drape_disc(replace(CLOTH, bending=bending), spacing=2.0) for bending in (4e-6, 6e-5))
    assert limp.coefficient < 45.0 < 75.0 < stiff.coefficient < 100.0
    assert limp.folds > stiff.folds > 0


def test_a_heavier_disc_has_a_smaller_coefficient() -> None:
    light, heavy = (drape_coefficient(replace(CLOTH, density=density), spacing=2.0) for density in (0.1, 0.4))
    assert heavy < light - 10.0


def test_a_drape_coefficient_hardly_depends_on_the_spacing() -> None:
    """With held vertices up to 9 cm only, the result at 2 cm was 6.6 points lower: the clamp lay half a row inside."""
    coarse, fine = (drape_coefficient(FABRICS["default"], spacing=spacing) for spacing in (2.0, 1.0))
    assert coarse == pytest.approx(fine, abs=3.0)


def test_cotton_has_the_measured_drape_coefficient() -> None:
    """68.4 %: Gan, Ly and Steven, J. Textile Inst. 82(1), 1991."""
    assert drape_coefficient(FABRICS["cotton"], specimens=3) == pytest.approx(68.4, abs=0.5)


def test_every_named_fabric_has_cited_targets_for_every_test() -> None:
    found = {(target.fabric, target.test, target.direction) for target in read_targets()}
    tests = [("drape_coefficient", "all")]
    tests += [("bending_length", grain) for grain in ("warp", "weft")]
    tests += [("tensile_stiffness", direction) for direction in ("warp", "weft", "bias")]
    assert found == {(name, *test) for name in FABRICS for test in tests}
    assert len(read_targets()) == len(found)
    assert all(len(target.citation) > 10 for target in read_targets())


def test_the_fabrics_have_the_measured_figures_of_their_targets() -> None:
    """Tensile stiffness equals the target up to the rounding in ``FABRICS``."""
    for target in read_targets():
        if target.test == "tensile_stiffness":
            found = getattr(FABRICS[target.fabric].pull, target.direction)
            assert found == pytest.approx(target.target, rel=6e-3)


def test_results_are_judged_against_the_band() -> None:
    targets = [t for t in read_targets() if (t.fabric, t.test, t.direction) == ("gcd_stiff", "bending_length", "weft")]
    [inside] = results(targets, [1.0], "cpu")
    assert inside["in_band 1_cm"] is True
    [outside] = results([replace(targets[0], low=8.0, high=9.0)], [1.0], "cpu")
    assert (outside["in_band 1_cm"], outside["1_cm"]) == (False, inside["1_cm"])
    [unknown] = results([replace(targets[0], low=np.nan, high=np.nan)], [1.0], "cpu")
    assert (unknown["in_band 1_cm"], unknown["band"]) == ("-", "-")


@pytest.mark.parametrize(
    ("was", "now", "message"),
    [
        ("denim,drape_coefficient,all,%,,70,90", "denim,drape_coefficient,all,%,,90,70", "a band with low below high"),
        ("denim,drape_coefficient,all", "denin,drape_coefficient,all", "no test of a fabric: denin"),
        ("denim,drape_coefficient,all", "denim,drape_coefficient,warp", "no test of a fabric: denim"),
        ("denim,drape_coefficient,all,%,,70", "denim,drape_coefficient,all,%,,seventy", "could not convert string"),
    ],
)
def test_a_wrong_row_is_named_by_file_and_line(was: str, now: str, message: str, tmp_path: Path) -> None:
    text = TARGETS.read_text(encoding="utf-8")
    line = next(number for number, row in enumerate(text.splitlines(), start=1) if row.startswith(was))
    wrong = tmp_path / "targets.csv"
    wrong.write_text(text.replace(was, now, 1), encoding="utf-8")
    with pytest.raises(ConfigError, match=message) as error:
        read_targets(wrong)
    assert f"targets.csv: line {line}: " in str(error.value)
