"""Any body measured: ours by known vertices, every other by landmarks found on it or given by name."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.doubts import require_body_alone, require_free_limbs, require_skin
from gcd_dataset.generator.body.find import found_marks, found_parts
from gcd_dataset.generator.body.geodesic import net_between
from gcd_dataset.generator.body.marks import GivenMarks, Marks, own_marks
from gcd_dataset.generator.body.register import register
from gcd_dataset.generator.body.scan import Scan
from gcd_dataset.generator.body.tailor import Taken, own_sites, sites_of, take
from gcd_dataset.generator.body.upright import Placing, placed
from gcd_dataset.records import Body, Measurements, Record

__all__ = ["Fitted", "fit_tape", "measure", "measure_closely"]


def measure(body: Body) -> Measurements:
    """The 26 measures of a body. Raises ``BodyError`` where no body, or no skin at a landmark, is found."""
    return measure_closely(body).measurements


def measure_closely(body: Body) -> Taken:
    """The measures of a body, with the levels of its girths and which of them end on the border of the search."""
    vertices = np.asarray(body.vertices, float)
    own = body_model().faces
    if body.faces is own or np.array_equal(body.faces, own):
        return take(vertices, own_marks(vertices), own_sites())
    return fit_tape(vertices, body.faces, body.name).taken


@dataclass(frozen=True, eq=False)
class Fitted(Record):
    """What was found out about a mesh of which nothing was known."""

    taken: Taken
    marks: Marks
    """In the turned mesh's coordinates, soles at y = 0 [cm]."""
    parts: UInt8[np.ndarray, " v"]
    """``BodyPart`` of each vertex of the mesh as it came."""
    placing: Placing
    """What makes the mesh stand upright and face +z at y = 0."""
    misfit: float
    """Mean distance of our body model from the skin, as it was laid over it [cm of a body of 172 cm]."""


def fit_tape(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    name: str = "body",
    *,
    given: GivenMarks | None = None,
    parts: UInt8[np.ndarray, " v"] | None = None,
) -> Fitted:
    """A mesh [cm] measured by what is found on it; ``given`` landmarks and ``parts`` take the place of those found.

    The mesh may have holes that no tape crosses, and its faces may look either way. Raises ``BodyError`` where no body
    is found in it, or where a measure would be a guess.
    """
    standing = placed(Scan.of(vertices, faces, name), name)
    scan, scale = standing.scan, standing.scale
    registration = register(standing.surface, standing.guess)
    require_body_alone(scan, standing.surface, registration, name)
    labels = found_parts(scan.vertices * scale + standing.shift, registration)
    if parts is not None:
        labels[scan.source] = parts
    try:
        marks = found_marks(scan, standing.surface, registration, scale, standing.shift)
        if given is not None:
            marks = given.over(marks, standing.placing)
        arm, mesh = net_between(scan.vertices, scan.faces, marks.points["shoulder_right"], marks.points["wrist_right"])
        sites = sites_of(scan.vertices, scan.faces, labels, marks, arm)
        taken = take(mesh, marks, sites)
    except BodyError as error:
        raise BodyError(f"{name}: {error}") from error
    require_skin(scan, marks, sites, taken, name)
    require_free_limbs(scan, labels, taken, name)
    return Fitted(taken, marks, labels[scan.source], standing.placing, registration.guess.misfit)
