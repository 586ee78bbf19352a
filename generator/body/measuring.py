"""Measures any body: the model's mesh by known vertices, any other mesh by landmarks found on it or given."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import ConvexHull, QhullError, cKDTree

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.arms import A_POSE_TOLERANCE, ArmPose, model_mesh_in_a_pose, turn_off_a_pose
from gcd_dataset.generator.body.asset import body_model, landmark_table
from gcd_dataset.generator.body.geodesic import graph_between
from gcd_dataset.generator.body.landmarks import GivenLandmarks, Landmarks, levels_of, model_landmarks
from gcd_dataset.generator.body.register import (
    Registration,
    UprightScan,
    find_upright,
    model_height,
    registration_at,
    unit_of,
)
from gcd_dataset.generator.body.repair import BodyScan, VisibleSkin, kept_mesh
from gcd_dataset.generator.body.section import contour_length, girth, loops, rough_girths, section, section_points
from gcd_dataset.generator.body.surface import SkinSurface, near
from gcd_dataset.generator.body.tailor import (
    GIRTHS,
    MeasureResult,
    Sites,
    measure_at,
    model_sites,
    relative_height,
    sinking,
    sites_of,
)
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import Body, BodyPart, Measurements, Record

CONFIDENCE_RADIUS = 6.0  # cm about a landmark within which the misfit decides its confidence
WRIST_SEARCH = np.arange(-6, 7) * 0.5  # cm along the forearm
WRIST_REACH = 7.0  # cm from the ring within which faces are searched for the wrist: excludes the trunk
MAX_WRIST_PATCH = 2.0  # cm of patch that the tape round the wrist may cross
BEHIND = 0.5  # cm behind the model's closed lips and lids: inside a mouth or a socket
HALF_CONFIDENCE = 1.5  # cm of misfit at which the confidence is 0.5


def find_landmarks(
    scan: BodyScan, surface: SkinSurface, registration: Registration, scale: float, shift: Float[np.ndarray, "3"]
) -> Landmarks:
    """The model's landmarks projected to the nearest skin.

    ``surface`` is the scan's surface scaled to the model's height: ``vertices * scale + shift``. The wrist is the
    narrowest section nearby. The confidence of a landmark falls with the misfit around it, and with the share of its
    points on patches.
    """
    model = model_landmarks(registration.vertices)
    offsets = {name: model_height() * share for name, share in landmark_table().beside.items()}
    expected = {name: (at + offsets.get(name, 0.0))[None] for name, at in model.points.items()} | dict(model.rings)
    nearest = {name: surface.nearest(at) for name, at in expected.items()}
    tree = cKDTree(registration.vertices)
    confidence = {}
    for name, at in nearest.items():
        around = np.unique(np.concatenate([*tree.query_ball_point(at.points, CONFIDENCE_RADIUS), []])).astype(int)
        misfit = np.sqrt((registration.distances[around] ** 2).mean()) if len(around) else np.inf
        patched = scan.patched[at.faces].mean()
        confidence[name] = float((1 - patched) / (1 + (misfit / HALF_CONFIDENCE) ** 2))
    points = {name: (nearest[name].points[0] - shift) / scale for name in model.points}
    rings = {name: (nearest[name].points - shift) / scale for name in model.rings}
    wrist = near(scan.vertices, rings["wrist_right"], WRIST_REACH / scale)[scan.faces].all(axis=1)
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
    if any(contour_length(section(turned, faces[patched], 1, offset)) > MAX_WRIST_PATCH for offset in offsets):
        raise BodyError("the skin round the right wrist has a hole: close it, and give a whole hand")
    loops = [points[level == offset] for offset in offsets]
    narrowest = min(loops, key=lambda loop: girth(loop[:, [0, 2]]))
    try:
        hull = narrowest[ConvexHull(narrowest[:, [0, 2]]).vertices]
    except QhullError as error:  # collinear points: a sliver
        raise BodyError("no skin goes all round the right wrist: correct the mesh there") from error
    return hull @ np.stack([across, normal, along]) + middle


def find_parts(vertices: Float[np.ndarray, "v 3"], registration: Registration) -> UInt8[np.ndarray, " v"]:
    """``BodyPart`` of each vertex, from the model's nearest skin vertex; internal if well behind the skin."""
    model = body_model()
    internal = model.parts == BodyPart.INTERNAL.value
    skin = np.flatnonzero(~internal)
    parts = model.parts[skin[cKDTree(registration.vertices[skin]).query(vertices)[1]]]
    candidates = np.flatnonzero(internal[cKDTree(registration.vertices).query(vertices)[1]])
    closed = VisibleSkin.of(model.faces, model.parts)
    skin_at = SkinSurface.of(closed.points(registration.vertices), closed.faces).nearest(vertices[candidates])
    behind = np.einsum("vi,vi->v", vertices[candidates] - skin_at.points, skin_at.normals) < -BEHIND
    parts[candidates[behind]] = BodyPart.INTERNAL.value
    return parts


