"""Lines drawn on paper: strokes with a width along their length, anti-aliased, in grey."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float, UInt8
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from gcd_dataset.records import Record

STEP = 0.4  # pixels between the discs that a stroke is drawn with
PAPER = 255
GRAIN = 0.13  # standard deviation of the ink on paper


@dataclass(frozen=True, eq=False)
class Stroke(Record):
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
    strokes: Sequence[Stroke], size: int, *, paper: UInt8[np.ndarray, "h w"] | None = None, grain: int | None = None
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


def dashed(stroke: Stroke, dash: float, gap: float) -> list[Stroke]:
    """The stroke in dashes of equal length, as shares of the picture; begins and ends with a dash."""
    along = _along(stroke.points)
    count = max(1, round((along[-1] + gap) / (dash + gap)))
    scale = along[-1] / (count * dash + (count - 1) * gap)
    starts = np.arange(count) * (dash + gap) * scale
    return [replace(stroke, points=_cut(stroke.points, along, start, start + dash * scale)) for start in starts]


def by_hand(stroke: Stroke, rng: np.random.Generator, *, shake: float = 0.0022, again: float = 0.35) -> list[Stroke]:
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


# ------------------------------------------------------------------------------------------------------------- helpers


def _stamp(ink: Float[np.ndarray, " p"], stroke: Stroke, size: int) -> None:
    """Raise ``ink`` to the stroke's coverage of each pixel: a disc at every ``STEP`` along the line."""
    along = _along(stroke.points) * size
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


def _along(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def _cut(
    points: Float[np.ndarray, "n 2"], along: Float[np.ndarray, " n"], begin: float, end: float
) -> Float[np.ndarray, "m 2"]:
    """The part of a polyline between two lengths."""
    inner = (along > begin) & (along < end)
    at = np.concatenate([[begin], along[inner], [end]])
    return np.stack([np.interp(at, along, points[:, k]) for k in range(2)], axis=1)


CORNER = math.radians(40.0)  # a turn by more within ``TURN`` ends a piece
TURN = 0.012  # shares of the picture
PIECE = (0.12, 0.5)  # shares of the picture; length of a piece, drawn from the wrist or the elbow


def _pieces(points: Float[np.ndarray, "n 2"], rng: np.random.Generator) -> list[Float[np.ndarray, "m 2"]]:
    """A line cut at its corners and into lengths that an arm draws in one move."""
    along = _along(points)
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

    def at(length: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        return np.stack([np.interp(length, along, points[:, k]) for k in range(2)], axis=1)

    before, after = points - at(along - TURN), at(along + TURN) - points
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    turn = np.abs(np.arctan2(cross, (before * after).sum(axis=1)))
    turn[(along < TURN) | (along > along[-1] - TURN)] = 0.0
    peak = (turn > CORNER) & (turn >= np.roll(turn, 1)) & (turn > np.roll(turn, -1))
    return along[peak]


def _wavering(stroke: Stroke, rng: np.random.Generator, shake: float) -> Stroke:
    """The stroke, displaced by smooth noise, longer at both ends, with a pressure that begins and ends lightly."""
    points = _overshot(stroke.points, rng, min(0.006, 0.12 * stroke.length))
    along = _along(points)
    at = np.linspace(0.0, along[-1], max(4, math.ceil(along[-1] / 0.003)))
    points = np.stack([np.interp(at, along, points[:, k]) for k in range(2)], axis=1)
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
