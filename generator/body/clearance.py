"""The gap between arms and trunk: sleeves and side seams need room there."""

import functools

import numpy as np
import shapely
from jaxtyping import Int

from gcd_dataset.generator.body.asset import body_model, landmark_table
from gcd_dataset.generator.body.section import section_points
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import Body, BodyPart

X, Y, Z = range(3)
ARMPIT = 3.0  # cm below the underarm point, where arm and trunk separate; GarmentCode's armholes reach 2.5 cm down


def arm_clearance(body: Body) -> float:
    """Least distance between the convex hulls of arm and trunk in the level section below the armpits [cm]."""
    level = body.vertices[landmark_table().points["underarm_right"], Y] - ARMPIT
    trunk, *arms = (_hull(body, part, level) for part in (BodyPart.TRUNK, BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM))
    return float(min(shapely.distance(trunk, arm) for arm in arms))


def _hull(body: Body, part: BodyPart, level: float) -> shapely.Geometry:
    points = section_points(body.vertices, _edges_of(part), Y, np.array([level]))[0]
    return shapely.convex_hull(shapely.multipoints(points[:, [X, Z]]))


@functools.cache
def _edges_of(part: BodyPart) -> Int[np.ndarray, "e 2"]:
    """Edges of the faces that lie in a part with all corners."""
    model = body_model()
    return mesh_edges(model.faces[(model.parts == part.value)[model.faces].all(axis=1)]).ends
