"""Garments draped on the neutral body, and measures of how they lie round its arms and legs.

A limb is reduced to its axis, the straight line that fits its skin. A rim is a closed ring of border edges: the end of
a sleeve, an armhole, a hem.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.drape import DrapeJob, drape_batch
from gcd_dataset.generator.drape.moving import Motion
from gcd_dataset.generator.garments import GarmentDesign, design_from_dict, draw_garment
from gcd_dataset.generator.garments.wardrobe import Bottom
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.records import Body, BodyPart, BoxMesh, Drape, Measurements, Outcome
from tests.generator.drape.reference import segments_cross
from tests.generator.mesh.shapes import directed_edges

SIDES = {"left": 1.0, "right": -1.0}
LIMBS = {
    "left arm": BodyPart.LEFT_ARM,
    "right arm": BodyPart.RIGHT_ARM,
    "left leg": BodyPart.LEFT_LEG,
    "right leg": BodyPart.RIGHT_LEG,
}
GIRTHS = ("bust", "back_width", "waist", "waist_back_width", "hips", "hip_back_width", "leg_circ")


@dataclass(frozen=True)
class Worn:
    """A garment at rest."""

    mesh: BoxMesh
    drape: Drape
    body: Body

    def vertices_of(self, *panels: str) -> Int[np.ndarray, " n"]:
        """The vertices of all panels whose names start with one of ``panels``."""
        rows = [row for row, name in enumerate(self.mesh.panel_names) if name.startswith(panels)]
        return np.unique(self.mesh.faces[np.isin(self.mesh.panel_id, rows)])

    def openings(self, limb: str) -> list[Int[np.ndarray, " n"]]:
        """The rims round a limb of ``LIMBS``, or round its axis beyond its tip."""
        axis = Axis.of(self.body, limb)
        at = self.drape.vertices
        return [rim for rim in rims(self.mesh.faces) if axis.winding(at[rim]) and axis.share(at[rim]).mean() > 0.0]

    def from_skin(self, vertices: Int[np.ndarray, " n"], limb: str) -> float:
        """Largest distance of the vertices from the limb's skin [cm]."""
        return float(cKDTree(skin(self.body, limb)).query(self.drape.vertices[vertices])[0].max())

    def under_soles(self, *, inset: float) -> Int[np.ndarray, " n"]:
        """The vertices below the floor and more than ``inset`` [cm] inside the outline of a foot."""
        below = np.flatnonzero(self.drape.vertices[:, 1] < 0.0)
        points = shapely.points(self.drape.vertices[below][:, [0, 2]])
        feet = self.body.vertices[self.body.parts == BodyPart.FEET.value][:, [0, 2]]
        soles = [shapely.MultiPoint(feet[side * feet[:, 0] > 0.0]).convex_hull for side in SIDES.values()]
        return below[shapely.contains(shapely.union_all(soles).buffer(-inset), points)]

    def most_stretched(self, rim: Int[np.ndarray, " n"]) -> float:
        """Largest length over flat length of the edges of a rim."""
        mesh = self.mesh
        sides = directed_edges(mesh.corners)
        flat = np.linalg.norm(mesh.uv[sides[:, 1]] - mesh.uv[sides[:, 0]], axis=1)
        known = dict(zip(map(tuple, mesh.uv_vertex[sides].tolist()), flat.tolist(), strict=True))
        here, ends = self.drape.vertices[rim], zip(rim.tolist(), np.roll(rim, -1).tolist(), strict=True)
        lengths = np.linalg.norm(np.roll(here, -1, axis=0) - here, axis=1)
        return float((lengths / [known[end] for end in ends]).max())


@cache
def neutral(*, legs_apart: bool = False) -> tuple[Body, Measurements]:
    """The neutral body, and its measures with legs together."""
    shape = neutral_shape()
    return build_body(replace(shape, legs_apart=legs_apart)), measure(build_body(shape))


def skin(body: Body, limb: str) -> Float[np.ndarray, "n 3"]:
    """Vertices of a limb of ``LIMBS`` with its hand or foot [cm]."""
    side = SIDES[limb.split()[0]]
    tip = BodyPart.HANDS if limb.endswith("arm") else BodyPart.FEET
    own = (body.parts == LIMBS[limb].value) | ((body.parts == tip.value) & (side * body.vertices[:, 0] > 0.0))
    return body.vertices[own]


