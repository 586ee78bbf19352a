"""Places for garments in the buffers of one solver: garments enter and leave while others drape.

The buffers have a fixed size, so the captured graphs stay valid. A garment takes a range of vertices, and edges and
faces in proportion; its drape does not depend on its place.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import warp as wp
from jaxtyping import Float

from gcd_dataset.generator.device import launch_lock, to_host
from gcd_dataset.generator.drape.config import DrapeConfig
from gcd_dataset.generator.drape.kernels import place as kernels
from gcd_dataset.generator.drape.kernels.moving import begin_motion
from gcd_dataset.generator.drape.kernels.place import EDGES, FACES, Placement, VertexState
from gcd_dataset.generator.drape.kernels.world import DONE
from gcd_dataset.generator.drape.model import ClothModel, ClothState, empty_model
from gcd_dataset.generator.drape.moving import Motion, MovingSkin, own_skin, refitting
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.drape.topology import WARP
from gcd_dataset.generator.mesh import CoarseMesh
from gcd_dataset.records import BoxMesh

ENDLESS = 1 << 30  # frames
WIDTH = 12  # edges and faces of a vertex for which there is room at least
MIN_FRAMES = 4  # frames of the fine mesh before it may count as at rest
VERTEX_STATE = ("x", "v", "ahead", "x_seen", "contact_weight", "beside", "tangled", "push")
THREADS = 256  # that clear one place on a GPU


@dataclass(frozen=True)
class CoarseEnd:
    """The end of a garment's coarse drape, from which its fine drape starts."""

    corners: wp.array
    """See ``CoarseMesh.corners``."""
    weights: wp.array
    """See ``CoarseMesh.weights``."""
    x: wp.array
    """Positions [cm]."""
    v: wp.array
    """Velocities [cm/s]."""
    time: float
    """[s]"""
    held: int
    overfull: int
    """1 where a contact list was full: which contacts were dropped is not deterministic, nor is the drape."""

    @classmethod
    def at_rest(cls, vertices: Float[np.ndarray, "v 3"], time: float, device: str) -> Self:
        """A start of the same mesh at rest, released from holds, ``time`` seconds after the start of the drape."""
        same = np.repeat(np.arange(len(vertices), dtype=np.int32)[:, None], 3, axis=1)
        x = wp.array(vertices.astype(np.float32), dtype=wp.vec3, device=device)
        weights = wp.array(np.tile(np.eye(3, dtype=np.float32)[0], (len(vertices), 1)), dtype=wp.vec3, device=device)
        corners = wp.array(same, dtype=wp.vec3i, device=device)
        return cls(corners, weights, x, wp.zeros_like(x), time, held=0, overfull=0)

    @classmethod
    def of(cls, mesh: CoarseMesh, state: ClothState, at: slice, *, time: float, held: int, overfull: int) -> Self:
        """The end of a drape of ``mesh``, whose vertices are the rows ``at`` of a batch's state."""
        with launch_lock:
            x, v = wp.clone(state.x[at]), wp.clone(state.v[at])
            corners = wp.array(mesh.corners.astype(np.int32), dtype=wp.vec3i, device=x.device)
            weights = wp.array(mesh.weights.astype(np.float32), dtype=wp.vec3, device=x.device)
        return cls(corners, weights, x, v, time, held, overfull)


def room_for(mesh: BoxMesh) -> int:
    """Vertices of the place that a garment needs; its edges are estimated: as many as vertices and faces (Euler)."""
    vertices, faces = len(mesh.vertices), len(mesh.faces)
    return _room(vertices, vertices + faces + 64, faces)


def rooms_of(model: ClothModel) -> list[int]:
    """Vertices of the place that each garment of a model takes."""
    rooms = model.parameters["room"].tolist()
    return [
        _room(_count(vertices), _count(edges), _count(faces), room)
        for vertices, edges, faces, room in zip(model.vertices, model.edges, model.faces, rooms, strict=True)
    ]


