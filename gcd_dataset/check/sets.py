"""Faults of all garments together: shares of kinds, designs and bodies that splits share, repeated patterns."""

import hashlib
import json
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int

from gcd_dataset.check.garments import ARRAYS, CheckedGarment
from gcd_dataset.tensors import EdgeColumn, PanelColumn, PatternTensor

NOBODY = 0  # hash of a body that garments may share: the neutral one, or one without name and weights
COMMON_BODIES = ("neutral", "female", "male", "mean_all", "")
DOMINANT, FEWEST = 0.9, 20  # share of one kind, among at least so many garments
DISTANCE = 0.1  # total variation between the shares of two splits, beyond that of chance
KINDS = ("upper", "bottom")
OPTIONAL = ("stitches", "closures", "lines", "seams")  # a garment of one piece may have no seam


class SplitCensus:
    """The garments of one split, a hundred bytes for each."""

    def __init__(self) -> None:
        self.position, self.design, self.body = array("q"), array("q"), array("q")
        self.structure, self.exact, self.projected = array("q"), array("q"), array("f")
        self.shares: dict[str, Counter[str]] = {name: Counter() for name in ("grade", "outcome", *KINDS)}
        self.sizes: dict[str, array[int]] = {name: array("q") for name in ("panels", "stitches", "verts")}
        self._empty: Counter[tuple[str, ...]] = Counter()
        """Fields without rows to the number of garments that lack just these."""
        self._first: dict[tuple[str, ...], int] = {}
        """Fields without rows to the position of the first such garment."""

    def __len__(self) -> int:
        return len(self.position)

    def add(self, position: int, garment: CheckedGarment) -> None:
        """Count a garment."""
        self.position.append(position)
        self.design.append(_hash(json.dumps(garment.design, sort_keys=True).encode()) if garment.design else 0)
        self.body.append(_body_hash(garment))
        tensor = garment.tensor
        structure, exact, projected = (0, 0, np.zeros(DIMENSIONS)) if tensor is None else fingerprint(tensor)
        self.structure.append(structure)
        self.exact.append(exact)
        self.projected.extend(projected.tolist())
        for name, value in _kinds(garment).items():
            self.shares[name][value] += 1
        for name, sizes in self.sizes.items():
            if garment.has(name):
                sizes.append(len(garment.arrays[name]))
        empty = tuple(name for name in ARRAYS if name in garment.arrays and not garment.has(name))
        self._empty[empty] += 1
        self._first.setdefault(empty, position)

    def medians(self) -> dict[str, float]:
        """Medians of panels, stitches and vertices, of the garments that have them."""
        names = {"panels": "panels", "stitches": "stitches", "verts": "vertices"}
        return {names[name]: float(np.median(sizes)) for name, sizes in self.sizes.items() if len(sizes)}

    def lacking(self) -> Iterator[tuple[tuple[str, ...], int, int]]:
        """Fields that only some garments have: the fields that are lacking, number of garments, the first position."""
        never = set.intersection(*map(set, self._empty)) if self._empty else set()
        for empty, count in self._empty.items():
            if fields := tuple(name for name in empty if name not in never and name not in OPTIONAL):
                yield fields, count, self._first[empty]

    def dominant(self) -> Iterator[str]:
        """Kinds that make up nearly all of the split."""
        for name in KINDS:
            amounts = self.shares[name]
            total = amounts.total()
            for value, count in amounts.most_common(1):
                if total >= FEWEST and count > DOMINANT * total:
                    yield f"{name} {value}: {count / total:.0%}"


class Census:
    """The garments of all splits."""

    def __init__(self) -> None:
        self.splits: dict[str, SplitCensus] = {}

    def shared(self, name: str) -> Iterator[tuple[str, str, Int[np.ndarray, " n"]]]:
        """Pairs of splits that share values of ``design`` or ``body``, and the rows of the second with such a value."""
        for first, second in self._pairs():
            values = {split: np.frombuffer(getattr(self.splits[split], name), np.int64) for split in (first, second)}
            known = np.unique(values[first])
            rows = np.flatnonzero(np.isin(values[second], known[known != NOBODY]))
            if len(rows):
                yield first, second, rows

    def unlike(self) -> Iterator[tuple[str, str]]:
        """Splits whose kinds have other shares than those of the first split, and the largest difference."""
        for first, second in self._pairs():
            if first != next(iter(self.splits)):
                continue
            for name in KINDS:
                if text := _difference(name, self.splits[first].shares[name], self.splits[second].shares[name], first):
                    yield second, text

    def _pairs(self) -> Iterator[tuple[str, str]]:
        """Pairs of splits; ``failed`` is left out: its designs may be in any other split too."""
        names = [name for name in self.splits if name != "failed"]
        return ((first, second) for number, first in enumerate(names) for second in names[number + 1 :])


def _difference(name: str, one: Counter[str], other: Counter[str], first: str) -> str:
    n, m = one.total(), other.total()
    if min(n, m) < FEWEST:
        return ""
    gap = {value: other[value] / m - one[value] / n for value in {*one, *other}}
    distance = 0.5 * sum(map(abs, gap.values()))
    if distance <= DISTANCE + np.sqrt(len(gap) / min(n, m)):
        return ""
    value = max(gap, key=lambda key: abs(gap[key]))
    return f"{name} {value}: {other[value] / m:.0%}, and {one[value] / n:.0%} in {first}"


def _body_hash(garment: CheckedGarment) -> int:
    """A number for the wearer; ``NOBODY`` for a mean body."""
    body = str(garment.meta.get("body") or "")
    if garment.has("body"):
        return NOBODY if body in COMMON_BODIES[:-1] else _hash(garment.arrays["body"].tobytes())
    # Published bodies have a name and a pose: 00345_straight.
    person = body.removesuffix("_straight").removesuffix("_apart")
    return NOBODY if person in COMMON_BODIES else _hash(person.encode())


def _kinds(garment: CheckedGarment) -> dict[str, str]:
    """Grade, outcome and garment types, as far as known."""
    meta, drape = garment.meta, garment.meta.get("drape")
    known = {"grade": meta.get("grade") or "", "outcome": drape["outcome"] if drape else ""}
    return {name: value for name, value in (known | kinds_of(garment.design)).items() if value}


def kinds_of(design: Mapping[str, Any] | None) -> dict[str, str]:
    """The choices of garment types in a tree of design parameters, as far as known."""
    chosen: Any = (design or {}).get("meta")
    found = {name: chosen[name] for name in KINDS if isinstance(chosen, Mapping) and name in chosen}
    return {name: str(kind.get("v") if isinstance(kind, Mapping) else kind) for name, kind in found.items()}


# ---------------------------------------------------------------------------------------------------- repeated patterns

# Two patterns are compared if they have the same structure: panels, edges, kinds of curves, stitches. The coordinates
# of a structure of d numbers are projected to 16 dimensions by a random Gaussian matrix, which keeps distances up to a
# factor of about 1.5 (Johnson and Lindenstrauss, 1984), and a k-d tree over these finds each pattern's nearest ones.
# The root mean square of the differences, which the projection keeps, is at most the largest difference: so nearby
# patterns are among these candidates.

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
