"""Maps of a drape: how far each vertex is stretched, how far it is from the skin, and how hard it presses on it.

The pressure is that of the job's own fabric in the shape of the drape. The drape computes with a fabric of limited
stiffness (``Fabric.softened``). Where the body gives the shape, as in a tight ring, the pressure is right; where cloth
hangs by its weight it is too high, by up to ``Maps.softened``.
"""

from collections.abc import Sequence

import numpy as np
import warp as wp
from jaxtyping import Float

from gcd_dataset.generator.body.surface import kept_per_body
from gcd_dataset.generator.device import launch_lock, load_kernels, native_builds, resolve_device, to_host
from gcd_dataset.generator.drape.body_field import closed_skin
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.kernels import maps as kernels
from gcd_dataset.generator.drape.kernels import topology
from gcd_dataset.generator.drape.kernels.sheet import Sheet, sheet_of
from gcd_dataset.generator.drape.topology import MeshBatch
from gcd_dataset.records import Body, Drape, Maps, Outcome

CONTACT = DrapeConfig().body_gap + 0.15  # cm: nearer cloth rests on the skin


def maps_of(job: DrapeJob, drape: Drape, *, device: str = "auto") -> Maps:
    """The maps of a drape of a job; all NaN for a drape that diverged or was not made.

    ``device``: see ``resolve_device``; raises ``ConfigError`` for an unknown one.
    """
    return PendingMaps([(job, drape)], resolve_device(device)).maps()[0]


class PendingMaps:
    """Maps of drapes that a device is computing."""

    def __init__(self, draped: Sequence[tuple[DrapeJob, Drape]], device: str) -> None:
        self._draped = draped
        self._result: wp.array | None = None
        self._kept: object = None
        if known := [(job, drape.vertices) for job, drape in draped if has_maps(drape)]:
            jobs, at = zip(*known, strict=True)
            self._launch(jobs, at, device)

    def maps(self) -> list[Maps]:
        """Wait for the maps of each drape. Call once."""
        found = np.empty((0, 4)) if self._result is None else to_host(self._result).astype(float)
        self._kept = None
        first, maps = 0, []
        for job, drape in self._draped:
            count = len(drape.vertices)
            if not has_maps(drape):
                maps.append(Maps.unknown(count))
                continue
            values, first = found[first : first + count], first + count
            softened = max(np.divide(job.fabric.pull, job.fabric.softened().pull).tolist())
            maps.append(Maps(values[:, :2], values[:, 2], values[:, 3], softened))
        return maps

    def _launch(self, jobs: Sequence[DrapeJob], at: Sequence[Float[np.ndarray, "_ 3"]], device: str) -> None:
        load_kernels("maps", kernels, topology, device=device)
        meshes = [job.box_mesh for job in jobs]
        batch, skins = MeshBatch.of(meshes, device), _skins([job.posed_body for job in jobs], device)
        world = np.repeat(np.arange(len(jobs), dtype=np.int32), [len(vertices) for vertices in at])
        with launch_lock:
            surface = batch.surface(meshes)
            batch.find_faces(surface)
            inputs = [
                surface,
                wp.array(world, dtype=int, device=device),
                wp.array([sheet_of(job.fabric) for job in jobs], dtype=Sheet, device=device),
                wp.array([skin.id for skin in skins], dtype=wp.uint64, device=device),
                batch.joined(at, np.float32, wp.vec3),
                CONTACT,
            ]
            self._result = batch.empty(len(world), wp.vec4)
            batch.launch(kernels.describe, len(world), inputs, [self._result])
        self._kept = skins, inputs


def _skins(bodies: Sequence[Body], device: str) -> list[wp.Mesh]:
    """The closed skin of each body on a device."""
    with launch_lock:
        missing = {id(body): body for body in bodies if device not in _on_devices(body)}.values()
        closed = [closed_skin(body) for body in missing]
        at = [one.skin.points(body.vertices).astype(np.float32) for one, body in zip(closed, missing, strict=True)]
        points = [wp.array(vertices, dtype=wp.vec3, device=device) for vertices in at]
        triangles = [wp.array(one.triangles, dtype=int, device=device) for one in closed]
        with native_builds(device):
            for body, *skin in zip(missing, points, triangles, strict=True):
                _on_devices(body)[device] = wp.Mesh(*skin)
        return [_on_devices(body)[device] for body in bodies]


@kept_per_body
def _on_devices(_: Body) -> dict[str, wp.Mesh]:
    """The skin of a body by device, filled by ``_skins``."""
    return {}


def has_maps(drape: Drape) -> bool:
    """Whether a drape was made and did not diverge."""
    return drape.outcome is not Outcome.CANNOT_BE_PUT_ON and bool(np.isfinite(drape.vertices).all())
