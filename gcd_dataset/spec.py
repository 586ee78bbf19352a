"""Reading and writing patterns as GarmentCode specification files (``<name>_specification.json``).

Files hold degrees and the length unit they declare; patterns in memory hold radians and centimetres. Older files, with
absolute control points, other units or unnormalised loops, are converted when they are read.

A stitch stays a list of two edges, whatever its closure, so that pygarment and other readers sew it. The list
``pattern.closures``, which they ignore, names the stitches that are not sewn from end to end: ``panel`` and ``edge`` of
the first side, ``closure``, and ``closed``, the joined part from and to, as shares of that edge.

Lines inside a panel are its list ``lines``: ``endpoints`` and ``curvature`` as of an edge, and ``role``. Seams of lines
are in the list ``pattern.line_stitches``, which others ignore, too: ``sides``, each a panel and an ``edge`` or a
``line``, ``right_wrong``, and ``seam``, its position among all seams. In ``closures`` they are named by ``line``. A
fold has its rest ``angle`` [degrees]; the seams between layers of a pleat are in ``line_stitches``, too.

>>> from gcd_dataset.records import Panel, Pattern, Placement, Edge
>>> square = Panel("square", np.array([[0, 0], [9, 0], [9, 9], [0, 9]]), tuple(Edge(i, (i + 1) % 4) for i in range(4)),
...                Placement(np.zeros(3), np.zeros(3)))
>>> pattern = Pattern("napkin", (square,), ())
>>> pattern_from_spec(spec_from_pattern(pattern), "napkin").panels == pattern.panels
True
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Point, Quadratic, mirrored, signed_area, to_frame
from gcd_dataset.errors import PatternError, shown
from gcd_dataset.files import write_whole
from gcd_dataset.jsonfile import JsonPath, found, given, read_json
from gcd_dataset.records import (
    Closure,
    Edge,
    EdgeRef,
    EdgeRole,
    InnerLine,
    LineRole,
    Panel,
    PanelRole,
    Pattern,
    Placement,
    Seam,
    role_of,
)

__all__ = [
    "is_bodice", "is_trouser_leg", "panel_order", "pattern_from_spec", "pattern_name", "read_pattern", "role_by_name",
    "spec_from_pattern", "write_pattern",
]  # fmt: skip

UNITS_IN_METER = 100  # files are written in centimetres
NEIGHBOURS = 10.0  # cm: panels this close in x form a column of the panel order, in y a row
UNPLACED = [0.0, 0.0, 0.0]  # default translation and rotation of a panel
LARGEST_UNIT = 1e6  # upper bound of units_in_meter; its inverse is the lower bound
MOST_NAMES = 40  # most names listed in a message
NAMES = {
    PanelRole.LEG: ("pant", "skirt", "leg", "trouser", "short"),
    PanelRole.ARM: ("sleeve", "arm", "cuff", "sl_"),
    PanelRole.BODY: ("torso", "bodice", "wb", "hood", "collar", "lapel", "body", "top", "waist"),
}
"""Role of a panel to words in its name."""
TROUSERS = "pant"  # part of the names of GarmentCode's trouser panels and their cuffs
BODICE = ("torso", "bodice", "top", "bust")  # parts of the names of panels that hang from the armpits
LARGEST_SPEC = 4 << 20  # bytes, three seconds to read; published specifications have 60 kB
NAMELESS = frozenset({"specification", "template", "prediction"})  # stems: the pattern is named after the folder


def read_pattern(path: Path | str) -> Pattern:
    """The pattern in a specification file, named after the file; after its folder for a plain ``specification.json``.

    Raises ``SpecError`` for a file that is missing or not a specification. Whether the pattern can be sewn is checked
    by ``check_pattern``, not here.
    """
    path = Path(path)
    spec = read_json(path, "specification JSON", limit=LARGEST_SPEC)
    return pattern_from_spec(spec, pattern_name(path), source=str(path))


def write_pattern(pattern: Pattern, path: Path | str) -> None:
    """Write the pattern as a specification file. Raises ``OutputError``."""
    write_whole(path, (json.dumps(spec_from_pattern(pattern), indent=2) + "\n").encode())


def pattern_from_spec(spec: Any, name: str, *, source: str = "") -> Pattern:
    """The pattern of a parsed specification; ``source`` names it in errors.

    Null counts as absent. Panels without a translation or rotation are placed at the origin; a file without stitches
    gives a pattern without seams. Raises ``SpecError`` naming the panel and edge that break the format.
    """
    at = JsonPath(source or name)
    at.require_flat(spec)
    if "pattern" not in at.mapping(spec, ""):
        keys = ", ".join(shown(key[:MOST_NAMES]) for key in islice(spec, 9))
        raise at.error(f"no object named pattern, only {keys or 'nothing'}: give a specification JSON")
    body = at.mapping(spec["pattern"], "pattern")
    form = _Form.of(at.mapping(given(spec, "properties", {}), "properties"), at)
    panels = {
        key: _panel(key, at.mapping(entry, f"panel {shown(key)}"), form, at.within(f"panel {shown(key)}"))
        for key, entry in at.mapping(body.get("panels"), "pattern.panels").items()
    }
    stitches = at.list_of(body, "stitches") if body.get("stitches") is not None else []
    seams = tuple(_seam(entry, panels, at.within(f"stitch {i}")) for i, entry in enumerate(stitches))
    if body.get("line_stitches") is not None:
        seams = _with_line_seams(seams, at.list_of(body, "line_stitches"), panels, at)
    if body.get("closures") is not None:
        seams = _closed(seams, at.list_of(body, "closures"), panels, at)
    if not form.loops_normalised:
        panels, seams = _normalise_loops(panels, seams)
    order = _given_order(body, panels, at) if body.get("panel_order") is not None else panel_order(panels.values())
    return Pattern(name, tuple(panels[key] for key in order), seams, _extra(spec, form))


def spec_from_pattern(pattern: Pattern) -> dict[str, Any]:
    """The specification of a pattern as a JSON tree; numbers keep all their digits."""
    panels = {panel.name: panel for panel in pattern.panels}
    entries = [[_side_entry(side, panels) for side in (seam.left, seam.right)] for seam in pattern.seams]
    seams = list(zip(pattern.seams, entries, strict=True))
    closures = [
        {**sides[0], "closure": str(seam.closure), "closed": list(seam.closed)}
        for seam, sides in seams
        if not seam.is_plain
    ]
    of_lines = [
        {"seam": number, "sides": sides, "right_wrong": seam.right_wrong}
        for number, (seam, sides) in enumerate(seams)
        if any("line" in side for side in sides) or pattern.layers(seam)
    ]
    hidden = {entry["seam"] for entry in of_lines}
    return {
        "pattern": {
            "panels": {panel.name: _panel_entry(panel) for panel in pattern.panels},
            "stitches": [
                sides + ["right_wrong"] * seam.right_wrong
                for number, (seam, sides) in enumerate(seams)
                if number not in hidden
            ],
            **({"line_stitches": of_lines} if of_lines else {}),
            **({"closures": closures} if closures else {}),
            "panel_order": [panel.name for panel in pattern.panels],
        },
        "parameters": {},
        "parameter_order": [],
        **{key: value for key, value in pattern.extra.items() if key != "properties"},
        "properties": {
            **pattern.extra.get("properties", {}),
            "curvature_coords": "relative",
            "normalize_panel_translation": False,
            "normalized_edge_loops": True,
            "units_in_meter": UNITS_IN_METER,
        },
    }


def panel_order(panels: Iterable[Panel]) -> tuple[str, ...]:
    """Panel names in the order that numbers a mesh: columns from the wearer's right to left, upward, back to front.

    A panel's position is the midpoint of the side of its bounding box that hangs highest. Panels within 10 cm of the
    first panel of a column, or of a row in it, belong to it.
    """
    hung = sorted((_hanging_point(panel), panel.name) for panel in panels)
    ordered = []
    for column in _runs(hung, axis=0):
        for row in _runs(sorted(column, key=lambda item: (item[0][1], item[1])), axis=1):
            ordered += sorted(row, key=lambda item: (item[0][2], item[1]))
    return tuple(name for _, name in ordered)


def role_by_name(name: str) -> PanelRole | None:
    """The role that a panel's name suggests, for files without labels; ``None`` if it suggests none."""
    return next((role for role, words in NAMES.items() if any(word in name.lower() for word in words)), None)


