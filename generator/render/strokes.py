"""Lines of pictures: curves found in fields, chained to smooth polylines, and drawn as strokes, anti-aliased, in grey.

Curves are in (column, row), and the centre of the upper left pixel is (0, 0); strokes are in shares of the picture.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from scipy.spatial import cKDTree

from gcd_dataset.records import Record

STEP = 0.4  # pixels between the discs that a stroke is drawn with
PAPER = 255
GRAIN = 0.13  # standard deviation of the ink on paper


@dataclass(frozen=True, eq=False)
class SketchLine(Record):
    """A line to draw."""

    points: Float[np.ndarray, "n 2"]
    """Column and row, as shares of the picture: 0 to 1."""
    width: float
    """Share of the picture."""
    ink: float = 1.0
    """0 leaves the paper white, 1 is black."""
    pressure: Float[np.ndarray, " n"] | None = None
    """Width at each point, as a multiple of ``width``; ``None`` for an even line."""

    @property
    def length(self) -> float:
        """Share of the picture."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())


def draw_strokes(
    strokes: Sequence[SketchLine], size: int, *, paper: UInt8[np.ndarray, "h w"] | None = None, grain: int | None = None
) -> UInt8[np.ndarray, "h w"]:
    """A grey picture of ``size`` × ``size`` pixels; where strokes cross, the darker one shows.

    ``grain``: seed of the paper's grain, which a pencil leaves partly white; ``None``: ink.
    """
    ink = np.zeros(size * size)
    for stroke in strokes:
        _stamp(ink, stroke, size)
    if grain is not None:
        rough = gaussian_filter(np.random.default_rng(grain).standard_normal((size, size)), 0.6) / 0.45
        ink *= np.clip(0.84 + GRAIN * rough.ravel(), 0.3, 1.0)
    ground = np.full(size * size, float(PAPER)) if paper is None else paper.ravel().astype(float)
    return np.rint(ground * (1.0 - ink)).astype(np.uint8).reshape(size, size)


def dashed(stroke: SketchLine, dash: float, gap: float) -> list[SketchLine]:
    """The stroke in dashes of equal length, as shares of the picture; begins and ends with a dash."""
    along = lengths_along(stroke.points)
    count = max(1, round((along[-1] + gap) / (dash + gap)))
    scale = along[-1] / (count * dash + (count - 1) * gap)
    starts = np.arange(count) * (dash + gap) * scale
    return [replace(stroke, points=_cut(stroke.points, along, start, start + dash * scale)) for start in starts]


def by_hand(
    stroke: SketchLine, rng: np.random.Generator, *, shake: float = 0.0022, again: float = 0.35
) -> list[SketchLine]:
    """The stroke as a hand draws it: pieces that overshoot, waver and press unevenly; some drawn a second time.

    ``shake``: standard deviation of the place [shares of the picture]; ``again``: share of pieces drawn twice.
    """
    pieces = []
    for points in _pieces(stroke.points, rng):
        piece = replace(stroke, points=points)
        repeats = 1 + (rng.random() < again and piece.length > 0.05)
        for number in range(repeats):
            ink = stroke.ink * rng.uniform(0.75, 1.0) * (0.6 if number else 1.0)
            pieces.append(_wavering(replace(piece, ink=ink), rng, shake))
    return pieces


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


def smoothed(line: Float[np.ndarray, "n 2"], sigma: float) -> Float[np.ndarray, "n 2"]:
    """A polyline resampled at each pixel and smoothed over ``sigma`` pixels; open ends stay in place."""
    length = lengths_along(line)
    if length[-1] == 0.0:
        return line[:1]
    steps = max(2, round(float(length[-1])))
    at = np.linspace(0.0, length[-1], steps + 1)
    even = points_at(line, length, at)
    width = min(sigma, 0.15 * float(length[-1])) / (float(length[-1]) / steps)
    if (line[0] == line[-1]).all():
        ring = gaussian_filter1d(even[:-1], width, axis=0, mode="wrap")
        return np.concatenate([ring, ring[:1]])
    # Odd reflection about the ends keeps them in place.
    pad = min(steps, int(4 * width) + 1)
    before, after = 2 * even[0] - even[pad:0:-1], 2 * even[-1] - even[-2 : -pad - 2 : -1]
    return gaussian_filter1d(np.concatenate([before, even, after]), width, axis=0)[pad : pad + steps + 1]


