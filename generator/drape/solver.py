"""The time steps of a batch: one frame recorded as a graph, on the CPU as on a GPU, and played until all is at rest."""

from dataclasses import dataclass

import numpy as np
import warp as wp

from gcd_dataset.generator.drape.config import DrapeConfig
from gcd_dataset.generator.drape.device import load_kernels
from gcd_dataset.generator.drape.kernels import body_contact, crossing, elastic, self_contact, stillness, world
from gcd_dataset.generator.drape.model import ClothModel

KERNELS = (body_contact, crossing, elastic, self_contact, stillness, world)
__all__ = ["ClothState", "Solver", "new_state"]

REBUILD_EVERY = 10  # frames after which the tree of boxes is built anew
GPU_THREADS = 132 * 1024  # enough to fill the largest GPU; longer lists are walked in strides


@dataclass(frozen=True)
class ClothState:
    """What changes during a drape, on the model's device."""

    x: wp.array
    """(v) positions [cm]."""
    v: wp.array
    """(v) velocities [cm/s]."""
    ahead: wp.array
    """(v) where forces are taken [cm]."""
    x_new: wp.array
    v_new: wp.array
    x_seen: wp.array
    """(v) positions one frame ago [cm]."""
    push: wp.array
    """(v, 4) displacements asked for by contacts, as whole numbers."""
    time: wp.array
    """(w) simulated time [s]."""
    status: wp.array
    """(w) ``RUNNING``, ``DONE`` or ``DIVERGED``."""
    moving: wp.array
    """(w) vertices that moved in the last frame."""
    overfull: wp.array
    """(w) whether a list of pairs ran over."""
    lower: wp.array
    upper: wp.array
    tangled: wp.array
    near: wp.array
    point_pairs: wp.array
    edge_pairs: wp.array
    edge_normals: wp.array
    crossings: wp.array
    point_count: wp.array
    edge_count: wp.array
    crossing_count: wp.array


def new_state(model: ClothModel, config: DrapeConfig) -> ClothState:
    """The start: every garment where its panels hang, at rest."""
    n, worlds, faces = len(model.start), model.n_worlds, model.faces.shape[0]
    room = config.contact_capacity * n

    def array(size: int, dtype: type) -> wp.array:
        return wp.zeros(size, dtype=dtype, device=model.device)

    def positions() -> wp.array:
        return wp.array(model.start, dtype=wp.vec3, device=model.device)

    return ClothState(
        x=positions(),
        v=array(n, wp.vec3),
        ahead=positions(),
        x_new=positions(),
        v_new=array(n, wp.vec3),
        x_seen=positions(),
        push=wp.zeros((n, 4), dtype=int, device=model.device),
        time=array(worlds, float),
        status=array(worlds, int),
        moving=array(worlds, int),
        overfull=array(worlds, int),
        lower=array(faces, wp.vec3),
        upper=array(faces, wp.vec3),
        tangled=array(n, int),
        near=array(n, int),
        point_pairs=array(room, wp.vec3i),
        edge_pairs=array(room, wp.vec2i),
        edge_normals=array(room, wp.vec3),
        crossings=array(room, wp.vec2i),
        point_count=array(1, int),
        edge_count=array(1, int),
        crossing_count=array(1, int),
    )


