"""Finds landmarks and body parts on a mesh without known vertices, from the body model registered to it."""

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import ConvexHull, QhullError, cKDTree

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.asset import body_model, landmark_table
from gcd_dataset.generator.body.holes import VisibleSkin
from gcd_dataset.generator.body.landmarks import Landmarks, levels_of, model_landmarks
from gcd_dataset.generator.body.register import Registration, model_height
from gcd_dataset.generator.body.scan import Scan
from gcd_dataset.generator.body.section import contour_length, girth, section, section_points
from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import BodyPart

CONFIDENCE_RADIUS = 6.0  # cm about a landmark within which the misfit decides its confidence
WRIST_SEARCH = np.arange(-6, 7) * 0.5  # cm along the forearm
WRIST_REACH = 7.0  # cm from the ring within which faces are searched for the wrist: excludes the trunk
MAX_BRIDGED = 2.0  # cm of patch that the tape round the wrist may cross
BEHIND = 0.5  # cm behind the model's closed lips and lids: inside a mouth or a socket
HALF_CONFIDENCE = 1.5  # cm of misfit at which the confidence is 0.5


def find_landmarks(
    scan: Scan, surface: SkinSurface, registration: Registration, scale: float, shift: Float[np.ndarray, "3"]
) -> Landmarks:
    """The model's landmarks projected to the nearest skin.

    ``surface`` is the scan's surface scaled to the model's height: ``vertices * scale + shift``. The wrist is the
    narrowest section nearby. The confidence of a landmark falls with the misfit around it, and with the share of its
    points on patches.
    """
    model = model_landmarks(registration.vertices)
    offsets = {name: model_height() * share for name, share in landmark_table().beside.items()}
    expected = {name: (at + offsets.get(name, 0.0))[None] for name, at in model.points.items()} | dict(model.rings)
    near = {name: surface.nearest(at) for name, at in expected.items()}
    tree = cKDTree(registration.vertices)
    confidence = {}
    for name, at in near.items():
        around = np.unique(np.concatenate([*tree.query_ball_point(at.points, CONFIDENCE_RADIUS), []])).astype(int)
        misfit = np.sqrt((registration.distances[around] ** 2).mean()) if len(around) else np.inf
        patched = scan.patched[at.faces].mean()
        confidence[name] = float((1 - patched) / (1 + (misfit / HALF_CONFIDENCE) ** 2))
    points = {name: (near[name].points[0] - shift) / scale for name in model.points}
    rings = {name: (near[name].points - shift) / scale for name in model.rings}
    wrist = _near(scan.vertices, rings["wrist_right"], WRIST_REACH / scale)[scan.faces].all(axis=1)
    rings["wrist_right"] = narrowest_ring(
        scan.vertices, scan.faces[wrist], rings["wrist_right"], WRIST_SEARCH / scale, scan.patched[wrist]
    )
    return Landmarks(points, rings, levels_of(rings, float(np.ptp(scan.vertices[:, 1]))), confidence)


def narrowest_ring(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    ring: Float[np.ndarray, "n 3"],
    offsets: Float[np.ndarray, " o"],
    patched: Bool[np.ndarray, " f"],
) -> Float[np.ndarray, "m 3"]:
    """The convex hull of the narrowest section of a limb, parallel to the plane of a ring [cm].

    ``offsets``: the searched distances from the ring's plane; ``patched``: the faces that close holes. Raises
    ``BodyError`` if a plane cuts no skin, or cuts a hole.
    """
    middle = ring.mean(axis=0)
    across, along, normal = np.linalg.svd(ring - middle)[2]
    turned = (vertices - middle) @ np.stack([across, normal, along], axis=1)
    points, level = section_points(turned, mesh_edges(faces).ends, 1, offsets)
    if len(np.unique(level)) < len(offsets):
        raise BodyError("no skin is found round the right wrist: correct the mesh there")
    if any(contour_length(section(turned, faces[patched], 1, offset)) > MAX_BRIDGED for offset in offsets):
        raise BodyError("the skin round the right wrist has a hole: close it, and give a whole hand")
    loops = [points[level == offset] for offset in offsets]
    narrowest = min(loops, key=lambda loop: girth(loop[:, [0, 2]]))
    try:
        hull = narrowest[ConvexHull(narrowest[:, [0, 2]]).vertices]
    except QhullError as error:  # collinear points: a sliver
        raise BodyError("no skin goes all round the right wrist: correct the mesh there") from error
    return hull @ np.stack([across, normal, along]) + middle


def _near(vertices: np.ndarray, points: np.ndarray, radius: float) -> np.ndarray:
    return cKDTree(points).query(vertices, distance_upper_bound=radius)[0] < radius


def find_parts(vertices: Float[np.ndarray, "v 3"], registration: Registration) -> UInt8[np.ndarray, " v"]:
    """``BodyPart`` of each vertex, from the model's nearest skin vertex; internal if well behind the skin."""
    model = body_model()
    internal = model.parts == BodyPart.INTERNAL.value
    skin = np.flatnonzero(~internal)
    parts = model.parts[skin[cKDTree(registration.vertices[skin]).query(vertices)[1]]]
    candidates = np.flatnonzero(internal[cKDTree(registration.vertices).query(vertices)[1]])
    closed = VisibleSkin.of(model.faces, model.parts)
    near = SkinSurface.of(closed.points(registration.vertices), closed.faces).nearest(vertices[candidates])
    behind = np.einsum("vi,vi->v", vertices[candidates] - near.points, near.normals) < -BEHIND
    parts[candidates[behind]] = BodyPart.INTERNAL.value
    return parts
