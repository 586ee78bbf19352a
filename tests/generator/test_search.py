"""Search by draping: steps of parameters on a linear map of the drape."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gcd_dataset.generator import Fitting
from gcd_dataset.generator.body import named_body
from gcd_dataset.generator.drape import drape_batch
from gcd_dataset.generator.garments import design_from_dict
from gcd_dataset.generator.garments.rules import DrawnGarment, too_heavy
from gcd_dataset.generator.jacobian import moved
from gcd_dataset.generator.quality import sample_surface
from gcd_dataset.generator.search import ScanPoints, Target, gauss_newton, search
from gcd_dataset.generator.silhouettes import Silhouettes
from tests.generator.test_silhouettes import cut_out
from tests.helpers import patch

SIDE = 41  # vertices along each side of a sheet of 80 cm


def sheet(drop: float, wider: float) -> np.ndarray:
    """Vertices of a sheet that is bent along x, dropped and widened [cm]."""
    x, y = np.meshgrid(np.linspace(0, 80 + wider, SIDE), np.linspace(0, 80, SIDE))
    return np.stack([x, y, 10 * np.sin(x / 20) - drop], axis=-1).reshape(-1, 3)


@pytest.mark.parametrize(("partial", "known"), [(False, 2), (True, 1)])
def test_parameters_are_found_on_a_linear_map(partial: bool, known: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Drop and width of a sheet, vaguely proposed; a scan of a part does not show where the sheet ends."""
    monkeypatch.setattr("gcd_dataset.generator.search.PROPOSED", 0.2)
    base = sheet(0.0, 0.0)
    derivatives = np.stack([sheet(20.0, 0.0) - base, sheet(0.0, 1.0) - base]) * [[[1.0]], [[30.0]]]
    worn = SimpleNamespace(job=SimpleNamespace(box_mesh=patch(SIDE - 1, SIDE - 1)))
    jacobian: Any = SimpleNamespace(worn=worn, positions=base, derivatives=derivatives)
    points = sheet(2.0, 3.0)
    slope = np.stack([-0.5 * np.cos(points[:, 0] / 20), np.zeros(len(points)), np.ones(len(points))], axis=1)
    normals = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    rows = np.random.default_rng(0).permutation(len(points))
    if partial:
        rows = rows[points[rows, 0] < 40]
    scan = ScanPoints.of(np.concatenate([points, normals], axis=1)[rows], partial=partial)
    found = scan.change(jacobian, step=0.1, offset=np.zeros(2))
    assert found[:known] == pytest.approx([0.1, 0.1][:known], abs=0.025)  # the prior holds back


def test_parameters_that_a_scan_does_not_show_go_back_to_the_proposal() -> None:
    shown = np.array([[80.0, 80.0, 80.0], [0.0, 0.0, 0.0]])  # cm from end to end of the range

    def rows(change: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, float]]:
        return [(change @ shown - 4.0, shown, 1.0)]

    assert gauss_newton(rows, 0.1, np.array([0.0, 0.04])) == pytest.approx([0.05, -0.04], abs=0.02)


class Wide:
    """A target that is the nearer, the wider a circle skirt is."""

    def distances(self, drapes: Any, mapped: Any) -> list[float]:
        return [5 - each.design.flare_skirt.suns for each in drapes]

    def change(self, jacobian: Any, step: float, offset: np.ndarray) -> np.ndarray:
        return np.array([2 * step * (name == "flare-skirt.suns") for name in jacobian.parameters])


@pytest.mark.long
def test_a_skirt_does_not_become_too_heavy_for_its_waist() -> None:
    """On a wearer who is not known to the centimetre, it would slide off."""
    body, size, _ = named_body("neutral")
    light = design_from_dict({"meta": {"bottom": "SkirtCircle"}, "flare-skirt": {"length": 0.1, "suns": 0.65}})
    assert too_heavy(DrawnGarment.of(size, moved(light, {"flare-skirt.suns": 0.12})))
    options: Any = {"rounds": ((1, 0.06),), "pairs": 4, "resolution": 8.0, "device": "cpu"}
    found = search(Wide(), [light], lambda _: (body, size), **options).drape.design
    assert found.flare_skirt.suns > 0.65
    assert not too_heavy(DrawnGarment.of(size, found))


@pytest.mark.parametrize("pictured", [False, pytest.param(True, marks=pytest.mark.long)])
def test_the_length_of_a_skirt_is_found_from_its_drape(pictured: bool, tmp_path: Path) -> None:
    """From points of it, or its silhouettes in two pictures. One of two proposals is another skirt, one is too long."""
    body, size, _ = named_body("neutral")
    fitting = Fitting(body, size, resolution=6.0)
    skirt = design_from_dict({"meta": {"bottom": "PencilSkirt"}, "pencil-skirt": {"length": 0.5}})
    worn = fitting.worn(skirt)
    assert worn is not None
    [drape] = drape_batch([worn.job], device="cpu")
    points = sample_surface(drape.vertices, worn.job.box_mesh.faces, 4096, np.random.default_rng(0))
    target: Target = ScanPoints.of(points)
    if pictured:
        cut_out(tmp_path, worn.job.box_mesh, drape.vertices, body)
        target = Silhouettes.read(tmp_path, device="cpu")
    proposals = [design_from_dict({"meta": {"bottom": "SkirtCircle"}}), moved(skirt, {"pencil-skirt.length": 0.1})]
    options: Any = {"pairs": 8, "resolution": 6.0, "device": "cpu"}
    apart = {}
    for count in (0, 2):
        rounds = ((2, 0.05), (1, 0.03))[:count]
        found = search(target, proposals, lambda _: (body, size), rounds=rounds, **options)
        apart[count] = abs(found.drape.design.pencil_skirt.length - 0.5)
    assert apart[0] > 0.05
    assert apart[2] < 0.3 * apart[0]
