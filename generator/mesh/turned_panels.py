"""Which panels are sewn in wrong side out.

Seams join right sides to right sides, and the faces on both sides of them are wound alike. A seam of right side to
wrong side, as of a lapel, turns the cloth over: past it the outside of the garment is the wrong side of the panel.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from gcd_dataset.curves import sample_curve
from gcd_dataset.records import BoxMesh, Panel, Pattern, Seam

__all__ = ["flat_areas", "turned_over", "turned_panels"]

SAMPLES = 17  # points of an edge, by which a loop's turn is told


def turned_panels(pattern: Pattern, mesh: BoxMesh) -> tuple[str, ...]:
    """The panels of a box mesh whose wrong side is out: their faces run against the loops of the pattern's panels."""
    flat = np.bincount(mesh.panel_id, flat_areas(mesh.uv[mesh.corners]), minlength=len(mesh.panel_names))
    loops = {panel.name: _loop_area(panel) for panel in pattern.panels}
    return tuple(name for name, area in zip(mesh.panel_names, flat, strict=True) if area * loops[name] < 0)


def flat_areas(corners: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, " f"]:
    """Signed areas of flat triangles, positive for counter-clockwise ones [cm²]."""
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    return np.asarray(0.5 * (ax * by - ay * bx))


def turned_over(names: Sequence[str], areas: Float[np.ndarray, " p"], seams: Sequence[Seam]) -> Bool[np.ndarray, " p"]:
    """Which panels, of these flat areas, have to be turned over for all seams to join faces that are wound alike.

    Of panels that hang together, those with the larger area stay right side out. Seams that would have a band both ways
    out, as of a Möbius strip, are left with the turn in the last of them.
    """
    number = {name: row for row, name in enumerate(names)}
    beside: list[list[tuple[int, bool]]] = [[] for _ in names]
    for seam in seams:
        left, right = number[seam.left.panel], number[seam.right.panel]
        beside[left].append((right, seam.right_wrong))
        beside[right].append((left, seam.right_wrong))
    turned = np.zeros(len(names), bool)
    if not any(seam.right_wrong for seam in seams):
        return turned
    seen = np.zeros(len(names), bool)
    for first in range(len(names)):
        if seen[first]:
            continue
        garment = _follow(first, beside, turned, seen)
        if areas[garment][turned[garment]].sum() > areas[garment][~turned[garment]].sum():
            turned[garment] = ~turned[garment]
    return turned


def _follow(
    first: int,
    beside: Sequence[Sequence[tuple[int, bool]]],
    turned: Bool[np.ndarray, " p"],
    seen: Bool[np.ndarray, " p"],
) -> list[int]:
    """The panels that hang together with the first, each marked in ``turned`` as against that."""
    found, waiting = [], deque([first])
    seen[first] = True
    while waiting:
        panel = waiting.popleft()
        found.append(panel)
        for other, turns in beside[panel]:
            if not seen[other]:
                seen[other] = True
                turned[other] = turned[panel] != turns
                waiting.append(other)
    return found


def _loop_area(panel: Panel) -> float:
    """Signed area that a panel's loop encloses, positive for a counter-clockwise one [cm²]."""
    edges = [sample_curve(*panel.edge_ends(i), edge.curve, SAMPLES)[:-1] for i, edge in enumerate(panel.edges)]
    x, y = np.concatenate(edges).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
