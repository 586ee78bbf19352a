"""Seams of a garment: whether the mesh is sewn where the pattern says so, and whether the sewn edges fit."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Int

from gcd_dataset.doctor import checks
from gcd_dataset.doctor.checks import Check
from gcd_dataset.records import Pattern

OPEN = 0.2  # share of a seam's mesh edges on the border of the mesh, above which it is open
RATIO = 0.01  # relative error of a stored gather ratio
GATHERED = 6.0  # ratio of two lengths sewn together; ruffles of the design space reach 2, of the published data 3
SLACK = 0.5  # cm: a difference of two lengths that any seam absorbs


def sewing_faults(
    arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any], pattern: Pattern | None
) -> Iterator[tuple[Check, str]]:
    """The faults of the seams of one garment."""
    if all(len(arrays.get(name, ())) for name in ("faces", "stitches")) and "seams" in arrays:
        seams, stitches = arrays["seams"].astype(np.int64), len(arrays["stitches"])
        if len(np.unique(seams[:, 1])) < stitches:
            yield checks.OPEN_SEAMS, "seams without vertices in the mesh"
        on_seam = np.bincount(seams[:, 1], minlength=stitches)
        border = open_edges(arrays["faces"].astype(np.int64), seams, stitches)
        if (border > np.maximum(OPEN * on_seam, 1)).any():
            yield checks.OPEN_SEAMS, "both edges are on the border of the mesh"
    if pattern is not None:
        yield from _length_faults(pattern, meta.get("gathers") or ())


def open_edges(faces: Int[np.ndarray, "f 3"], seams: Int[np.ndarray, "n 2"], stitches: int) -> Int[np.ndarray, " s"]:
    """Number of mesh edges of each seam that belong to one triangle only."""
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    count = int(faces.max()) + 1
    codes, uses = np.unique(ends[:, 0] * count + ends[:, 1], return_counts=True)
    border = codes[uses == 1]
    first, second = border // count, border % count
    # Vertex and seam as one sorted code: a border edge is on a seam if both of its ends are.
    rows = np.unique(seams[:, 0] * stitches + seams[:, 1])
    on = np.searchsorted(rows // stitches, [first, first + 1]) if len(rows) else np.zeros((2, len(first)), int)
    found = np.zeros(stitches, np.int64)
    for row in range(int((on[1] - on[0]).max(initial=0))):
        has = on[0] + row < on[1]
        seam = rows[on[0][has] + row] % stitches
        other = np.isin(second[has] * stitches + seam, rows)
        found += np.bincount(seam[other], minlength=stitches)
    return found


def _length_faults(pattern: Pattern, gathers: Any) -> Iterator[tuple[Check, str]]:
    ratios = np.array(pattern.gather_ratios())
    stored = np.array(gathers, float)
    if len(stored) and len(stored) != len(ratios):
        yield checks.SEAM_LENGTHS, "meta[gathers] has another number of seams than the pattern"
    elif len(stored) and (np.abs(ratios / np.maximum(stored, 1e-6) - 1.0) > RATIO).any():
        yield checks.SEAM_LENGTHS, "edges of other lengths than meta[gathers] says"
    elif len(ratios) and np.maximum(ratios, 1 / np.maximum(ratios, 1e-6)).max() > GATHERED:
        yield checks.SEAM_LENGTHS, f"one edge over {GATHERED:g} times as long as the other"
