"""The same box meshes and bodies, draped by Newton's ``SolverStyle3D`` (Apache-2.0, package ``newton``).

Newton has no batches of cloth: garments stand apart in one model, which runs until the last one rests. Set up for best
speed: all skins are one shape, since contacts are tested between every vertex and every shape; two steps of 1/120 s per
frame with 4 nonlinear and 10 linear iterations; on a GPU, one captured graph per frame. Waist and collar are held as in
ours, by projecting vertices onto their plane after each step. The fabric is the same, in Newton's parameters.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp
from jaxtyping import Bool, Float, Int

from benchmarks.peers import newton_kernels
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.body.repair import VisibleSkin
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, Fabric
from gcd_dataset.generator.drape.fabrics import shear_stiffness
from gcd_dataset.generator.drape.holds import holds
from gcd_dataset.records import BoxMesh

M = 0.01  # metres in a cm
SPACING = 3.0  # m between garments
SUBSTEPS = 2
STEP = 1 / 120  # s
ITERATIONS, LINEAR_ITERATIONS = 4, 10
STILL = 5e-4  # m per frame; less counts as at rest
CONTACT_STIFFNESS = 1e3  # N/m
MAX_FRAMES = 300
POLL_EVERY = 4  # frames
GRAVITY = (0.0, -9.81, 0.0)  # m/s²


@dataclass(frozen=True)
class PeerDrapes:
    """Newton's result for a batch."""

    vertices: list[Float[np.ndarray, "v 3"]]
    """[cm]"""
    rested: Bool[np.ndarray, " w"]
    """Whether each garment came to rest within the frame budget."""
    frames: Int[np.ndarray, " w"]
    """Frames until rest, or all frames."""
    setup_seconds: float
    """Time to build the model and run the first frame, for the whole batch [s]."""
    solve_seconds: float


def require_newton() -> Any:
    """The package ``newton``. Raises ``ConfigError`` if it is not installed."""
    try:
        import newton
    except ImportError as error:
        raise ConfigError(
            "--peer newton: the package newton is not installed: pip install 'gcd-dataset[bench]'"
        ) from error
    return newton


def drape_with_newton(jobs: Sequence[DrapeJob], *, device: str, max_frames: int = MAX_FRAMES) -> PeerDrapes:
    """Drape the garments on their bodies, all in one model."""
    newton = require_newton()
    start = time.perf_counter()
    with wp.ScopedDevice(device):
        scene = _Scene.of(newton, jobs)
        scene.begin()
        wp.synchronize_device(device)
        ready = time.perf_counter()
        rested_at = _run(scene, max_frames)
        wp.synchronize_device(device)
        done = time.perf_counter()
        x = scene.states[0].particle_q.numpy()
    starts, shifts = scene.starts, scene.shifts
    return PeerDrapes(
        [((x[a:b] - shift) / M).astype(np.float32) for a, b, shift in zip(starts, starts[1:], shifts, strict=False)],
        rested_at >= 0,
        np.where(rested_at < 0, max_frames, rested_at),
        ready - start,
        done - ready,
    )


@dataclass
class _Scene:
    """A model with its solver, states and buffers."""

    solver: Any
    pipeline: Any
    contacts: Any
    control: Any
    states: list[Any]
    starts: Int[np.ndarray, " w1"]
    """First vertex of each garment, and the total number."""
    shifts: Float[np.ndarray, "w 3"]
    """Offset of each garment [m]."""
    hold_normal: wp.array
    hold_offset: wp.array
    held: wp.array
    world: wp.array
    x_seen: wp.array
    moving: wp.array
    graph: Any = field(default=None)

    @classmethod
    def of(cls, newton: Any, jobs: Sequence[DrapeJob]) -> "_Scene":
        shifts = _shifts(len(jobs))
        model = _model(newton, jobs, shifts)
        sizes = [len(job.box_mesh.vertices) for job in jobs]
        held = [holds(job) for job in jobs]
        normal = np.concatenate([n for n, _ in held]).astype(np.float32)
        moved = np.repeat(shifts, sizes, axis=0)
        offset = M * np.concatenate([o for _, o in held]) + np.einsum("vk,vk->v", normal, moved)
        config = newton.solvers.SolverStyle3D.Config(iterations=ITERATIONS, linear_iterations=LINEAR_ITERATIONS)
        pipeline = newton.CollisionPipeline(model, soft_contact_gap=0.02)
        return cls(
            solver=newton.solvers.SolverStyle3D(model=model, config=config),
            pipeline=pipeline,
            contacts=pipeline.contacts(),
            control=model.control(),
            states=[model.state(), model.state()],
            starts=np.cumsum([0, *sizes]),
            shifts=shifts,
            hold_normal=wp.array(normal, dtype=wp.vec3),
            hold_offset=wp.array(offset.astype(np.float32), dtype=float),
            held=wp.ones(1, dtype=int),
            world=wp.array(np.repeat(np.arange(len(jobs), dtype=np.int32), sizes), dtype=int),
            x_seen=wp.clone(model.particle_q),
            moving=wp.zeros(len(jobs), dtype=int),
        )

    def begin(self) -> None:
        """Run the first frame, which loads kernels and allocates; on a GPU then capture a frame as a graph."""
        self.frame()
        if wp.get_device().is_cuda:
            with wp.ScopedCapture() as capture:
                self.frame()
            self.graph = capture.graph

    def frame(self) -> None:
        """Run two steps, then count the moving vertices."""
        self.moving.zero_()
        for step in range(SUBSTEPS):
            before, after = self.states[step % 2], self.states[1 - step % 2]
            before.clear_forces()
            self.pipeline.collide(before, self.contacts)
            self.solver.step(before, after, self.control, self.contacts, STEP)
            state = [after.particle_q, after.particle_qd]
            n = len(after.particle_q)
            wp.launch(newton_kernels.hold, n, inputs=[self.hold_normal, self.hold_offset, self.held, *state])
        x = self.states[0].particle_q
        wp.launch(newton_kernels.watch, len(x), inputs=[self.world, STILL, x, self.x_seen, self.moving])


