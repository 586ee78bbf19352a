"""Pictures of garments on bodies by ray casting; needs neither a display nor OpenGL."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drawing import jpeg_bytes
from gcd_dataset.generator.lay_plan import PALETTE
from gcd_dataset.generator.render.plain_batch import Picture, Scene, View, start_render
from gcd_dataset.records import Body, BoxMesh, Sample

SKIN = (0.80, 0.76, 0.72)  # sRGB colour of bodies, 0 to 1


@dataclass(frozen=True)
class ColouredMesh:
    """A triangle mesh with a colour for each face: one object of a scene."""

    vertices: Float[np.ndarray, "v 3"]
    """[cm]"""
    faces: Int[np.ndarray, "f 3"]
    """Counter-clockwise on the right side."""
    colour_of_face: Int[np.ndarray, " f"]
    """Row of ``colours`` for each face."""
    colours: Float[np.ndarray, "n 3"]
    """sRGB, 0 to 1."""


def garment_scene(vertices: Float[np.ndarray, "v 3"], mesh: BoxMesh, body: Body) -> tuple[ColouredMesh, ColouredMesh]:
    """A scene: the body, and the garment at ``vertices`` [cm] with a colour for each panel."""
    skin = ColouredMesh(body.vertices, body.faces, np.broadcast_to(0, len(body.faces)), np.array([SKIN]))
    return skin, ColouredMesh(vertices, mesh.faces, mesh.panel_id % len(PALETTE), np.array(PALETTE))


def render_view(scene: Scene, *, size: int = 512, view: View = "front", device: str = "auto") -> Picture:
    """A square picture of a scene; deterministic, and framed alike from the front and from behind.

    Raises ``ConfigError`` for a missing device or a size below 1.
    """
    [(picture,)] = start_render([scene], [view], size=size, device=device).pictures()
    return picture


def render_garment(
    vertices: Float[np.ndarray, "v 3"], mesh: BoxMesh, body: Body, *, size: int = 512, device: str = "auto"
) -> tuple[Picture, Picture]:
    """Front and back of a garment at ``vertices`` [cm] on its body."""
    scene = garment_scene(vertices, mesh, body)
    [(front, back)] = start_render([scene], ["front", "back"], size=size, device=device).pictures()
    return front, back


def render_sample(sample: Sample, body: Body, *, size: int = 512, device: str = "auto") -> tuple[bytes, bytes]:
    """JPEGs of a draped sample on its body, front and back. Raises ``ConfigError`` for a sample without a drape."""
    if sample.box_mesh is None or sample.drape is None:
        raise ConfigError(f"{sample.key} is not draped: make it with stage drape to render it")
    front, back = render_garment(sample.drape.vertices, sample.box_mesh, body, size=size, device=device)
    return jpeg_bytes(front), jpeg_bytes(back)
