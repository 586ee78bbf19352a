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
from gcd_dataset.generator.body.register import Registration, register, registration_at
from gcd_dataset.generator.body.scan import Scan
from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.generator.body.tailor import MeasureResult, measure_at, model_sites, sites_of
from gcd_dataset.generator.body.upright import StandingTransform, UprightScan, find_upright
from gcd_dataset.records import Body, BodyPart, Measurements, Record

__all__ = ["FoundBody", "find_body", "measure", "measure_closely", "measure_model_mesh"]


def measure(body: Body) -> Measurements:
    """The 26 measures of a body. Raises ``BodyError`` if the mesh holds no body, or no skin at a landmark."""
    return measure_closely(body).measurements


def measure_closely(body: Body) -> MeasureResult:
    """The measures of a body, with the level of each girth; see ``MeasureResult``."""
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
    transform: StandingTransform
    """From the input to a body that stands upright on y = 0 and faces +z."""
    misfit: float
    """Mean distance of the registered body model from the skin, scaled to the model's height [cm]."""
    arm_turn: float
    """Rotation of the arms to the A-pose before measuring [rad]; 0 if they were near it."""
    holes: Float[np.ndarray, " h"]
    """Distance across each hole in the skin [cm]."""
    underbust_error: float
    """Possible error of the underbust, from the uncertainty of its level [cm]."""
    mean_edge: float
    """Mean length of the mesh's edges [cm]."""
    sagitta: float
    """Mean depth of the triangles under a smooth skin [cm]."""


def find_body(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    name: str = "body",
    *,
    given: GivenLandmarks | None = None,
    parts: UInt8[np.ndarray, " v"] | None = None,
) -> FoundBody:
    """Find landmarks and parts of a mesh [cm] and measure it; ``given`` landmarks and ``parts`` override found ones.

    The mesh may have holes away from the tapes, and faces wound either way. Arms in another pose are moved to the
    A-pose first; only ``arm_pose_angle`` refers to the given pose. Raises ``BodyError`` if no body is found, or if a
    measure could not be trusted.
    """
    upright = find_upright(Scan.of(vertices, faces, name), name)
    scan, scale, shift = upright.scan, upright.scale, upright.shift
    registration = register(upright.surface, upright.alignment)
    require_body_alone(scan, upright.surface, registration, name)
    labels = find_parts(scan.vertices * scale + shift, registration)
    if parts is not None:
        labels[scan.source] = parts
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
        transform=upright.transform,
        misfit=registration.alignment.misfit,
        arm_turn=posed.turn,
        holes=scan.holes,
        underbust_error=underbust_uncertainty(posed.scan, sites, result, registration.alignment.misfit),
        mean_edge=scan.mean_edge,
        sagitta=scan.sagitta,
    )


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
