"""Landmarks and parts of a mesh from its geometry alone: our body model is laid over it and tells where they are."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial import cKDTree

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.marks import Marks, own_marks
from gcd_dataset.generator.body.register import Registration
from gcd_dataset.generator.body.scan import Scan
from gcd_dataset.generator.body.surface import Surface
from gcd_dataset.records import BodyPart, Record

__all__ = ["found_marks", "found_parts"]

AROUND = 6.0  # cm about a landmark, where the model's misfit tells how sure it is
HALF_SURE = 1.5  # cm of misfit at which it is as likely wrong as right


def found_marks(scan: Scan, surface: Surface, registration: Registration) -> Marks:
    """The model's landmarks on the nearest skin. ``surface`` is the scan's."""
    model = own_marks(registration.vertices)
    near = {name: surface.nearest(np.atleast_2d(at)) for name, at in (model.points | model.rings).items()}
    tree = cKDTree(registration.vertices)
    confidence = {}
    for name, at in near.items():
        around = np.unique(np.concatenate(tree.query_ball_point(at.points, AROUND) + [[]]).astype(int))
        misfit = np.sqrt((registration.distances[around] ** 2).mean()) if len(around) else np.inf
        patched = scan.patched[at.faces].mean()
        confidence[name] = float((1 - patched) / (1 + (misfit / HALF_SURE) ** 2))
    return Marks(
        {name: near[name].points[0] for name in model.points},
        {name: near[name].points for name in model.rings},
        confidence,
    )


def found_parts(vertices: Float[np.ndarray, "v 3"], registration: Registration) -> UInt8[np.ndarray, " v"]:
    """``BodyPart`` of each vertex: that of the nearest vertex of the model's skin."""
    parts = body_model().parts
    skin = np.flatnonzero(parts != BodyPart.INTERNAL.value)
    return parts[skin[cKDTree(registration.vertices[skin]).query(vertices)[1]]]
