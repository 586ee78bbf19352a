"""How the garments of a batch are shared out to parts, each padded to its own number of edges.

Attention takes time as the square of the number of edges, so garments of like size are computed together. ``parts_of``
fits a batch; ``fixed_parts`` have room for nearly every batch of a set, so that all batches have one shape.
"""

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from benchmarks.reconstruction.stitching.graphs import ALIGNMENT, aligned

SMALLER = 0.75  # share of a batch, of the fewest edges, that is computed apart from the others
LEAST_APART = 16  # garments of a batch that is computed in parts
FIXED = 3  # parts of batches of one shape: two would have a third more pairs of edges
RARE = 1e-6  # upper bound of the chance that the garments of a batch exceed a part of ``fixed_parts``


@dataclass(frozen=True, slots=True)
class Part:
    """Garments of a batch that are computed together."""

    rows: int
    given: int
    """Most garments, the first ones, of which seams are given."""
    width: int
    """Edges to which they are padded."""


def parts_of(counts: Int[Tensor, " b"], shares: Float[Tensor, " b"]) -> tuple[Part, ...]:
    """The parts that fit a batch: its smaller garments, and the others. ``shares``: of the seams that are given."""
    order = counts.argsort()
    apart = [int(SMALLER * len(order))] if len(order) >= LEAST_APART else []
    chunks = order.tensor_split(apart)
    return tuple(Part(len(c), int((shares[c] > 0).sum()), aligned(int(counts[c].max()))) for c in chunks)


def ordered(parts: Sequence[Part], counts: Int[Tensor, " b"], shares: Float[Tensor, " b"]) -> Int[Tensor, " b"]:
    """The garments of a batch in the order of its parts, in each part those of the largest shares first."""
    chunks = torch.split(counts.argsort(), [part.rows for part in parts])
    return torch.cat([chunk[shares[chunk].argsort(descending=True)] for chunk in chunks])


def shares_above(counts: Int[Tensor, "n v"], chances: Sequence[float]) -> tuple[float, ...]:
    """The chances that a garment, whose variants have these counts and chances, exceeds each multiple of 8 edges."""
    widths = torch.arange(ALIGNMENT, aligned(int(counts.max())) + 1, ALIGNMENT)
    above = torch.stack([(counts > width).double().mean(dim=0) for width in widths])
    return tuple((above @ torch.tensor(chances, dtype=torch.double)).tolist())


@functools.lru_cache
def fixed_parts(rows: int, above: tuple[float, ...], *, garments: int, is_given: bool) -> tuple[Part, ...]:
    """The parts of every batch of ``rows`` garments, of the fewest pairs of edges. ``above``: ``shares_above``.

    ``is_given``: whether seams of garments are given, of each with a chance of 1/2 or less.
    """
    wider = [min(rows, _most(rows, chance, garments)) for chance in above[:-1]]  # most garments above each width
    count = min(FIXED if rows >= LEAST_APART else 1, len(above))

    def sized(widths: Sequence[int]) -> list[tuple[int, int]]:
        """Garments and edges of each part; a part takes those that are wider than the part before."""
        room = [rows, *(wider[number] for number in widths), 0]
        edges = [ALIGNMENT * (number + 1) for number in (*widths, len(wider))]
        counts = [most - rest for most, rest in itertools.pairwise(room)]
        return list(zip(counts, edges, strict=True))

    tries = (sized(widths) for widths in itertools.combinations(range(len(wider)), count - 1))
    best = min(tries, key=lambda parts: sum(size * width**2 for size, width in parts))
    return tuple(Part(size, _most_given(size) if is_given else 0, width) for size, width in best if size)


def _most_given(rows: int) -> int:
    """Three standard deviations more than half: where there are more, the smallest shares count as none."""
    return min(rows, math.ceil(0.5 * rows + 1.5 * math.sqrt(rows)))


def _most(rows: int, chance: float, garments: int) -> int:
    """The number of garments of this chance that a batch exceeds at most rarely (Bernstein's inequality)."""
    rare = -math.log(RARE)
    variance = rows * chance * (1 - chance) * (1 + rows / garments)  # a garment may be drawn twice
    return math.ceil(rows * chance + rare / 3 + math.sqrt((rare / 3) ** 2 + 2 * rare * variance)) if chance else 0
