"""Faults of one garment, from the fields of its item."""

import re
from collections.abc import Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from gcd_dataset.check import checks
from gcd_dataset.check.checks import Check
from gcd_dataset.errors import PatternError, SpecError
from gcd_dataset.faults import Rule, Severity, check_pattern
from gcd_dataset.generator.mesh.triangulate import flat_areas
from gcd_dataset.generator.quality import WRONG_ORDER
from gcd_dataset.loaders import OutfitCloth
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import MISFITS, Grade, Outcome, Pattern
from gcd_dataset.shards.layout import of_garment, split_worn, worn_name
from gcd_dataset.spec import pattern_from_spec
from gcd_dataset.tensors import (
    COLUMNS,
    NO_LINES,
    CurveKind,
    EdgeColumn,
    PatternTensor,
    StitchColumn,
    closure_rows,
    decode_pattern,
    sewn_rows,
)

Fault = tuple[Check, str]
"""A check, and the fault in words without figures of the garment: equal faults are counted together."""

FIELDS_READ = (
    "meta", "spec", "design", "measures", "panels", "edges", "stitches", "closures", "lines", "body", "faces", "uv",
    "panel_id", "seams", "corners", "uv_vertex", "box", "verts", "points",
)  # fmt: skip
"""The fields that are examined; pictures and captions are not."""
ARRAYS = tuple(field for field in FIELDS_READ if field not in ("meta", "spec", "design", "measures"))
FLOATS = ("panels", "edges", "closures", "lines", "body", "uv", "box", "verts", "points")
PLACED = ("verts", "box")  # in this order: the drape, or the mesh before sewing

SMALLEST, LARGEST = 10.0, 400.0  # cm: extent of a draped garment, belts and trains included
WIDEST = 5000.0  # cm: extent before sewing; a ruffle is many metres long
SHORTEST, TALLEST = 40.0, 250.0  # cm: height of a wearer
STRETCH = 3.0  # median ratio of a mesh edge to its flat length, beyond which units differ; cloth stretches by 1.1
SIZES = (Rule.UNLIKELY_SIZE, Rule.TOO_LARGE)
LOW, HIGH, ASIDE = 10.0, 230.0, 80.0  # cm: centre of a garment above the soles, and beside the body's axis


@dataclass(frozen=True)
class CheckedGarment:
    """One garment, with the fields that its data set has."""

    key: str
    meta: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray]
    """Field to array; an array of a stage that did not run has no rows."""
    spec: Mapping[str, Any] | None = None
    design: Mapping[str, Any] | None = None
    measures: Mapping[str, float] | None = None

    @classmethod
    def of(cls, item: Mapping[str, Any], number: int = 0) -> "CheckedGarment":
        """From an item of a data set; ``number``: of the garment in an outfit."""
        own = of_garment(number, item)
        arrays = {name: np.asarray(own[name]) for name in ARRAYS if own.get(name) is not None}
        rest = {name: own.get(name) for name in ("spec", "design", "measures")}
        return cls(item["meta"]["key"], item["meta"]["outfit"][number] if number else item["meta"], arrays, **rest)

    @classmethod
    def joined(cls, item: Mapping[str, Any]) -> "CheckedGarment":
        """As ``of``, with the patterns and the designs of all garments of an outfit, to compare outfits."""
        numbers = range(1, len(item["meta"].get("outfit", ())))
        if not numbers or not {"panels", "edges", "stitches", "lines"} <= item.keys():
            return cls.of(item)
        pattern = {name: rows for name, rows in item.items() if name == "meta" or split_worn(name)[1] in COLUMNS}
        designs = {name: item[name] for number in numbers if (name := worn_name(number, "design")) in item}
        return cls.of({**item, **OutfitCloth()(pattern), "design": {**item.get("design", {}), **designs}})

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
            closures=self.arrays.get("closures", sewn_rows(len(self.arrays["stitches"]))),
            panel_names=tuple(meta["panel_names"]),
            panel_labels=tuple(meta["panel_labels"]),
            edge_labels=tuple(meta["edge_labels"]),
            lines=self.arrays.get("lines", NO_LINES),
        )

    @cached_property
    def pattern(self) -> Pattern | None:
        """The pattern; ``None`` where its arrays are missing or contradict each other."""
        try:
            return None if self.tensor is None else decode_pattern(self.tensor)
        except PatternError:
            return None


def item_faults(item: Mapping[str, Any]) -> Iterator[Fault]:
    """The faults of a garment, or of each garment of an outfit and of its layers."""
    yield from garment_faults(CheckedGarment.of(item))
    meta = item["meta"]
    if "outfit" not in meta:
        return
    count = len(meta["outfit"])
    held = {split_worn(name)[0]: len(item[name]) > 0 for name in item if split_worn(name)[1] == "panels"}
    if any(rows != (number < count) for number, rows in held.items()) or 1 < len(held) < count:
        yield checks.REFERENCES, "meta[outfit] and the arrays have different garments"
        return
    for number in range(1, count):
        faults = garment_faults(CheckedGarment.of(item, number))
        yield from ((check, f"garment {number} of the outfit: {fault}") for check, fault in faults)
    yield from ((checks.REFERENCES, fault) for fault in _layer_faults(item))