def _run(scene: _Scene, max_frames: int) -> Int[np.ndarray, " w"]:
    """Step until all garments rest, at most ``max_frames``; the frame in which each came to rest, or -1."""
    ours = DrapeConfig()
    release = round((ours.sewing_time + ours.held_time) / (SUBSTEPS * STEP))
    limit = ours.moving_share * np.diff(scene.starts)
    rested_at = np.full(len(limit), -1)
    for number in range(2, max_frames + 1):
        if number == release:
            scene.held.zero_()
        if scene.graph is None:
            scene.frame()
        else:
            wp.capture_launch(scene.graph)
        if number > release and number % POLL_EVERY == 0:
            rests = scene.moving.numpy() <= limit
            rested_at[rests & (rested_at < 0)] = number
            if (rested_at >= 0).all():
                break
    return rested_at


def _shifts(n: int) -> Float[np.ndarray, "n 3"]:
    """Offsets on a square grid [m], close together for the sake of single precision."""
    side = int(np.ceil(np.sqrt(n)))
    row, column = np.divmod(np.arange(n), side)
    return SPACING * np.stack([column, np.zeros(n), row], axis=1).astype(float)


def _model(newton: Any, jobs: Sequence[DrapeJob], shifts: Float[np.ndarray, "w 3"]) -> Any:
    """Newton's model of all garments and skins."""
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=GRAVITY)
    newton.solvers.SolverStyle3D.register_custom_attributes(builder)
    for job, shift in zip(jobs, shifts, strict=True):
        _add_cloth(newton, builder, job, shift)
    vertices, faces = _skins(jobs, shifts)
    skin = newton.Mesh(vertices, faces.ravel(), compute_inertia=False)
    builder.add_shape_mesh(body=-1, mesh=skin, cfg=newton.ModelBuilder.ShapeConfig(mu=jobs[0].fabric.friction))
    model = builder.finalize()
    model.soft_contact_ke, model.soft_contact_kd = CONTACT_STIFFNESS, 1e-5
    model.soft_contact_mu = jobs[0].fabric.friction
    return model


def _add_cloth(newton: Any, builder: Any, job: DrapeJob, shift: Float[np.ndarray, "3"]) -> None:
    mesh, fabric = job.box_mesh, job.fabric.softened()
    newton.solvers.style3d.add_cloth_mesh(
        builder,
        pos=wp.vec3(*shift),
        rot=wp.quat_identity(),
        vel=wp.vec3(0.0, 0.0, 0.0),
        vertices=M * mesh.vertices,
        indices=mesh.faces.ravel(),
        panel_verts=M * unmirrored(mesh).reshape(-1, 2),
        panel_indices=np.arange(3 * len(mesh.faces)),
        density=fabric.density,
        particle_radius=M * DrapeConfig().body_gap,
        tri_aniso_ke=_pull(fabric),
        edge_aniso_ke=_bend(fabric),
    )


def unmirrored(mesh: BoxMesh) -> Float[np.ndarray, "f 3 2"]:
    """The corners of every face in its panel's plane [cm], mirrored if the panel is clockwise.

    Newton drops triangles of negative area, and with them the panels that are drawn from the wrong side.
    """
    corners = mesh.uv[mesh.corners].copy()
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    corners[ax * by < ay * bx, :, 0] *= -1
    return corners


def _pull(fabric: Fabric) -> Any:
    """Stretch stiffness along weft and warp, and shear stiffness [N/m]."""
    return wp.vec3(fabric.pull.weft, fabric.pull.warp, shear_stiffness(fabric.pull))


def _bend(fabric: Fabric) -> Any:
    """Bending stiffness along weft, warp and bias [N·m].

    A third of the rigidities, since the quadratic bending energy of a mesh is three times the energy of a sheet (see
    ``kernels.sheet``).
    """
    warp, weft = fabric.bend
    return wp.vec3(weft / 3, warp / 3, (warp + weft) / 6)


def _skins(
    jobs: Sequence[DrapeJob], shifts: Float[np.ndarray, "w 3"]
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """The bodies' visible skins, each at its garment's offset [m]."""
    skins = {id(job.body): VisibleSkin.of(job.body.faces, job.body.parts) for job in jobs}
    vertices, faces, count = [], [], 0
    for job, shift in zip(jobs, shifts, strict=True):
        skin = skins[id(job.body)]
        points = skin.points(job.body.vertices)
        vertices.append(M * points + shift)
        faces.append(skin.faces + count)
        count += len(points)
    return np.concatenate(vertices), np.concatenate(faces)
