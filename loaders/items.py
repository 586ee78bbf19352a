"""The fields of items, with types that editors complete and type checkers know."""

from typing import Any, TypedDict

from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor


class GarmentFields(TypedDict, total=False):
    """The fields of a garment; ``fields`` of its data set, and transforms, decide which of them an item holds.

    Floating fields have the data set's ``dtype``; integers are int32, and index the item's own arrays. Fields of a
    stage that was not made have no rows. Cameras are OpenCV's: axes x right, y down, z forward, a point X [cm] at
    K (R X + t), the centre of the upper left pixel at (0, 0). K is in pixels; [R | t] maps world to camera [1, cm].
    """

    meta: dict[str, Any]
    """Seed, index, recipe, names, outcome and figures of the drape: ``gcd_dataset.shards.meta``."""
    spec: dict[str, Any]
    """The pattern as a GarmentCode specification [cm, degrees]."""
    design: dict[str, Any]
    measures: dict[str, float]
    """The tailor's measures of the wearer [cm, degrees]."""
    caption: str
    """Three lines of English, see ``gcd_dataset.captions``."""
    panels: Float[Tensor, "p 14"]
    """[cm, rad]; columns of ``gcd_dataset.tensors.PanelColumn``."""
    edges: Float[Tensor, "e 13"]
    """[cm]; columns of ``EdgeColumn``."""
    stitches: Int[Tensor, "s 3"]
    """A row for each seam; columns of ``StitchColumn``."""
    body: Float[Tensor, " k"]
    """Weights of the wearer's shape components [standard deviations]."""
    faces: Int[Tensor, "f 3"]
    """Triangles: rows of ``verts`` and ``box``."""
    uv: Float[Tensor, "c 2"]
    """Positions in the panels' planes [cm]; a vertex on a seam has several."""
    panel_id: Int[Tensor, " f"]
    """The panel of each face."""
    labels: Int[Tensor, "l 2"]
    """(vertex, row of ``meta["edge_labels"]``)."""
    seams: Int[Tensor, "m 2"]
    """(vertex, row of ``stitches``)."""
    corners: Int[Tensor, "f 3"]
    """Rows of ``uv`` at the corners of each face."""
    uv_vertex: Int[Tensor, " c"]
    """The vertex of each row of ``uv``."""
    box: Float[Tensor, "v 3"]
    """Positions before sewing [cm]."""
    verts: Float[Tensor, "v 3"]
    """Positions at rest [cm]."""
    points: Float[Tensor, "n 6"]
    """Points of the surface [cm], and normals."""
    front: UInt8[Tensor, "3 h w"]
    back: UInt8[Tensor, "3 h w"]
    views: UInt8[Tensor, "n h w 3"]
    """sRGB pictures, stored or of ``Views``."""
    camera_k: Float[Tensor, "n 3 3"]
    camera_rt: Float[Tensor, "n 3 4"]
    depth_map: Float[Tensor, "n h w"]
    panel_id_map: Int[Tensor, "n h w"]
    """Two of the maps of ``Views``: see ``gcd_dataset.generator.render.Picture``."""
    panel_corners: Int[Tensor, "k 2"]
    """(panel, corner) of each row of the next two."""
    panel_corner_pixels: Float[Tensor, "k n 2"]
    """Column and row in each view; NaN behind the camera."""
    panel_corner_visible: Bool[Tensor, "k n"]
    """In the picture, and hidden by nothing."""
    landmark_pixels: Float[Tensor, "n l 2"]
    """As ``panel_corner_pixels``, of ``Views.landmark_names``; NaN where the body has none."""
    landmark_visible: Bool[Tensor, "n l"]
    scan: Float[Tensor, "n 6"]
    """``Scan``: measured position [cm], true normal towards the camera; NaN where nothing was measured."""
    scan_panel_id: Int[Tensor, " n"]
    scan_camera: Int[Tensor, " n"]
    """Panel and camera of each point: -1 on the body, and where nothing was measured."""
    scan_camera_rt: Float[Tensor, "k 3 4"]
    scan_camera_k: Float[Tensor, "k 3 3"]
    sketch: UInt8[Tensor, "n h w"]
    """``Sketch``: grey, dark lines on white."""
    sketch_k: Float[Tensor, "n 3 3"]
    sketch_rt: Float[Tensor, "n 3 4"]


class BodyFields(TypedDict, total=False):
    """The fields of a person; soles are at y = 0."""

    name: str
    shape: Float[Tensor, " k"]
    """Weights of the shape components [standard deviations]."""
    arm_angle: Float[Tensor, ""]
    """Angle by which both arms are raised from the A-pose [rad]."""
    measures: Float[Tensor, " 26"]
    """In the order of ``columns``: cm, inclinations in degrees; NaN if not measured."""
    straight: Float[Tensor, "v 3"]
    apart: Float[Tensor, "v 3"]
    """Vertices with straight legs, and with the legs apart [cm]."""
