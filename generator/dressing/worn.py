"""Cloth at rest on a body, over which another garment is put on."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from gcd_dataset.records import BodyPart, BoxMesh, PanelRole
from gcd_dataset.spec import is_trouser_leg


@dataclass(frozen=True, eq=False)
class WornCloth:
    """A draped garment, as the garments over it meet it."""

    vertices: Float[np.ndarray, "v 3"]
    """Positions at rest [cm]."""
    faces: Int[np.ndarray, "f 3"]
    """Triangles, counter-clockwise on the garment's outside."""
    parts: UInt8[np.ndarray, " v"]
    """``BodyPart`` value of the limb that each vertex covers; that of the trunk for skirts and panels without a label.
    """

    @classmethod
    def of(cls, mesh: BoxMesh, vertices: Float[np.ndarray, "v 3"]) -> Self:
        """The garment of a box mesh with its vertices at rest [cm]."""
        roles = np.array([str(role) for role in mesh.panel_labels])
        trousers = np.array([is_trouser_leg(name) for name in mesh.panel_names])
        parts = np.full(len(vertices), BodyPart.TRUNK.value, np.uint8)
        for panels, left, right in (
            (trousers, BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG),
            (roles == PanelRole.ARM, BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM),
        ):
            for side, part in ((1.0, left), (-1.0, right)):
                parts[mesh.faces[on_side(mesh, panels, side)]] = part.value
        return cls(np.asarray(vertices), mesh.faces, parts)


def on_side(mesh: BoxMesh, panels: Bool[np.ndarray, " p"], side: float) -> Bool[np.ndarray, " f"]:
    """The faces of those panels that lie to the left (1) or to the right (-1); a panel may reach past the middle."""
    x = np.bincount(mesh.panel_id, mesh.vertices[mesh.faces, 0].sum(axis=1), minlength=len(panels))
    return (panels & (side * x > 0.0))[mesh.panel_id]
