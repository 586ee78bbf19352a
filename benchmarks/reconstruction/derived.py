"""Arrays of a garment that are computed from other fields of its item, for tasks about surfaces and bodies."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from trimesh.triangles import closest_point

from benchmarks.reconstruction.design_codes import encode_design
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render.pictures import BACKGROUND, GARMENT, HAIR, MapName
from gcd_dataset.loaders import VIEW_FIELDS, Scan, Views
from gcd_dataset.loaders.base import Item
from gcd_dataset.loaders.scenes import BodyOf
from gcd_dataset.metrics.answers import CLASS_OF, PANEL_CLASSES, panel_class
from gcd_dataset.records import BodyPart, EdgeRole
from gcd_dataset.scoring.inputs import EVERY, PICTURE_SIZE, PICTURES, POINTS, SCAN_SIZE, person_points, seen_all_round
from gcd_dataset.tensors import EDGE_LABELS, PANEL_LABELS, PanelColumn

CENTRE = np.array([0.0, 100.0, 0.0])  # cm, roughly the centre of garments: half precision is finest near 0
MOST_NUMBERED: Mapping[str, int] = {
    "skirt_panel": 15, "skirt_front": 5, "skirt_back": 5, "ins_skirt_front": 6, "ins_skirt_back": 6,
}  # fmt: skip
PANEL_NAMES = (
    *(name for name in PANEL_CLASSES if name not in ("other", "skirt_panel", "ins_skirt_front", "ins_skirt_back")),
    *(f"{name}_{number}" for name, count in MOST_NUMBERED.items() for number in range(count)),
)
"""All names of panels that the generator draws, which are GarmentCode's; a garment has each at most once."""
RINGS = ("bust", "waist", "hips")
FIT = ("sizes", *RINGS)
"""Sizes from the wearer's to the one that a garment is cut for; ease of the cloth as cut at three rings [cm]."""
LABELLED = ("meta", "faces", "panel_id", "labels", "seams")
"""Fields that tell the labels of points."""
CANDIDATES = 4  # triangles whose distance to a point is measured
SIDES = {"left": "right", "right": "left", "_l": "_r", "_r": "_l"}
ROW_OF_NAME = {name: row for row, name in enumerate(PANEL_NAMES)}
MIRRORED = tuple(
    CLASS_OF.get(re.sub("left|right|_[lr](?=_|$)", lambda found: SIDES[found[0]], name), row)
    for row, name in enumerate(PANEL_CLASSES)
)
"""The class of the mirror image of a panel."""
MIRRORED_EDGES = tuple(EDGE_LABELS.index(EdgeRole(name).mirrored if name else "") for name in EDGE_LABELS)
"""The label of the mirror image of an edge."""


POINT_LABELS = ("box_labels", "draped_labels", "scan_labels")
"""Names of the arrays of labels of surface points: of the box mesh, of the drape, and of a scan of it."""


@dataclass(frozen=True)
class Derived:
    """An array that is computed from an item."""

    needs: tuple[str, ...]
    """Fields of the item."""
    of: Callable[[Item], np.ndarray]


def derived_arrays(item: Item, names: Sequence[str], bodies: BodyOf | None = None) -> dict[str, np.ndarray]:
    """Arrays of an item by name: derived ones, and fields of the item.

    Pictures that the item lacks are rendered on a CPU. ``bodies``: the wearers of items without shape weights.
    """
    if "views" not in item and not {"pictures", "shown"}.isdisjoint(names):
        item = picture_views("cpu", bodies)(item)
    if "person" in names:
        item = seen_all_round(bodies)(item)
    if "scan" in names:
        item = Scan(n=1, points=POINTS, size=SCAN_SIZE, bodies=bodies)(item)
    return {name: DERIVED[name].of(item) if name in DERIVED else item[name].numpy() for name in names}


def item_fields(names: Sequence[str]) -> list[str]:
    """The item fields that these arrays need, each once."""
    needed = (field for name in names for field in (DERIVED[name].needs if name in DERIVED else (name,)))
    return list(dict.fromkeys(needed))


def _panel_classes(item: Item) -> np.ndarray:
    return np.array([panel_class(name) for name in item["meta"]["panel_names"]], np.int32)


