"""Pictures of garments on their bodies by ray casting, without display or GL."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.colours import PALETTE
from gcd_dataset.generator.drawing import jpeg_bytes
from gcd_dataset.generator.render_batch import Picture, Scene, View, expose
from gcd_dataset.records import Body, BoxMesh, Sample

__all__ = [
    "Painted",
    "painted_garment",
    "render_garment",
    "render_sample",
    "render_view",
]

SKIN = (0.80, 0.76, 0.72)


@dataclass(frozen=True)
class Painted:
    """Triangles with colours: a thing that a picture shows."""

    vertices: Float[np.ndarray, "v 3"]
    """[cm]"""
    faces: Int[np.ndarray, "f 3"]
    """Counter-clockwise on the right side."""
    paint: Int[np.ndarray, " f"]
    """Row of ``colours`` of each face."""
    colours: Float[np.ndarray, "n 3"]
    """sRGB, 0 to 1."""


def painted_garment(vertices: Float[np.ndarray, "v 3"], mesh: BoxMesh, body: Body) -> tuple[Painted, Painted]:
    """A body, and a garment at ``vertices`` [cm] on it, the panels in different colours."""
    skin = Painted(body.vertices, body.faces, np.broadcast_to(0, len(body.faces)), np.array([SKIN]))
    return skin, Painted(vertices, mesh.faces, mesh.panel_id % len(PALETTE), np.array(PALETTE))


def render_view(shown: Scene, *, size: int = 512, view: View = "front", device: str = "auto") -> Picture:
    """A square picture of all that is ``shown``, framed alike from the front and from behind; the same on every run.

    Raises ``ConfigError`` for a device that is not there, or a picture without pixels.
    """
    [(picture,)] = expose([shown], [view], size=size, device=device).pictures()
    return picture


def render_garment(
    vertices: Float[np.ndarray, "v 3"], mesh: BoxMesh, body: Body, *, size: int = 512, device: str = "auto"
) -> tuple[Picture, Picture]:
    """Front and back of a garment at ``vertices`` [cm] on its body."""
    shown = painted_garment(vertices, mesh, body)
    [(front, back)] = expose([shown], ["front", "back"], size=size, device=device).pictures()
    return front, back


def render_sample(sample: Sample, body: Body, *, size: int = 512, device: str = "auto") -> tuple[bytes, bytes]:
    """JPEGs of a draped sample on its body, front and back. Raises ``ConfigError`` for a sample without a drape."""
    if sample.box_mesh is None or sample.drape is None:
        raise ConfigError(f"{sample.key} is not draped: there is nothing to render")
    front, back = render_garment(sample.drape.vertices, sample.box_mesh, body, size=size, device=device)
    return jpeg_bytes(front), jpeg_bytes(back)
