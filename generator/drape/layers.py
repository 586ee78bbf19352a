"""How the garments of an outfit lie over each other."""

from collections.abc import Sequence

import numpy as np
import warp as wp
from jaxtyping import Float, Int

from gcd_dataset.generator.device import launch_lock, load_kernels, native_builds, resolve_device, to_host
from gcd_dataset.generator.drape.body_field import closed_skin
from gcd_dataset.generator.drape.kernels import layers as kernels
from gcd_dataset.generator.dressing.worn import WornCloth
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import Body, BodyPart, Layer

TRUNK = (BodyPart.TRUNK, BodyPart.HEAD)
LIMBS = (  # the side of the body, 0 for both, and the parts of each; the order that ``kernels.ARMS`` counts on
    (1.0, (BodyPart.LEFT_ARM, BodyPart.HANDS)),
    (-1.0, (BodyPart.RIGHT_ARM, BodyPart.HANDS)),
    (0.0, (*TRUNK, BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG, BodyPart.FEET)),
    (0.0, (*TRUNK, BodyPart.LEFT_LEG)),
    (0.0, (*TRUNK, BodyPart.RIGHT_LEG)),
)
LIMB_OF = {
    BodyPart.LEFT_ARM: 0, BodyPart.RIGHT_ARM: 1, BodyPart.TRUNK: 2, BodyPart.LEFT_LEG: 3, BodyPart.RIGHT_LEG: 4
}  # fmt: skip
"""The row of ``LIMBS`` for each part of ``WornCloth.parts``: a hem over the thighs belongs to the trunk's cloth."""

NOWHERE = np.full((3, 3), 1.0e5)  # cm: the triangle of a limb that a body lacks


def layers_of(garments: Sequence[WornCloth], body: Body, *, device: str = "auto") -> tuple[Layer, ...]:
    """How each pair of garments lies, by ``outer``, then ``inner``; ``garments``: from the skin outwards.

    ``device``: see ``resolve_device``; raises ``ConfigError`` for an unknown one.
    """
    device = resolve_device(device)
    load_kernels("layers", kernels, device=device)
    table = np.zeros(max(part.value for part in BodyPart) + 1, np.int32)
    table[[part.value for part in LIMB_OF]] = list(LIMB_OF.values())
    with launch_lock:
        skins = _limbs(body, device)
        meshes = [_mesh(cloth.vertices, cloth.faces, device) for cloth in garments]
        edges = [
            wp.array(mesh_edges(cloth.faces).ends.astype(np.int32), dtype=wp.vec2i, device=device) for cloth in garments
        ]
        limbs = wp.array([mesh.id for mesh in skins], dtype=wp.uint64, device=device)
        pairs, counts = [(inner, outer) for outer in range(len(garments)) for inner in range(outer)], []
        for inner, outer in pairs:
            crossings = wp.zeros(1, dtype=int, device=device)
            for one, other in ((inner, outer), (outer, inner)):
                inputs = [meshes[one].points, edges[one], meshes[other].id]
                wp.launch(kernels.count_edges_through, len(edges[one]), inputs, [crossings], device=device)
            at, of = meshes[inner].points, wp.array(table[garments[inner].parts], dtype=int, device=device)
            covered, wrong = (wp.zeros(len(at), dtype=int, device=device) for _ in range(2))
            wp.launch(kernels.order_layers, len(at), [limbs, of, at, meshes[outer].id], [covered, wrong], device=device)
            counts.append((crossings, covered, wrong))
    layers = []
    for (inner, outer), (crossings, covered, wrong) in zip(pairs, counts, strict=True):
        hidden = int(to_host(covered).sum())
        share = float(to_host(wrong).sum() / max(hidden, 1))
        layers.append(Layer(inner, outer, int(to_host(crossings)[0]), hidden, share))
    return tuple(layers)


def _limbs(body: Body, device: str) -> list[wp.Mesh]:
    """The skin of each of ``LIMBS``; a triangle far away for a limb that the body lacks."""
    skin = closed_skin(body).skin
    points, faces, parts = skin.points(body.vertices), skin.faces, skin.parts
    aside = points[faces, 0].sum(axis=1)
    limbs = []
    for side, own in LIMBS:
        tips = (parts != BodyPart.HANDS.value) | (side * aside >= 0.0)
        limb = faces[np.isin(parts, [part.value for part in own]) & tips]
        limbs.append(_mesh(points, limb, device) if len(limb) else _mesh(NOWHERE, np.array([[0, 1, 2]]), device))
    return limbs


def _mesh(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], device: str) -> wp.Mesh:
    points = wp.array(np.asarray(vertices, np.float32), dtype=wp.vec3, device=device)
    corners = wp.array(np.ravel(faces).astype(np.int32), dtype=int, device=device)
    with native_builds(device):
        return wp.Mesh(points, corners)