def _point_labels(item: Item, vertices: str, measured: str = "points") -> np.ndarray:
    """Labels of each point: panel of the nearest triangle; edge label and seam of that triangle's nearest corner.

    ``vertices``, ``measured``: fields of positions, which need not be finite: those of a failed drape may not be.
    """
    place, points = (
        np.nan_to_num(item[name].numpy().astype(float), posinf=0.0, neginf=0.0)[:, :3] for name in (vertices, measured)
    )
    faces, panels = item["faces"].numpy(), _panel_classes(item)[item["panel_id"].numpy()]
    of_vertices = np.zeros((len(place), 2), np.uint8)
    edges = item["labels"].numpy()
    edges = edges[edges[:, 1] < len(EDGE_LABELS)]
    of_vertices[edges[:, 0], 0] = edges[:, 1]
    of_vertices[item["seams"].numpy()[:, 0], 1] = 1
    face = _nearest_triangles(place[faces], points)
    corners = faces[face]
    nearest = np.linalg.norm(place[corners] - points[:, None], axis=2).argmin(axis=1)
    return np.column_stack([panels[face].astype(np.uint8), of_vertices[corners[np.arange(len(points)), nearest]]])


def _nearest_triangles(
    triangles: Float[np.ndarray, "f 3 3"], points: Float[np.ndarray, "n 3"]
) -> Int[np.ndarray, " n"]:
    """Row of the nearest triangle of each point, among the ``CANDIDATES`` with the nearest centroids."""
    count = min(CANDIDATES, len(triangles))
    _, rows = cKDTree(triangles.mean(axis=1)).query(points, k=range(1, count + 1))
    closest = closest_point(triangles[rows.ravel()], np.repeat(points, count, axis=0))
    distance = np.linalg.norm(closest.reshape(-1, count, 3) - points[:, None], axis=2)
    known = np.nan_to_num(distance, nan=np.inf)  # of a triangle without area it may be unknown
    return rows[np.arange(len(points)), known.argmin(axis=1)]


def _labels_of(vertices: str) -> Derived:
    return Derived((*LABELLED, "points", vertices), partial(_point_labels, vertices=vertices))


def _panel_names(item: Item) -> np.ndarray:
    return np.array([ROW_OF_NAME.get(name, -1) for name in item["meta"]["panel_names"]], np.int32)


def _design(item: Item) -> np.ndarray:
    return encode_design(item["design"])[None]


def _pose(item: Item) -> np.ndarray:
    pose = item["meta"]["pose"]
    return np.array([[pose["arm_angle"], float(pose["legs_apart"])]], np.float32)


def _scan(item: Item) -> np.ndarray:
    return np.asarray(item["scan"].numpy())


def picture_views(device: str, bodies: BodyOf | None = None) -> Views:
    """Renders the pictures of items on a device; ``auto`` is a GPU where there is one."""
    return Views(n=PICTURES, size=PICTURE_SIZE, maps=MAPS, device=device, bodies=bodies)


def _fit(item: Item) -> np.ndarray:
    fit = item["meta"].get("fit") or {}
    if "step" not in fit or "ease" not in fit:
        raise ConfigError(f"{item['meta']['key']} has no size and ease: give garments made with --sizes and --ease")
    rings = [fit["ease"][name] for name in RINGS]
    ease = [np.nan if ring["cloth"] is None else ring["cloth"] - ring["body"] for ring in rings]
    return np.array([[fit["step"], *ease]], np.float32)


def _pictures(item: Item) -> np.ndarray:
    return np.asarray(item["views"].numpy())


def _shown(item: Item) -> np.ndarray:
    labels = item["panels"][:, PanelColumn.LABEL].int().numpy()
    known = np.where(labels < len(PANEL_LABELS), labels, 0)
    return pixel_labels({name: item[f"{name}_map"].numpy() for name in MAPS}, known)


def _motion(item: Item) -> np.ndarray:
    return np.asarray(item["motion_verts"][::EVERY].transpose(0, 1).numpy())


def _turns(item: Item) -> np.ndarray:
    return np.asarray(item["motion_pose"][::EVERY].numpy())


