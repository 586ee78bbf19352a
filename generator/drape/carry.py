"""Copy the state of garments that still move into the next batch, where they continue bit for bit."""

from collections.abc import Sequence
from operator import attrgetter

import warp as wp

from gcd_dataset.generator.drape.device import to_host
from gcd_dataset.generator.drape.kernels.carry import Move, carry_contacts
from gcd_dataset.generator.drape.solver import Solver

VERTEX_ARRAYS = (
    "x",
    "v",
    "ahead",
    "x_seen",
    "search.x",
    "search.skin",
    "contact_weight",
    "beside",
    "search.listed",
    "tangled",
)
WORLD_ARRAYS = (
    "time", "status", "held", "loose_after", "frames", "search.moved_far",
    "crossing.due", "crossing.searched", "crossing.least", "crossing.least_at", "crossing.separated",
)  # fmt: skip
CONTACT_COUNTS = ("point_count", "edge_count", "long_count", "crossing_count", "overfull")
THREADS = 256  # threads that copy the contact lists of one garment on a GPU


def carry_over(old: Solver, new: Solver, worlds: Sequence[tuple[int, int]]) -> None:
    """Copy the state of garments between two frames; ``worlds``: pairs of world indices in ``old`` and ``new``."""
    if not worlds:
        return
    first_old, first_new = old.model.topology.vertex_offset, new.model.topology.vertex_offset
    for name in VERTEX_ARRAYS:
        array_of = attrgetter(name)
        source, target = array_of(old.state), array_of(new.state)
        for before, after in worlds:
            count = int(first_old[before + 1] - first_old[before])
            wp.copy(target, source, dest_offset=int(first_new[after]), src_offset=int(first_old[before]), count=count)
    for name in WORLD_ARRAYS:
        array_of = attrgetter(name)
        _copy_worlds(array_of(old.state), array_of(new.state), worlds)
    for name in CONTACT_COUNTS:
        _copy_worlds(getattr(old.state.contacts, name), getattr(new.state.contacts, name), worlds)
    device = new.model.device
    threads = 1 if device == "cpu" else THREADS
    moves = wp.array([_move(old, new, *pair) for pair in worlds], dtype=Move, device=device)
    wp.launch(
        carry_contacts,
        dim=(len(worlds), threads),
        inputs=[old.model.worlds, new.model.worlds, moves, threads, old.state.contacts],
        outputs=[new.state.contacts],
        device=device,
    )


def _copy_worlds(source: wp.array, target: wp.array, worlds: Sequence[tuple[int, int]]) -> None:
    values, old_values = to_host(target), to_host(source)
    for before, after in worlds:
        values[after] = old_values[before]
    target.assign(values)


def _move(old: Solver, new: Solver, before: int, after: int) -> Move:
    move = Move()
    move.old_world, move.new_world = before, after
    old_topology, new_topology = old.model.topology, new.model.topology
    move.edge_shift = int(new_topology.edge_offset[after] - old_topology.edge_offset[before])
    move.face_shift = int(new_topology.face_offset[after] - old_topology.face_offset[before])
    return move