def _stamp(ink: Float[np.ndarray, " p"], stroke: SketchLine, size: int) -> None:
    """Raise ``ink`` to the stroke's coverage of each pixel: a disc at every ``STEP`` along the line."""
    along = lengths_along(stroke.points) * size
    at = np.linspace(0.0, along[-1], max(2, math.ceil(along[-1] / STEP) + 1))
    x, y = (np.interp(at, along, stroke.points[:, k]) * size - 0.5 for k in range(2))
    pressure = np.ones(len(at)) if stroke.pressure is None else np.interp(at, along, stroke.pressure)
    width = stroke.width * size * pressure
    # A line thinner than a pixel is drawn a pixel wide and paler.
    radius, tone = 0.5 * np.maximum(width, 1.0), stroke.ink * np.minimum(width, 1.0)
    reach = math.ceil(float(radius.max()) + 0.5)
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    offset = np.arange(-reach, reach + 2)
    c, r = column[:, None, None] + offset, row[:, None, None] + offset[:, None]
    apart = np.hypot(c - x[:, None, None], r - y[:, None, None])
    cover = np.clip(radius[:, None, None] + 0.5 - apart, 0.0, 1.0) * tone[:, None, None]
    c, r = np.broadcast_arrays(c, r)
    inside = (c >= 0) & (c < size) & (r >= 0) & (r < size) & (cover > 0)
    np.maximum.at(ink, (r * size + c)[inside], cover[inside])


def lengths_along(points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
    """Length of a polyline up to each of its points."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def points_at(
    points: Float[np.ndarray, "n d"], along: Float[np.ndarray, " n"], lengths: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "m d"]:
    """The points of a polyline at some lengths; ``along``: its ``lengths_along``."""
    return np.stack([np.interp(lengths, along, values) for values in points.T], axis=1)


def _cut(
    points: Float[np.ndarray, "n 2"], along: Float[np.ndarray, " n"], begin: float, end: float
) -> Float[np.ndarray, "m 2"]:
    """The part of a polyline between two lengths."""
    inner = (along > begin) & (along < end)
    return points_at(points, along, np.concatenate([[begin], along[inner], [end]]))


CORNER = math.radians(40.0)  # a turn by more within ``TURN`` ends a piece
TURN = 0.012  # shares of the picture
PIECE = (0.12, 0.5)  # shares of the picture; length of a piece, drawn from the wrist or the elbow


def _pieces(points: Float[np.ndarray, "n 2"], rng: np.random.Generator) -> list[Float[np.ndarray, "m 2"]]:
    """A line cut at its corners and into lengths that an arm draws in one move."""
    along = lengths_along(points)
    cuts = [0.0]
    corners = _corners(points, along)
    while cuts[-1] < along[-1]:
        end = cuts[-1] + rng.uniform(*PIECE)
        ahead = corners[(corners > cuts[-1] + TURN) & (corners < end)]
        end = float(ahead[0]) if len(ahead) else end
        cuts.append(along[-1] if end > along[-1] - 0.5 * PIECE[0] else end)
    return [_cut(points, along, a, b) for a, b in pairwise(cuts) if b > a]


def _corners(points: Float[np.ndarray, "n 2"], along: Float[np.ndarray, " n"]) -> Float[np.ndarray, " k"]:
    """Lengths at which the line turns sharply."""
    before, after = points - points_at(points, along, along - TURN), points_at(points, along, along + TURN) - points
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    turn = np.abs(np.arctan2(cross, (before * after).sum(axis=1)))
    turn[(along < TURN) | (along > along[-1] - TURN)] = 0.0
    peak = (turn > CORNER) & (turn >= np.roll(turn, 1)) & (turn > np.roll(turn, -1))
    return along[peak]


def _wavering(stroke: SketchLine, rng: np.random.Generator, shake: float) -> SketchLine:
    """The stroke, displaced by smooth noise, longer at both ends, with a pressure that begins and ends lightly."""
    points = _overshot(stroke.points, rng, min(0.006, 0.12 * stroke.length))
    along = lengths_along(points)
    at = np.linspace(0.0, along[-1], max(4, math.ceil(along[-1] / 0.003)))
    points = points_at(points, along, at)
    slow, quick, press = (_smooth_noise(rng, len(at), reach) for reach in (40.0, 8.0, 20.0))
    tangent = np.gradient(points, axis=0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    offset = shake * (0.9 * slow + 0.25 * quick + 0.4 * rng.standard_normal())
    fade = np.minimum(1.0, (np.minimum(at, at[-1] - at) + 0.002) / min(0.03, 0.35 * at[-1] + 1e-6))
    pressure = np.clip(1.0 + 0.3 * press, 0.4, 1.8) * (0.35 + 0.65 * fade)
    return replace(stroke, points=points + offset[:, None] * normal, pressure=pressure)


def _overshot(points: Float[np.ndarray, "n 2"], rng: np.random.Generator, most: float) -> Float[np.ndarray, "m 2"]:
    """The line with straight ends up to ``most`` longer."""
    back = min(4, len(points) - 1)
    ends = []
    for here, inner in ((points[0], points[back]), (points[-1], points[-1 - back])):
        direction = (here - inner) / max(float(np.linalg.norm(here - inner)), 1e-12)
        ends.append(here + rng.uniform(0.0, most) * direction)
    return np.concatenate([ends[:1], points, ends[1:]])


def _smooth_noise(rng: np.random.Generator, n: int, reach: float) -> Float[np.ndarray, " n"]:
    """Noise of unit variance, correlated over ``reach`` values."""
    pad = int(4 * reach)
    noise = gaussian_filter1d(rng.standard_normal(n + 2 * pad), reach)[pad : pad + n]
    return noise * math.sqrt(2.0 * math.sqrt(math.pi) * reach)


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
