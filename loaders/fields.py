"""The fields of items: their types, and which of them garments hold, by the stage that they were made up to."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypedDict

from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from gcd_dataset.errors import ConfigError
from gcd_dataset.shards.layout import JOINT, select_fields, split_worn


class GarmentFields(TypedDict, total=False):
    """The fields of a garment; ``fields`` of its data set, and transforms, decide which of them an item holds.

    Floating fields have the data set's ``dtype``; integers are int32, and index the item's own arrays. Fields of a
    stage that was not made have no rows. Cameras are OpenCV's: axes x right, y down, z forward, a point X [cm] at
    K (R X + t), the centre of the upper left pixel at (0, 0). K is in pixels; [R | t] maps world to camera [1, cm].

    The fields of a further garment of an outfit are named ``g1_verts``, ``g1_panels``, …: without rows where an outfit
    has fewer garments. ``OutfitCloth`` joins them.
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
    closures: Float[Tensor, "s 3"]
    """How far the same seams are joined, and by what; columns of ``ClosureColumn``."""
    lines: Float[Tensor, "n 17"]
    """Lines inside the panels [cm]; columns of ``LineColumn``."""
    body: Float[Tensor, " k"]
    """Weights of the wearer's shape components [standard deviations]."""
    pose: Float[Tensor, "21 3"]
    """Bend, spread and twist of each of ``gcd_dataset.records.BONES`` [rad]; in recipes with ``poses``."""
    motion_verts: Float[Tensor, "t v 3"]
    """Positions in each frame of the window [cm]; this field and the next three are of ``MotionWindows``.
    ``GeneratedGarments`` have ``motion_verts`` and ``motion_pose`` of the whole motion."""
    motion_velocities: Float[Tensor, "t v 3"]
    """Way from the frame before, times frames a second [cm/s]; 0 in the first frame of the motion, at rest. Positions
    are multiples of 1/16 cm: of a slow garment take the mean of several frames."""
    motion_pose: Float[Tensor, "t 21 3"]
    """``pose`` in each frame."""
    motion_first: Int[Tensor, ""]
    """Number of the window's first frame in the motion, from 0."""
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
    garment_id: Int[Tensor, " v"]
    """The garment of each vertex, from the skin outwards; this field and the next one are of ``OutfitCloth``."""
    panel_garment: Int[Tensor, " p"]
    """The garment of each panel."""
    points: Float[Tensor, "n 6"]
    """Points of the surface [cm], and normals."""
    stretch: Float[Tensor, "v 2"]
    """Largest and smallest principal stretch; this field and the next two are in recipes with ``maps``."""
    gap: Float[Tensor, " v"]
    """Signed distance to the skin [cm]."""
    pressure: Float[Tensor, " v"]
    """On the skin [kPa], see ``gcd_dataset.records.Maps``."""
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
    keypoints: Float[Tensor, "n 17 3"]
    """Column, row and visibility, 0 to 2, of ``generator.render.COCO_KEYPOINTS``, as ``Picture.keypoints``."""
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


MESH = ("faces", "uv", "panel_id", "corners", "uv_vertex", "box", "labels", "seams")
OFTEN_EMPTY = ("labels", "seams")  # empty for a garment without labelled edges or without seams
ADDED: Mapping[str, tuple[str, ...]] = {"mesh": (*MESH, "points"), "drape": ("verts", "front", "back")}
"""Stage to the fields that it adds to those of the earlier stages."""
STAGES = ("pattern", *ADDED)
OPTIONAL: Mapping[str, str] = {
    "points": "have no surface points",
    "front": "have no pictures",
    "back": "have no pictures",
    "body": "have no shape weights of their bodies",
}
"""Optional fields, and the words for their absence in an error message."""


def select_present_fields(
    fields: Iterable[str] | None, available: Iterable[str], absent: Mapping[str, str]
) -> tuple[str, ...]:
    """The requested fields, in the order of ``available``; for ``None`` every field that is not ``absent``.

    ``views`` and its cameras may be requested where the fields of single views are available.

    ``absent``: field to the reason why no garment holds it. Raises ``ConfigError`` with that reason and the fields to
    choose from.
    """
    available = tuple(available)
    present = [field for field in available if split_worn(field)[1] not in absent]
    if fields is None:
        return tuple(present)
    requested = {fields} if isinstance(fields, str) else set(fields)
    known = dict.fromkeys((*available, *absent))
    if missing := [field for field in known if field in requested and field not in present]:
        reason = absent[split_worn(missing[0])[1]]
        raise ConfigError(f"no field {', '.join(missing)}: these garments {reason}: choose among {', '.join(present)}")
    return select_fields(requested, (*present, *_joint(present)))


def _joint(available: Iterable[str]) -> list[str]:
    """The fields that join the available fields of single views."""
    known = set(available)
    first = {"jpg": "view_0", "json": "view_0_json"}
    return [field for field, ending in JOINT.items() if first[ending] in known and field not in known]


def absent_at_stage(stage: str, empty: Iterable[str] = ()) -> dict[str, str]:
    """Field to the reason for its absence, for garments of a stage; ``empty``: fields that are empty in all of them.

    >>> sorted(absent_at_stage("mesh"))
    ['back', 'front', 'verts']
    """
    later = STAGES[STAGES.index(stage) + 1 :]
    reasons = {
        field: f"end with stage {stage}, and {field} come{'' if field.endswith('s') else 's'} with stage {other}"
        for other in later
        for field in ADDED[other]
    }
    return {field: OPTIONAL[field] for field in empty if field in OPTIONAL} | reasons


def absent_when_empty(is_empty: Callable[[str], bool], available: Iterable[str]) -> dict[str, str]:
    """Field to the reason for its absence, judged by the stored fields that are empty in all garments.

    ``available``: the stored fields; ``is_empty`` is called for these alone.
    """
    stored = set(available)
    mesh = [field for field in MESH if field in stored and field not in OFTEN_EMPTY]
    empty = [field for field in OPTIONAL if field in stored and is_empty(field)]
    if mesh and all(map(is_empty, mesh)):
        stage = "pattern"
    elif "verts" in stored and is_empty("verts"):
        stage = "mesh"
    else:
        stage = "drape"
    return absent_at_stage(stage, empty)
