"""Winding of triangles and outlines, mirrored uv, and the side that the wearer faces."""

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from gcd_dataset.doctor import checks
from gcd_dataset.doctor.checks import Check
from gcd_dataset.tensors import CurveKind, EdgeColumn

MIXED = 0.02  # share of a panel's area whose triangles may wind against the rest: slivers of a bad mesh
INWARD = -0.2  # outwardness of a garment that is inside out; garments reach 0.5 to 1
SIDES: Mapping[str, tuple[str, str]] = {
    "front and back": (r"front|ftorso|(^|_)f(_|$)", r"back|btorso|(^|_)b(_|$)"),
    "left and right": (r"(^|_)(left|l)(_|$)", r"(^|_)(right|r)(_|$)"),
}
"""Patterns of the names of panels towards +z and -z, and towards +x and -x."""
AXIS = {"front and back": 2, "left and right": 0}
APART = 1.0  # cm: nearer centres tell no side
START = slice(EdgeColumn.START_X, EdgeColumn.START_Y + 1)
CONTROL0 = slice(EdgeColumn.CONTROL0_X, EdgeColumn.CONTROL0_Y + 1)
CONTROL1 = slice(EdgeColumn.CONTROL1_X, EdgeColumn.CONTROL1_Y + 1)


def orientation_faults(
    arrays: Mapping[str, np.ndarray], panel_names: Sequence[str], placed: Float[np.ndarray, "v 3"] | None
) -> Iterator[tuple[Check, str]]:
    """The faults of orientation of one garment; ``placed``: its vertices at rest, else before sewing [cm]."""
    loops = loop_areas(arrays["edges"], len(panel_names)) if len(arrays.get("edges", ())) else None
    needed = ("faces", "uv", "corners", "panel_id")
    if placed is None or any(not len(arrays.get(name, ())) for name in needed):
        return
    faces, panel = arrays["faces"], arrays["panel_id"].astype(int)
    flat = flat_areas(arrays["uv"][arrays["corners"]])
    inside_out = outwardness(placed, faces) < INWARD
    positive = np.bincount(panel, np.maximum(flat, 0.0), len(panel_names))
    negative = np.bincount(panel, np.maximum(-flat, 0.0), len(panel_names))
    if (np.minimum(positive, negative) > MIXED * (positive + negative)).any():
        yield checks.WINDING, "both ways within a panel"
    elif inside_out:
        yield checks.WINDING, "normals point into the body"
    elif loops is not None:
        yield from _mirrored(positive - negative, loops, arrays.get("stitches"), arrays["edges"])
    yield from ((checks.AXES, fault) for fault in _facing(placed, faces, panel, panel_names))


def _mirrored(
    flat: Float[np.ndarray, " p"],
    loops: Float[np.ndarray, " p"],
    stitches: Int[np.ndarray, "s 3"] | None,
    edges: Float[np.ndarray, "e 13"],
) -> Iterator[tuple[Check, str]]:
    """Panels whose triangles wind against their loops, except those that a seam turns wrong side out, as lapels."""
    against = flat * loops < 0
    if against.any() and not _can_be_turned(stitches, edges, len(loops)).any():
        yield checks.MIRRORED, "all panels" if against.all() else "some panels"
    elif against.all():
        yield checks.MIRRORED, "all panels"


def _can_be_turned(
    stitches: Int[np.ndarray, "s 3"] | None, edges: Float[np.ndarray, "e 13"], count: int
) -> Bool[np.ndarray, " p"]:
    """The panels with a seam that joins the wrong side of one to the right side of the other."""
    turned = np.zeros(count, bool)
    if stitches is not None and len(stitches):
        ends = stitches[stitches[:, 2] != 0, :2].astype(int)
        turned[edges[ends.ravel(), EdgeColumn.PANEL].astype(int)] = True
    return turned


def _facing(
    placed: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], panel: Int[np.ndarray, " f"], names: Sequence[str]
) -> Iterator[str]:
    """Sides that are exchanged: panels named front behind those named back, or left on the right."""
    count = np.maximum(np.bincount(panel, minlength=len(names)), 1)
    centre = placed[faces].mean(axis=1)
    for sides, (towards, away) in SIDES.items():
        along = np.bincount(panel, centre[:, AXIS[sides]], len(names)) / count
        first, second = ([row for row, name in enumerate(names) if re.search(side, name)] for side in (towards, away))
        if first and second and along[first].mean() < along[second].mean() - APART:
            yield f"{sides} are exchanged"


def flat_areas(corners: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, " f"]:
    """Signed areas of flat triangles, positive for counter-clockwise ones [cm²]."""
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    return np.asarray(0.5 * (ax * by - ay * bx))


def loop_areas(edges: Float[np.ndarray, "e 13"], count: int) -> Float[np.ndarray, " p"]:
    """Signed area of each panel's loop, with the midpoint of each curve as a corner [cm²].

    A Bézier curve is at t = 1/2 at (start + 2 control + end) / 4, or (start + 3 controls + end) / 8.
    """
    panel = edges[:, EdgeColumn.PANEL].astype(int)
    last = np.flatnonzero(np.diff(panel, append=-1))
    following = np.arange(1, len(edges) + 1)
    following[last] = np.concatenate([[0], last[:-1] + 1])
    start, kind = edges[:, START], edges[:, EdgeColumn.KIND, None]
    end, c0, c1 = start[following], edges[:, CONTROL0], edges[:, CONTROL1]
    middle = np.where(kind == CurveKind.QUADRATIC, (start + 2 * c0 + end) / 4, (start + end) / 2)
    middle = np.where(kind == CurveKind.CUBIC, (start + 3 * (c0 + c1) + end) / 8, middle)
    middle = np.where(kind == CurveKind.ARC, c0, middle)
    twice = _cross(start, middle) + _cross(middle, end)
    return 0.5 * np.bincount(panel, twice, count)


def _cross(a: Float[np.ndarray, "e 2"], b: Float[np.ndarray, "e 2"]) -> Float[np.ndarray, " e"]:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def loop_outwardness(
    loops: Float[np.ndarray, " p"], centre: Float[np.ndarray, "p 3"], across: Float[np.ndarray, "p 3"]
) -> float:
    """As ``outwardness``, of the panels as they are placed: -1 if all loops run clockwise as seen from outside.

    ``loops``: signed areas [cm²]; ``centre``: of each panel in space [cm]; ``across``: the panels' unit z axes.
    """
    weight = np.abs(loops)
    away = centre - np.average(centre, axis=0, weights=np.maximum(weight, 1e-12))
    total = float(weight @ np.linalg.norm(away, axis=1))
    return float(((loops[:, None] * across) * away).sum()) / total if total > 0 else 0.0


def outwardness(placed: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> float:
    """Mean of the triangles' area vectors along the direction from the garment's centre, from -1 to 1.

    1 for a sphere whose normals point outwards; by the divergence theorem the sum is 3 · volume for a closed surface.
    """
    corners = placed[faces].astype(float)
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    weight = np.linalg.norm(area, axis=1)
    centre = corners.mean(axis=1)
    away = centre - np.average(centre, axis=0, weights=np.maximum(weight, 1e-12))
    total = float(weight @ np.linalg.norm(away, axis=1))
    return float((area * away).sum()) / total if total > 0 else 0.0