MISSING = 3.0  # cm: largest median distance of a present part from the scan
STRAY = 8.0  # cm: surface further from the registered model is not part of the body
STRAY_SHARE = 0.02  # largest share of the mesh's area that is stray: a bun, a heel, a fragment
STICKS_OUT = 6.0  # cm above the model's head or below its soles, largest extent of the mesh
MAX_BRIDGED = 3.0  # cm that a tape may run over one patch: straight over it, the tape is at most 0.1 cm too short
MAX_JOINED = 8.0  # cm: largest length of arm contour in the loop of a girth; sampled bodies have none
LEVEL_ERROR = 2.0  # possible error of a level over the misfit
MIN_TRUNK = 20.0  # cm: a loop with more contour of trunk and legs than this belongs to the trunk

NEEDED = {
    BodyPart.TRUNK: "the trunk",
    BodyPart.LEFT_ARM: "the left arm",
    BodyPart.RIGHT_ARM: "the right arm",
    BodyPart.LEFT_LEG: "the left leg",
    BodyPart.RIGHT_LEG: "the right leg",
    BodyPart.HEAD: "the head",
    BodyPart.HANDS: "the hands",
    BodyPart.FEET: "the feet",
}
CHECKED_POINTS = ("nape_of_neck", "neck_right", "shoulder_left", "shoulder_right", "underarm_right", "crotch_point")
X, Y, Z = 0, 1, 2


def require_body_alone(scan: BodyScan, surface: SkinSurface, registration: Registration, name: str) -> None:
    """Raise ``BodyError`` if a body part is missing, or the mesh holds other objects.

    ``surface`` is the scan's surface, scaled to the model's height.
    """
    parts = body_model().parts
    for part, words in NEEDED.items():
        of_part = parts == part.value
        # The left and the right half separately: one hand alone may be missing.
        halves = [of_part & (side * registration.vertices[:, X] > 0) for side in (-1, 1)]
        distance = max(float(np.median(registration.distances[half])) for half in halves if half.any())
        if distance > MISSING:
            raise BodyError(f"{name}: no skin within {distance:.0f} cm of where {words} should be: give a whole body")
    corners = surface.corners
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    far = cKDTree(registration.vertices).query(corners.mean(axis=1))[0] > STRAY
    share = float(area[far & ~scan.patched[surface.owners]].sum() / area.sum())
    if share > STRAY_SHARE:
        raise BodyError(
            f"{name}: {share:.0%} of its surface lies more than {STRAY:.0f} cm off the body in it: "
            "leave only the body in it (no floor, chair, loose clothes or second person)"
        )
    for words, excess in beyond_model(surface, registration).items():
        if excess > STICKS_OUT:
            raise BodyError(f"{name}: something lies {excess:.0f} cm {words}: leave only the body in the mesh")


def beyond_model(surface: SkinSurface, registration: Registration) -> dict[str, float]:
    """How far a surface reaches beyond the model's head and soles [cm], as hair and heels do."""
    levels, model = surface.corners[..., Y], registration.vertices[:, Y]
    ends = {"above the head": levels.max() - model.max(), "below the soles": model.min() - levels.min()}
    return {words: float(excess) for words, excess in ends.items()}