def is_trouser_leg(name: str) -> bool:
    """Whether a panel goes round one leg, by its name: the label ``leg`` covers skirts, too."""
    return TROUSERS in name


def is_bodice(name: str) -> bool:
    """Whether a panel hangs from the armpits, by its name."""
    return any(word in name.lower() for word in BODICE)


@dataclass(frozen=True)
class _Form:
    """A file's conventions: length unit, control points, panel origins, loops."""

    scale: float
    """Centimetres in the file's unit."""
    absolute_controls: bool
    centre_panels: bool
    loops_normalised: bool

    @staticmethod
    def of(properties: Mapping[str, Any], at: JsonPath) -> "_Form":
        units = at.number(given(properties, "units_in_meter", UNITS_IN_METER), "properties.units_in_meter")
        if not 1 / LARGEST_UNIT <= units <= LARGEST_UNIT:
            raise at.error(f"properties.units_in_meter is {units}: give the number of length units in a metre")
        controls = given(properties, "curvature_coords", "relative")
        if controls not in ("relative", "absolute"):
            raise at.error(f"properties.curvature_coords is {controls!r}: give 'relative' or 'absolute'")
        return _Form(
            scale=UNITS_IN_METER / units,
            absolute_controls=controls == "absolute",
            centre_panels=bool(properties.get("normalize_panel_translation", False)),
            loops_normalised=bool(properties.get("normalized_edge_loops", False)),
        )


