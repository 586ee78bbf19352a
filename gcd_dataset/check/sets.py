"""Faults of all garments together: shares of kinds, and designs, bodies and patterns that splits share."""

import hashlib
import json
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Int

from gcd_dataset.check.garments import ARRAYS, CheckedGarment
from gcd_dataset.tensors import EdgeColumn, PanelColumn, PatternTensor

NOBODY = 0  # hash of a body that garments may share: the neutral one, or one without name and weights
COMMON_BODIES = ("neutral", "female", "male", "mean_all", "")
DOMINANT, FEWEST = 0.9, 20  # share of one kind, among at least so many garments
DISTANCE = 0.1  # total variation between the shares of two splits, beyond that of chance
KINDS = ("upper", "bottom")
STEP = 1e-3  # cm: patterns that round to the same numbers are equal
PANEL_COLUMNS = [PanelColumn.X, PanelColumn.Y, PanelColumn.Z]
EDGE_COLUMNS = [*range(EdgeColumn.START_X, EdgeColumn.START_Y + 1)]
EDGE_COLUMNS += range(EdgeColumn.CONTROL0_X, EdgeColumn.CONTROL1_Y + 1)
OPTIONAL = ("stitches", "closures", "lines", "seams")  # a garment of one piece may have no seam


class SplitCensus:
    """The garments of one split, a hundred bytes for each."""

    def __init__(self) -> None:
        self.position, self.design, self.body, self.pattern = (array("q") for _ in range(4))
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
        self.pattern.append(0 if garment.tensor is None else _pattern_hash(garment.tensor))
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
        """Pairs of splits that share values of an array such as ``design``, and the rows of the second with one."""
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


def evenly_spaced(count: int, most: int) -> list[int]:
    """At most ``most`` of ``count`` positions."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)).tolist()


def kinds_of(design: Mapping[str, Any] | None) -> dict[str, str]:
    """The choices of garment types in a tree of design parameters, as far as known."""
    chosen: Any = (design or {}).get("meta")
    found = {name: chosen[name] for name in KINDS if isinstance(chosen, Mapping) and name in chosen}
    return {name: str(kind.get("v") if isinstance(kind, Mapping) else kind) for name, kind in found.items()}


def _pattern_hash(tensor: PatternTensor) -> int:
    """A number for the panels, edges and stitches, with all positions rounded to ``STEP``."""
    numbers = np.concatenate([tensor.panels[:, PANEL_COLUMNS].ravel(), tensor.edges[:, EDGE_COLUMNS].ravel()])
    words = repr((tensor.panel_names, tensor.stitches.tolist(), tensor.edges[:, [0, EdgeColumn.KIND]].tolist()))
    return _hash(words.encode() + np.rint(numbers.astype(float) / STEP).astype("<i8").tobytes())


def _hash(data: bytes) -> int:
    return int.from_bytes(hashlib.blake2b(data, digest_size=8).digest(), "little", signed=True)
