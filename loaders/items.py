"""The fields of an item, with types that editors complete and mypy checks.

>>> from gcd_dataset.loaders import FakeGarments
>>> item: GarmentFields = FakeGarments(1)[0]
>>> item["faces"].shape[1]
3
"""

from typing import Any, TypedDict

from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

__all__ = ["BodyFields", "GarmentFields"]


class GarmentFields(TypedDict, total=False):
    """The fields of a garment; ``fields`` of the data set and its transforms decide which of them an item holds.

    Floating fields have the ``dtype`` of the data set. Integers are int32: rows of the item's own arrays. Fields of a
    stage that was not made have no rows. Of ``Views``, ``Scan`` and ``Sketch``: cameras are OpenCV's, axes x right, y
    down, z forward, a point X [cm] at K (R X + t), the centre of the upper left pixel at (0, 0).
    """

    meta: dict[str, Any]
    """Seed, index, recipe, names of rows, outcome and figures of the drape; keys: ``gcd_dataset.shards.meta``."""
    spec: dict[str, Any]
    """The pattern as a GarmentCode specification [cm, degrees]."""
    design: dict[str, Any]
    """The parameters of the design."""
    measures: dict[str, float]
    """The tailor's measures of the wearer [cm, degrees]."""
    caption: str
    """Three lines of English: ``gcd_dataset.captions``; after ``PickCaption`` one of them."""
    panels: Float[Tensor, "p 14"]
    """A row for each panel: columns of ``gcd_dataset.tensors.PanelColumn``."""
    edges: Float[Tensor, "e 13"]
    """A row for each edge: columns of ``gcd_dataset.tensors.EdgeColumn``."""
    stitches: Int[Tensor, "s 3"]
    """A row for each seam: columns of ``gcd_dataset.tensors.StitchColumn``."""
    body: Float[Tensor, " k"]
    """Weights of the wearer's shape components [standard deviations]."""
    faces: Int[Tensor, "f 3"]
    """Triangles: rows of ``verts`` and ``box``."""
    uv: Float[Tensor, "c 2"]
    """Coordinates in the panels' planes [cm]; vertices on seams have several."""
    panel_id: Int[Tensor, " f"]
    """The panel of each face: rows of ``panels``."""
    labels: Int[Tensor, "l 2"]
    """(row of ``verts``, row of ``meta["edge_labels"]``)."""
    seams: Int[Tensor, "m 2"]
    """(row of ``verts``, row of ``stitches``)."""
    corners: Int[Tensor, "f 3"]
    """Rows of ``uv`` at the corners of each face."""
    uv_vertex: Int[Tensor, " c"]
    """The vertex of each row of ``uv``."""
    box: Float[Tensor, "v 3"]
    """Positions before sewing [cm]."""
    verts: Float[Tensor, "v 3"]
    """Positions at rest [cm]."""
    points: Float[Tensor, "n 6"]
    """Points of the surface [cm] and normals."""
    front: UInt8[Tensor, "3 h w"]
    back: UInt8[Tensor, "3 h w"]
    views: UInt8[Tensor, "n h w 3"]
    """sRGB pictures, stored or of ``Views``."""
    camera_k: Float[Tensor, "n 3 3"]
    """Intrinsics of the views [pixels]."""
    camera_rt: Float[Tensor, "n 3 4"]
    """[R | t] of the views, world to camera [1, cm]."""
    depth_map: Float[Tensor, "n h w"]
    panel_id_map: Int[Tensor, "n h w"]
    """Two of the ``maps`` of ``Views``; those and the others: ``gcd_dataset.generator.render.Picture``."""
    panel_corners: Int[Tensor, "k 2"]
    """``Views``: (row of ``panels``, corner) of each row of the next two."""
    panel_corner_pixels: Float[Tensor, "k n 2"]
    """Column and row in each view; NaN behind the camera."""
    panel_corner_visible: Bool[Tensor, "k n"]
    """In the picture, and hidden by nothing."""
    landmark_pixels: Float[Tensor, "n l 2"]
    """Landmarks of the body, ``Views.landmark_names``; NaN where the body has none."""
    landmark_visible: Bool[Tensor, "n l"]
    scan: Float[Tensor, "n 6"]
    """``Scan``: measured position [cm], true normal towards the camera; NaN where the cameras measured nothing."""
    scan_panel_id: Int[Tensor, " n"]
    """Rows of ``panels``; -1 on the body."""
    scan_camera: Int[Tensor, " n"]
    """The camera of each point; -1 where nothing is measured."""
    scan_camera_rt: Float[Tensor, "k 3 4"]
    scan_camera_k: Float[Tensor, "k 3 3"]
    """True extrinsics [1, cm] and intrinsics [pixels] of the depth cameras."""
    sketch: UInt8[Tensor, "n h w"]
    """``Sketch``: grey, dark lines on white; a drawing for each side."""
    sketch_k: Float[Tensor, "n 3 3"]
    sketch_rt: Float[Tensor, "n 3 4"]
    """Intrinsics [pixels] and extrinsics [1, cm] of the drawings."""


class BodyFields(TypedDict, total=False):
    """The fields of a person of ``BodyDataset`` and ``PublishedBodies``; soles are at y = 0."""

    name: str
    shape: Float[Tensor, " k"]
    """Weights of the shape components [standard deviations]."""
    arm_angle: Float[Tensor, ""]
    """Angle by which both arms are raised from the A-pose [rad]."""
    measures: Float[Tensor, " 26"]
    """In the order of ``columns``: cm, inclinations in degrees; NaN if not measured."""
    straight: Float[Tensor, "v 3"]
    """Vertices with straight legs [cm]."""
    apart: Float[Tensor, "v 3"]
    """Vertices with the legs apart [cm]."""
