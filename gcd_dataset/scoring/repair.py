"""Specification files as published models write them, repaired so far that they can be read and scored.

NeuralTailor, SewFormer, SewingLDM and AIpparel write patterns in the format of Korosteleva and Lee (2021) or of
GarmentCode. Curvature without a type, missing units and missing labels are read by ``gcd_dataset.spec``; this module
mends what networks add: outlines that do not close, seams to edges that are not there, a panel order with gaps.
"""

from collections.abc import Mapping, Sequence
from math import dist
from typing import Any

from gcd_dataset.errors import PatternError
from gcd_dataset.jsonfile import JsonPath, whole
from gcd_dataset.records import Pattern
from gcd_dataset.spec import pattern_from_spec


def read_prediction(spec: Any, name: str, *, source: str = "") -> tuple[Pattern, tuple[str, ...]]:
    """The pattern of a parsed specification after repairs, and one remark for each; see ``repaired``.

    Raises ``SpecError`` for what is no specification, and ``PatternError`` for one without a panel.
    """
    mended, remarks = repaired(spec, source=source or name)
    pattern = pattern_from_spec(mended, name, source=source)
    if not pattern.panels:
        raise PatternError(f"{source or name}: no panel with an edge: the model predicted nothing; leave it out")
    return pattern, remarks


def repaired(spec: Any, *, source: str = "specification") -> tuple[Mapping[str, Any], tuple[str, ...]]:
    """The specification with these repairs, and a remark for each.

    - Panels without an edge are left out.
    - An outline that ends elsewhere than it starts gets one straight edge more, as NeuralTailor counts it.
    - An arc too small for its chord becomes a half circle.
    - Seams to a missing panel or edge are left out, with their closures.
    - The panel order names every panel once; empty places in it are left out.

    Raises ``SpecError`` for a file without panels.
    """
    at = JsonPath(source)
    at.require_flat(spec)
    whole = dict(at.mapping(spec, ""))
    body = dict(at.mapping(whole.get("pattern"), "pattern"))
    entries = {
        key: dict(at.mapping(entry, f"panel {key}"))
        for key, entry in at.mapping(body.get("panels"), "pattern.panels").items()
    }
    remarks = [f"panel {key}: no edge: left out" for key, entry in entries.items() if not entry.get("edges")]
    panels = {key: entry for key, entry in entries.items() if entry.get("edges")}
    for key, entry in panels.items():
        within = at.within(f"panel {key}")
        entry["edges"] = [
            dict(within.mapping(edge, f"edge {i}")) for i, edge in enumerate(within.list_of(entry, "edges"))
        ]
        remarks += [f"panel {key}: {fault}" for fault in _mend_panel(entry)]
    stitches = at.list_of(body, "stitches") if body.get("stitches") is not None else []
    kept = [stitch for stitch in stitches if _joins(stitch, panels)]
    if len(kept) < len(stitches):
        remarks.append(f"{len(stitches) - len(kept)} of {len(stitches)} seams to missing edges: left out")
    body |= {"panels": panels, "stitches": kept}
    if len(kept) < len(stitches) and body.get("closures") is not None:
        closed = [(first["panel"], first["edge"]) for first, *_ in kept]
        body["closures"] = [
            entry
            for entry in at.list_of(body, "closures")
            if not isinstance(entry, Mapping) or (entry.get("panel"), entry.get("edge")) in closed
        ]
    if (order := body.get("panel_order")) is not None:
        given = [name for name in at.list_of(body, "panel_order") if isinstance(name, str) and name in panels]
        body["panel_order"] = list(dict.fromkeys((*given, *panels)))
        if body["panel_order"] != order:
            remarks.append("panel_order: did not name every panel once: completed")
    return whole | {"pattern": body}, tuple(remarks)


def _mend_panel(entry: dict[str, Any]) -> list[str]:
    """Close the outline and enlarge arcs in place. Returns the remarks."""
    remarks = []
    edges: list[dict[str, Any]] = entry["edges"]
    for index, edge in enumerate(edges):
        if _too_small(edge, entry.get("vertices")):
            remarks.append(f"edge {index}: its arc is too small for its chord: made a half circle")
    first, last = _end(edges[0], 0), _end(edges[-1], 1)
    if first is not None and last is not None and first != last:
        edges.append({"endpoints": [last, first]})
        remarks.append("its outline does not close: closed by a straight edge")
    return remarks


def _too_small(edge: dict[str, Any], vertices: Any) -> bool:
    """Whether the edge is an arc with a radius under half its chord, which is then set to that."""
    curve, start, end = edge.get("curvature"), _end(edge, 0), _end(edge, 1)
    if not (isinstance(curve, dict) and curve.get("type") == "circle" and isinstance(vertices, list)):
        return False
    if start is None or end is None:
        return False
    try:
        radius, *flags = curve["params"]
        half = 0.5 * dist(vertices[start], vertices[end])
        if not radius < half:
            return False
    except (TypeError, ValueError, IndexError, KeyError):
        return False  # the reader reports it
    edge["curvature"] = curve | {"params": [half, *flags]}
    return True


def _end(edge: Mapping[str, Any], side: int) -> int | None:
    ends = edge.get("endpoints")
    return whole(ends[side]) if isinstance(ends, list) and len(ends) == 2 else None


def _joins(stitch: Any, panels: Mapping[str, Mapping[str, Sequence[Any]]]) -> bool:
    """Whether both sides of a stitch name an edge that is there."""
    sides = stitch[:2] if isinstance(stitch, list) else []
    return len(sides) == 2 and all(
        isinstance(side, Mapping)
        and isinstance(side.get("panel"), str)
        and side["panel"] in panels
        and (edge := whole(side.get("edge"))) is not None
        and 0 <= edge < len(panels[side["panel"]]["edges"])
        for side in sides
    )