DERIVED: Mapping[str, Derived] = {
    "box_labels": _labels_of("box"),
    "draped_labels": _labels_of("verts"),
    "design": Derived(("design",), _design),
    "fit": Derived(("meta",), _fit),
    "motion": Derived(("motion_verts",), _motion),
    "panel_classes": Derived(("meta",), _panel_classes),
    "panel_names": Derived(("meta",), _panel_names),
    "person": Derived(VIEW_FIELDS, person_points),
    "pictures": Derived(VIEW_FIELDS, _pictures),
    "pose": Derived(("meta",), _pose),
    "scan": Derived(VIEW_FIELDS, _scan),
    "scan_labels": Derived((*VIEW_FIELDS, *LABELLED), partial(_point_labels, vertices="verts", measured="scan")),
    "shown": Derived((*VIEW_FIELDS, "panels"), _shown),
    "turns": Derived(("motion_pose",), _turns),
}
"""``box_labels``, ``draped_labels``, ``scan_labels`` (n, 3): labels of each point of a surface or scan, u8. The first
is the class of the panel of the nearest triangle, a row of ``PANEL_CLASSES``. The others are those of its nearest
corner: the label of the edge, a row of ``EDGE_LABELS``, and 1 on a seam. Bands along edges and seams are therefore
about as wide as a triangle; ``design`` (1, d): parameters, as ``encode_design``; ``fit`` (1, 4): ``FIT``, NaN for a
ring without cloth; ``motion`` (v, t, 3): positions in the frames of T8 [cm]; ``turns`` (t, 21, 3): angles of ``BONES``
in them [rad]; ``panel_classes`` (p): rows of ``PANEL_CLASSES``; ``panel_names`` (p): rows of ``PANEL_NAMES``, -1 for
others; ``person`` (n, 7): points of garment and visible body as in the inputs of T5, NaN if no camera sees the
garment; ``pose`` (1, 2): angle of the arms [rad], 1 for legs apart; ``pictures`` (``PICTURES``, h, w, 3): drawn
cameras, cloth, lights and places, u8 sRGB; ``shown`` (``PICTURES``, h, w): what their pixels show, u8 as
``pixel_labels``; ``scan`` (``POINTS``, 6): points that one depth camera measures, and normals [cm], NaN if it measured
none."""


MAPS: tuple[MapName, ...] = ("part", "panel_id")
"""The maps of a picture that tell it."""
_HAIR, _BACKGROUND = len(BodyPart), len(BodyPart) + 1
FIRST_PANEL = len(BodyPart) + 2
"""Label of a pixel of the first panel with ``PANEL_LABELS[0]``; below: body parts, hair, background."""
SHOWN_CLASSES = FIRST_PANEL + len(PANEL_LABELS)
"""Number of classes of a pixel: body parts, hair, background, and panels by label."""
MOST_PANELS = (256 - FIRST_PANEL) // len(PANEL_LABELS)
_SIDES = {"LEFT": "RIGHT", "RIGHT": "LEFT"}
MIRRORED_PIXELS = (
    *(BodyPart[re.sub("LEFT|RIGHT", lambda found: _SIDES[found[0]], part.name)].value for part in BodyPart),
    *range(len(BodyPart), 256),
)
"""The label of a pixel in the mirror image of a picture."""


def pixel_labels(maps: Mapping[str, np.ndarray], labels: ArrayLike) -> UInt8[np.ndarray, "*n h w"]:
    """``FIRST_PANEL`` + number of labels × panel + row of ``PANEL_LABELS``, or less for what is no garment.

    ``maps``: those of ``MAPS``, (…, h, w); ``labels`` (p): row of ``PANEL_LABELS`` of each panel. Panels beyond
    ``MOST_PANELS`` share their labels.
    """
    rows = np.asarray(labels)
    part, panel = maps["part"], np.maximum(maps["panel_id"], 0)
    of_panels = FIRST_PANEL + len(PANEL_LABELS) * (panel % MOST_PANELS) + rows[panel]
    others = np.where(part == HAIR, _HAIR, np.where(part == BACKGROUND, _BACKGROUND, part))
    return np.where(part == GARMENT, of_panels, others).astype(np.uint8)
