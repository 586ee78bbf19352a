"""The contents of a display of one garment: frozen arrays and texts, the same for every front end."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from gcd_dataset.bodies import Wearer
from gcd_dataset.errors import BodyError, GcdError
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.outfits import joined
from gcd_dataset.records import (
    ANGLES,
    Body,
    BoxMesh,
    Drape,
    GarmentMotion,
    Grade,
    Measurements,
    Outcome,
    Outfit,
    Pattern,
    Pose,
    Record,
    Sample,
)

Rows = tuple[tuple[str, str], ...]
"""Names and values of a table."""
SPEC_SPACING = 2.0  # cm, of the mesh of a specification file
TINY = 0.01  # cm: least radius that has a size class of its own
PARALLEL = 1e-12  # cm³: least volume of edge and face for a crossing


@dataclass(frozen=True, eq=False)
class Content(Record):
    """One garment for display: pattern, mesh, drape and body as far as there are any, and tables of texts."""

    title: str
    pattern: Pattern
    mesh: BoxMesh | None = None
    draped: Float[np.ndarray, "v 3"] | None = None
    """Positions at rest [cm], in the order of the mesh."""
    body: Body | None = None
    motion: GarmentMotion | None = None
    """The garment on its body in motion; ``draped`` and ``body`` are those of the first frame."""
    body_motion: Float[np.ndarray, "t w 3"] | None = None
    """Positions of the body in each frame of ``motion`` [cm]; ``None`` if it is not the motion's."""
    layers: tuple[int, ...] = ()
    """Number of panels of each garment of an outfit, from the skin outwards; the pattern, the mesh and the drape are
    those of all garments."""
    values: Mapping[str, Float[np.ndarray, " v"]] = field(default_factory=dict)
    """``stretch``, the larger principal stretch, of a drape; of one with maps also ``gap`` and ``pressure``."""
    crossed: Int[np.ndarray, " n"] | None = None
    """Ends of the mesh edges that cross the cloth or the body; ``None`` without a drape."""
    caption: str = ""
    """A line for each level of detail."""
    views: tuple[bytes, ...] = ()
    """Stored pictures, JPEG."""
    tags: tuple[str, ...] = ()
    outcome: Outcome | None = None
    grade: Grade | None = None
    tables: Mapping[str, Rows] = field(default_factory=dict)
    """Title to rows: outcome, measures, design, recipe."""


def content_of(subject: Sample | Pattern, body: Body | None = None, *, wearer: Wearer | None = None) -> Content:
    """The content of a sample, or of a pattern alone, which is placed round a body and meshed at 2 cm.

    ``body``: of a sample; by default the body of its shape weights, if they are of this package's body model.
    ``wearer``: of a pattern; by default the neutral body. A pattern that cannot be meshed has no mesh.
    """
    return _of_pattern(subject, wearer or _neutral) if isinstance(subject, Pattern) else _of_sample(subject, body)


def crossing_vertices(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], body: Body | None = None
) -> Int[np.ndarray, " n"]:
    """Ends of the mesh edges that cross another face of the cloth, or a face of the body; each vertex once."""
    edges = mesh_edges(faces).ends
    hit = _crossing_edges(vertices, edges, vertices, faces, sharing=True)
    if body is not None:
        hit |= _crossing_edges(vertices, edges, body.vertices, body.faces, sharing=False)
    return np.unique(edges[hit])


def _of_sample(sample: Sample, body: Body | None) -> Content:
    outfit, sample = sample.outfit, joined(sample)
    mesh, drape = sample.box_mesh, sample.drape
    moving = None if body or not sample.motion or not sample.motion.poses else _moving_body(sample, sample.motion.poses)
    body = body or body_of(sample)
    is_finite = drape is not None and bool(np.isfinite(drape.vertices).all())
    return Content(
        title=sample.key,
        pattern=sample.pattern,
        mesh=mesh,
        draped=drape.vertices if drape is not None and is_finite else None,
        body=body,
        motion=sample.motion if sample.motion and sample.motion.poses else None,
        body_motion=moving,
        values=_values(sample) if is_finite else {},
        crossed=_crossed(mesh, drape, body) if is_finite else None,
        caption=sample.caption or "",
        views=tuple(view.picture for view in sample.views if view.picture),
        tags=sample.tags,
        outcome=None if drape is None else drape.outcome,
        grade=sample.grade,
        layers=tuple(len(garment.pattern.panels) for garment in (outfit.garments if outfit else ())),
        tables={
            "Outfit": tuple(_outfit_rows(outfit)) if outfit else (),
            "Outcome": tuple(_outcome_rows(sample)),
            "Measures": tuple(
                (name, f"{value:.1f} {'°' if name in ANGLES else 'cm'}")
                for name, value in sample.measurements.to_file_values().items()
            ),
            "Design": tuple(_flat(sample.design)),
            "Recipe": tuple(_recipe_rows(sample)),
        },
    )


