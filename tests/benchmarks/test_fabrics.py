"""Cusick's drapemeter, and the published targets of the fabric tests."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.cases import fabrics
from benchmarks.cases.fabrics import TARGETS, read_targets, results
from benchmarks.cloth_tests import EDGE, SPECIMEN, SUPPORT, disc, drape_disc, folds, shadow
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape import FABRICS, Fabric
from gcd_dataset.generator.drape.config import GRAVITY

CLOTH = Fabric(density=0.2, tensile=100.0, bending=2e-5)


def test_a_flat_disc_has_its_whole_shadow() -> None:
    mesh = disc(1.0)
    assert shadow(mesh.vertices, mesh) == pytest.approx(np.pi * SPECIMEN**2, rel=2e-3)
    assert folds(mesh.vertices, mesh) == 0


def test_layers_count_once_in_a_shadow() -> None:
    """A disc folded over a diameter has half its shadow."""
    mesh = disc(1.0)
    folded = np.array(mesh.vertices)
    folded[:, 0] = np.abs(folded[:, 0])
    assert shadow(folded, mesh) == pytest.approx(np.pi * SPECIMEN**2 / 2, rel=0.04)


def test_a_wavy_rim_has_as_many_folds_as_waves() -> None:
    mesh = disc(1.0)
    wavy = np.array(mesh.vertices)
    wavy[:, [0, 2]] *= 0.8 + 0.1 * np.sin(7 * np.arctan2(wavy[:, 2], wavy[:, 0]))[:, None]
    assert folds(wavy, mesh) == 7


def test_a_stiffer_disc_has_a_larger_coefficient_and_fewer_folds() -> None:
    limp, stiff = (drape_disc(replace(CLOTH, bending=bending), spacing=2.0, edge=2.0) for bending in (4e-6, 6e-5))
    assert limp.coefficient < 45.0 < 75.0 < stiff.coefficient < 100.0
    assert limp.folds > stiff.folds > 0


def test_a_disc_is_fine_at_the_edge_of_the_support_and_as_coarse_as_asked_outside() -> None:
    mesh = disc(2.0)
    ends = mesh.uv[mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)]
    length, radius = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1), np.linalg.norm(ends.mean(axis=1), axis=1)
    assert np.median(length[np.abs(radius - SUPPORT) < 0.4]) == pytest.approx(EDGE, rel=0.2)
    assert np.median(length[radius > SUPPORT + 4.5]) == pytest.approx(2.0, rel=0.2)


def test_drape_coefficients_by_relation_follow_the_published_cloths() -> None:
    """KES bending rigidity [gf cm²/cm], weight [mg/cm²] and drape coefficient [%] of four woven cloths: Matsudaira,
    Masuda, Wada and Yokura, J. Textile Eng. 61(6), 2015. A target is the least-squares line at the bending length of
    the mean rigidity, within the range of the cloths; its band is the residual deviation."""
    cloths = np.array([[0.118, 12.38, 82.9], [0.067, 16.29, 49.8], [0.077, 11.65, 50.7], [0.019, 10.43, 28.3]])
    length, published = (cloths[:, 0] / (1e-3 * cloths[:, 1])) ** (1 / 3), cloths[:, 2]
    slope, start = np.polyfit(length, published, 1)
    deviation = np.sqrt(np.sum((published - start - slope * length) ** 2) / (len(cloths) - 2))
    targets = [target for target in read_targets() if target.basis == "relation"]
    assert len(targets) == 4
    for target in targets:
        fabric = FABRICS[target.fabric]
        own = (np.mean(fabric.bend) * 1e7 / (fabric.mass * GRAVITY)) ** (1 / 3)
        assert length.min() < own < length.max()
        expected = start + slope * own
        assert target.target == pytest.approx(expected, abs=0.06)
        assert (target.low, target.high) == pytest.approx((expected - deviation, expected + deviation), abs=0.06)


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


def test_results_are_judged_against_the_band(monkeypatch: pytest.MonkeyPatch) -> None:
    targets = [t for t in read_targets() if (t.fabric, t.test, t.direction) == ("gcd_stiff", "bending_length", "weft")]
    [inside] = results(targets, [1.0], "cpu")
    assert inside["in_band 1_cm"] is True
    monkeypatch.setattr(fabrics, "_run", lambda *_: inside["1_cm"])
    [outside] = results([replace(targets[0], low=8.0, high=9.0)], [1.0], "cpu")
    assert (outside["in_band 1_cm"], outside["1_cm"]) == (False, inside["1_cm"])
    [unknown] = results([replace(targets[0], low=np.nan, high=np.nan)], [1.0], "cpu")
    assert (unknown["in_band 1_cm"], unknown["band"]) == ("-", "-")


@pytest.mark.parametrize(
    ("was", "now", "message"),
    [
        ("denim,drape_coefficient,all,%,60.6,50.7", "denim,drape_coefficient,all,%,60.6,80.7", "low below high"),
        ("denim,drape_coefficient,all", "denim,drape_coefficient,warp", "no test of a fabric: denim"),
        ("denim,drape_coefficient,all,%,60.6", "denim,drape_coefficient,all,%,sixty", "could not convert string"),
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