def require_skin(scan: BodyScan, marks: Landmarks, sites: Sites, result: MeasureResult, name: str) -> None:
    """Raise ``BodyError`` if a landmark or a tape lies on a patch over a hole."""
    patches = scan.faces[scan.patched]
    if not len(patches):
        return
    for point in CHECKED_POINTS:
        if marks.confidence[point] == 0:
            raise BodyError(f"{name}: the {point.replace('_', ' ')} lies in a hole: close the skin there")
    for key, level in result.levels.items():
        band = sites.thighs if key == "leg_circ" else sites.bands[key]
        _require_bridgeable(scan, _common(patches, band), Y, level, key, name)
    _require_bridgeable(scan, _common(patches, sites.spine), X, marks.points["nape_of_neck"][X], "waist_line", name)
    over_bust = float(marks.rings["bust_line"][:, X].mean())
    _require_bridgeable(scan, _common(patches, sites.breast), X, over_bust, "waist_over_bust_line", name)


def _require_bridgeable(scan: BodyScan, patches: np.ndarray, axis: int, level: float, measure: str, name: str) -> None:
    if not len(patches):
        return
    segments = section(scan.vertices, patches, axis, level)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    bridged = float(np.bincount(loops(segments), length).max(initial=0.0))  # the longest connected line
    if bridged > MAX_BRIDGED * relative_height(scan.vertices):
        raise BodyError(f"{name}: {measure} crosses {bridged:.0f} cm of a hole in the skin: close it")


def _common(patches: Int[np.ndarray, "a 3"], band: Int[np.ndarray, "b 3"]) -> Int[np.ndarray, "c 3"]:
    """The patches that are also faces of a band."""
    of_band = {tuple(face) for face in band.tolist()}
    common = [face for face in patches.tolist() if tuple(face) in of_band]
    return np.array(common, int).reshape(-1, 3)


def require_free_limbs(scan: BodyScan, parts: UInt8[np.ndarray, " v"], result: MeasureResult, name: str) -> None:
    """Raise ``BodyError`` if an arm is merged with the trunk at a girth's level, as in scans with lowered arms."""
    arms = np.isin(parts, [BodyPart.LEFT_ARM.value, BodyPart.RIGHT_ARM.value, BodyPart.HANDS.value])
    for key in GIRTHS:
        if joined_arm_contour(scan, arms, result.levels[key]) > MAX_JOINED * relative_height(scan.vertices):
            raise BodyError(
                f"{name}: an arm is merged with the trunk at the level of the {key}, "
                f"{result.levels[key]:.0f} cm: raise the arms, or separate them in the mesh"
            )


def underbust_uncertainty(scan: BodyScan, sites: Sites, result: MeasureResult, misfit: float) -> float:
    """Change of the underbust over the possible error of its level [cm]; infinite off the skin.

    Other girths are extrema over their levels; the underbust level is the lower end of the breast on the registered
    model.
    """
    level, error = result.levels["underbust"], LEVEL_ERROR * misfit * relative_height(scan.vertices)
    heights = np.array([level - error, level, level + error])
    points, at = section_points(scan.vertices, sites.rings["underbust"], Y, heights)
    girths = rough_girths(points[:, [X, Z]], at)
    return float(np.abs(girths - girths[1]).max()) if len(girths) == 3 else np.inf


def joined_arm_contour(scan: BodyScan, arms: np.ndarray, level: float) -> float:
    """Length of the arms' contour in the loops of a level section that also contain trunk [cm]."""
    heights = scan.vertices[scan.faces, Y]
    cut = scan.faces[(heights.min(axis=1) <= level) & (heights.max(axis=1) > level)]
    segments = section(scan.vertices, cut, Y, level)
    of_arm = arms[cut].any(axis=1)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    loop = loops(segments)
    trunk_share = np.bincount(loop, weights=length * ~of_arm)
    arm_share = np.bincount(loop, weights=length * of_arm)
    return float(arm_share[trunk_share > MIN_TRUNK * relative_height(scan.vertices)].sum())


SAME_VERTICES = 5.0  # cm: median distance of a model mesh's vertices from those of the registered model, if the same


def measure(body: Body) -> Measurements:
    """The 26 measures of a body. Raises ``BodyError`` if the mesh holds no body, or no skin at a landmark."""
    return measure_closely(body).measurements


