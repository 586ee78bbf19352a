"""Pressed folds in the drape."""

from dataclasses import replace

import numpy as np
import pytest

from gcd_dataset.generator.drape import DrapeJob, drape_batch
from gcd_dataset.generator.drape.topology import folds_of
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.records import Outcome
from tests.generator.drape.garments import neutral


@pytest.mark.parametrize("pleats", ["knife", "box", "inverted"])
def test_pleats_stay_pressed(pleats: str) -> None:
    """The layers lie near each other along the folds, and few of their edges pass through another layer."""
    body, size = neutral()
    section = {"pleats": pleats, "count": 3, "length": 0.1}
    design = design_from_dict({"meta": {"bottom": "PleatedSkirt", "wb": "StraightWB"}, "pleated-skirt": section})
    mesh = build_box_mesh(draw_garment(size, design), spacing=3.0)
    job = DrapeJob(mesh, body, size)
    [drape] = drape_batch([job], device="cpu", at_once=1)
    assert (drape.outcome, drape.body_crossings) == (Outcome.SETTLED, 0)
    assert drape.self_crossings <= 10
    folds = folds_of(job)
    unfolded = folds_of(replace(job, box_mesh=replace(mesh, folds=mesh.folds * [1, 1, 0]))).springs[:, 1]
    apart = np.linalg.norm(np.subtract(*drape.vertices[folds.apexes].transpose(1, 0, 2)), axis=1)
    assert (apart < 0.5 * unfolded).mean() > 0.9
    assert np.median(apart / unfolded) < 0.35