def body_of(sample: Sample) -> Body | None:
    """The body of the sample's shape weights; ``None`` without weights of this package's body model."""
    from gcd_dataset.generator.body import build_body

    try:
        return None if sample.shape is None else build_body(sample.shape, name=sample.provenance.body_name)
    except BodyError:  # weights of another body model
        return None


def _moving_body(sample: Sample, poses: Sequence[Pose]) -> Float[np.ndarray, "t w 3"] | None:
    from gcd_dataset.generator.body import pose_body

    home = None if sample.shape is None else body_of(replace(sample, shape=replace(sample.shape, pose=None)))
    return None if home is None else np.stack([pose_body(home, pose).vertices for pose in poses])


def _of_pattern(pattern: Pattern, wearer: Wearer) -> Content:
    from gcd_dataset.generator.dressing import dress
    from gcd_dataset.generator.dressing.hold_edges import has_legs
    from gcd_dataset.generator.mesh import build_box_mesh

    body, measurements = wearer(has_legs(pattern))
    counts = (("panels", str(len(pattern.panels))), ("seams", str(len(pattern.seams))))
    tables = {"Pattern": counts, "Design": tuple(_flat(pattern.extra.get("parameters") or {}))}
    try:
        pattern = dress(pattern, body, measurements).pattern
        mesh = build_box_mesh(pattern, spacing=SPEC_SPACING)
    except GcdError:
        return Content(pattern.name, pattern, tables=tables)
    return Content(pattern.name, pattern, mesh, body=body, tables=tables)


@cache
def _neutral(legs_apart: bool) -> tuple[Body, Measurements]:
    from gcd_dataset.generator.body import named_body

    body, measurements, _ = named_body("neutral", legs_apart=legs_apart)
    return body, measurements


def vertex_stretch(mesh: BoxMesh, vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, " v"]:
    """The larger principal stretch of each vertex: the mean over its faces."""
    from gcd_dataset.generator.quality import principal_stretches

    corners, stretch = mesh.faces.ravel(), principal_stretches(mesh, vertices)[:, 0]
    sums, counts = (np.bincount(corners, weights, len(vertices)) for weights in (np.repeat(stretch, 3), None))
    return sums / np.maximum(counts, 1)


def _values(sample: Sample) -> dict[str, Float[np.ndarray, " v"]]:
    if sample.maps is not None:
        return {**sample.maps.by_vertex, "stretch": sample.maps.stretch[:, 0]} if sample.maps.is_known else {}
    mesh, drape = sample.box_mesh, sample.drape
    return {} if mesh is None or drape is None else {"stretch": vertex_stretch(mesh, drape.vertices)}


def _crossed(mesh: BoxMesh | None, drape: Drape | None, body: Body | None) -> Int[np.ndarray, " n"] | None:
    if mesh is None or drape is None:
        return None
    if drape.self_crossings == drape.body_crossings == drape.body_through == 0:
        return np.zeros(0, int)
    return crossing_vertices(np.asarray(drape.vertices, float), mesh.faces, body)


def _outfit_rows(outfit: Outfit) -> Iterator[tuple[str, str]]:
    """How each garment is worn, and how each two lie."""
    for number, garment in enumerate(outfit.garments):
        ways = ["tucked"] * garment.tucked + ["worn open"] * (not garment.closed)
        drape = "" if garment.drape is None else garment.drape.outcome.name.lower().replace("_", " ")
        fabric = "" if garment.fabric is None else garment.fabric.name
        yield f"garment {number}", ", ".join(filter(None, [garment.pattern.name, *ways, drape, fabric]))
    for layer in outfit.layers:
        order = f"{layer.wrong_order:.2%} of {layer.covered} covered vertices in wrong order"
        yield f"{layer.outer} over {layer.inner}", f"{layer.crossings} crossings, {order}"


def _outcome_rows(sample: Sample) -> Iterator[tuple[str, str]]:
    drape = sample.drape
    if sample.grade is not None:
        yield "grade", sample.grade.value
    if drape is not None:
        yield "outcome", f"{drape.outcome.name.lower().replace('_', ' ')}: {drape.outcome.value}"
        yield "frames", str(drape.frames)
        yield "edges through the cloth", str(drape.self_crossings)
        yield "edges through the body", str(drape.body_crossings)
        if drape.body_through >= 0:
            yield "body edges through the cloth", str(drape.body_through)
        yield "stretch, median and 99 %", f"{drape.stretch_median:.3f}, {drape.stretch_p99:.3f}"
    if drape is not None and drape.strain is not None:
        largest, smallest = drape.strain.principal
        yield "principal stretch", f"{smallest:.3f} to {largest:.3f}"
    if (fit := sample.fit) is not None:
        yield "cut for", f"size {fit.cut_for}, the wearer's {fit.wearer_size} {fit.step:+d}, of chart {fit.chart}"
        yield from ((label.rule.replace("_", " "), label.reason) for label in fit.labels)
    if sample.box_mesh is not None:
        yield "vertices", str(len(sample.box_mesh.vertices))
        yield "faces", str(len(sample.box_mesh.faces))
    yield "panels", str(len(sample.pattern.panels))
    yield "seams", str(len(sample.pattern.seams))
    if sample.fabric is not None:
        yield "fabric", sample.fabric.name
        yield from _flat(sample.fabric.parameters)


