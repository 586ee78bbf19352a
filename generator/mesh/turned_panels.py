"""Turned panels: panels that are sewn in wrong side out.

Most seams join right side to right side, and the faces on both sides have the same winding. A seam of right side to
wrong side, such as a lapel's, turns the cloth over: beyond it the outside of the garment is the panel's wrong side.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from gcd_dataset.curves import sample_curve
from gcd_dataset.records import BoxMesh, Panel, Pattern, Seam

SAMPLES = 17  # points of an edge, for the sign of a loop's area


def turned_panels(pattern: Pattern, mesh: BoxMesh) -> tuple[str, ...]:
    """Names of the panels with their wrong side out: their faces have the opposite winding of the pattern's loops."""
    flat = np.bincount(mesh.panel_id, flat_areas(mesh.uv[mesh.corners]), minlength=len(mesh.panel_names))
    loops = {panel.name: _loop_area(panel) for panel in pattern.panels}
    return tuple(name for name, area in zip(mesh.panel_names, flat, strict=True) if area * loops[name] < 0)


def flat_areas(corners: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, " f"]:
    """Signed areas of flat triangles, positive for counter-clockwise ones [cm²]."""
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    return np.asarray(0.5 * (ax * by - ay * bx))


def turned_over(names: Sequence[str], areas: Float[np.ndarray, " p"], seams: Sequence[Seam]) -> Bool[np.ndarray, " p"]:
    """Flags of the panels to turn over, so that all seams join faces of the same winding.

    Of each set of connected panels the part with the larger area (``areas``, flat) stays right side out. A one-sided
    band (a Möbius strip) cannot satisfy all of its seams: at least one joins faces of opposite windings.
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
        connected = _orient_connected(first, beside, turned, seen)
        if areas[connected][turned[connected]].sum() > areas[connected][~turned[connected]].sum():
            turned[connected] = ~turned[connected]
    return turned


def _orient_connected(
    first: int,
    beside: Sequence[Sequence[tuple[int, bool]]],
    turned: Bool[np.ndarray, " p"],
    seen: Bool[np.ndarray, " p"],
) -> list[int]:
    """The panels connected to ``first``; sets ``turned`` of each relative to it, and ``seen``."""
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
    """Signed area of a panel's loop [cm²], positive if counter-clockwise."""
    edges = [sample_curve(*panel.edge_ends(i), edge.curve, SAMPLES)[:-1] for i, edge in enumerate(panel.edges)]
    x, y = np.concatenate(edges).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
