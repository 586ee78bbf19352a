"""One garment as a single HTML file: pattern beside mesh, without any reference to a server or another file.

The arrays are quantised to 16 bits, as differences, in byte planes, deflated, in base64; the page's own script
decodes them. All texts of the data are escaped, and the page's policy allows no script but its own.
"""

import base64
import hashlib
import zlib
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from html import escape
from itertools import accumulate
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from gcd_dataset.curves import signed_area
from gcd_dataset.generator.lay_plan import PALETTE, PLAIN_EDGE, LayPlan, SheetPanel, lay_out, seam_colour
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import MOTION_STEP, BoxMesh, EdgeRef, GarmentMotion, Outcome, Pattern
from gcd_dataset.viewer.content import Content
from gcd_dataset.viewer.maps import SCALES
from gcd_dataset.viewer.notebook import asset, inline_svg, picture, script_data, table

SCRIPTS = ("geometry.js", "scale.js", "garment.js", "picture.js", "page.js")
LEVELS = 65535  # steps of a quantised coordinate: 0.003 cm for a garment of 2 m
DENSE = 0.25  # cm between points of an outline
COMPRESSION = 6  # of zlib: level 9 takes three times as long and saves 0.3 %
KEPT_MESHES = 2  # bodies' faces, packed
LIGHTENING = 0.15  # share of white in the colours of panels
FOOTER = (
    "Drag to turn the garment, right button or two fingers to move it, wheel or pinch to zoom either view. A click "
    "keeps a part lit, Escape lets it go."
)
HINT = "Point at a panel or a seam"


def page_of(content: Content, *, maps: bool = False) -> str:
    """The page as HTML text, to write as UTF-8; with ``maps`` it opens in the colours of stretch."""
    mesh, plan = content.mesh, lay_out(content.pattern)
    script = "".join(map(asset, SCRIPTS))
    parts = {
        "title": escape(content.title),
        "headline": _headline(content),
        "main_class": "" if mesh is not None else ' class="alone"',
        "hint": HINT,
        "parts": _part_options(content.pattern),
        "pattern": inline_svg(content.pattern, 'role="group" aria-label="Panels"', plan),
        "view": "" if mesh is None else _view(content),
        "pictures": _pictures(content),
        "tables": "".join(_table(title, rows) for title, rows in content.tables.items() if rows),
        "footer": FOOTER,
        "style": asset("page.css"),
        "data": script_data({**_data(content, plan), "colours": "stretch" if maps and content.values else "panels"}),
        "script": script,
        "script_hash": f"sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}",
    }
    return _filled(asset("page.html"), parts)


def _filled(template: str, parts: Mapping[str, str]) -> str:
    """The template with each ``{{name}}`` replaced once; the inserted texts are not searched again."""
    pieces = template.split("{{")
    tails = (piece.partition("}}") for piece in pieces[1:])
    return pieces[0] + "".join(parts[name] + rest for name, _, rest in tails)


def _headline(content: Content) -> str:
    caption = f'    <p class="caption">{escape(content.caption)}</p>\n' if content.caption else ""
    badge = ""
    if content.outcome is not None:
        style = "good" if content.outcome is Outcome.SETTLED else "warn"
        badge = f'<li class="{style}">{content.outcome.name.lower().replace("_", " ")}</li>'
    tags = badge + "".join(f"<li>{escape(tag)}</li>" for tag in content.tags)
    return caption + (f'    <ul class="tags">{tags}</ul>\n' if tags else "")


def _part_options(pattern: Pattern) -> str:
    panels = "".join(_option(f"panel:{i}", panel.name) for i, panel in enumerate(pattern.panels))
    seams = "".join(
        _option(f"seam:{i}", f"{i}: {seam.left.panel} – {seam.right.panel}") for i, seam in enumerate(pattern.seams)
    )
    return f'        <optgroup label="Panels">{panels}</optgroup>\n        <optgroup label="Seams">{seams}</optgroup>\n'


def _option(value: str, text: str) -> str:
    return f'<option value="{value}">{escape(text)}</option>'


def _view(content: Content) -> str:
    stages = ("Flat", "Placed", "Draped")[: 2 if content.draped is None else 3]
    parts = {
        "scales": "".join(map(_choice, content.values)),
        "no_crossings": "" if content.crossed is not None else " disabled",
        "body_switch": ""
        if content.body is None
        else '      <label class="check"><input type="checkbox" id="body" checked>Body</label>\n',
        "legends": "".join(map(_legend, content.values)),
        "crossings": '<i class="dot"></i>cloth that crosses itself or the body'
        if content.crossed is not None and len(content.crossed)
        else "the cloth crosses neither itself nor the body",
        "stops": "".join(f'<button type="button" data-stage="{i}">{name}</button>' for i, name in enumerate(stages)),
        "layers": _layers(content) if content.layers else _frames(content.motion) if content.motion else "",
    }
    return _filled(asset("view.html"), parts)