def _recipe_rows(sample: Sample) -> Iterator[tuple[str, str]]:
    made = sample.provenance
    yield "seed", str(made.seed)
    yield "index", str(made.index)
    yield "body", made.body_name or "unknown"
    if sample.shape and sample.shape.pose:
        yield "pose", sample.shape.pose.name
    if made.source:
        yield "source", made.source
    yield "attempts", str(made.attempts)
    for number, reason in enumerate(made.rejects, 1):
        yield f"reject {number}", reason
    yield from ((f"redraws: {rule}", str(count)) for rule, count in made.redraws.items())
    yield from _flat(made.recipe)
    yield from _flat(made.versions)


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested values as dotted names and texts; of a parameter with its range, as in design files, the value."""
    for name, value in values.items():
        if isinstance(value, Mapping) and "v" in value and ("range" in value or "type" in value):
            yield f"{prefix}{name}", _text(value["v"])
        elif isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", _text(value)


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_text, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value is None else str(value)


def _crossing_edges(
    vertices: Float[np.ndarray, "v 3"],
    edges: Int[np.ndarray, "e 2"],
    corners: Float[np.ndarray, "w 3"],
    faces: Int[np.ndarray, "f 3"],
    *,
    sharing: bool,
) -> np.ndarray:
    """Whether each edge crosses a face; ``sharing``: faces that share a vertex with the edge do not count.

    The broad phase compares bounding spheres, by classes of similar size: a few long edges must not widen the search
    for all others.
    """
    start, end = vertices[edges[:, 0]], vertices[edges[:, 1]]
    triangles = corners[faces]
    centres = triangles.mean(axis=1)
    reach = np.linalg.norm(triangles - centres[:, None], axis=2).max(axis=1)
    middles, half = 0.5 * (start + end), 0.5 * np.linalg.norm(end - start, axis=1)
    hit = np.zeros(len(edges), bool)
    for edge, face in _near_pairs(middles, half, centres, reach):
        if sharing:
            apart = (edges[edge][:, :, None] != faces[face][:, None, :]).all(axis=(1, 2))
            edge, face = edge[apart], face[apart]
        hit[edge[_cross(start[edge], end[edge], triangles[face])]] = True
    return hit


def _near_pairs(
    one: Float[np.ndarray, "n 3"],
    one_radius: Float[np.ndarray, " n"],
    other: Float[np.ndarray, "m 3"],
    other_radius: Float[np.ndarray, " m"],
) -> Iterator[tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]]:
    """Pairs of spheres that touch, by classes of radii within a factor of 2."""
    others = [(own, cKDTree(other[own]), other_radius[own].max()) for own in _size_classes(other_radius)]
    for rows in _size_classes(one_radius):
        tree, radius = cKDTree(one[rows]), one_radius[rows].max()
        for columns, other_tree, largest in others:
            near = tree.sparse_distance_matrix(other_tree, radius + largest, output_type="ndarray")
            i, j = rows[near["i"]], columns[near["j"]]
            touch = near["v"] <= one_radius[i] + other_radius[j]
            yield i[touch], j[touch]


def _size_classes(radius: Float[np.ndarray, " n"]) -> list[Int[np.ndarray, " k"]]:
    """Rows of similar radius; radii below 0.1 mm are one class."""
    classes = np.ceil(np.log2(np.maximum(radius, TINY))).astype(int)
    return [np.flatnonzero(classes == number) for number in np.unique(classes)]


def _cross(
    start: Float[np.ndarray, "n 3"], end: Float[np.ndarray, "n 3"], triangles: Float[np.ndarray, "n 3 3"]
) -> np.ndarray:
    """Whether each segment crosses its triangle (Möller and Trumbore 1997)."""
    along, u, v = end - start, triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p, t = np.cross(along, v), start - triangles[:, 0]
    q = np.cross(t, u)
    volume = (u * p).sum(axis=1)
    safe = np.where(np.abs(volume) > PARALLEL, volume, np.inf)
    a, b, s = (t * p).sum(axis=1) / safe, (along * q).sum(axis=1) / safe, (v * q).sum(axis=1) / safe
    return (np.abs(volume) > PARALLEL) & (a >= 0) & (b >= 0) & (a + b <= 1) & (s >= 0) & (s <= 1)
