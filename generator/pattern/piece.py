"""Pieces: panels under construction, with named edges and a placement round the body.

``assemble.py`` turns pieces into ``records.Panel``: it divides edges for their seams, turns loops counter-clockwise as
seen from outside, and numbers corners.
"""

from dataclasses import dataclass, replace
from typing import Self, TypeAlias

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import Point
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.pattern.outline import Outline
from gcd_dataset.generator.pattern.seam import Interface, Section
from gcd_dataset.generator.pattern.stroke import rotate
from gcd_dataset.records import PanelRole, Placement

Vector: TypeAlias = tuple[float, float, float]

UNTURNED: Vector = (0.0, 0.0, 0.0)

LYING_FLAT = 0.999  # cosine of the angle between a normal and the vertical: within 2.6 degrees


@dataclass(frozen=True, slots=True)
class Piece:
    """A closed outline with its placement before sewing and the part of the body it covers."""

    name: str
    outline: Outline
    translation: Vector = (0.0, 0.0, 0.0)
    """Position of the drawing's origin [cm]."""
    rotation: Vector = (0.0, 0.0, 0.0)
    """Angles about the fixed x, y, z axes, applied in that order [rad]."""
    label: PanelRole | str = ""
    """The part of the body it covers; empty if not decided yet."""

    def __post_init__(self) -> None:
        if not self.outline.closed:
            raise PatternError(f"panel {self.name}: the outline is not closed")

    def at(self, x: float, y: float, z: float) -> Self:
        """Moved so that the origin of its drawing is at a point [cm]."""
        return type(self)(self.name, self.outline, (x, y, z), self.rotation, self.label)

    def moved(self, by: Vector) -> Self:
        """Shifted in space [cm]."""
        x, y, z = self.translation
        return self.at(x + by[0], y + by[1], z + by[2])

    def turned(self, angle: float) -> Self:
        """Turned about the z axis through the world's origin [rad]."""
        x, y = rotate(self.translation[:2], angle)
        about_x, about_y, about_z = self.rotation
        turned = (about_x, about_y, about_z + angle)  # z is the last axis applied, so turns about it add up
        return replace(self, translation=(x, y, self.translation[2]), rotation=turned)

    def mirrored(self, name: str) -> Self:
        """The mirror image about the plane x = 0, with a new name."""
        (x, y, z), (a, b, c) = self.translation, self.rotation
        return replace(self, name=name, outline=self.outline.mirrored(), translation=(-x, y, z), rotation=(a, -b, -c))

    def along(self, *edges: str, ruffle: float = 1.0) -> Interface:
        """The interface of these edges in turn, each in drawing direction; ``ruffle``: see ``Section``."""
        return tuple(Section(self.name, edge, ruffle=ruffle) for edge in edges)

    def against(self, *edges: str, ruffle: float = 1.0) -> Interface:
        """The interface of these edges in turn, each against its drawing direction; ``ruffle``: see ``Section``."""
        return tuple(Section(self.name, edge, backward=True, ruffle=ruffle) for edge in edges)

    @property
    def placement(self) -> Placement:
        """Translation and rotation as a record."""
        return Placement(np.array(self.translation), np.array(self.rotation))

    def in_space(self, point: Point) -> Vector:
        """A point of the drawing in space [cm]."""
        if self.rotation == UNTURNED:
            x, y, z = self.translation
            return (x + point[0], y + point[1], z)
        x, y, z = self.placement.apply(np.array(point)).tolist()
        return (x, y, z)

    def points(self, edge: str | None = None) -> Float[np.ndarray, "n 3"]:
        """Points along the outline, or along one edge, in space [cm]."""
        flat = self.outline.points() if edge is None else np.concatenate([s.points() for s in self.outline.run(edge)])
        if self.rotation == UNTURNED:
            return np.column_stack([flat, np.zeros(len(flat))]) + self.translation
        return self.placement.apply(flat)

    @property
    def faces_out(self) -> bool:
        """Whether the drawing is counter-clockwise as seen from outside the wearer.

        Outside is away from the vertical axis through the wearer, and above for a piece that lies flat. Raises
        ``PatternError`` for a piece that is seen edge-on from outside.
        """
        if self.rotation == UNTURNED:  # nearly all pieces: upright, in front or behind
            return self._runs_outwards(self.translation[2])
        corners = self.placement.apply(np.array([stroke.start for stroke in self.outline.strokes]))
        centre, normal = corners.mean(axis=0), self.placement.matrix[:, 2]
        lies_flat = bool(abs(normal[1]) > LYING_FLAT)
        outward = float(normal[1] if lies_flat else normal[0] * centre[0] + normal[2] * centre[2])
        return self._runs_outwards(outward)

    def _runs_outwards(self, outward: float) -> bool:
        """Whether the drawing is counter-clockwise from outside; ``outward`` > 0 if its plane's normal points out."""
        if outward == 0.0:
            raise PatternError(f"panel {self.name} has no outer side: turn it, or move it off the wearer's axis")
        return (outward > 0) == (self.outline.area > 0)
