"""Curves in pictures: borders of regions, level lines and valleys of fields, chained to smooth polylines.

Coordinates are (column, row); the centre of the upper left pixel is (0, 0).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from scipy.spatial import cKDTree

from gcd_dataset.records import Record


@dataclass(frozen=True, eq=False)
class Segments(Record):
    """Line segments between numbered nodes."""

    ends: Int[np.ndarray, "m 2"]
    """Rows of ``place``."""
    place: Float[np.ndarray, "n 2"]
    """Column and row of each node."""


def cracks(across: Bool[np.ndarray, "h w1"], down: Bool[np.ndarray, "h1 w"]) -> Segments:
    """The sides between pixels: ``across[r, c]`` between (r, c) and (r, c + 1), ``down[r, c]`` below (r, c)."""
    height, width = across.shape[0], down.shape[1]
    row, column = np.nonzero(across)
    upright = np.stack([row * (width + 1) + column + 1, (row + 1) * (width + 1) + column + 1], axis=1)
    row, column = np.nonzero(down)
    level = np.stack([(row + 1) * (width + 1) + column, (row + 1) * (width + 1) + column + 1], axis=1)
    rows, columns = np.indices((height + 1, width + 1))
    return Segments(np.concatenate([upright, level]), np.stack([columns.ravel(), rows.ravel()], axis=1) - 0.5)


def level_lines(field: Float[np.ndarray, "h w"], level: float) -> Segments:
    """Where a field crosses a level: marching squares. NaN has no lines."""
    f = field - level
    return _zero_lines(np.stack([f[:-1, :-1], f[:-1, 1:], f[1:, 1:], f[1:, :-1]]), field.shape)


def valleys(field: Float[np.ndarray, "h w"], *, sigma: float) -> tuple[Segments, Float[np.ndarray, "h w"]]:
    """Valley lines of a field smoothed over ``sigma`` pixels, and their strength at each pixel [1/pixel²].

    A valley is where the derivative along the direction of the largest curvature is zero and this curvature is
    positive (Haralick, Ridges and valleys on digital images, 1983). The sign of that direction is arbitrary, so in each
    cell the directions are turned to agree.
    """
    smooth = gaussian_filter(field, sigma)
    dy, dx = np.gradient(smooth)
    dyy, dyx = np.gradient(dy)
    _, dxx = np.gradient(dx)
    half, mean = 0.5 * (dxx - dyy), 0.5 * (dxx + dyy)
    root = np.hypot(half, dyx)
    strength = mean + root
    angle = 0.5 * np.arctan2(dyx, half)
    axis = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    slope = dx * axis[..., 0] + dy * axis[..., 1]
    slope = np.where(strength > 0, slope, np.nan)
    corners = [(slice(None, -1), slice(None, -1)), (slice(None, -1), slice(1, None)),
               (slice(1, None), slice(1, None)), (slice(1, None), slice(None, -1))]  # fmt: skip
    first = axis[corners[0]]
    turned = [np.where((axis[c] * first).sum(axis=-1) < 0, -slope[c], slope[c]) for c in corners]
    return _zero_lines(np.stack(turned), field.shape), strength


def chains(segments: Segments) -> list[Float[np.ndarray, "n 2"]]:
    """The segments as polylines that end where other than two segments meet; a closed one repeats its first point."""
    ends = segments.ends
    if not len(ends):
        return []
    node, inverse = np.unique(ends, return_inverse=True)
    ends = inverse.reshape(-1, 2)
    place = segments.place[node]
    incident = np.argsort(ends.ravel(), kind="stable") // 2
    first = np.searchsorted(np.sort(ends.ravel()), np.arange(len(node) + 1)).tolist()
    pairs, incident_of, used = ends.tolist(), incident.tolist(), [False] * len(ends)
    degree = np.diff(first)
    found = []

    def walk(start: int, segment: int) -> None:
        path, here = [start], start
        while True:
            used[segment] = True
            a, b = pairs[segment]
            here = b if a == here else a
            path.append(here)
            if degree[here] != 2 or here == start:
                break
            one, other = incident_of[first[here] : first[here + 1]]
            segment = other if one == segment else one
            if used[segment]:
                break
        found.append(place[path])

    for start in np.flatnonzero(degree != 2).tolist():
        for segment in incident_of[first[start] : first[start + 1]]:
            if not used[segment]:
                walk(start, segment)
    for segment in range(len(pairs)):
        if not used[segment]:
            walk(pairs[segment][0], segment)
    return found


def linked(lines: Sequence[Float[np.ndarray, "n 2"]], reach: float, *, over: int = 6) -> list[Float[np.ndarray, "n 2"]]:
    """The lines, joined end to end where one goes on as another: nearest first, over gaps of up to ``reach`` pixels.

    ``over``: points that give the direction of an end.
    """
    if len(lines) < 2:
        return list(lines)
    place = np.array([end for line in lines for end in (line[0], line[-1])])
    inner = np.array([end for line in lines for end in (line[: over + 1][-1], line[-over - 1 :][0])])
    outward = place - inner
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    a, b = cKDTree(place).query_pairs(reach, output_type="ndarray").T
    gap = place[b] - place[a]
    length = np.linalg.norm(gap, axis=1)
    slack = 1.5  # pixels: a crack's end is as uncertain
    ahead = [(outward[a] * gap).sum(axis=1), -(outward[b] * gap).sum(axis=1)]
    good = (a // 2 != b // 2) & ((outward[a] * outward[b]).sum(axis=1) < -STRAIGHT)
    good &= (ahead[0] > STRAIGHT * length - slack) & (ahead[1] > STRAIGHT * length - slack)
    partner: dict[int, int] = {}
    for _, one, other in sorted(zip(length[good].tolist(), a[good].tolist(), b[good].tolist(), strict=True)):
        if one not in partner and other not in partner:
            partner[one], partner[other] = other, one
    return _joined(lines, partner)


def smoothed(line: Float[np.ndarray, "n 2"], sigma: float, *, spacing: float = 1.0) -> Float[np.ndarray, "n 2"]:
    """A polyline resampled at ``spacing`` and smoothed over ``sigma``, both in pixels; open ends stay in place."""
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    if length[-1] == 0.0:
        return line[:1]
    steps = max(2, round(float(length[-1]) / spacing))
    at = np.linspace(0.0, length[-1], steps + 1)
    even = np.stack([np.interp(at, length, line[:, k]) for k in range(2)], axis=1)
    width = min(sigma, 0.15 * float(length[-1])) / (float(length[-1]) / steps)
    if (line[0] == line[-1]).all():
        ring = gaussian_filter1d(even[:-1], width, axis=0, mode="wrap")
        return np.concatenate([ring, ring[:1]])
    # Odd reflection about the ends keeps them in place.
    pad = min(steps, int(4 * width) + 1)
    before, after = 2 * even[0] - even[pad:0:-1], 2 * even[-1] - even[-2 : -pad - 2 : -1]
    return gaussian_filter1d(np.concatenate([before, even, after]), width, axis=0)[pad : pad + steps + 1]


# ------------------------------------------------------------------------------------------------------------- helpers

STRAIGHT = 0.75  # cosine: lines that turn by more where they meet are not joined


def _joined(lines: Sequence[np.ndarray], partner: Mapping[int, int]) -> list[np.ndarray]:
    """Lines joined at their ends; ends 2k and 2k + 1 are the first and last point of line k."""
    used, found = [False] * len(lines), []
    free = [end for end in range(2 * len(lines)) if end not in partner]
    for start in [*free, *sorted(partner)]:  # what is left after the free ends are rings
        end, parts = start, []
        while not used[end // 2]:
            used[end // 2] = True
            parts.append(lines[end // 2][:: -1 if end % 2 else 1])
            end = partner.get(end ^ 1, end)
        if parts:
            found.append(np.concatenate(parts))
    return found


def _zero_lines(f: Float[np.ndarray, "4 h1 w1"], shape: tuple[int, int]) -> Segments:
    """Zero lines from the values at the corners of each cell: upper left, upper right, lower right, lower left."""
    height, width = shape
    below = f < 0
    mixed = (below.any(axis=0) != below.all(axis=0)) & np.isfinite(f).all(axis=0)
    row, column = np.nonzero(mixed)
    f = f[:, row, column]
    following = np.roll(f, -1, axis=0)
    crossed = (f < 0) != (following < 0)
    pixel, level = row * width + column, height * width
    # Sides of a cell: top, right, bottom, left. A node is a side; those down the picture come after those across.
    nodes = np.stack([pixel, level + pixel + 1, pixel + width, level + pixel])
    count, ends = crossed.sum(axis=0), []
    for a, b in combinations(range(4), 2):
        chosen = (count == 2) & crossed[a] & crossed[b]
        ends.append(np.stack([nodes[a][chosen], nodes[b][chosen]], axis=1))
    for a, b in ((0, 3), (1, 2)):  # a saddle
        ends.append(np.stack([nodes[a], nodes[b]], axis=1)[count == 4])
    place = np.zeros((2 * level, 2))
    corner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    share = f / np.where(crossed, f - following, 1.0)
    for k, side in enumerate(crossed):
        along = corner[(k + 1) % 4] - corner[k]
        start = np.stack([column, row], axis=1)[side] + corner[k]
        place[nodes[k][side]] = start + share[k][side, None] * along
    return Segments(np.concatenate(ends), place)