def _panel(name: str, entry: Mapping[str, Any], form: _Form, at: JsonPath) -> Panel:
    translation = form.scale * np.array(at.numbers(given(entry, "translation", UNPLACED), 3, "translation"))
    rotation = np.radians(at.numbers(given(entry, "rotation", UNPLACED), 3, "rotation"))
    points = [at.numbers(point, 2, f"vertex {i}") for i, point in enumerate(at.list_of(entry, "vertices"))]
    vertices = form.scale * np.array(points, float).reshape(-1, 2)
    edges = tuple(
        _edge(at.mapping(edge, f"edge {i}"), vertices, form, at.within(f"edge {i}"))
        for i, edge in enumerate(at.list_of(entry, "edges"))
    )
    lines = tuple(
        _line(at.mapping(line, f"line {i}"), vertices, form, at.within(f"line {i}"))
        for i, line in enumerate(at.list_of(entry, "lines") if entry.get("lines") is not None else [])
    )
    if form.centre_panels and len(vertices):
        centre = vertices.mean(axis=0)
        vertices = vertices - centre
        translation = translation + np.append(centre, 0.0)
    label = role_of(PanelRole, at.text(entry.get("label") or "", "label"))
    return Panel(name, vertices, edges, Placement(translation, rotation), label, lines)


def _line(entry: Mapping[str, Any], vertices: Float[np.ndarray, "v 2"], form: _Form, at: JsonPath) -> InnerLine:
    drawn, role = _edge(entry, vertices, form, at), at.text(given(entry, "role", LineRole.STITCH), "role")
    angle = at.number(given(entry, "angle", 0.0), "angle")
    return InnerLine(drawn.start, drawn.end, drawn.curve, role_of(LineRole, role), angle)


def _edge(entry: Mapping[str, Any], vertices: Float[np.ndarray, "v 2"], form: _Form, at: JsonPath) -> Edge:
    ends = entry.get("endpoints")
    if not (isinstance(ends, list) and len(ends) == 2):
        raise at.error(f"endpoints must be two vertex numbers, found {found(ends)}")
    start, end = (at.index(vertex, "endpoint") for vertex in ends)
    label = role_of(EdgeRole, at.text(entry.get("label") or "", "label"))
    if entry.get("curvature") is None:
        return Edge(start, end, label=label)
    curve = _curve(entry["curvature"], form.scale, at)
    if form.absolute_controls and not isinstance(curve, Arc):
        if not (0 <= start < len(vertices) and 0 <= end < len(vertices)):
            raise at.error(
                f"endpoints {start}, {end} of {len(vertices)} vertices, numbered from 0: correct the endpoints"
            )
        curve = _relative(curve, vertices[start], vertices[end], form.scale, at)
    return Edge(start, end, curve, label)