class Solver:
    """Steps a batch frame by frame. The first frame records the graph; the rest replay it."""

    def __init__(self, model: ClothModel, config: DrapeConfig) -> None:
        self.model, self.config = model, config
        self.state = new_state(model, config)
        self.frames = 0
        self._bound()
        self._bvh = wp.Bvh(self.state.lower, self.state.upper, groups=model.face_world)
        self._graph: wp.Graph | None = None

    def frame(self) -> None:
        """One frame: ``config.substeps`` time steps, and the count of what still moves."""
        if self.frames % REBUILD_EVERY == 0 and self.frames:
            self._bound()
            self._bvh.rebuild()
        if self._graph is None:
            load_kernels("drape", *KERNELS, device=self.model.device)
            with wp.ScopedCapture(device=self.model.device) as capture:
                self._record_frame()
            self._graph = capture.graph
        wp.capture_launch(self._graph)
        self.frames += 1

    def self_crossings(self) -> np.ndarray:
        """Edges of each world that cross its cloth."""
        m, s = self.model, self.state
        counts = wp.zeros(m.n_worlds, dtype=int, device=m.device)
        self._bound()
        self._bvh.refit()
        self._launch(
            crossing.count_self_crossings,
            m.edges.shape[0],
            [m.vertex_world, m.edges, m.faces, self._bvh.id, s.x],
            [counts],
        )
        return counts.numpy()

    def body_crossings(self) -> np.ndarray:
        """Edges of each world that cross its body."""
        m = self.model
        counts = wp.zeros(m.n_worlds, dtype=int, device=m.device)
        inputs = [m.vertex_world, m.edges, m.body_mesh, self.state.x]
        self._launch(crossing.count_body_crossings, m.edges.shape[0], inputs, [counts])
        return counts.numpy()

    def _record_frame(self) -> None:
        self._find_crossings()
        for step in range(self.config.substeps):
            if step % self.config.detect_every == 0:
                self._detect()
            self._step()
        m, s = self.model, self.state
        s.moving.zero_()
        self._launch(
            stillness.count_moving,
            s.x.shape[0],
            [m.worlds, m.vertex_world, self.config.still_speed, self.config.substeps],
            [s.status, s.x, s.x_seen, s.moving],
        )

    def _step(self) -> None:
        m, s = self.model, self.state
        n = s.x.shape[0]
        self._launch(
            elastic.advance,
            n,
            [m.worlds, m.vertex_world, m.mass, m.inertia, m.row_start, m.row_vertex, m.row_weight, m.bend_diagonal]
            + [s.status, s.time, s.x, s.v, s.ahead],
            [s.x_new, s.v_new],
        )
        self._push()
        self._launch(
            body_contact.finish_step,
            n,
            [m.worlds, m.vertex_world, m.unseen_parts, m.hold_normal, m.hold_offset, m.field, m.field_parts]
            + [s.status, s.time, s.x_new, s.v_new],
            [s.push, s.x, s.v, s.ahead],
        )
        self._launch(world.tick, m.n_worlds, [m.worlds, s.status], [s.time])

    def _push(self) -> None:
        """What contacts and crossings ask of the vertices: first how many share each, then how far they push."""
        m, s = self.model, self.state
        room, stride = s.point_pairs.shape[0], self._stride
        for announce in (True, False):
            self._launch(
                self_contact.push_point_triangle,
                stride,
                [m.worlds, m.vertex_world, m.faces, m.inertia, announce, stride, room]
                + [s.status, s.point_pairs, s.point_count, s.x, s.x_new],
                [s.push],
            )
            self._launch(
                self_contact.push_edge_edge,
                stride,
                [m.worlds, m.vertex_world, m.edges, m.inertia, announce, stride, room]
                + [s.status, s.edge_pairs, s.edge_normals, s.edge_count, s.x, s.x_new],
                [s.push],
            )
            self._launch(
                body_contact.push_long_edges,
                m.edges.shape[0],
                [m.worlds, m.vertex_world, m.edges, m.unseen_parts, m.field, m.field_parts, announce]
                + [s.status, s.x, s.x_new],
                [s.push],
            )
        self._launch(
            crossing.part_crossings,
            stride,
            [m.worlds, m.vertex_world, m.edges, m.edge_opposite, m.faces, m.inertia, stride, room]
            + [s.status, s.crossings, s.crossing_count, s.x_new],
            [s.push],
        )

    def _find_crossings(self) -> None:
        """Where the cloth crosses itself: marked, so that contacts do not lock it in."""
        m, s = self.model, self.state
        room = s.crossings.shape[0]
        s.tangled.zero_()
        s.crossing_count.zero_()
        self._bound()
        self._bvh.refit()
        self._launch(
            crossing.find_crossings,
            m.edges.shape[0],
            [m.vertex_world, m.edges, m.faces, self._bvh.id, room, s.status, s.x],
            [s.tangled, s.crossings, s.crossing_count, s.overfull],
        )

    def _detect(self) -> None:
        """The pairs that may touch before the next search."""
        m, s = self.model, self.state
        n, e = s.x.shape[0], m.edges.shape[0]
        margin, room = self.config.contact_margin, s.point_pairs.shape[0]
        for array in (s.near, s.point_count, s.edge_count):
            array.zero_()
        self._bound()
        self._bvh.refit()
        tree = self._bvh.id
        self._launch(
            self_contact.find_point_triangle,
            n,
            [m.worlds, m.vertex_world, m.faces, tree, margin, room, s.status, s.tangled, s.x],
            [s.near, s.point_pairs, s.point_count, s.overfull],
        )
        self._launch(
            self_contact.find_edge_edge,
            e,
            [m.vertex_world, m.edges, m.face_edges, m.edge_face, tree, margin, room, s.status, s.tangled, s.near, s.x],
            [s.edge_pairs, s.edge_normals, s.edge_count, s.overfull],
        )

    def _bound(self) -> None:
        m, s = self.model, self.state
        self._launch(self_contact.bound_triangles, m.faces.shape[0], [m.faces, s.x], [s.lower, s.upper])

    @property
    def _stride(self) -> int:
        """Threads that walk a list of pairs together."""
        return 1 if self.model.device == "cpu" else min(GPU_THREADS, self.state.point_pairs.shape[0])

    def _launch(self, kernel: wp.Kernel, dim: int, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.model.device)