def measure_closely(body: Body) -> MeasureResult:
    """The measures of a body, with the level of each girth; one with the model's mesh must be upright, facing +z."""
    vertices = np.asarray(body.vertices, float)
    model_faces = body_model().faces
    if body.faces is model_faces or np.array_equal(body.faces, model_faces):
        return measure_model_mesh(vertices)
    return find_body(vertices, body.faces, body.name).result


def measure_model_mesh(vertices: Float[np.ndarray, "v 3"]) -> MeasureResult:
    """The measures of a body with the model's mesh, in the A-pose.

    Arms in another pose are moved to the A-pose first; only ``arm_pose_angle`` refers to the given pose.
    """
    marks = model_landmarks(vertices)
    angle = float(sinking(marks.points["shoulder_right"], marks.points["wrist_right"]))
    if not turn_off_a_pose(angle):
        return measure_at(vertices, marks, model_sites())
    in_a_pose = model_mesh_in_a_pose(vertices)
    return _with_arm_angle(angle, measure_at(in_a_pose, model_landmarks(in_a_pose), model_sites()))


def _with_arm_angle(angle: float, result: MeasureResult) -> MeasureResult:
    return replace(result, measurements=replace(result.measurements, arm_pose_angle=angle))


@dataclass(frozen=True, eq=False)
class FoundBody(Record):
    """A body found in an unknown mesh: measures, landmarks, parts, and figures of their accuracy."""

    result: MeasureResult
    marks: Landmarks
    """In the coordinates of the upright mesh, soles at y = 0 [cm]."""
    parts: UInt8[np.ndarray, " v"]
    """``BodyPart`` of each vertex of the input mesh; loose pieces are internal."""
    upright: UprightScan
    """The skin of the mesh, upright [cm]."""
    misfit: float
    """Mean distance of the registered body model from the skin, scaled to the model's height [cm]."""
    arm_turn: float
    """Rotation of the arms to the A-pose before measuring [rad]; 0 if they were near it."""
    underbust_error: float
    """Possible error of the underbust, from the uncertainty of its level [cm]."""
    by_vertex: bool
    """Whether the mesh is the body model's, so that landmarks and parts are known by vertex."""
    beyond: Mapping[str, float]
    """See ``beyond_model``."""


def find_body(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    name: str = "body",
    *,
    given: GivenLandmarks | None = None,
    parts: UInt8[np.ndarray, " v"] | None = None,
    in_cm: bool = True,
    height: float | None = None,
) -> FoundBody:
    """Find landmarks and parts of a mesh and measure it; ``given`` landmarks and ``parts`` override found ones.

    The mesh may have holes away from the tapes, faces wound either way, and other objects that are not connected to the
    body. Without ``in_cm`` its unit follows from the height, ``height`` [cm] or an adult's: see ``unit_of``. Arms in
    another pose are moved to the A-pose first; only ``arm_pose_angle`` refers to the given pose. Raises ``BodyError``
    if no body is found, or if a measure could not be trusted.
    """
    upright, registration = find_upright(BodyScan.of(vertices, faces, name), name)
    if not in_cm:
        upright = upright.in_cm(unit_of(float(np.ptp(upright.scan.vertices[:, 1])), name, height))
    scan, scale, shift, misfit = upright.scan, upright.scale, upright.shift, registration.alignment.misfit
    require_body_alone(scan, upright.surface, registration, name)
    beyond, skin = beyond_model(upright.surface, registration), ~(scan.loose | scan.outside)
    known = None if given is not None else _model_vertices(*kept_mesh(vertices, faces, skin), upright, registration)
    if known is not None:
        result, marks = measure_model_mesh(known), model_landmarks(known)
        if parts is None:
            parts = np.full(len(vertices), BodyPart.INTERNAL.value, np.uint8)
            parts[skin] = body_model().parts
        arm_turn = turn_off_a_pose(result.measurements.arm_pose_angle)
        return FoundBody(result, marks, parts, upright, misfit, arm_turn, 0.0, by_vertex=True, beyond=beyond)
    labels = find_parts(scan.vertices * scale + shift, registration)
    if parts is not None:
        labels[scan.source[skin]] = parts[skin]
    posed = _InAPose.of(upright, registration)
    try:
        marks = find_landmarks(posed.scan, posed.surface, posed.registration, scale, shift)
        if given is not None:
            marks = given.override(marks, posed.apply)
        arm, extended = graph_between(
            posed.scan.vertices, scan.faces, marks.points["shoulder_right"], marks.points["wrist_right"]
        )
        sites = sites_of(posed.scan.vertices, scan.faces, labels, marks, arm)
        result = measure_at(extended, marks, sites)
    except BodyError as error:
        raise BodyError(f"{name}: {error}") from error
    require_skin(posed.scan, marks, sites, result, name)
    require_free_limbs(scan, labels, result, name)
    found_parts = np.where(scan.loose, BodyPart.INTERNAL.value, labels[scan.source]).astype(np.uint8)
    return FoundBody(
        result=posed.result_in_pose(result, marks),
        marks=posed.marks_in_pose(marks),
        parts=found_parts if parts is None else parts,
        upright=upright,
        misfit=misfit,
        arm_turn=posed.turn,
        underbust_error=underbust_uncertainty(posed.scan, sites, result, misfit),
        by_vertex=False,
        beyond=beyond,
    )