def _curve(entry: Any, scale: float, at: JsonPath) -> Curve:
    if isinstance(entry, list):  # the first version of the format: one control point
        return Quadratic(_pair(entry, at))
    kind, params = at.text(at.mapping(entry, "curvature").get("type"), "curvature type"), at.list_of(entry, "params")
    expected = {"quadratic": 1, "cubic": 2, "circle": 3}
    if kind not in expected:
        raise at.error(f"curvature type {kind!r}: give one of {', '.join(expected)}")
    if len(params) != expected[kind]:
        raise at.error(f"a {kind} curvature has {expected[kind]} params, found {len(params)}")
    if kind == "circle":
        radius = at.number(params[0], "arc radius")
        return Arc(scale * radius, *(bool(at.number(flag, "arc flag")) for flag in params[1:]))
    controls = [_pair(point, at) for point in params]
    return Quadratic(*controls) if kind == "quadratic" else Cubic(*controls)


def _pair(value: Any, at: JsonPath) -> Point:
    a, b = at.numbers(value, 2, "control point")
    return (a, b)


def _relative(curve: Curve, start: np.ndarray, end: np.ndarray, scale: float, at: JsonPath) -> Curve:
    """The curve in the edge frame; ``curve`` has control points in the panel's plane, in the file's unit."""

    def framed(control: Point) -> Point:
        return to_frame((start[0], start[1]), (end[0], end[1]), (scale * control[0], scale * control[1]))

    try:
        match curve:
            case Quadratic(control):
                return Quadratic(framed(control))
            case Cubic(control0, control1):
                return Cubic(framed(control0), framed(control1))
            case _:
                return curve
    except PatternError as error:
        raise at.error(str(error)) from error


def _seam(entry: Any, panels: Mapping[str, Panel], at: JsonPath) -> Seam:
    if not isinstance(entry, list) or len(entry) not in (2, 3):
        raise at.error(f"a stitch is two edges, and at most the word right_wrong; found {found(entry)}")
    if len(entry) == 3 and entry[2] not in ("right_wrong", None):
        raise at.error(f"the third word of a stitch is right_wrong, found {found(entry[2])}")
    left, right = (_side(at.mapping(side, "a side of the stitch"), panels, at) for side in entry[:2])
    return Seam(left, right, right_wrong=entry[2:] == ["right_wrong"])


def _side(entry: Mapping[str, Any], panels: Mapping[str, Panel], at: JsonPath) -> EdgeRef:
    """The edge, or the line, that a side of a stitch names."""
    name = at.text(entry.get("panel"), "panel")
    if entry.get("line") is None:
        edge = at.index(entry.get("edge"), "edge number")
        if name in panels and panels[name].lines and edge >= len(panels[name].edges):
            raise at.error(f"panel {shown(name)} has no edge {edge}: correct panel or edge")
        return EdgeRef(name, edge)
    if name not in panels or not 0 <= (line := at.index(entry["line"], "line number")) < len(panels[name].lines):
        raise at.error(f"panel {shown(name)} has no line {entry['line']}: correct panel or line")
    return EdgeRef(name, len(panels[name].edges) + line)