def _room(vertices: int, edges: int, faces: int, room: int = 0) -> int:
    """A multiple of ``WARP``, since the rows of as many vertices are interleaved; the last vertex stays empty."""
    least = max(vertices + 1, -(-edges // int(EDGES)), -(-faces // int(FACES)), room)
    return -(-least // WARP) * WARP


def _count(span: slice) -> int:
    return int(span.stop - span.start)


class Slots:
    """A solver whose worlds are filled and freed one by one; ``worlds``: number of garments at once."""

    def __init__(
        self, room: int, worlds: int, config: DrapeConfig, device: str, *, width: int = WIDTH, coupled: bool = False
    ) -> None:
        # The first ``WARP`` vertices belong to no garment: unused faces and edges lie there.
        self.room, self._empty_world = room, worlds
        model = empty_model(room + WARP, worlds, width, device, coupled=coupled)
        self.solver = Solver(model, config)
        self.solver.state.status.fill_(DONE)
        self._free = [(WARP, room)]
        """First vertex and number of vertices of each unused range, in order."""
        self._places: dict[int, tuple[int, int]] = {}
        self._rows = model.parameters
        self._axes, self._meshes = to_host(model.cloth.axes), to_host(model.cloth.body_mesh)

    @classmethod
    def of(cls, model: ClothModel, config: DrapeConfig, starts: Sequence[CoarseEnd | None]) -> Self:
        """A solver that holds the garments of a model, in its order; ``starts``: as for ``place``."""
        width, coupled = max(WIDTH, model.rows.width), bool(model.rows.coupled)
        slots = cls(sum(rooms_of(model)), len(starts), config, model.device, width=width, coupled=coupled)
        slots.place(model, starts)
        return slots

    def suits(self, model: ClothModel) -> bool:
        """Whether the rows have room for those of a model."""
        rows = self.solver.model.rows
        return bool(model.rows.width <= rows.width and model.rows.coupled <= rows.coupled)

    def count_fitting(self, rooms: Sequence[int]) -> int:
        """How many of the first garments that need these places may fit, whatever the order of the free ranges."""
        free = sum(size for _, size in self._free)
        return int((np.cumsum(rooms) <= free).sum())

    def place(self, new: ClothModel, starts: Sequence[CoarseEnd | None]) -> list[int]:
        """Write garments into free places, in order, as long as there is room; returns their worlds.

        ``new``: the model of these garments. ``starts``: the coarse drape from which each starts, if any.
        """
        worlds: list[int] = []
        unused = [w for w in range(self._empty_world) if w not in self._places]
        for room, w in zip(rooms_of(new), unused, strict=False):
            taken = self._take(room)
            if taken is None:
                break
            self._places[w] = taken
            worlds.append(w)
        if worlds:
            self._write(new, starts, worlds)
        return worlds

    def move(self, w: int, motion: Motion, *, ends: bool = True) -> None:
        """Let the body of a garment at rest move; the drape ends once both are at rest, or not at all."""
        solver, model, state = self.solver, self.solver.model, self.solver.state
        shared = model.bodies[w]
        assert shared is not None
        with launch_lock:
            body = model.bodies[w] = own_skin(shared)
            row = self._rows[w : w + 1]
            frame, first = float(row["frame"][0]), int(row["first"][0])
            count, refit = math.ceil(motion.seconds / frame), refitting(body.mesh)
            skin = MovingSkin(w, body.mesh, motion, self._keys(motion), count, frame, refit)
            row["skin"] = self._meshes[w] = body.mesh.id
            self._axes[2 * w : 2 * w + 2] = motion.last_axes
            row["lowest"] -= max(motion.drop, 0.0)
            row["max_frames"] = skin.frames + solver.config.max_frames if ends else ENDLESS
            model.worlds.assign(self._rows)
            model.cloth.body_mesh.assign(self._meshes)
            outputs = [state.x, state.v, state.ahead, state.ahead_next, state.x_seen, state.time, state.status]
            outputs += [state.frames, state.held, state.loose_after, state.crossing]
            inputs = [w, first, (skin.frames + 1.5 if ends else ENDLESS) * frame]
            self._launch(begin_motion, int(row["size"][0]), inputs, outputs)
        solver.moving[w] = skin
        solver.rebuild_bvh_next()

    def move_on(self, w: int, motion: Motion, seconds: float) -> None:
        """Let a body that moves without an end go on, a key every ``seconds`` to the nearest frame."""
        skin = self.solver.moving[w]
        frames = max(round(seconds / skin.seconds), 1) * (len(motion.keys) - 1)
        self.solver.moving[w] = replace(
            skin, motion=motion, keys=self._keys(motion), frames=frames, gently=False, frame=0
        )

    def _keys(self, motion: Motion) -> wp.array:
        return wp.array(motion.points, dtype=wp.vec3, device=self.solver.model.device)

    def free(self, worlds: Sequence[int]) -> None:
        """Give up the places of garments."""
        if not worlds:
            return
        model = self.solver.model
        places = np.array([(w, *self._places.pop(w)) for w in worlds], np.int32)
        for _, first, size in places.tolist():
            self._give_back(first, size)
        self._rows["size"][list(worlds)] = 0
        for w in worlds:
            self.solver.moving.pop(w, None)
            model.bodies[w] = None
            model.vertices[w] = model.edges[w] = model.faces[w] = slice(0, 0)
        threads = 1 if model.device == "cpu" else THREADS
        with launch_lock:
            model.worlds.assign(self._rows)
            inputs = [wp.array(places, dtype=wp.vec3i, device=model.device), threads, self._empty_world]
            outputs = [model.cloth, model.face_world, self.solver.state.status]
            self._launch(kernels.clear_places, (len(places), threads), inputs, outputs)
        self.solver.rebuild_bvh_next()

    def _take(self, size: int) -> tuple[int, int] | None:
        """The first free range of ``size`` vertices."""
        for number, (first, free) in enumerate(self._free):
            if free >= size:
                self._free[number : number + 1] = [(first + size, free - size)] if free > size else []
                return first, size
        return None

    def _give_back(self, first: int, size: int) -> None:
        merged: list[tuple[int, int]] = []
        for begin, free in sorted([*self._free, (first, size)]):
            if merged and sum(merged[-1]) == begin:
                merged[-1] = (merged[-1][0], merged[-1][1] + free)
            else:
                merged.append((begin, free))
        self._free = merged

    def _write(self, new: ClothModel, starts: Sequence[CoarseEnd | None], worlds: Sequence[int]) -> None:
        model, state = self.solver.model, self.solver.state
        count = len(worlds)
        x, v = wp.clone(new.start), wp.zeros_like(new.start)
        placements = []
        for k, w in enumerate(worlds):
            first, start = self._places[w][0], starts[k]
            body = model.bodies[w] = new.bodies[k]
            assert body is not None
            self._rows[w], self._meshes[w] = new.parameters[k], body.mesh.id
            self._rows[w]["first"] = first
            self._axes[2 * w : 2 * w + 2] = body.axes
            at = [first, int(EDGES) * first, int(FACES) * first]
            spans = [new.vertices[k], new.edges[k], new.faces[k]]
            for own, begin, span in zip((model.vertices, model.edges, model.faces), at, spans, strict=True):
                own[w] = slice(begin, begin + _count(span))
            if start is not None:
                inputs = [start.corners, start.weights, spans[0].start, start.x, start.v]
                self._launch(kernels.interpolate, len(start.corners), inputs, [x, v])
            placements.append(_placement(w, at, spans, new.parameters[k], start))
        model.worlds.assign(self._rows)
        model.cloth.axes.assign(self._axes)
        model.cloth.body_mesh.assign(self._meshes)
        places = wp.array(placements, dtype=Placement, device=model.device)
        vertices, edges, faces = new.vertices[count - 1].stop, new.edges[count - 1].stop, new.faces[count - 1].stop
        of_vertices = VertexState()
        for name in VERTEX_STATE:
            setattr(of_vertices, name, getattr(state, name))
        self._launch(
            kernels.place_vertices,
            vertices,
            [places, new.cloth, new.rows, x, v],
            [model.cloth, model.rows, of_vertices, state.search],
        )
        self._launch(kernels.place_edges, edges, [places, new.cloth, new.springs], [model.cloth, model.springs])
        self._launch(kernels.place_faces, faces, [places, new.cloth], [model.cloth, model.face_world])
        outputs = [state.time, state.status, state.held, state.loose_after, state.frames, state.contacts]
        self._launch(kernels.place_worlds, count, [places], [*outputs, state.search, state.crossing])
        self.solver.rebuild_bvh_next()

    def _launch(self, kernel: wp.Kernel, dim: int | tuple[int, ...], inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.solver.model.device)


def _placement(
    w: int, at: Sequence[int], spans: Sequence[slice], world: np.ndarray, start: CoarseEnd | None
) -> Placement:
    """The place of the garment of ``spans`` (vertices, edges, faces), whose first ones come to ``at``."""
    place = Placement()
    vertices, edges, faces = spans
    place.world, place.last, place.dt = w, vertices.stop - 1, float(world["dt"])
    place.vertex_shift, place.edge_shift, place.face_shift = (
        to - span.start for to, span in zip(at, spans, strict=True)
    )
    place.edge_entries, place.face_entries = 2 * (at[1] - edges.start), 3 * (at[2] - faces.start)
    place.held = 1
    if start is not None:
        place.time, place.held, place.overfull = start.time, start.held, start.overfull
        place.loose_after = start.time + MIN_FRAMES * float(world["frame"])
    return place