def _model_vertices(
    vertices: np.ndarray, faces: np.ndarray, upright: UprightScan, registration: Registration
) -> Float[np.ndarray, "m 3"] | None:
    """The upright vertices [cm] of a body with the model's mesh; ``None`` for another mesh, or a mirrored body."""
    if not np.array_equal(faces, body_model().faces):
        return None
    standing = upright.transform.apply(vertices)
    off = np.linalg.norm(standing * upright.scale + upright.shift - registration.vertices, axis=1)
    return standing if np.median(off) < SAME_VERTICES else None


@dataclass(frozen=True, eq=False)
class _InAPose(Record):
    """An upright scan with its arms moved to the A-pose, unless they are within ``A_POSE_TOLERANCE`` of it."""

    upright: UprightScan
    arms: ArmPose | None  # the arms' original pose; ``None``: not moved
    scan: BodyScan
    surface: SkinSurface
    registration: Registration

    @classmethod
    def of(cls, upright: UprightScan, registration: Registration) -> Self:
        scan = upright.scan
        if np.linalg.norm(registration.alignment.arm_turns, axis=1).max() < A_POSE_TOLERANCE:
            return cls(upright, None, scan, upright.surface, registration)
        arms = ArmPose.of(upright.surface, registration)
        scaled = arms.to_a_pose(scan.vertices * upright.scale + upright.shift)
        surface = SkinSurface.of(scaled, scan.faces, scan.patched)
        scan = replace(scan, vertices=(scaled - upright.shift) / upright.scale)
        return cls(upright, arms, scan, surface, registration_at(surface, arms.in_a_pose.alignment))

    @property
    def turn(self) -> float:
        return 0.0 if self.arms is None else self.arms.turn

    def apply(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Points of the input mesh, moved to the measured body [cm]."""
        points = self.upright.transform.apply(points)
        return points if self.arms is None else self._mapped(self.arms.to_a_pose, points)

    def marks_in_pose(self, marks: Landmarks) -> Landmarks:
        """Landmarks of the measured body, moved to the original pose of the arms."""
        if self.arms is None:
            return marks
        points = {name: self._mapped(self.arms.from_a_pose, at[None])[0] for name, at in marks.points.items()}
        rings = {name: self._mapped(self.arms.from_a_pose, ring) for name, ring in marks.rings.items()}
        return replace(marks, points=points, rings=rings)

    def result_in_pose(self, result: MeasureResult, marks: Landmarks) -> MeasureResult:
        """The measures with ``arm_pose_angle`` of the original pose."""
        points = self.marks_in_pose(marks).points
        return _with_arm_angle(float(sinking(points["shoulder_right"], points["wrist_right"])), result)

    def _mapped(self, function: Callable[[np.ndarray], np.ndarray], points: np.ndarray) -> np.ndarray:
        """Points mapped by a function of points scaled to the model's height."""
        scale, shift = self.upright.scale, self.upright.shift
        return (function(points * scale + shift) - shift) / scale