def _layers(content: Content) -> str:
    """The slider that takes off the garments of an outfit, the outermost first."""
    count = len(content.layers)
    stops = (f'<button type="button" data-layer="{number + 1}">garment {number}</button>' for number in range(count))
    options = f'min="1" max="{count}" step="1" value="{count}" aria-label="Garments from the skin outwards"'
    bar = f'<input type="range" id="layers" {options}>'
    return f'      <div class="slider">{bar}<div class="stops">{"".join(stops)}</div></div>\n'


def _frames(motion: GarmentMotion) -> str:
    """The slider over the frames of a motion, and the button that plays them."""
    bar = f'<input type="range" id="motion" max="{len(motion.poses) - 1}" value="0" aria-label="Frame">'
    button = '<button type="button" id="play" aria-pressed="false">play</button>'
    return f'      <div class="slider">{bar}<div class="stops">{button}</div></div>\n'


def _choice(name: str) -> str:
    choice = f'<input type="radio" name="colours" value="{name}"><span>{name.capitalize()}</span>'
    return f"        <label>{choice}</label>\n"


def _legend(name: str) -> str:
    scale = SCALES[name]
    ramp = ",".join("rgb({},{},{})".format(*colour) for colour in scale.colours[::32])
    bar = f'<i class="ramp" style="background:linear-gradient(90deg,{ramp})"></i>'
    marks = "".join(f"<span>{mark}</span>" for mark in scale.marks)
    text = f'{scale.title}{bar}<span class="ends">{marks}</span>'
    return f'      <div class="legend" data-legend="{name}" hidden>{text}</div>\n'


def _pictures(content: Content) -> str:
    """The stored views; empty without any."""
    if not content.views:
        return ""
    images = "".join(picture(view, f"view {number}") for number, view in enumerate(content.views))
    head = '<div class="strip"><h2>Pictures</h2></div>'
    return f'<section class="card pictures" aria-label="Pictures">{head}<div>{images}</div></section>\n'


def _table(title: str, rows: Sequence[tuple[str, Any]]) -> str:
    return (
        f'<section class="card"><div class="strip"><h2>{escape(title)}</h2></div>'
        f'<div class="scroll" tabindex="0">{table(rows, breaks=True)}</div></section>\n'
    )


def _data(content: Content, plan: LayPlan) -> dict[str, Any]:
    return {
        "panels": [_panel_data(piece) for piece in plan.panels],
        "seams": list(_seam_data(content.pattern)),
        "plainEdge": PLAIN_EDGE,
        "layers": list(accumulate(content.layers)),
        "mesh": None if content.mesh is None else _mesh_data(content, content.mesh, plan),
        "body": None
        if content.body is None
        else {
            "vertices": _coordinates(content.body.vertices),
            "motion": None if content.body_motion is None else _moving(content.body_motion),
            "faces": _packed_faces(np.asarray(content.body.faces, np.int32).tobytes()),
        },
    }


def _panel_data(piece: SheetPanel) -> dict[str, Any]:
    colour = [round(255 * (part + LIGHTENING * (1.0 - part))) for part in PALETTE[piece.number % len(PALETTE)]]
    label = f" · {piece.panel.label}" if piece.panel.label else ""
    return {
        "text": f"{piece.panel.name}{label} · {abs(signed_area(piece.outline)):.0f} cm²",
        "colour": colour,
        "shift": piece.shift.round(4).tolist(),
        "turn": Rotation.from_matrix(piece.panel.placement.matrix).as_rotvec().round(6).tolist(),
    }


def _seam_data(pattern: Pattern) -> Iterator[dict[str, Any]]:
    number = {panel.name: i for i, panel in enumerate(pattern.panels)}
    lengths = {panel.name: panel.lengths() for panel in pattern.panels}
    for i, (seam, ratio) in enumerate(zip(pattern.seams, pattern.gather_ratios(), strict=True)):
        sides = [_side(ref, lengths.get(ref.panel, [])) for ref in (seam.left, seam.right)]
        gathers = "" if 0.98 < ratio < 1.02 else f" · gathered {max(ratio, 1 / ratio):.2f} : 1"
        part = "" if seam.joined in ((0.0, 0.0), (0.0, 1.0)) else " from {:.0%} to {:.0%}".format(*seam.joined)
        closure = "" if seam.is_plain else f" · {seam.closure}{part}"
        yield {
            "text": f"seam {i} · {sides[0]} to {sides[1]}{gathers}{closure}",
            "colour": seam_colour(i),
            "panels": [number.get(ref.panel, -1) for ref in (seam.left, seam.right)],
        }


def _side(ref: EdgeRef, lengths: Sequence[float]) -> str:
    """One side of a seam in words; an unchecked pattern may name an edge that it lacks."""
    return f"{ref.panel} {lengths[ref.edge]:.1f} cm" if 0 <= ref.edge < len(lengths) else f"{ref.panel}, no such edge"


