"""Pressed folds in the drape."""

import numpy as np
import pytest
from jaxtyping import Float

from gcd_dataset.curves import reflection
from gcd_dataset.generator.drape import DrapeJob, drape_batch
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.records import BoxMesh, Outcome, Panel
from tests.generator.drape.garments import neutral


@pytest.mark.parametrize("pleats", ["knife", "box", "inverted"])
def test_pleats_stay_pressed(pleats: str) -> None:
    """Folds are as deep as drawn, and few edges of a layer pass through another."""
    body, size = neutral()
    section = {"pleats": pleats, "count": 3, "length": 0.1}
    design = design_from_dict({"meta": {"bottom": "PleatedSkirt", "wb": "StraightWB"}, "pleated-skirt": section})
    pattern = draw_garment(size, design)
    mesh = build_box_mesh(pattern, spacing=3.0)
    [drape] = drape_batch([DrapeJob(mesh, body, size)], device="cpu", at_once=1)
    assert (drape.outcome, drape.body_crossings) == (Outcome.SETTLED, 0)
    assert drape.self_crossings <= 10
    depths = np.concatenate([fold_depths(panel, mesh, drape.vertices) for panel in pattern.panels if panel.lines])
    assert np.median(depths) == pytest.approx(1.0, abs=0.1)
    assert (np.abs(depths - 1.0) < 0.25).mean() > 0.9


def fold_depths(panel: Panel, mesh: BoxMesh, vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, " n"]:
    """Depth of each fold over the drawn one, at nine heights; 0 for a pleat that has opened.

    The points of the outer layers over the inner fold, and under the outer one, are three depths apart in the cloth,
    and one in a pressed pleat.
    """
    depths = []
    for first, second in zip(panel.lines[::2], panel.lines[1::2], strict=True):
        one, other = (panel.vertices[[line.start, line.end]] for line in (first, second))
        for share in np.linspace(0.1, 0.9, 9):
            p, q = (line[0] + share * (line[1] - line[0]) for line in (one, other))
            over, under = (reflection(*line) @ [*point, 1.0] for line, point in ((one, q), (other, p)))
            apart = np.linalg.norm(np.subtract(*(at(end[:2], panel, mesh, vertices) for end in (over, under))))
            depths.append((3.0 - apart / np.linalg.norm(p - q)) / 2.0)
    return np.array(depths)


def at(point: Float[np.ndarray, "2"], panel: Panel, mesh: BoxMesh, vertices: Float[np.ndarray, "v 3"]) -> np.ndarray:
    """Where a point of a panel is in the drape."""
    own = np.flatnonzero(mesh.panel_id == mesh.panel_names.index(panel.name))
    corners = mesh.uv[mesh.corners[own]]
    sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=-1)
    shares = np.linalg.solve(sides, (point - corners[:, 0])[:, :, None])[:, :, 0]
    shares = np.column_stack([1.0 - shares.sum(axis=1), shares])
    inside = shares.min(axis=1).argmax()
    return np.asarray(shares[inside] @ vertices[mesh.faces[own[inside]]])