def stouter(size: Measurements, factor: float) -> Measurements:
    """Measures of a wearer of the same height with ``factor`` times the girths of the trunk."""
    return replace(size, **{girth: factor * getattr(size, girth) for girth in GIRTHS})


@cache
def wear(design: GarmentDesign, *, cut_for: Measurements | None = None, spacing: float = 3.0) -> Worn:
    """Drape a design on the neutral body. A garment cut for other measures (``cut_for``) is moved to its waist."""
    legs_apart = design.meta.bottom is Bottom.PANTS
    body, size = neutral(legs_apart=legs_apart)
    other = cut_for or size
    mesh = build_box_mesh(draw_garment(other, design), spacing=spacing)
    mesh = replace(mesh, vertices=mesh.vertices - [0.0, other.waist_level - size.waist_level, 0.0])
    [drape] = drape_batch([DrapeJob(mesh, body, size)], device="cpu", at_once=1)
    return Worn(mesh, drape, body)


def job_of(design: Mapping[str, Any], *, spacing: float, legs_apart: bool = False) -> DrapeJob:
    """A garment with these sections of its design, on the neutral body."""
    body, size = neutral(legs_apart=legs_apart)
    return DrapeJob(build_box_mesh(draw_garment(size, design_from_dict(design)), spacing=spacing), body, size)


@dataclass(frozen=True)
class Axis:
    """The axis of a limb, from the trunk outward [cm]."""

    start: Float[np.ndarray, "3"]
    end: Float[np.ndarray, "3"]

    @classmethod
    def of(cls, body: Body, limb: str) -> "Axis":
        """The axis of a limb of ``LIMBS`` with its hand or foot."""
        points, upper = skin(body, limb), body.vertices[body.parts == LIMBS[limb].value]
        middle = upper.mean(axis=0)
        along = np.linalg.svd(upper - middle, full_matrices=False)[2][0]
        along = along * -np.sign(along[1])  # limbs hang
        reach = (points - middle) @ along
        return cls(middle + reach.min() * along, middle + reach.max() * along)

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.end - self.start))

    def share(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Position along the limb, 0 at its start and 1 at its tip."""
        return (points - self.start) @ self._along / self.length

    def winding(self, ring: Float[np.ndarray, "n 3"]) -> int:
        """Absolute winding number of a ring round the axis."""
        x, y = np.linalg.svd(self._along[None])[2][1:] @ (ring - self.start).T
        turns = np.angle(np.roll(x + 1j * y, -1) / (x + 1j * y)).sum() / (2 * np.pi)
        return abs(round(float(turns)))

    def pierces(self, triangles: Float[np.ndarray, "f 3 3"]) -> int:
        """Number of triangles that the axis crosses between the limb's start and its tip."""
        return int(segments_cross(self.start, self.end, *triangles.transpose(1, 0, 2)).sum())

    @property
    def _along(self) -> Float[np.ndarray, "3"]:
        return (self.end - self.start) / self.length


def rims(faces: Int[np.ndarray, "f 3"]) -> list[Int[np.ndarray, " n"]]:
    """The closed rings of border edges, each as its vertices in order."""
    whole = set(map(tuple, directed_edges(faces).tolist()))
    following: dict[int, list[int]] = {}
    for a, b in sorted(whole):
        if (b, a) not in whole:
            following.setdefault(a, []).append(b)
    return list(_rings(following))


def _rings(following: dict[int, list[int]]) -> Iterable[Int[np.ndarray, " n"]]:
    """Follow the successors of each vertex; several rings may share a vertex."""
    while following:
        ring = [next(iter(following))]
        while (at := ring[-1]) in following:
            ring.append(following[at].pop())
            if not following[at]:
                del following[at]
        yield np.array(ring[:-1])


def still(
    _: object, rests: Sequence[Drape], ways: Sequence[Iterable[Motion]], **__: object
) -> Iterator[tuple[int, Drape]]:
    """In place of ``drape_on``: cloth that stays where it is."""
    moving = ((k, rest) for k, rest in enumerate(rests) if rest.outcome is Outcome.SETTLED)
    return ((k, rest) for k, rest in moving for part in ways[k] for _ in part.keys[1:])
