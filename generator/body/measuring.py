"""Measures any body: the model's mesh by known vertices, any other mesh by landmarks found on it or given."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Float, Int, UInt8

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.arms import A_POSE_TOLERANCE, ArmPose, model_mesh_in_a_pose, turn_off_a_pose
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.find import find_landmarks, find_parts
from gcd_dataset.generator.body.geodesic import graph_between
from gcd_dataset.generator.body.landmarks import GivenLandmarks, Landmarks, model_landmarks
from gcd_dataset.generator.body.measures import sinking
from gcd_dataset.generator.body.mesh_checks import (
    require_body_alone,
    require_free_limbs,
    require_skin,
    underbust_uncertainty,
)
from gcd_dataset.generator.body.register import Registration, registration_at
from gcd_dataset.generator.body.scan import Scan, kept_mesh
from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.generator.body.tailor import MeasureResult, measure_at, model_sites, sites_of
from gcd_dataset.generator.body.upright import UprightScan, find_upright, unit_of
from gcd_dataset.records import Body, BodyPart, Measurements, Record

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
    upright, registration = find_upright(Scan.of(vertices, faces, name), name)
    if not in_cm:
        upright = upright.in_cm(unit_of(float(np.ptp(upright.scan.vertices[:, 1])), name, height))
    scan, scale, shift, misfit = upright.scan, upright.scale, upright.shift, registration.alignment.misfit
    require_body_alone(scan, upright.surface, registration, name)
    skin = ~(scan.loose | scan.outside)
    known = None if given is not None else _model_vertices(*kept_mesh(vertices, faces, skin), upright, registration)
    if known is not None:
        result, marks = measure_model_mesh(known), model_landmarks(known)
        if parts is None:
            parts = np.full(len(vertices), BodyPart.INTERNAL.value, np.uint8)
            parts[skin] = body_model().parts
        arm_turn = turn_off_a_pose(result.measurements.arm_pose_angle)
        return FoundBody(result, marks, parts, upright, misfit, arm_turn, underbust_error=0.0, by_vertex=True)
    labels = find_parts(scan.vertices * scale + shift, registration)
    if parts is not None:
        labels[scan.source[skin]] = parts[skin]
    posed = _InAPose.of(upright, registration)
    try:
        marks = find_landmarks(posed.scan, posed.surface, posed.registration, scale, shift)
        if given is not None:
            marks = given.override(marks, posed)
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
    arms: ArmPose | None
    """The arms' original pose; ``None``: not moved."""
    scan: Scan
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
