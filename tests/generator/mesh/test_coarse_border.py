"""The borders of box meshes, and the points of them that a coarse mesh keeps."""

from collections import Counter

import numpy as np
import pytest

from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.mesh.coarse import PanelBorders, thin
from gcd_dataset.records import Pattern
from tests.generator.mesh.shapes import panel, rectangle, sewn, tube
from tests.generator.mesh.test_box_mesh import darted, patchwork

PATTERNS = [darted(), patchwork(), tube(), sewn(panel("a", rectangle(20.0, 13.0)))]


@pytest.mark.parametrize("pattern", PATTERNS)
def test_border_segments_are_the_sides_of_one_face(pattern: Pattern) -> None:
    mesh = build_box_mesh(pattern, spacing=1.0)
    borders = PanelBorders.of(mesh)
    sides = mesh.corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()
    count = Counter(frozenset(side) for side in sides)
    assert sorted(zip(borders.rows.tolist(), borders.after.tolist(), strict=True)) == sorted(
        (u, v) for u, v in sides if count[frozenset((u, v))] == 1
    )
    same_loop = np.flatnonzero(np.diff(borders.panel) == 0)
    assert (borders.after[same_loop] == borders.rows[same_loop + 1]).all()


@pytest.mark.parametrize("pattern", PATTERNS)
def test_dropped_vertices_lie_between_kept_ones(pattern: Pattern) -> None:
    """All outlines here are straight between corners and bends, so the shares give the positions back."""
    mesh = build_box_mesh(pattern, spacing=1.0)
    borders = PanelBorders.of(mesh)
    thinned = thin(mesh, borders)
    on_border = np.unique(mesh.uv_vertex[borders.rows])
    assert thinned.kept.sum() + len(thinned.dropped) == len(on_border)
    assert sorted([*np.flatnonzero(thinned.kept), *thinned.dropped]) == on_border.tolist()
    assert thinned.kept[thinned.between].all()
    assert (thinned.share > 0.0).all()
    assert (thinned.share < 1.0).all()
    assert thinned.kept.sum() < 0.7 * len(on_border)