def _layer_faults(item: Mapping[str, Any]) -> Iterator[str]:
    """Layers that are missing, or that other garments than the item's would have."""
    rows = item["meta"]["layers"]
    outcomes = [entry["drape"] and entry["drape"]["outcome"] for entry in item["meta"]["outfit"]]
    draped, settled = (
        set(combinations([number for number, outcome in enumerate(outcomes) if outcome in kinds], 2))
        for kinds in (Outcome.__members__, [Outcome.SETTLED.name])
    )
    pairs = [(row["inner"], row["outer"]) for row in rows]
    if not settled <= {*pairs} <= draped or len({*pairs}) < len(pairs):
        yield "meta[layers] has not one row for each two draped garments"
        return
    is_clean = item["meta"]["grade"] == Grade.CLEAN.value
    if is_clean and any(row["crossings"] or row["wrong_order"] > WRONG_ORDER for row in rows):
        yield "meta[grade] is clean, and garments cross or lie in wrong order"
    for row in rows:
        verts = item.get(worn_name(row["inner"], "verts"))
        if not 0.0 <= row["wrong_order"] <= 1.0 or (verts is not None and not 0 <= row["covered"] <= len(verts)):
            yield "meta[layers] holds a share above 1, or counts more vertices than there are"


def garment_faults(garment: CheckedGarment) -> Iterator[Fault]:
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
    if (
        drape is not None
        and "chart" in meta.get("fit", {})
        and drape["outcome"] in {outcome.name for outcome in MISFITS}
    ):
        return
    if drape is not None and drape["outcome"] != Outcome.SETTLED.name:
        yield f"outcome {drape['outcome']}"
    elif meta.get("grade") == Grade.FAILED.value:
        yield "grade failed"


def _reference_faults(garment: CheckedGarment) -> Iterator[str]:
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
        if not _are_rows(ends, [*arrays["edges"], *arrays.get("lines", ())]):
            yield "stitches refers to rows that edges and lines lack"
    if garment.has("panels") and len(garment.meta["panel_names"]) != len(arrays["panels"]):
        yield "panels and meta[panel_names] differ in length"
    if garment.tensor is not None and garment.pattern is None:
        yield "panels, edges, stitches, closures and lines are not a pattern"
    yield from _spec_faults(garment)


def _are_rows(ids: np.ndarray, target: Sized | None) -> bool:
    """Whether all ids are rows of ``target``; a field that was not read is not examined."""
    return target is None or bool(0 <= ids.min() <= ids.max() < len(target))


def _spec_faults(garment: CheckedGarment) -> Iterator[str]:
    """A specification with other panels, stitches or closures than the arrays."""
    pattern = (garment.spec or {}).get("pattern")
    if not isinstance(pattern, Mapping) or not garment.has("panels") or "stitches" not in garment.arrays:
        return
    if set(pattern.get("panels", ())) != set(garment.meta["panel_names"]):
        yield "spec and panels have different panels"
    elif sum(len(pattern.get(key) or ()) for key in ("stitches", "line_stitches")) != len(garment.arrays["stitches"]):
        yield "spec and stitches have different stitches"
    elif garment.has("closures") and ("closures" in pattern or (garment.arrays["closures"] != sewn_rows(1)).any()):
        try:
            rows = closure_rows(pattern_from_spec(garment.spec, garment.key, source="spec"))
        except (PatternError, SpecError) as error:
            yield str(error)
        else:
            if not np.allclose(rows, garment.arrays["closures"]):
                yield "spec and closures have different closures"


def _pattern_faults(garment: CheckedGarment, pattern: Pattern) -> Iterator[Fault]:
    """Loops that run the wrong way round, and patterns that cannot be sewn."""
    across = np.array([panel.placement.matrix[:, 2] for panel in pattern.panels])
    loops = loop_areas(garment.arrays["edges"], len(across))
    # As if the panels were triangles: -1 if all loops run clockwise as seen from outside.
    if _outwardness(loops[:, None] * across, garment.arrays["panels"][:, :3]) < INWARD:
        yield checks.LOOPS, "all panels"
    faults = check_pattern(pattern)
    if any(fault.rule is Rule.SEWN_CROSSWISE for fault in faults):
        yield checks.LOOPS, "seams that join the far ends of their edges"
    if any(fault.rule in SIZES for fault in faults):
        yield checks.UNITS, "pattern of a size unlikely for a person"
    others = (fault for fault in faults if fault.rule not in SIZES)
    yield from ((checks.UNSEWABLE, fault.rule.value) for fault in others if fault.severity is Severity.ERROR)


