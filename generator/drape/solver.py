"""The solver of a batch: substeps captured as graphs, on CPU and GPU alike, and replayed frame by frame."""

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from jaxtyping import Bool, Int

from gcd_dataset.errors import DrapeError
from gcd_dataset.generator.device import HostMirror, launch_lock, native_builds, to_host
from gcd_dataset.generator.drape.config import DrapeConfig
from gcd_dataset.generator.drape.kernels import contacts, crossing, finish, search, sides, step, stillness
from gcd_dataset.generator.drape.kernels.world import RUNNING
from gcd_dataset.generator.drape.loading import load_drape
from gcd_dataset.generator.drape.model import ClothModel, new_state
from gcd_dataset.generator.drape.moving import MovingSkin

REBUILD_EVERY = 10  # frames between two builds of the BVH; in between it is refitted
FINISHING_ROUNDS = 4
GPU_THREADS = 128 * 1024  # enough to fill the largest GPU; kernels walk longer lists in strides


SELF_CROSSINGS, BODY_CROSSINGS, BODY_THROUGH = CROSSING_COUNTS = (
    crossing.count_self_crossings,
    crossing.count_body_crossings,
    crossing.count_body_through,
)


def nothing() -> None:
    """The default for ``between`` in ``Solver.frame``."""


class Solver:
    """Steps a batch frame by frame. The first frame captures the graphs; later frames replay them."""

    def __init__(self, model: ClothModel, config: DrapeConfig) -> None:
        load_drape(model.device)
        self.model, self.config = model, config
        self.state = new_state(model, config)
        self.frames = self._rebuild_at = 0
        self._bound_faces()
        with native_builds(model.device):
            self._bvh = wp.Bvh(self.state.lower, self.state.upper, groups=model.face_world)
        self._roots = wp.zeros(model.n_worlds, dtype=int, device=model.device)
        self._none, self._every = wp.zeros_like(self.state.tangled), wp.ones_like(self.state.tangled)
        self._graphs: list[wp.Graph] = []
        self._skins: tuple[wp.array, int] | None = None
        self.moving: dict[int, MovingSkin] = {}
        """World to the skin that moves in it."""
        self.mirror = HostMirror()
        self.untangling: Any = None
        """Buffers and graph of ``outcome.untangle``, kept for its next call."""

    def frame(self, between: Callable[[], None] = nothing) -> None:
        """One frame: ``config.substeps`` substeps, then the status of each world.

        ``between`` is called every few substeps; an exception that it raises ends the drape.
        """
        self.refresh_bvh()
        self.replay_frame(between)

    def refresh_bvh(self) -> None:
        """Build the BVH anew if due."""
        if self._rebuild_at > self.frames:
            return
        with launch_lock:
            self._bound_faces()
            with native_builds(self.model.device):
                self._bvh.rebuild()
        self._rebuild_at = self.frames + REBUILD_EVERY

    def rebuild_bvh_next(self) -> None:
        """Build the BVH anew before the next frame: garments have come or gone."""
        self._rebuild_at, self._skins = self.frames, None

    def replay_frame(self, between: Callable[[], None] = nothing) -> None:
        """``frame`` with the present BVH."""
        if not self._graphs:
            with launch_lock:
                steps = self.captured(self._search_and_step)
                rounds = self.config.substeps // self.config.search_every
                self._graphs = [self.captured(self._begin_frame), *rounds * [steps], self.captured(self._end_frame)]
        for skin in self.moving.values():
            skin.advance(self.state, self.model.cloth)
        for graph in self._graphs:
            between()
            wp.capture_launch(graph)
        self.frames += 1

    def captured(self, launches: Callable[[], None]) -> wp.Graph:
        """Capture the kernel launches of a function as a graph."""
        with wp.ScopedCapture(device=self.model.device) as capture:
            launches()
        return capture.graph

    def run_for(self, seconds: float) -> None:
        """Step until every garment has reached a simulated time [s]. Raises ``DrapeError`` if one ends earlier."""
        while to_host(self.state.time).min() < seconds:
            if (to_host(self.state.status) != RUNNING).any():
                raise DrapeError(f"a garment has ended before {seconds} s: raise max_frames and held_time")
            self.frame()

    def leave_skin(self, chosen: wp.array, pierced: wp.array | None = None) -> None:
        """Move cloth of the chosen worlds off the skin and worn garments, without new crossings of cloth with cloth.

        ``pierced``: what ``BODY_THROUGH`` counts in them, if known.
        """
        m, s = self.model, self.state
        pierced = self.counted(BODY_THROUGH, chosen) if pierced is None else pierced
        through, height = wp.zeros_like(s.search.listed), wp.zeros(m.n_vertices, dtype=float, device=m.device)
        skins, most_edges = self._skin_edges()
        allowed, start, moved = wp.empty(m.n_vertices, dtype=float, device=m.device), wp.clone(s.x), wp.empty_like(s.x)
        self.launch(finish.reset_allowed_moves, m.n_vertices, [m.worlds, m.cloth], [allowed])
        wp.copy(s.search.searching, chosen)
        self._search()
        threads = 1 if m.device == "cpu" else 256
        self.launch(finish.bound_moves, (m.n_worlds, threads), [m.worlds, s.contacts, threads, chosen, s.x], [allowed])
        for _ in range(FINISHING_ROUNDS):
            height.zero_()
            self.launch(finish.mark_body_crossings, m.n_edges, [m.worlds, m.cloth, chosen, s.x], [through, height])
            bvh, roots = self.refitted_bvh()
            inputs = [m.cloth, skins, bvh, roots, pierced, s.x]
            self.launch(finish.measure_pierced_faces, (len(skins), most_edges), inputs, [through, height])
            inputs = [m.worlds, m.cloth, chosen, through, height, allowed, start, s.x]
            self.launch(finish.leave_skin, m.n_vertices, inputs, [moved])
            wp.copy(s.x, moved)

    def round_positions(self, chosen: wp.array) -> None:
        """Round the positions of the chosen worlds to multiples of ``POSITION_STEP``, as shards store them."""
        m = self.model
        self.launch(finish.round_positions, m.n_vertices, [m.cloth, chosen], [self.state.x])

    def self_crossings(self) -> Int[np.ndarray, " w"]:
        """(w) edges of each world's cloth that cross the cloth."""
        return to_host(self.counted(SELF_CROSSINGS, self.chosen(None)))

    def body_crossings(self) -> Int[np.ndarray, " w"]:
        """(w) edges of each world's cloth that cross the skin."""
        return to_host(self.counted(BODY_CROSSINGS, self.chosen(None)))

    def body_through(self) -> Int[np.ndarray, " w"]:
        """(w) edges of each world's skin that cross the cloth."""
        return to_host(self.counted(BODY_THROUGH, self.chosen(None)))

    def counted(self, kernel: wp.Kernel, chosen: wp.array, *, refit: bool = True) -> wp.array:
        """(w) what one of ``CROSSING_COUNTS`` counts in the worlds marked in ``chosen`` (w), on the device.

        ``refit``: whether the cloth has moved since the BVH was refitted.
        """
        m = self.model
        inputs: list[Any] = [m.worlds, m.cloth] if kernel is BODY_CROSSINGS else [m.cloth]
        dim: int | tuple[int, int] = m.n_edges
        if kernel is BODY_THROUGH:
            skins, most_edges = self._skin_edges()
            inputs, dim = [*inputs, skins], (len(skins), most_edges)
        if kernel is not BODY_CROSSINGS:
            inputs += self.refitted_bvh() if refit else (self._bvh.id, self._roots)
        counts = wp.zeros(m.n_worlds, dtype=int, device=m.device)
        self.launch(kernel, dim, [*inputs, chosen, self.state.x], [counts])
        return counts

    def _skin_edges(self) -> tuple[wp.array, int]:
        """The edges of each world's skin and of the garments worn on it, and the largest number of them."""
        if self._skins is not None:
            return self._skins
        skins = []
        for w, body in enumerate(self.model.bodies):
            worn = body.worn.meshes if body and body.worn else ()
            for mesh, ends in ((body.mesh, body.edges), *worn) if body else ():
                skin = crossing.SkinEdges()
                skin.world, skin.mesh, skin.ends = w, mesh.id, ends
                skins.append(skin)
        longest = max(len(skin.ends) for skin in skins)
        self._skins = wp.array(skins, dtype=crossing.SkinEdges, device=self.model.device), longest
        return self._skins

    def stretches(self) -> wp.array:
        """(e) length over flat length of every edge."""
        m = self.model
        ratio = wp.empty(m.n_edges, dtype=float, device=m.device)
        self.launch(stillness.stretch_edges, m.n_edges, [m.cloth, m.springs, self.state.x], [ratio])
        return ratio

    def chosen(self, worlds: Bool[np.ndarray, " w"] | None) -> wp.array:
        """(w) 1 in the given worlds, 0 in others; None: 1 in all."""
        every = np.ones(self.model.n_worlds, bool)
        return wp.array((every if worlds is None else worlds).astype(np.int32), dtype=int, device=self.model.device)

    def _begin_frame(self) -> None:
        """Search for crossings in the worlds where a search is due."""
        s, c = self.state, self.config
        if c.exempt_crossings or c.untangle or c.pull_to_parts:
            wp.capture_if(s.crossing.any_searched, self._find_crossings)
        self._sum_work(contacts.count_work, s.status, s.contacts.work)

    def _search_and_step(self) -> None:
        """Search for contacts in the worlds where a search is due, then ``search_every`` substeps."""
        m, s = self.model, self.state
        s.search.any_search.zero_()
        self.launch(search.plan_search, m.n_worlds, [s.status], [s.search, s.crossing])
        wp.capture_if(s.search.any_search, self._search)
        for number in range(self.config.search_every):
            self._step(odd=number % 2 == 1, before_search=number + 1 == self.config.search_every)

    def _end_frame(self) -> None:
        """Update the status of each world, and plan the next search for crossings."""
        m, s = self.model, self.state
        s.crossing.any_searched.zero_()
        threads = 1 if m.device == "cpu" else 256
        self.launch(
            stillness.watch_frame,
            (m.n_worlds, threads),
            [m.worlds, m.cloth, threads, s.frames, s.x],
            [s.status, s.x_seen, s.counts],
        )
        self.launch(
            stillness.end_frame,
            m.n_worlds,
            [m.worlds, s.time],
            [
                *(s.status, s.frames, s.held, s.loose_after, s.contacts.overfull),
                *(s.contacts.crossing_count, s.counts, s.crossing),
            ],
        )

    def _step(self, *, odd: bool, before_search: bool) -> None:
        m, s = self.model, self.state
        threads = self._threads
        ahead, ahead_next = (s.ahead_next, s.ahead) if odd else (s.ahead, s.ahead_next)
        self.launch(
            contacts.push_contacts,
            threads,
            [m.worlds, m.cloth, s.contacts, threads, s.status, s.crossing, s.contact_weight, s.x, s.v],
            [s.time, s.push],
        )
        self.launch(
            step.step,
            m.n_vertices,
            [m.worlds, m.cloth, m.rows, before_search, s.status, s.time, s.held, ahead],
            [s.search, s.x, s.v, s.push, ahead_next, s.contact_weight],
        )

    def _find_crossings(self) -> None:
        """List crossings of cloth with cloth and mark their vertices as tangled."""
        m, s = self.model, self.state
        self._refit_bvh()
        self.launch(crossing.clear_tangled, m.n_vertices, [m.cloth, s.crossing], [s.tangled])
        self.launch(
            crossing.find_crossings,
            m.n_edges,
            [m.worlds, m.cloth, self._bvh.id, self._roots, s.crossing, s.beside, s.x],
            [s.tangled, s.search.listed, s.contacts],
        )

    def _search(self) -> None:
        """Find contacts: pairs that may touch before the next search, in the worlds where a search is due."""
        m, s = self.model, self.state
        if self.config.remember_sides:
            self._keep_passed_pairs()
        exempt = s.tangled if self.config.exempt_crossings else self._none
        self._find_contacts(s.tangled, exempt, s.passed)
        if self.config.remember_sides:
            per_world = 1 if m.device == "cpu" else 256
            inputs = [m.worlds, per_world, s.search.searching]
            self.launch(sides.restore_kept, (m.n_worlds, per_world), inputs, [s.search.listed, s.contacts])
        self.launch(
            search.find_long_edges,
            m.n_edges,
            [m.worlds, m.cloth, s.search.searching, s.search.skin, s.x],
            [s.search.listed, s.contacts],
        )
        self._sum_work(contacts.count_work, s.status, s.contacts.work)

    def find_contacts_of(self, active: wp.array) -> None:
        """Find the contacts of the worlds marked in ``active`` (w), without contacts where cloth crosses cloth."""
        wp.copy(self.state.search.searching, active)
        self._find_contacts(self._none, self._every, self._none)

    def _find_contacts(self, listed: wp.array, exempt: wp.array, passed: wp.array) -> None:
        """Broad and narrow phase in the worlds marked in ``search.searching``.

        Each argument marks vertices. ``listed``: already in a contact list. ``exempt``: cloth may cross cloth there.
        ``passed``: passed through cloth.
        """
        m, s = self.model, self.state
        threads = self._threads
        self.launch(sides.clear_lists, m.n_worlds, [s.search.searching], [s.contacts])
        s.newest.fill_(-1)
        self.launch(
            search.fill_grid,
            m.n_vertices,
            [m.worlds, m.cloth, s.search.searching, listed, s.x],
            [s.newest, s.older, s.beside, s.search.listed],
        )
        per_vertex = 1 if m.device == "cpu" else max(1, min(GPU_THREADS // m.n_vertices, 14))
        self.launch(
            search.find_near_vertices,
            (m.n_vertices, per_vertex),
            [m.worlds, m.cloth, per_vertex, s.search.searching, s.x, s.newest, s.older],
            [m.cloth.skin_velocity, s.search.asked, s.search.x, s.search.skin, s.beside, s.contacts],
        )
        self._sum_work(search.count_near_work, s.search.searching, s.contacts.near_work)
        if self.config.self_contact:
            inputs = [m.worlds, m.cloth, threads, exempt, passed, s.x]
            self.launch(search.find_contacts, threads, inputs, [s.search.listed, s.contacts])

    def _sum_work(self, count: wp.Kernel, active: wp.array, sums: wp.array) -> None:
        """Prefix sums of each world's work, which ``count`` counts in the worlds marked in ``active``."""
        m, s = self.model, self.state
        self.launch(count, m.n_worlds, [m.worlds, active], [s.contacts])
        self.launch(contacts.scan_work, m.n_worlds + 1, [s.contacts.own_work], [sums])

    def _keep_passed_pairs(self) -> None:
        """Set aside the contacts that have passed through each other since the last search, with their old sides."""
        m, s = self.model, self.state
        threads = self._threads
        for cleared in (s.passed, s.contacts.kept_point_count, s.contacts.kept_edge_count):
            cleared.zero_()
        inputs = [m.worlds, s.contacts, threads, s.status, s.search.searching, s.search.x, s.x]
        self.launch(sides.mark_passed, threads, inputs, [s.passed])
        self.launch(
            sides.keep_sides, threads, [m.worlds, threads, s.status, s.search.searching, s.passed], [s.contacts]
        )

    def _refit_bvh(self) -> None:
        """Refit the BVH to the current positions."""
        self._bound_faces()
        self._bvh.refit()
        self.launch(crossing.find_roots, self.model.n_worlds, [self.model.worlds, self._bvh.id], [self._roots])

    def refitted_bvh(self) -> tuple[int, wp.array]:
        """The identifier of the BVH, refitted to the current positions, and the root of each world's subtree in it."""
        self._refit_bvh()
        return self._bvh.id, self._roots

    def _bound_faces(self) -> None:
        m, s = self.model, self.state
        self.launch(crossing.bound_faces, len(m.face_world), [m.cloth, s.x], [s.lower, s.upper])

    @property
    def _threads(self) -> int:
        """Threads of the kernels that walk contact lists in strides."""
        return 1 if self.model.device == "cpu" else min(GPU_THREADS, 2 * self.model.n_vertices)

    def launch(self, kernel: wp.Kernel, dim: int | tuple[int, ...], inputs: list, outputs: list) -> None:
        """Launch a kernel on the model's device, in blocks that suit the batch."""
        block = 64 if self.model.n_vertices < GPU_THREADS else 256  # small blocks spread a small batch over the GPU
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.model.device, block_dim=block)
