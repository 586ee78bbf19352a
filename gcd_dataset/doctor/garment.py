"""Faults of one garment, from the fields of its item."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from gcd_dataset.doctor import checks
from gcd_dataset.doctor.checks import Check
from gcd_dataset.doctor.orientation import INWARD, loop_areas, loop_outwardness, orientation_faults
from gcd_dataset.doctor.sewing import sewing_faults
from gcd_dataset.errors import PatternError
from gcd_dataset.records import Grade, Outcome, Pattern
from gcd_dataset.tensors import PatternTensor, StitchColumn, decode_pattern
from gcd_dataset.validate import Rule, Severity, check_pattern

Fault = tuple[Check, str]
"""A check, and the fault in words without figures of the garment: equal faults are counted together."""

FIELDS_READ = (
    "meta", "spec", "design", "measures", "panels", "edges", "stitches", "body", "faces", "uv", "panel_id", "seams",
    "corners", "uv_vertex", "box", "verts", "points",
)  # fmt: skip
"""The fields that are examined; pictures and captions are not."""
ARRAYS = tuple(field for field in FIELDS_READ if field not in ("meta", "spec", "design", "measures"))
FLOATS = ("panels", "edges", "body", "uv", "box", "verts", "points")
PLACED = ("verts", "box")  # in this order: the drape, or the mesh before sewing

SMALLEST, LARGEST = 10.0, 400.0  # cm: extent of a draped garment, belts and trains included
WIDEST = 5000.0  # cm: extent before sewing; a ruffle is many metres long
SHORTEST, TALLEST = 40.0, 250.0  # cm: height of a wearer
STRETCH = 3.0  # median ratio of a mesh edge to its flat length, beyond which units differ; cloth stretches by 1.1
SIZES = (Rule.UNLIKELY_SIZE, Rule.TOO_LARGE)
LOW, HIGH, ASIDE = 10.0, 230.0, 80.0  # cm: centre of a garment above the soles, and beside the body's axis


@dataclass(frozen=True)
class Garment:
    """One garment, with the fields that its data set has."""

    key: str
    meta: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray]
    """Field to array; an array of a stage that did not run has no rows."""
    spec: Mapping[str, Any] | None = None
    design: Mapping[str, Any] | None = None
    measures: Mapping[str, float] | None = None

    @classmethod
    def of(cls, item: Mapping[str, Any]) -> "Garment":
        """From an item of a data set."""
        arrays = {name: np.asarray(item[name]) for name in ARRAYS if item.get(name) is not None}
        rest = {name: item.get(name) for name in ("spec", "design", "measures")}
        return cls(item["meta"]["key"], item["meta"], arrays, **rest)

    def has(self, *names: str) -> bool:
        """Whether the garment has rows of all these arrays."""
        return all(len(self.arrays.get(name, ())) for name in names)

    @property
    def placed(self) -> np.ndarray | None:
        """Vertices at rest, else before sewing [cm]; ``None`` without a mesh."""
        return next((self.arrays[name] for name in PLACED if self.has(name)), None)

    @cached_property
    def tensor(self) -> PatternTensor | None:
        """The pattern as arrays; ``None`` if a part is missing or not finite."""
        if not self.has("panels", "edges") or "stitches" not in self.arrays:
            return None
        if not (np.isfinite(self.arrays["panels"]).all() and np.isfinite(self.arrays["edges"]).all()):
            return None
        meta = self.meta
        return PatternTensor(
            panels=self.arrays["panels"],
            edges=self.arrays["edges"],
            stitches=self.arrays["stitches"],
            panel_names=tuple(meta["panel_names"]),
            panel_labels=tuple(meta["panel_labels"]),
            edge_labels=tuple(meta["edge_labels"]),
        )

    @cached_property
    def pattern(self) -> Pattern | None:
        """The pattern; ``None`` where its arrays are missing or contradict each other."""
        try:
            return None if self.tensor is None else decode_pattern(self.tensor)
        except PatternError:
            return None


def garment_faults(garment: Garment) -> Iterator[Fault]:
    """All faults of a garment that can be seen without the others."""
    unfinite = [name for name in FLOATS if name in garment.arrays and not np.isfinite(garment.arrays[name]).all()]
    yield from ((checks.NOT_FINITE, name) for name in unfinite)
    yield from ((checks.FAILED_DRAPE, fault) for fault in _drape_faults(garment.meta))
    broken = list(_reference_faults(garment))
    yield from ((checks.REFERENCES, fault) for fault in broken)
    if unfinite or broken:
        return  # geometry of such arrays is undefined
    units = list(_unit_faults(garment))
    yield from ((checks.UNITS, fault) for fault in units)
    if not units:
        yield from ((checks.AXES, fault) for fault in _axis_faults(garment))
    yield from orientation_faults(garment.arrays, garment.meta["panel_names"], garment.placed)
    if garment.pattern is not None:
        yield from _pattern_faults(garment, garment.pattern)
    yield from sewing_faults(garment.arrays, garment.meta, garment.pattern)


def _drape_faults(meta: Mapping[str, Any]) -> Iterator[str]:
    drape = meta.get("drape")
    if drape is not None and drape["outcome"] != Outcome.SETTLED.name:
        yield f"outcome {drape['outcome']}"
    elif meta.get("grade") == Grade.FAILED.value:
        yield "grade failed"


def _reference_faults(garment: Garment) -> Iterator[str]:
    """Arrays that refer to missing rows, or disagree in length."""
    arrays = garment.arrays
    vertices = "verts" if garment.has("verts") else "box"
    targets = {"faces": vertices, "corners": "uv", "uv_vertex": vertices, "panel_id": "panels"}
    for name, target in targets.items():
        if garment.has(name) and not _are_rows(arrays[name], arrays.get(target)):
            yield f"{name} refers to rows that {target} lacks"
    if garment.has("seams") and "stitches" in arrays and arrays["seams"][:, 1].max() >= len(arrays["stitches"]):
        yield "seams refers to rows that stitches lacks"
    for one, other in (("faces", "corners"), ("faces", "panel_id"), ("uv", "uv_vertex"), ("box", "verts")):
        if garment.has(one, other) and len(arrays[one]) != len(arrays[other]):
            yield f"{one} and {other} differ in length"
    if garment.has("stitches", "edges"):
        ends = arrays["stitches"][:, [StitchColumn.LEFT, StitchColumn.RIGHT]]
        if not _are_rows(ends, arrays["edges"]):
            yield "stitches refers to rows that edges lacks"
    if garment.has("panels") and len(garment.meta["panel_names"]) != len(arrays["panels"]):
        yield "panels and meta[panel_names] differ in length"
    if garment.tensor is not None and garment.pattern is None:
        yield "panels, edges and stitches are not a pattern"
    yield from _spec_faults(garment)


def _are_rows(ids: np.ndarray, target: np.ndarray | None) -> bool:
    """Whether all ids are rows of ``target``; a field that was not read is not examined."""
    return target is None or bool(0 <= ids.min() <= ids.max() < len(target))


def _spec_faults(garment: Garment) -> Iterator[str]:
    """A specification with other panels or stitches than the arrays."""
    pattern = (garment.spec or {}).get("pattern")
    if not isinstance(pattern, Mapping) or not garment.has("panels") or "stitches" not in garment.arrays:
        return
    if set(pattern.get("panels", ())) != set(garment.meta["panel_names"]):
        yield "spec and panels have different panels"
    elif len(pattern.get("stitches", ())) != len(garment.arrays["stitches"]):
        yield "spec and stitches have different stitches"


def _pattern_faults(garment: Garment, pattern: Pattern) -> Iterator[Fault]:
    """Loops that run the wrong way round, and patterns that cannot be sewn."""
    across = np.array([panel.placement.matrix[:, 2] for panel in pattern.panels])
    loops = loop_areas(garment.arrays["edges"], len(across))
    if loop_outwardness(loops, garment.arrays["panels"][:, :3], across) < INWARD:
        yield checks.LOOPS, "all panels"
    faults = check_pattern(pattern)
    if any(fault.rule is Rule.SEWN_CROSSWISE for fault in faults):
        yield checks.LOOPS, "seams that join the far ends of their edges"
    if any(fault.rule in SIZES for fault in faults):
        yield checks.UNITS, "pattern of a size unlikely for a person"
    others = (fault for fault in faults if fault.rule not in SIZES)
    yield from ((checks.UNSEWABLE, fault.rule.value) for fault in others if fault.severity is Severity.ERROR)


# ------------------------------------------------------------------------------------------------------ units and axes


def _unit_faults(garment: Garment) -> Iterator[str]:
    placed = garment.placed
    if placed is not None:
        largest = LARGEST if garment.has("verts") else WIDEST
        yield from _extent_faults("vertices", float(np.ptp(placed, axis=0).max()), largest)
        if garment.has("uv", "corners", "faces") and not _same_unit(garment, placed):
            yield "uv and vertices have different units"
    height = (garment.measures or {}).get("height")
    if height is not None and not SHORTEST < height < TALLEST:
        yield f"measures in {_likely_unit(height / 170.0)}"


def _extent_faults(name: str, extent: float, largest: float) -> Iterator[str]:
    if not SMALLEST < extent < largest:
        yield f"{name} in {_likely_unit(extent / 80.0)}"


def _likely_unit(scale: float) -> str:
    """The unit in which a length is ``scale`` times what it is in cm."""
    units = {"metres": 0.01, "inches": 0.39, "millimetres": 10.0}
    unit = min(units, key=lambda name: abs(np.log(max(scale, 1e-9) / units[name])))
    return unit if abs(np.log10(max(scale, 1e-9) / units[unit])) < 0.8 else "an unknown unit"


def _same_unit(garment: Garment, placed: np.ndarray) -> bool:
    faces, uv = garment.arrays["faces"], garment.arrays["uv"][garment.arrays["corners"]]
    solid = np.linalg.norm(placed[faces[:, 1]] - placed[faces[:, 0]], axis=1)
    flat = np.linalg.norm(uv[:, 1] - uv[:, 0], axis=1)
    ratio = np.median(solid) / max(float(np.median(flat)), 1e-9)
    # Before sewing, edges at seams span the gap between panels: a coarse mesh has little else.
    limit = STRETCH if garment.has("verts") else 10 * STRETCH
    return bool(1 / limit < ratio < limit)


def _axis_faults(garment: Garment) -> Iterator[str]:
    placed = garment.placed
    if placed is None:
        return
    x, y, z = np.median(placed, axis=0).tolist()
    if not LOW < y < HIGH or abs(x) > ASIDE or abs(z) > ASIDE:
        yield "y is not up: the garment is not above the floor" if abs(z) > ASIDE else "the garment is off the body"
