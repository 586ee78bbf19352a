"""Equal and nearly equal patterns among many, in 72 bytes for each.

Two patterns are compared if they have the same structure: panels, edges, kinds of curves, stitches. The coordinates of
a structure of ``d`` numbers are projected to 16 dimensions by a random Gaussian matrix, which keeps distances up to a
factor of about 1.5 (Johnson and Lindenstrauss, 1984), and a k-d tree over these finds each pattern's nearest ones. The
root mean square of the differences, which the projection keeps, is at most the largest difference: so nearby patterns
are among these candidates.
"""

import hashlib
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Float32, Int

from gcd_dataset.tensors import EdgeColumn, PanelColumn, PatternTensor

NEAR = 0.2  # cm: largest difference of a coordinate of two patterns that count as one
DIMENSIONS = 16
NEAREST = 4  # neighbours of each pattern that are looked at
SPREAD = 1.6  # factor by which the projection may enlarge a distance of two patterns
STEP = 1e-3  # cm: patterns that round to the same numbers are equal
PANEL_COLUMNS = [PanelColumn.X, PanelColumn.Y, PanelColumn.Z]
EDGE_COLUMNS = list(range(EdgeColumn.START_X, EdgeColumn.START_Y + 1)) + list(
    range(EdgeColumn.CONTROL0_X, EdgeColumn.CONTROL1_Y + 1)
)

Fingerprint = tuple[int, int, Float32[np.ndarray, "16"]]
"""Hash of the structure, hash of the rounded numbers, and the projected numbers [cm]."""


def fingerprint(tensor: PatternTensor) -> Fingerprint:
    """The fingerprint of a pattern. Distances of projections are root mean squares of the differences [cm]."""
    numbers = _numbers(tensor)
    words = repr((tensor.panel_names, tensor.stitches.tolist(), tensor.edges[:, [0, EdgeColumn.KIND]].tolist()))
    projected = numbers @ _projection(len(numbers))
    return _hash(words.encode()), _hash(np.rint(numbers / STEP).astype("<i8").tobytes()), projected.astype(np.float32)


def difference(one: PatternTensor, other: PatternTensor) -> float:
    """Largest difference of a coordinate of two patterns of one structure [cm]; infinite for different sizes."""
    a, b = _numbers(one), _numbers(other)
    return float(np.abs(a - b).max(initial=0.0)) if len(a) == len(b) else np.inf


def near_pairs(
    structure: Int[np.ndarray, " n"], exact: Int[np.ndarray, " n"], projected: Float32[np.ndarray, "n 16"]
) -> tuple[Int[np.ndarray, "k 2"], Int[np.ndarray, "l 2"]]:
    """Pairs of equal patterns, and candidates for nearly equal ones: rows, the smaller first.

    Of several equal patterns each later one is paired with the first.
    """
    order = np.lexsort((np.arange(len(structure)), exact, structure))
    same = (np.diff(structure[order]) == 0) & (np.diff(exact[order]) == 0)
    leader = np.maximum.accumulate(np.where(np.concatenate([[True], ~same]), np.arange(len(order)), 0))
    first = order[leader]
    later = first != order
    equal = np.stack([first[later], order[later]], axis=1)
    return equal, _candidates(structure, projected, np.sort(order[~later]))


def _candidates(
    structure: Int[np.ndarray, " n"], projected: Float32[np.ndarray, "n 16"], rows: Int[np.ndarray, " m"]
) -> Int[np.ndarray, "l 2"]:
    from scipy.spatial import cKDTree

    rows = rows[np.argsort(structure[rows], kind="stable")]
    groups: Sequence[np.ndarray] = np.split(rows, np.flatnonzero(np.diff(structure[rows])) + 1) if len(rows) else []
    pairs = [np.zeros((0, 2), np.int64)]
    for group in groups:
        if len(group) < 2:
            continue
        tree = cKDTree(projected[group])
        found = tree.query(projected[group], k=min(NEAREST, len(group)), distance_upper_bound=SPREAD * NEAR)[1]
        one, column = np.nonzero(found < len(group))
        two = found[one, column]
        pairs.append(np.sort(np.stack([group[one], group[two]], axis=1)[one != two], axis=1))
    return np.unique(np.concatenate(pairs), axis=0)


def _numbers(tensor: PatternTensor) -> Float[np.ndarray, " d"]:
    """The lengths of a pattern: positions of panels, corners and control points [cm]."""
    return np.concatenate([tensor.panels[:, PANEL_COLUMNS].ravel(), tensor.edges[:, EDGE_COLUMNS].ravel()]).astype(
        float
    )


@lru_cache(64)
def _projection(count: int) -> Float[np.ndarray, "d 16"]:
    """A matrix that maps ``count`` numbers so that distances are root mean squares of differences."""
    random = np.random.Generator(np.random.Philox(key=count))
    return np.asarray(random.normal(size=(count, DIMENSIONS)) / np.sqrt(DIMENSIONS * count))


def _hash(data: bytes) -> int:
    return int.from_bytes(hashlib.blake2b(data, digest_size=8).digest(), "little", signed=True)