def _unit_faults(garment: CheckedGarment) -> Iterator[str]:
    placed = garment.placed
    if placed is not None:
        largest = LARGEST if garment.has("verts") else WIDEST
        extent = float(np.ptp(placed, axis=0).max())
        if not SMALLEST < extent < largest:
            yield f"vertices in {_likely_unit(extent / 80.0)}"
        if garment.has("uv", "corners", "faces") and not _same_unit(garment, placed):
            yield "uv and vertices have different units"
    height = (garment.measures or {}).get("height")
    if height is not None and not SHORTEST < height < TALLEST:
        yield f"measures in {_likely_unit(height / 170.0)}"


def _likely_unit(scale: float) -> str:
    """The unit in which a length is ``scale`` times what it is in cm."""
    units = {"metres": 0.01, "inches": 0.39, "millimetres": 10.0}
    unit = min(units, key=lambda name: abs(np.log(max(scale, 1e-9) / units[name])))
    return unit if abs(np.log10(max(scale, 1e-9) / units[unit])) < 0.8 else "an unknown unit"


def _same_unit(garment: CheckedGarment, placed: np.ndarray) -> bool:
    faces, uv = garment.arrays["faces"], garment.arrays["uv"][garment.arrays["corners"]]
    solid = np.linalg.norm(placed[faces[:, 1]] - placed[faces[:, 0]], axis=1)
    flat = np.linalg.norm(uv[:, 1] - uv[:, 0], axis=1)
    ratio = np.median(solid) / max(float(np.median(flat)), 1e-9)
    # Before sewing, edges at seams span the gap between panels: a coarse mesh has little else.
    limit = STRETCH if garment.has("verts") else 10 * STRETCH
    return bool(1 / limit < ratio < limit)


def _axis_faults(garment: CheckedGarment) -> Iterator[str]:
    placed = garment.placed
    if placed is None:
        return
    x, y, z = np.median(placed, axis=0).tolist()
    if not LOW < y < HIGH or abs(x) > ASIDE or abs(z) > ASIDE:
        yield "y is not up: the garment is not above the floor" if abs(z) > ASIDE else "the garment is off the body"


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
        ends = ends[(ends < len(edges)).all(axis=1)]  # a seam of a line turns nothing over
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
    (dx, dy), (x, y) = (start - end).T, middle.T
    return 0.5 * np.bincount(panel, dx * y - dy * x, count)


def outwardness(placed: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> float:
    """Mean of the triangles' area vectors along the direction from the garment's centre, from -1 to 1.

    1 for a sphere whose normals point outwards; by the divergence theorem the sum is 3 · volume for a closed surface.
    """
    corners = placed[faces].astype(float)
    return _outwardness(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners.mean(axis=1))


def _outwardness(area: Float[np.ndarray, "n 3"], centre: Float[np.ndarray, "n 3"]) -> float:
    weight = np.linalg.norm(area, axis=1)
    away = centre - np.average(centre, axis=0, weights=np.maximum(weight, 1e-12))
    total = float(weight @ np.linalg.norm(away, axis=1))
    return float((area * away).sum()) / total if total > 0 else 0.0


OPEN = 0.2  # share of a seam's mesh edges on the border of the mesh, above which it is open
RATIO = 0.01  # relative error of a stored gather ratio
GATHERED = 6.0  # ratio of two lengths sewn together; ruffles of the design space reach 2, of the published data 3


def sewing_faults(
    arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any], pattern: Pattern | None
) -> Iterator[tuple[Check, str]]:
    """The faults of the seams of one garment."""
    if all(len(arrays.get(name, ())) for name in ("faces", "stitches")) and "seams" in arrays:
        seams, stitches = arrays["seams"].astype(np.int64), len(arrays["stitches"])
        whole = [row for row in range(stitches) if pattern is None or pattern.seams[row].joined == (0.0, 1.0)]
        if not np.isin(whole, seams[:, 1]).all():
            yield checks.OPEN_SEAMS, "seams without vertices in the mesh"
        on_seam = np.bincount(seams[:, 1], minlength=stitches)
        border = open_edges(arrays["faces"].astype(np.int64), seams, stitches)
        if (border > np.maximum(OPEN * on_seam, 1)).any():
            yield checks.OPEN_SEAMS, "both edges are on the border of the mesh"
    if pattern is not None:
        yield from _length_faults(pattern, meta.get("gathers") or ())


def open_edges(faces: Int[np.ndarray, "f 3"], seams: Int[np.ndarray, "n 2"], stitches: int) -> Int[np.ndarray, " s"]:
    """Number of mesh edges of each seam that belong to one triangle only."""
    edges = mesh_edges(faces)
    first, second = edges.ends[edges.counts == 1].T
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
