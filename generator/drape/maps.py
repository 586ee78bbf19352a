"""Maps of a drape: how far each vertex is stretched, how far it is from the skin, and how hard it presses on it.

The pressure is that of the job's own fabric in the shape of the drape. The drape computes with a fabric of limited
stiffness (``Fabric.softened``). Where the body gives the shape, as in a tight ring, the pressure is right; where cloth
hangs by its weight it is too high, by up to ``Maps.softened``.
"""

import numpy as np
import warp as wp
from jaxtyping import Float

from gcd_dataset.generator.body.surface import kept_per_body
from gcd_dataset.generator.device import launch_lock, load_kernels
from gcd_dataset.generator.drape.body_field import closed_skin
from gcd_dataset.generator.drape.config import GRAVITY, DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.fabrics import DYNES_PER_CM, POISSON, Fabric, shear_stiffness
from gcd_dataset.generator.drape.kernels import skin
from gcd_dataset.generator.quality import Deformation, deformation, principal_stretches
from gcd_dataset.records import Body, Drape, Maps, Outcome

CONTACT = DrapeConfig().body_gap + 0.15  # cm: nearer cloth rests on the skin
KPA = 1e-4  # one g/(cm s²)
TINY = 1e-12


def maps_of(job: DrapeJob, drape: Drape) -> Maps:
    """The maps of a drape of a job, computed on the CPU; all NaN for a drape that diverged or was not made."""
    mesh, vertices = job.box_mesh, np.asarray(drape.vertices, float)
    softened = max(np.divide(job.fabric.pull, job.fabric.softened().pull).tolist())
    if drape.outcome is Outcome.CANNOT_BE_PUT_ON or not np.isfinite(vertices).all():
        nothing = np.full(len(vertices), np.nan)
        return Maps(np.stack([nothing, nothing], axis=1), nothing, nothing, softened)
    corners = np.ascontiguousarray(mesh.faces.T)

    def gathered(*values: Float[np.ndarray, " f"]) -> Float[np.ndarray, " v"]:
        """The sum, at each vertex, of the values of its faces: one for all corners, or one for each."""
        weights = np.broadcast_to(values, (3, corners.shape[1])).ravel()
        return np.bincount(corners.ravel(), weights, minlength=len(vertices))

    shape = deformation(mesh, vertices)
    flat, stretches = gathered(shape.flat), principal_stretches(mesh, vertices)
    stretch = [gathered(shape.flat * each) / np.maximum(flat, TINY) for each in stretches.T]
    away, gap = _gaps(job.body, vertices)
    force = np.stack([gathered(*each) for each in _forces(shape, job.fabric)], axis=1)
    force[:, 1] -= job.fabric.mass * GRAVITY * flat / 3
    area = gathered(shape.flat * stretches[:, 0] * stretches[:, 1]) / 3
    pressure = -KPA * np.einsum("vi,vi->v", force, away) / np.maximum(area, TINY)
    return Maps(np.stack(stretch, axis=1), gap, np.where(gap < CONTACT, np.maximum(pressure, 0.0), 0.0), softened)


def _forces(shape: Deformation, fabric: Fabric) -> list[list[Float[np.ndarray, " f"]]]:
    """For each coordinate the forces of each face on its three corners [g cm/s²].

    The deformation gradient F is a rotation R times a stretch U. The strain U - 1 gives the tension S. A face is a
    constant-strain triangle; its stress is R S.
    """
    uu, vv, uv = shape.squares()
    area = np.sqrt(np.maximum(uu * vv - uv * uv, TINY))
    trace = np.sqrt(uu + vv + 2 * area)
    u, v, mixed = (uu + area) / trace, (vv + area) / trace, uv / trace
    pull_u, pull_v, pull_uv = _tension(fabric, u - 1.0, v - 1.0, mixed)
    weight = np.where(shape.thin, 0.0, shape.flat / area)
    pull_u, pull_v, pull_uv = weight * pull_u, weight * pull_v, weight * pull_uv
    au, bu, av, bv = shape.of_corners
    forces = []
    for along_u, along_v in shape.gradient:
        turned_u, turned_v = v * along_u - mixed * along_v, u * along_v - mixed * along_u
        stress_u, stress_v = turned_u * pull_u + turned_v * pull_uv, turned_u * pull_uv + turned_v * pull_v
        second, third = stress_v * bu - stress_u * bv, stress_u * av - stress_v * au
        forces.append([-second - third, second, third])
    return forces


def _tension(
    fabric: Fabric, u: Float[np.ndarray, " f"], v: Float[np.ndarray, " f"], mixed: Float[np.ndarray, " f"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tension along weft, warp and between them, from the strains [g/s²].

    Cloth that is compressed buckles: across the larger strain it is taken to be as narrow as without tension there, and
    a face without stretch has no tension.
    """
    warp, weft, _ = fabric.pull
    scale = DYNES_PER_CM / (1 - POISSON**2)
    a, b, across = scale * weft, scale * warp, scale * POISSON * (warp * weft) ** 0.5
    shear = DYNES_PER_CM * shear_stiffness(fabric.pull)
    middle, half = 0.5 * (u + v), 0.5 * (u - v)
    spread = np.hypot(half, mixed)
    cos, sin = half / np.maximum(spread, TINY), mixed / np.maximum(spread, TINY)  # of twice the angle to the weft
    c, s, double = 0.5 * (1 + cos), 0.5 * (1 - cos), 0.25 * sin * sin
    coupling = (a + b - 4 * shear) * double + across * (c * c + s * s)
    stiffness = a * s * s + b * c * c + 2 * (across + 2 * shear) * double
    large = np.maximum(middle + spread, 0.0)
    small = np.maximum(middle - spread, -coupling / stiffness * large)
    middle, spread = 0.5 * (large + small), 0.5 * (large - small)
    u, v, mixed = middle + spread * cos, middle - spread * cos, spread * sin
    return a * u + across * v, across * u + b * v, 2 * shear * mixed


def _gaps(body: Body, vertices: Float[np.ndarray, "v 3"]) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, " v"]]:
    """Unit direction away from the nearest point of the skin, and signed distance from it [cm]."""
    load_kernels("maps", skin, device="cpu")
    found = np.empty((len(vertices), 4), np.float32)
    with launch_lock:
        inputs = [_skin_of(body).id, wp.array(vertices.astype(np.float32), dtype=wp.vec3, device="cpu")]
        outputs = [wp.array(found, dtype=wp.vec4, device="cpu", copy=False)]
        wp.launch(skin.find_gaps, dim=len(vertices), inputs=inputs, outputs=outputs, device="cpu")
    return found[:, :3].astype(float), found[:, 3].astype(float)


@kept_per_body
def _skin_of(body: Body) -> wp.Mesh:
    points, triangles = closed_skin(body)
    return wp.Mesh(
        wp.array(points.astype(np.float32), dtype=wp.vec3, device="cpu"), wp.array(triangles, dtype=int, device="cpu")
    )
