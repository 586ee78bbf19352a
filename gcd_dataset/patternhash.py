"""A hash of many patterns that is the same on every machine.

Machines differ in the last digits of a number: with other instructions (AVX2, AVX-512), another BLAS or C library, or
Python 3.12 or newer, whose ``sum`` is compensated, the numbers of a pattern move by up to 2e-11 cm, 1e-13 cm on
average. Numbers are therefore rounded to steps of 1e-4 before hashing. A number half-way between two steps, a tie, may
still be rounded up by one machine and down by another: this is expected for one in 150 pairs of machines with a data
set of 230,000 patterns, and for one in 40,000 pairs with 1,000 patterns. ``PatternHash`` records the ties and their
effect on the hash; ``agrees`` accepts the hash of a machine that rounded a tie the other way.

The hash of a pattern covers: its index; names and labels of panels, labels of edges; each panel's centroid in space,
rotation, centroid in its own coordinates and number of edges; each edge's panel, start, kind and control points, for an
arc its midpoint, side and large flag; the same, end and role of each line; the stitches; for an outfit, those of each
further garment, from the skin outwards. Two kinds of ``PatternTensor`` columns are left out, since they follow from the
others with larger rounding errors: Euler angles of rotations, which are not unique, and radii of arcs, which are
unbounded for nearly straight arcs.

The hash of many patterns is the sum of their hashes modulo 2^256 (AdHash; Bellare and Micciancio, 1997), so it does not
depend on their order. It identifies a data set, but gives no security against forgery.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Self

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.errors import PatternError
from gcd_dataset.tensors import EdgeColumn, LineColumn, PanelColumn, PatternTensor

STEP = 1e-4  # cm; unitless for quaternions
NEAR = 1e-5  # of a step: a number so near to half-way is a tie; 1e-9 cm, 50 times the largest observed difference
MOST_TIES = 6  # largest number of ties of a pattern for which all roundings, 2^6, are hashed
LARGEST = 1e15  # steps: upper limit of a number
MODULUS = 1 << 256

PANEL_COLUMNS = [
    PanelColumn.X,
    PanelColumn.Y,
    PanelColumn.Z,
    PanelColumn.CENTROID_X,
    PanelColumn.CENTROID_Y,
    PanelColumn.N_EDGES,
    PanelColumn.LABEL,
]
QUATERNION = [PanelColumn.QUATERNION_W, PanelColumn.QUATERNION_X, PanelColumn.QUATERNION_Y, PanelColumn.QUATERNION_Z]
EDGE_COLUMNS = [column for column in EdgeColumn if column is not EdgeColumn.RADIUS]
LINE_COLUMNS = [column for column in LineColumn if column not in (LineColumn.RADIUS, LineColumn.ANGLE)]


@dataclass(frozen=True)
class PatternHash:
    """The hash of a set of patterns; the hashes of disjoint sets add up.

    >>> PatternHash() + PatternHash(5, (1,), 1)
    PatternHash(value=5, ties=(1,), count=1)
    """

    value: int = 0
    ties: tuple[int, ...] = ()
    """Differences between ``value`` and the hashes with one or more ties of one pattern rounded the other way."""
    count: int = 0
    """Number of patterns."""

    @classmethod
    def of(cls, patterns: Iterable[tuple[int, *tuple[PatternTensor, ...]]]) -> Self:
        """The hash of indices, each with its pattern, or those of its outfit. Raises ``PatternError``."""
        value, count = 0, 0
        ties: list[int] = []
        for index, *garments in patterns:
            one = hash_pattern(index, *garments)
            value, count = (value + one.value) % MODULUS, count + one.count
            ties += one.ties
        return cls(value, tuple(ties), count)

    def __add__(self, other: "PatternHash") -> "PatternHash":
        value = (self.value + other.value) % MODULUS
        return PatternHash(value, self.ties + other.ties, self.count + other.count)

    @property
    def text(self) -> str:
        """64 hexadecimal digits."""
        return f"{self.value:064x}"

    def agrees(self, text: str) -> bool:
        """Whether ``text`` is the hash of the same patterns; ties of up to two patterns may be rounded differently."""
        try:
            missing = (int(text, 16) - self.value) % MODULUS
        except ValueError:
            return False
        if missing == 0 or missing in self.ties:
            return True
        one = set(self.ties)
        return any((missing - tie) % MODULUS in one for tie in one)


def hash_pattern(index: int, *garments: PatternTensor) -> PatternHash:
    """The hash of the pattern of sample ``index``, or of the patterns of its outfit, from the skin outwards.

    Raises ``PatternError`` for NaN or numbers beyond 1e11 cm.
    """
    words, rows = list[object]([index]), list[np.ndarray]()
    for tensor in garments:
        words += [tensor.panel_names, tensor.panel_labels, tensor.edge_labels, tensor.stitches.tolist()]
        rows += [
            tensor.panels[:, PANEL_COLUMNS].ravel(),
            _with_leading_sign(tensor.panels[:, QUATERNION]).ravel(),
            tensor.edges[:, EDGE_COLUMNS].ravel(),
            tensor.lines[:, LINE_COLUMNS].ravel(),
            tensor.lines[tensor.lines[:, LineColumn.ANGLE] != 0.0, LineColumn.ANGLE],
        ]
    steps = np.concatenate(rows).astype(float) / STEP
    if not (np.abs(steps) < LARGEST).all():  # false for NaN, too
        raise PatternError(
            f"pattern {garments[0].name}: a number is NaN or beyond {LARGEST * STEP:g} cm: correct the pattern"
        )
    head = hashlib.sha256(json.dumps(words, separators=(",", ":")).encode())
    whole = np.rint(steps).astype(np.int64)
    value = _digest(head, whole)
    ties = tuple((_digest(head, other) - value) % MODULUS for other in _other_roundings(steps, whole))
    return PatternHash(value, ties, 1)


def _with_leading_sign(quaternion: Float[np.ndarray, "p 4"]) -> Float[np.ndarray, "p 4"]:
    """Quaternions with a positive sign of the first component that does not round to 0.

    For a rotation by 180 degrees W is 0 up to rounding, so machines may disagree on the sign.
    """
    lead = np.rint(quaternion / STEP)
    sign = np.sign(lead[np.arange(len(lead)), (lead != 0).argmax(axis=1)])
    return quaternion * sign[:, None]


def _other_roundings(steps: Float[np.ndarray, " n"], whole: Int[np.ndarray, " n"]) -> Iterator[Int[np.ndarray, " n"]]:
    """All other ways to round the ties among ``steps``; none if there are more than ``MOST_TIES``."""
    rest = steps - whole
    tied = np.flatnonzero(np.abs(np.abs(rest) - 0.5) < NEAR)
    if len(tied) > MOST_TIES:
        return
    for chosen in product((0, 1), repeat=len(tied)):
        if any(chosen):
            other = whole.copy()
            other[tied] += np.array(chosen) * np.sign(rest[tied]).astype(np.int64)
            yield other


def _digest(head: "hashlib._Hash", numbers: Int[np.ndarray, " n"]) -> int:
    digest = head.copy()
    digest.update(numbers.astype("<i8").tobytes())
    return int.from_bytes(digest.digest(), "big")