def _mesh_data(content: Content, mesh: BoxMesh, plan: LayPlan) -> dict[str, Any]:
    number = {panel.name: i for i, panel in enumerate(content.pattern.panels)}
    panel_of = np.array([number[name] for name in mesh.panel_names])[mesh.panel_of_row]
    segments, seams = _segments(mesh, panel_of, plan)
    return {
        "flat": _coordinates(mesh.uv),
        "placed": _coordinates(mesh.vertices),
        "draped": None if content.draped is None else _coordinates(content.draped),
        "motion": None if content.motion is None else _moving(content.motion.vertices),
        "fps": 0.0 if content.motion is None else content.motion.fps,
        "corners": _packed(mesh.corners),
        "vertexOf": _packed(mesh.uv_vertex[:, None]),
        "panelOf": _packed(panel_of[:, None]),
        "segments": _packed(segments),
        "segmentSeam": _packed(seams[:, None]),
        "values": {
            name: {
                "of": _coordinates(values[:, None]),
                "low": SCALES[name].low,
                "high": SCALES[name].high,
                "colours": _packed(SCALES[name].colours),
            }
            for name, values in content.values.items()
        },
        "crossed": None if content.crossed is None else _packed(np.asarray(content.crossed)[:, None]),
        "sheetSize": [round(plan.width, 3), round(plan.height, 3)],
        "floor": None if content.body is None else float(content.body.vertices[:, 1].min()),
    }


def _segments(
    mesh: BoxMesh, panel_of: Int[np.ndarray, " c"], plan: LayPlan
) -> tuple[Int[np.ndarray, "n 2"], Int[np.ndarray, " n"]]:
    """Mesh edges along the outlines of all panels, as pairs of corners, and the seam of each; sorted by seam.

    Edges without a seam have the number of seams.
    """
    edges = mesh_edges(mesh.corners)
    pairs = edges.ends[edges.counts == 1]
    free = 1 + max((seam for piece in plan.panels for seam in piece.seams if seam is not None), default=-1)
    seams = np.full(len(pairs), free)
    middles = mesh.uv[pairs].mean(axis=1)
    for piece in plan.panels:
        own = np.flatnonzero(panel_of[pairs[:, 0]] == piece.number)
        lines = [_dense(piece.edge_points(index)) for index in range(len(piece.seams))]
        edge_of = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
        if len(own):
            _, nearest = cKDTree(np.concatenate(lines)).query(middles[own])
            of_edge = np.array([free if seam is None else seam for seam in piece.seams])
            seams[own] = of_edge[edge_of[nearest]]
    order = np.argsort(seams, kind="stable")
    return pairs[order], seams[order]


def _dense(line: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 2"]:
    """Points along a polyline at most ``DENSE`` apart, without its ends, which belong to two edges."""
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    count = max(3, int(np.ceil(along[-1] / DENSE)))
    at = (np.arange(count) + 0.5) / count * along[-1]
    return np.stack([np.interp(at, along, line[:, 0]), np.interp(at, along, line[:, 1])], axis=1)


def _moving(frames: Float[np.ndarray, "t v 3"]) -> dict[str, Any]:
    """All frames of one vertex after the other: neighbouring rows are alike."""
    return _coordinates(frames.transpose(1, 0, 2).reshape(-1, 3), finest=MOTION_STEP / 2)


def _coordinates(points: Float[np.ndarray, "n k"], *, finest: float = 1e-6) -> dict[str, Any]:
    """Points as integers, with offset of each column and step [cm]. Points that are not finite go to the centroid."""
    points = np.asarray(points, float)
    finite = np.isfinite(points).all(axis=1)
    points = np.where(finite[:, None], points, points[finite].mean(axis=0) if finite.any() else 0.0)
    low = points.min(axis=0, initial=np.inf)
    step = max(float((points - low).max(initial=0.0)) / LEVELS, finest)
    return {**_packed(np.round((points - low) / step).astype(int)), "low": low.tolist(), "step": step}


@lru_cache(KEPT_MESHES)  # all bodies of a model share their faces
def _packed_faces(faces: bytes) -> dict[str, Any]:
    return _packed(np.frombuffer(faces, np.int32).reshape(-1, 3))


def _packed(values: Int[np.ndarray, "n k"]) -> dict[str, Any]:
    """Integers ≥ 0 as differences between rows, by byte planes, deflated, in base64."""
    rows = np.asarray(values)
    size = 2 if rows.max(initial=0) <= LEVELS else 4
    steps = np.diff(rows.astype(np.int64), axis=0, prepend=0).astype(f"<u{size}").ravel()
    planes = steps.view(np.uint8).reshape(-1, size).T.tobytes()
    return {
        "size": size,
        "columns": rows.shape[1],
        "data": base64.b64encode(zlib.compress(planes, COMPRESSION)).decode(),
    }
