"""The geometry of a picture: a draped garment on its body, with the points whose pixels are wanted."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int, Int32, UInt8

from gcd_dataset.errors import ConfigError
from gcd_dataset.outfits import joined
from gcd_dataset.records import NO_MESH, Body, BoxMesh, PanelRole, Pattern, Record, Sample


class HairStyle(IntEnum):
    """Shape of the hair: a shell over the scalp of the body model."""

    NONE = 0
    CROPPED = 1
    SHORT = 2
    FULL = 3


@dataclass(frozen=True, eq=False)
class Scene(Record):
    """A garment on a body. Axes and units as everywhere: cm, y up, the wearer faces +z, soles at y = 0."""

    vertices: Float[np.ndarray, "v 3"]
    """Positions of the garment [cm]."""
    faces: Int[np.ndarray, "f 3"]
    """Triangles of the garment, counter-clockwise on its outside."""
    uv: Float[np.ndarray, "c 2"]
    """Panel-plane coordinates [cm] of the seam-split vertices; the second axis is the grain (warp)."""
    corners: Int[np.ndarray, "f 3"]
    """Rows of ``uv`` at each face's corners."""
    uv_vertex: Int[np.ndarray, " c"]
    """Vertex of each row of ``uv``."""
    panel_id: Int[np.ndarray, " f"]
    """Row of ``panel_names`` for each face."""
    panel_names: tuple[str, ...]
    panel_labels: tuple[PanelRole | str, ...]
    seams: Int[np.ndarray, "s 2"]
    """Pairs (vertex, row of the pattern's seams)."""
    body: Body
    panel_corners: Int[np.ndarray, "k 2"] = field(default_factory=lambda: np.zeros((0, 2), int))
    """(panel, corner): the panel corners that the mesh holds, as rows of ``panel_names`` and of ``Panel.vertices``."""
    corner_rows: Int[np.ndarray, " k"] = field(default_factory=lambda: np.zeros(0, int))
    """Row of ``uv`` at each of ``panel_corners``."""
    landmarks: Mapping[str, Float[np.ndarray, "3"]] = field(default_factory=dict)
    """Landmarks of the body by name [cm]."""
    hair: HairStyle = HairStyle.NONE
    values: Mapping[str, Float[np.ndarray, "v *channels"]] = field(default_factory=dict)
    """``stretch``, ``gap`` and ``pressure`` of each vertex, as in ``records.Maps``, for the maps of these names."""

    @property
    def parts(self) -> UInt8[np.ndarray, " v"]:
        """``BodyPart`` value of each vertex of the body."""
        return self.body.parts

    def bounds(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Lowest and highest corner of the box round body and garment [cm]."""
        return self._box

    @cached_property
    def panel_of_row(self) -> Int[np.ndarray, " c"]:
        """Row of ``panel_names`` for each row of ``uv``; 0 for a row without a face."""
        return np.maximum(_panel_of_row(self), 0)

    @cached_property
    def garment_points(self) -> Float[np.ndarray, "3 n"]:
        """Every fifth vertex of the garment, in rows of x, y and z [cm]."""
        return np.ascontiguousarray(self.vertices[::5].T, float)

    @cached_property
    def figure_points(self) -> Float[np.ndarray, "3 n"]:
        """Every fifth vertex of the garment and of the body, in rows of x, y and z [cm]."""
        return np.concatenate([self.garment_points, self.body.vertices[::5].T], axis=1)

    @cached_property
    def keypoints(self) -> Float[np.ndarray, "n 3"]:
        """Key points of the body in the order of ``COCO_KEYPOINTS`` [cm]; no rows for a body with another mesh."""
        from gcd_dataset.generator.body.keypoints import keypoints_of

        found = keypoints_of(self.body)
        return np.zeros((0, 3)) if found is None else found

    @cached_property
    def _box(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        # C-ordered rows: NumPy reduces them 20 times as fast as columns.
        points = [mesh.T.astype(float, order="C") for mesh in (self.vertices, self.body.vertices) if len(mesh)]
        return np.min([p.min(axis=1) for p in points], axis=0), np.max([p.max(axis=1) for p in points], axis=0)


def scene_of(
    mesh: BoxMesh,
    vertices: Float[np.ndarray, "v 3"],
    body: Body,
    *,
    pattern: Pattern | None = None,
    hair: HairStyle = HairStyle.NONE,
) -> Scene:
    """The scene of a garment at ``vertices`` [cm] on ``body``; with ``pattern``, its panel corners are found.

    Landmarks are those of the body model; a body with another mesh has none. Raises ``ConfigError`` where ``vertices``
    are not those of ``mesh``, or not finite.
    """
    if vertices.shape != mesh.vertices.shape:
        raise ConfigError(f"{len(vertices)} positions for a mesh of {len(mesh.vertices)} vertices: give one for each")
    if not np.isfinite(vertices).all():
        raise ConfigError("some positions of the garment are not numbers: its drape diverged; leave it out")
    scene = Scene(
        vertices=vertices,
        faces=mesh.faces,
        uv=mesh.uv,
        corners=mesh.corners,
        uv_vertex=mesh.uv_vertex,
        panel_id=mesh.panel_id,
        panel_names=mesh.panel_names,
        panel_labels=mesh.panel_labels,
        seams=mesh.seams,
        body=body,
        landmarks=_landmarks(body),
        hair=hair,
    )
    if pattern is None:
        return scene
    panel_of_row = _panel_of_row(mesh)
    ids, rows = _corners_in_mesh(mesh, panel_of_row, pattern)
    scene = replace(scene, panel_corners=ids, corner_rows=rows)
    vars(scene)["panel_of_row"] = np.maximum(panel_of_row, 0)  # as the cached property would find it
    return scene


def figure_scene(body: Body) -> Scene:
    """A scene without a garment."""
    return scene_of(NO_MESH, NO_MESH.vertices, body)


def scene_of_sample(sample: Sample, body: Body, *, hair: HairStyle = HairStyle.NONE) -> Scene:
    """The scene of a draped sample, all garments of an outfit, on its body.

    Raises ``ConfigError`` for a sample without a drape.
    """
    sample = joined(sample)
    if sample.box_mesh is None or sample.drape is None:
        raise ConfigError(f"{sample.key} is not draped: make it with stage drape to render it")
    scene = scene_of(sample.box_mesh, sample.drape.vertices, body, pattern=sample.pattern, hair=hair)
    return scene if sample.maps is None else replace(scene, values=sample.maps.by_vertex)


NEAR = 1e-2  # cm; a row of ``uv`` nearer than this to a panel corner is that corner: specifications round to 1e-3 cm


def _panel_of_row(mesh: BoxMesh | Scene) -> Int32[np.ndarray, " c"]:
    """The panel of each row of ``uv``; -1 for a row without a face."""
    panel_of_row = np.full(len(mesh.uv), -1, np.int32)
    for rows in mesh.corners.T:
        panel_of_row[rows] = mesh.panel_id
    return panel_of_row


def _corners_in_mesh(
    mesh: BoxMesh, panel_of_row: Int32[np.ndarray, " c"], pattern: Pattern
) -> tuple[Int[np.ndarray, "k 2"], Int[np.ndarray, " k"]]:
    """(panel, corner) and row of ``uv`` for each panel corner that is a vertex of the mesh."""
    panels = {panel.name: panel for panel in pattern.panels}
    order = np.argsort(panel_of_row, kind="stable")
    ends = np.searchsorted(panel_of_row[order], np.arange(len(mesh.panel_names) + 1))
    ids: list[tuple[int, int]] = []
    found: list[int] = []
    for number, name in enumerate(mesh.panel_names):
        own = order[ends[number] : ends[number + 1]]
        if name not in panels or not len(own):
            continue
        u, v = mesh.uv[own].T
        for corner, (x, y) in enumerate(panels[name].vertices):
            apart = (u - x) ** 2 + (v - y) ** 2
            nearest = int(apart.argmin())
            if apart[nearest] < NEAR**2:
                ids.append((number, corner))
                found.append(int(own[nearest]))
    return np.array(ids, int).reshape(-1, 2), np.array(found, int)


def _landmarks(body: Body) -> dict[str, Float[np.ndarray, "3"]]:
    from gcd_dataset.generator.body.asset import body_model, landmark_table

    if len(body.vertices) != len(body_model().parts):
        return {}
    return {name: body.vertices[vertex] for name, vertex in landmark_table().points.items()}