def _with_line_seams(
    seams: Sequence[Seam], entries: Sequence[Any], panels: Mapping[str, Panel], at: JsonPath
) -> tuple[Seam, ...]:
    """The seams with those of ``pattern.line_stitches`` at their positions."""
    found = list(seams)
    for i, value in enumerate(entries):
        here = at.within(f"line stitch {i}")
        entry = here.mapping(value, "an entry of line_stitches")
        turned, place = given(entry, "right_wrong", False), here.index(given(entry, "seam", len(found)), "seam")
        if turned not in (True, False):
            raise here.error("right_wrong is neither true nor false: give one of them")
        if not 0 <= place <= len(found):
            raise here.error(f"seam {place} is no position among {len(found)} seams: give 0 to {len(found)}")
        found.insert(place, _seam([*here.list_of(entry, "sides"), *["right_wrong"] * turned], panels, here))
    return tuple(found)


def _closed(
    seams: Sequence[Seam], entries: Sequence[Any], panels: Mapping[str, Panel], at: JsonPath
) -> tuple[Seam, ...]:
    """The seams with the closures of ``pattern.closures``."""
    row_of, found = {seam.left: row for row, seam in enumerate(seams)}, list(seams)
    for i, value in enumerate(entries):
        here = at.within(f"closure {i}")
        entry = here.mapping(value, "an entry of closures")
        edge = _side(entry, panels, here)
        if (row := row_of.pop(edge, None)) is None:
            raise here.error(
                f"no stitch begins with edge {edge.edge} of panel {shown(edge.panel)}, or an earlier closure names it: "
                "name each first side once"
            )
        closure = role_of(Closure, here.text(entry.get("closure"), "closure"))
        start, end = here.numbers(given(entry, "closed", [0, 1]), 2, "closed")
        found[row] = replace(found[row], closure=closure, closed=(start, end))
    return tuple(found)


def _given_order(body: Mapping[str, Any], panels: Mapping[str, Panel], at: JsonPath) -> tuple[str, ...]:
    order = tuple(at.text(name, "a name in panel_order") for name in at.list_of(body, "panel_order"))
    odd = sorted(set(order) ^ set(panels))
    if odd or len(order) != len(panels):
        named = f": look at {', '.join(map(shown, odd[:MOST_NAMES]))}" if odd else ""
        raise at.error(f"panel_order must name each of the {len(panels)} panels once{named}")
    return order


def _extra(spec: Mapping[str, Any], form: _Form) -> dict[str, Any]:
    """The file's content beside the pattern; a converted unit is recorded in ``original_units_in_meter``."""
    extra = {key: value for key, value in spec.items() if key != "pattern" and value is not None}
    if form.scale != 1.0:
        units = spec["properties"]["units_in_meter"]
        extra["properties"] = {"original_units_in_meter": units, **spec["properties"], "units_in_meter": UNITS_IN_METER}
    return extra


def _normalise_loops(panels: Mapping[str, Panel], seams: Iterable[Seam]) -> tuple[dict[str, Panel], tuple[Seam, ...]]:
    """Loops that start at the lower left corner and run counter-clockwise; panels keep their position in space."""
    shifts, changed = {}, {}
    for name, panel in panels.items():
        if not panel.edges or any(not 0 <= edge.start < len(panel.vertices) for edge in panel.edges):
            shifts[name], changed[name] = 0, panel  # ``check_pattern`` reports it
            continue
        corners = panel.vertices[[edge.start for edge in panel.edges]]
        facing = panel if signed_area(corners) >= 0 else _turned_over(panel)
        corners = facing.vertices[[edge.start for edge in facing.edges]]
        first = int(np.argmin(np.linalg.norm(corners - corners.min(axis=0), axis=1)))
        shifts[name] = first
        changed[name] = replace(facing, edges=facing.edges[first:] + facing.edges[:first])

    def renumbered(ref: EdgeRef) -> EdgeRef:
        if ref.panel not in changed or not 0 <= ref.edge < len(changed[ref.panel].edges):
            return ref
        return EdgeRef(ref.panel, (ref.edge - shifts[ref.panel]) % len(changed[ref.panel].edges))

    return changed, tuple(replace(s, left=renumbered(s.left), right=renumbered(s.right)) for s in seams)


