"""Any body measured: ours by known vertices, every other by landmarks found on it or given by name."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Float, Int, UInt8

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.arms import A_POSE_TOLERANCE, Arms, model_mesh_in_a_pose, turn_off_a_pose
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
from gcd_dataset.generator.body.tailor import MeasureResult, model_sites, sites_of, take
from gcd_dataset.generator.body.upright import StandingTransform, UprightScan, placed
from gcd_dataset.records import Body, BodyPart, Measurements, Record

__all__ = ["FoundBody", "find_body", "measure", "measure_closely", "measure_model_mesh"]


def measure(body: Body) -> Measurements:
    """The 26 measures of a body. Raises ``BodyError`` where no body, or no skin at a landmark, is found."""
    return measure_closely(body).measurements


def measure_closely(body: Body) -> MeasureResult:
    """The measures of a body, with the levels of its girths and which of them end on the border of the search."""
    vertices = np.asarray(body.vertices, float)
    own = body_model().faces
    if body.faces is own or np.array_equal(body.faces, own):
        return measure_model_mesh(vertices)
    return find_body(vertices, body.faces, body.name).taken


def measure_model_mesh(vertices: Float[np.ndarray, "v 3"]) -> MeasureResult:
    """The measures of a body of our own mesh, as with its arms about in the A-pose.

    Where they are held otherwise they are laid there first, and only ``arm_pose_angle`` tells how they are held.
    """
    marks = model_landmarks(vertices)
    angle = float(sinking(marks.points["shoulder_right"], marks.points["wrist_right"]))
    if not turn_off_a_pose(angle):
        return take(vertices, marks, model_sites())
    laid = model_mesh_in_a_pose(vertices)
    return _with_arms_at(angle, take(laid, model_landmarks(laid), model_sites()))


def _with_arms_at(angle: float, taken: MeasureResult) -> MeasureResult:
    return replace(taken, measurements=replace(taken.measurements, arm_pose_angle=angle))


@dataclass(frozen=True, eq=False)
class FoundBody(Record):
    """What was found out about a mesh of which nothing was known."""

    taken: MeasureResult
    marks: Landmarks
    """In the turned mesh's coordinates, soles at y = 0 [cm]."""
    parts: UInt8[np.ndarray, " v"]
    """``BodyPart`` of each vertex of the mesh as it came; loose pieces are internal."""
    placing: StandingTransform
    """What makes the mesh stand upright and face +z at y = 0."""
    misfit: float
    """Mean distance of our body model from the skin, as it was laid over it [cm of a body of 172 cm]."""
    arms: float
    """By how much the arms were turned to the A-pose to be measured [rad]; 0 where they were near it."""
    holes: Float[np.ndarray, " h"]
    """Distance across each hole in the skin [cm]."""
    underbust_error: float
    """By how much the underbust may be off, as its level is not sure [cm]."""
    edge: float
    """Mean length of the mesh's edges [cm]."""
    sagitta: float
    """How far its triangles lie under a smooth skin on average [cm]."""


def find_body(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    name: str = "body",
    *,
    given: GivenLandmarks | None = None,
    parts: UInt8[np.ndarray, " v"] | None = None,
) -> FoundBody:
    """A mesh [cm] measured by what is found on it; ``given`` landmarks and ``parts`` take the place of those found.

    The mesh may have holes that no tape crosses, and its faces may look either way. Arms that are held otherwise than
    in the A-pose are laid there first; only ``arm_pose_angle`` tells how they are held. Raises ``BodyError`` where no
    body is found in it, or where a measure would be a guess.
    """
    standing = placed(Scan.of(vertices, faces, name), name)
    scan, scale, shift = standing.scan, standing.scale, standing.shift
    registration = register(standing.surface, standing.guess)
    require_body_alone(scan, standing.surface, registration, name)
    labels = find_parts(scan.vertices * scale + shift, registration)
    if parts is not None:
        labels[scan.source] = parts
    lowered = _Lowered.of(standing, registration)
    try:
        marks = find_landmarks(lowered.scan, lowered.surface, lowered.registration, scale, shift)
        if given is not None:
            marks = given.over(marks, lowered)
        net, mesh = graph_between(
            lowered.scan.vertices, scan.faces, marks.points["shoulder_right"], marks.points["wrist_right"]
        )
        sites = sites_of(lowered.scan.vertices, scan.faces, labels, marks, net)
        taken = take(mesh, marks, sites)
    except BodyError as error:
        raise BodyError(f"{name}: {error}") from error
    require_skin(lowered.scan, marks, sites, taken, name)
    require_free_limbs(scan, labels, taken, name)
    own = np.where(scan.loose, BodyPart.INTERNAL.value, labels[scan.source]).astype(np.uint8)
    return FoundBody(
        taken=lowered.as_held(taken, marks),
        marks=lowered.marks_as_held(marks),
        parts=own if parts is None else parts,
        placing=standing.placing,
        misfit=registration.guess.misfit,
        arms=lowered.turn,
        holes=scan.holes,
        underbust_error=underbust_uncertainty(lowered.scan, sites, taken, registration.guess.misfit),
        edge=scan.edge,
        sagitta=scan.sagitta,
    )


@dataclass(frozen=True, eq=False)
class _Lowered(Record):
    """A standing scan with its arms in the A-pose: as it came, where they are nearly there."""

    standing: UprightScan
    arms: Arms | None
    """What moved them."""
    scan: Scan
    surface: SkinSurface
    registration: Registration

    @classmethod
    def of(cls, standing: UprightScan, registration: Registration) -> Self:
        scan = standing.scan
        if np.linalg.norm(registration.guess.arm_turns, axis=1).max() < A_POSE_TOLERANCE:
            return cls(standing, None, scan, standing.surface, registration)
        arms = Arms.of(standing.surface, registration)
        scaled = arms.laid(scan.vertices * standing.scale + standing.shift)
        surface = SkinSurface.of(scaled, scan.faces, scan.patched)
        scan = replace(scan, vertices=(scaled - standing.shift) / standing.scale)
        return cls(standing, arms, scan, surface, registration_at(surface, arms.hanging.guess))

    @property
    def turn(self) -> float:
        return 0.0 if self.arms is None else self.arms.turn

    def apply(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Points of the file, on the body that is measured."""
        points = self.standing.placing.apply(points)
        return points if self.arms is None else self._moved(self.arms.laid, points)

    def marks_as_held(self, marks: Landmarks) -> Landmarks:
        """LandmarkTable where they are on the body as it stands."""
        if self.arms is None:
            return marks
        points = {name: self._moved(self.arms.held_at, at[None])[0] for name, at in marks.points.items()}
        rings = {name: self._moved(self.arms.held_at, ring) for name, ring in marks.rings.items()}
        return replace(marks, points=points, rings=rings)

    def as_held(self, taken: MeasureResult, marks: Landmarks) -> MeasureResult:
        """The measures with the one that tells how the arms are held."""
        points = self.marks_as_held(marks).points
        return _with_arms_at(float(sinking(points["shoulder_right"], points["wrist_right"])), taken)

    def _moved(self, way: Callable[[np.ndarray], np.ndarray], points: np.ndarray) -> np.ndarray:
        scale, shift = self.standing.scale, self.standing.shift
        return (way(points * scale + shift) - shift) / scale
