"""Garments that still move, taken over from one batch into the next: they go on as if nothing had happened."""

from collections.abc import Sequence
from operator import attrgetter

import warp as wp

from gcd_dataset.generator.drape.kernels.carry import Move, carry_contacts
from gcd_dataset.generator.drape.solver import Solver

__all__ = ["carry_over"]

OF_VERTICES = (
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
OF_WORLDS = (
    "time", "status", "held", "loose_after", "frames", "search.moved_far",
    "crossing.due", "crossing.searched", "crossing.least", "crossing.least_at", "crossing.separated",
)  # fmt: skip
COUNTS = ("point_count", "edge_count", "long_count", "crossing_count", "overfull")
THREADS = 256  # for the lists of one garment


def carry_over(old: Solver, new: Solver, places: Sequence[tuple[int, int]]) -> None:
    """Copy the state of garments, given by their numbers in ``old`` and ``new``, between two frames."""
    if not places:
        return
    first, first_new = old.model.topology.vertex_offset, new.model.topology.vertex_offset
    for name in OF_VERTICES:
        of = attrgetter(name)
        source, target = of(old.state), of(new.state)
        for world, place in places:
            count = int(first[world + 1] - first[world])
            wp.copy(target, source, dest_offset=int(first_new[place]), src_offset=int(first[world]), count=count)
    for name in OF_WORLDS:
        of = attrgetter(name)
        _copy_worlds(of(old.state), of(new.state), places)
    for name in COUNTS:
        _copy_worlds(getattr(old.state.contacts, name), getattr(new.state.contacts, name), places)
    device = new.model.device
    threads = 1 if device == "cpu" else THREADS
    moves = wp.array([_move(old, new, *place) for place in places], dtype=Move, device=device)
    wp.launch(
        carry_contacts,
        dim=(len(places), threads),
        inputs=[old.model.worlds, new.model.worlds, moves, threads, old.state.contacts],
        outputs=[new.state.contacts],
        device=device,
    )


def _copy_worlds(source: wp.array, target: wp.array, places: Sequence[tuple[int, int]]) -> None:
    values, found = target.numpy().copy(), source.numpy()
    for world, place in places:
        values[place] = found[world]
    target.assign(values)


def _move(old: Solver, new: Solver, world: int, place: int) -> Move:
    move = Move()
    move.leaves, move.joins = world, place
    before, after = old.model.topology, new.model.topology
    move.edges = int(after.edge_offset[place] - before.edge_offset[world])
    move.faces = int(after.face_offset[place] - before.face_offset[world])
    return move