def _turned_over(panel: Panel) -> Panel:
    """The same panel in space, drawn from its other side: mirrored in its plane and turned by half a turn about y."""
    placement = panel.placement
    turned = placement.matrix @ np.diag([-1.0, 1.0, -1.0])
    return replace(
        panel,
        vertices=panel.vertices * [-1.0, 1.0],
        edges=tuple(replace(edge, curve=mirrored(edge.curve)) for edge in panel.edges),
        lines=tuple(replace(line, curve=mirrored(line.curve), angle=-line.angle or 0.0) for line in panel.lines),
        placement=Placement(placement.translation, euler_angles(turned)),
    )


def euler_angles(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """Angles (x, y, z) [rad] with ``Rz Ry Rx`` equal to the rotation matrix; x is 0 where only x ± z is determined."""
    sine = -matrix[2, 0]
    if abs(sine) < 1 - 1e-12:
        x, z = np.arctan2(matrix[2, 1], matrix[2, 2]), np.arctan2(matrix[1, 0], matrix[0, 0])
        return np.array([x, np.arctan2(sine, np.hypot(matrix[0, 0], matrix[1, 0])), z])
    return np.array([0.0, np.copysign(np.pi / 2, sine), np.arctan2(-matrix[0, 1], matrix[1, 1])])


def _panel_entry(panel: Panel) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "translation": panel.placement.translation.tolist(),
        "rotation": np.degrees(panel.placement.rotation).tolist(),
        "vertices": panel.vertices.tolist(),
        "edges": [{**_curve_entry(edge), **({"label": edge.label} if edge.label else {})} for edge in panel.edges],
    }
    if panel.lines:
        entry["lines"] = [
            {**_curve_entry(line), "role": str(line.role)} | ({"angle": line.angle} if line.angle else {})
            for line in panel.lines
        ]
    return {**entry, "label": panel.label} if panel.label else entry


def _curve_entry(edge: Edge | InnerLine) -> dict[str, Any]:
    entry: dict[str, Any] = {"endpoints": [edge.start, edge.end]}
    match edge.curve:
        case Quadratic(control):
            entry["curvature"] = {"type": "quadratic", "params": [list(control)]}
        case Cubic(control0, control1):
            entry["curvature"] = {"type": "cubic", "params": [list(control0), list(control1)]}
        case Arc(radius, large, right):
            entry["curvature"] = {"type": "circle", "params": [radius, int(large), int(right)]}
        case _:
            assert edge.curve == LINE
    return entry


def _side_entry(ref: EdgeRef, panels: Mapping[str, Panel]) -> dict[str, Any]:
    line = ref.edge - len(panels[ref.panel].edges) if ref.panel in panels else -1
    is_line = line >= 0 and line < len(panels[ref.panel].lines)
    return {"panel": ref.panel, "line": line} if is_line else {"panel": ref.panel, "edge": ref.edge}


def _hanging_point(panel: Panel) -> tuple[float, float, float]:
    """Midpoint of the highest side of the panel's bounding box in space [cm]."""
    if not len(panel.vertices):  # ``check_pattern`` reports it
        return (0.0, 0.0, 0.0)
    (x0, y0), (x1, y1) = panel.vertices.min(axis=0), panel.vertices.max(axis=0)
    x, y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    middles = panel.placement.apply(np.array([[x, y0], [x, y1], [x0, y], [x1, y]]))
    highest = middles[int(np.argmax(middles[:, 1]))]
    return (float(highest[0]), float(highest[1]), float(highest[2]))


def _runs(
    items: Sequence[tuple[tuple[float, float, float], str]], axis: int
) -> list[list[tuple[tuple[float, float, float], str]]]:
    """Sorted items in runs; a run ends before the first item further than ``NEIGHBOURS`` from its beginning."""
    runs: list[list[tuple[tuple[float, float, float], str]]] = []
    for item in items:
        if runs and item[0][axis] - runs[-1][0][0][axis] < NEIGHBOURS:
            runs[-1].append(item)
        else:
            runs.append([item])
    return runs


def pattern_name(path: Path | str) -> str:
    """The name of the pattern in a file: the file's, or its folder's for a plain ``specification.json``."""
    path = Path(path)
    if path.stem in NAMELESS:
        return path.resolve().parent.name
    return path.stem.removesuffix("_specification")
