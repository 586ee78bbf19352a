"""A hash of many patterns that comes out the same on every machine.

Machines differ in the last digits of a number: with other instructions (AVX2, AVX-512) or another BLAS or C library,
the numbers of a pattern move by up to 2e-11 cm, 1e-13 cm on average. So numbers are rounded to steps of 1e-4 before
they are hashed. A number in the middle between two steps may then still be rounded up by one machine and down by
another: to be expected once for every 150 pairs of machines in the 230,000 patterns of a large data set, once for
40,000 pairs in 1,000 patterns. ``PatternHash`` knows such numbers and what they make of the hash, and ``agrees`` with
the hash of a machine that has rounded them the other way.

What is hashed of a pattern: its index; names and labels of panels, labels of edges; of each panel where its centroid
hangs, its rotation, its centroid in its own coordinates, its number of edges; of each edge its panel, start and kind,
its control points, for an arc the point half-way, and on which side and how far round it runs; the stitches. Left out
are the columns of a ``PatternTensor`` that follow from others and magnify their last digits: a rotation's Euler angles,
which are not unique, and the radius of an arc, which of a nearly straight one is as large as chance makes it.

The hash of many patterns is the sum of their hashes modulo 2^256 (AdHash; Bellare and Micciancio, 1997), so that their
order does not matter. It tells data sets apart; it is no protection against somebody who makes one up to fit.
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
from gcd_dataset.tensors import EdgeColumn, PanelColumn, PatternTensor

__all__ = ["STEP", "PatternHash", "hash_pattern"]

STEP = 1e-4  # cm; of a quaternion 1
NEAR = 1e-5  # steps: 1e-9 cm, fifty times the greatest difference between machines that was seen
MOST_TIES = 6  # numbers of one pattern that are taken both ways
LARGEST = 1e15  # steps
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
QUATERNION = [
    PanelColumn.QUATERNION_W,
    PanelColumn.QUATERNION_X,
    PanelColumn.QUATERNION_Y,
    PanelColumn.QUATERNION_Z,
]
EDGE_COLUMNS = [column for column in EdgeColumn if column is not EdgeColumn.RADIUS]


@dataclass(frozen=True)
class PatternHash:
    """The hash of some patterns; those of disjoint sets are added.

    >>> PatternHash() + PatternHash(5, (1,), 1)
    PatternHash(value=5, ties=(1,), count=1)
    """

    value: int = 0
    ties: tuple[int, ...] = ()
    """What is added to ``value`` by a pattern one or more of whose numbers are rounded the other way."""
    count: int = 0
    """Patterns that were hashed."""

    @classmethod
    def of(cls, patterns: Iterable[tuple[int, PatternTensor]]) -> Self:
        """The hash of patterns with their indices. Raises ``PatternError``."""
        value, count = 0, 0
        ties: list[int] = []
        for index, tensor in patterns:
            one = hash_pattern(index, tensor)
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
        """Whether ``text`` is the hash of the same patterns, two of them at most with numbers rounded otherwise."""
        try:
            missing = (int(text, 16) - self.value) % MODULUS
        except ValueError:
            return False
        if missing == 0 or missing in self.ties:
            return True
        one = set(self.ties)
        return any((missing - tie) % MODULUS in one for tie in one)


def hash_pattern(index: int, tensor: PatternTensor) -> PatternHash:
    """The hash of the pattern of sample ``index``. Raises ``PatternError`` for numbers that cannot be rounded."""
    steps = np.concatenate(
        [
            tensor.panels[:, PANEL_COLUMNS].ravel(),
            _turned(tensor.panels[:, QUATERNION]).ravel(),
            tensor.edges[:, EDGE_COLUMNS].ravel(),
        ]
    ).astype(float)
    steps /= STEP
    if not (np.abs(steps) < LARGEST).all():  # NaN is not smaller either
        raise PatternError(f"pattern {tensor.name}: holds a number that is none, or beyond {LARGEST * STEP:g} cm")
    words = [index, tensor.panel_names, tensor.panel_labels, tensor.edge_labels, tensor.stitches.tolist()]
    head = hashlib.sha256(json.dumps(words, separators=(",", ":")).encode())
    whole = np.rint(steps).astype(np.int64)
    value = _digest(head, whole)
    ties = tuple((_digest(head, other) - value) % MODULUS for other in _otherwise(steps, whole))
    return PatternHash(value, ties, 1)


def _turned(quaternion: Float[np.ndarray, "p 4"]) -> Float[np.ndarray, "p 4"]:
    """Quaternions of which one sign is taken: of half a turn, whose W is 0 but for the last digits, either may come."""
    lead = np.rint(quaternion / STEP)
    sign = np.sign(lead[np.arange(len(lead)), (lead != 0).argmax(axis=1)])
    return quaternion * sign[:, None]


def _otherwise(steps: Float[np.ndarray, " n"], whole: Int[np.ndarray, " n"]) -> Iterator[Int[np.ndarray, " n"]]:
    """The rounded numbers as other machines may have them, where some lie in the middle between two steps."""
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
    told = head.copy()
    told.update(numbers.astype("<i8").tobytes())
    return int.from_bytes(told.digest(), "big")
