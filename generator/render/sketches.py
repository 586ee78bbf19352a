"""Line drawings of garments: outline, edges of cloth in front of cloth, seams, stitched hems and folds.

Lines are found in a range image and drawn as smooth strokes at any size:

- outline: the border of the cloth against the background, or against the body;
- edges: where the depth jumps, as at a fold in front of cloth, a sleeve in front of the trunk, or a neckline;
- seams: of the pattern, where nothing hides them, darts included;
- hems: a dashed line of stitches beside each edge of cloth;
- folds: valleys in the brightness under a lamp at the camera. These are the suggestive contours of DeCarlo et al.,
  Suggestive contours for conveying shape (ACM Trans. Graph. 22(3), 2003), by their method for pictures, section 4.2.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter
from scipy.spatial import cKDTree

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render.cameras import Camera, look_at
from gcd_dataset.generator.render.geometry import HEM, PanelBorders, panel_borders
from gcd_dataset.generator.render.scans import RangeImage, Ranger
from gcd_dataset.generator.render.scene import Scene
from gcd_dataset.generator.render.strokes import (
    Segments,
    SketchLine,
    by_hand,
    chains,
    cracks,
    dashed,
    draw_strokes,
    lengths_along,
    level_lines,
    linked,
    points_at,
    smoothed,
    valleys,
)
from gcd_dataset.records import Body

PIXELS = 640  # rows and columns of the range image; strokes are smooth, so that a sketch may be larger
FILL = 0.9  # share of the picture's height or width that the garment takes
DISTANCE = 1000.0  # cm; far away: a technical flat has hardly any perspective
NOBODY = Body(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros(0, np.uint8), "none")

WIDTHS = {"outline": 0.0046, "edge": 0.0030, "seam": 0.0020, "hem": 0.0016, "fold": 0.0018, "body": 0.0018}
"""Width of each kind of line, as a share of the picture."""
INKS = {"outline": 1.0, "edge": 1.0, "seam": 0.9, "hem": 0.8, "fold": 0.65, "body": 0.45}
"""Darkness of each kind of line."""

JUMP, LEAST_JUMP = 0.8, 0.25  # cm from a pixel to its neighbour's tangent plane: somewhere on an edge, and all along it
LINK, SPECK = 2.5, 0.4  # cm; gap over which edges are joined, and shortest piece of one
JUMP_SHARE = 0.1  # share of an edge on which the depth jumps by ``JUMP``
SHORTEST = {"outline": 2.0, "edge": 1.5, "seam": 1.5, "fold": 5.0, "body": 3.0}  # cm; shorter lines are left out
SMOOTH = 2.0  # pixels of the range image; removes the steps of pixels
HEM_STITCH = 1.8  # cm from the edge of the cloth to its stitches
DASH, GAP = 0.9, 0.55  # cm
HIDDEN = 0.6  # cm; a seam further behind the surface is hidden
FOLD_SCALE = 1.1  # cm; brightness is smoothed over this length
FOLD_STRENGTH, FOLD_PEAK = 0.010, 0.022  # 1/cm²: least curvature of the brightness along a fold, and at its deepest
CLEAR = {"seam": 0.7, "hem": 0.5, "fold": 1.2}  # cm; such lines keep this distance from outline and edges
INSIDE = 224  # grey of the cloth's inside in a flat


@dataclass(frozen=True)
class SketchStyle:
    """What is drawn, and how."""

    hand: bool = False
    """Whether lines waver, overshoot and vary in weight, as drawn by hand in pencil; else even lines in ink."""
    seams: bool = True
    hems: bool = True
    """Whether stitches are drawn beside the edges of the cloth."""
    folds: bool = True
    body: bool = False
    """Whether the wearer is drawn; else the garment alone, with its inside where that is seen."""
    weight: float = 1.0
    """Width of all lines, as a multiple of the standard one."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.weight) and self.weight > 0):
            raise ConfigError(f"weight of a sketch's lines is {self.weight}: give more than 0")


FLAT = SketchStyle()
"""A technical flat of the draped garment: clean lines, grey inside."""
HAND = SketchStyle(hand=True, body=True, hems=False)
"""A drawing on the figure, by hand."""


def sketch_camera(scene: Scene, yaw: float = 0.0, *, body: bool = False) -> Camera:
    """A far camera that frames the garment, with ``body`` the figure; 0 in front, 180 behind [degrees]."""
    points = scene.vertices
    if body:
        points = np.concatenate([points, scene.body.vertices])
    if not len(points):
        raise ConfigError("a sketch of a scene without cloth: give a draped garment")
    angle = math.radians(yaw)
    away, right = np.array([math.sin(angle), 0.0, math.cos(angle)]), np.array([math.cos(angle), 0.0, -math.sin(angle)])
    across, height = points @ right, points[:, 1]
    low, high = np.array([across.min(), height.min()]), np.array([across.max(), height.max()])
    middle = 0.5 * (low + high)
    deep = points @ away
    target = middle[0] * right + np.array([0.0, middle[1], 0.0]) + 0.5 * (deep.min() + deep.max()) * away
    nearest = DISTANCE - 0.5 * float(np.ptp(deep))
    return look_at(target + DISTANCE * away, target, focal=FILL * nearest / max(float((high - low).max()), 1e-6))


def sketch(
    scene: Scene,
    camera: Camera,
    *,
    size: int = 512,
    style: SketchStyle = FLAT,
    rng: np.random.Generator | None = None,
    device: str = "auto",
) -> UInt8[np.ndarray, "h w"]:
    """A drawing of ``size`` × ``size`` pixels, dark lines on white.

    ``rng`` moves the hand of a style with ``hand``. Raises ``ConfigError`` for such a style without it, a size below 1,
    and a scene without faces.
    """
    if size < 1:
        raise ConfigError(f"a sketch of {size} pixels: give a size of 1 or more")
    if style.hand and rng is None:
        raise ConfigError("a sketch by hand needs rng=, the random stream of its strokes")
    image = _range_image(scene, camera, style, device)
    strokes = [replace(s, width=s.width * style.weight) for s in sketch_strokes(image, style)]
    if rng is None or not style.hand:
        return draw_strokes(strokes, size, paper=_paper(image, size))
    drawn = [piece for stroke in strokes for piece in by_hand(stroke, rng)]
    return draw_strokes(drawn, size, grain=int(rng.integers(1 << 31)))


def sketch_strokes(image: RangeImage, style: SketchStyle = FLAT) -> list[SketchLine]:
    """The lines of a range image, as even strokes."""
    lines = _Lines(image)
    found = [*lines.outlines(), *lines.edges()]
    found += lines.seams() if style.seams else []
    found += lines.hems() if style.hems else []
    found += lines.folds() if style.folds else []
    found += lines.figure() if style.body else []
    return found


class _Lines:
    """The lines of one range image; lengths in cm are those at the middle of the cloth."""

    def __init__(self, image: RangeImage) -> None:
        self.image, self.cloth = image, image.garment
        depth = float(np.median(image.depth[self.cloth])) if self.cloth.any() else 1.0
        self.cm = image.camera.focal * image.size / depth
        """Pixels to the centimetre."""
        self.turned = _seen_from_behind(image)
        self.border = _differ(self.cloth)
        self.jumps = _jumps(image, self.turned)
        self.edge_lines = self._jump_lines(self.cloth)
        self.clearance = self._clearance()
        """Distance of each pixel from outline and edges [cm]."""

    @cached_property
    def borders(self) -> PanelBorders:
        return panel_borders(self.image.scene)

    def outlines(self) -> list[SketchLine]:
        return self._strokes("outline", chains(cracks(*self.border)))

    def edges(self) -> list[SketchLine]:
        return self._strokes("edge", self.edge_lines)

    def figure(self) -> list[SketchLine]:
        """The body's own lines, where cloth does not draw the border."""
        covered = self.image.covered
        skin = covered & ~self.cloth
        beside = [pair & ~border for pair, border in zip(_differ(covered), self.border, strict=True)]
        return self._strokes("body", [*chains(cracks(*beside)), *self._jump_lines(skin)])

    def seams(self) -> list[SketchLine]:
        """The pattern's seams that are seen."""
        scene, borders = self.image.scene, self.borders
        sewn = scene.uv_vertex[borders.ends[borders.seam != HEM]]
        pairs = np.unique(np.sort(sewn, axis=1), axis=0)
        runs: list[np.ndarray] = []
        for line in chains(Segments(pairs, scene.vertices)):
            even = _resampled(line, 0.4)
            pixels = self.image.camera.project(even, self.image.size)
            runs += _runs(pixels, self._in_sight(even, pixels), gap=4)
        return self._strokes("seam", runs)

    def hems(self) -> list[SketchLine]:
        """Dashes at ``HEM_STITCH`` from the edges of the cloth, on its outside."""
        runs: list[np.ndarray] = []
        for line in chains(level_lines(self._distance_to_hems(), HEM_STITCH)):
            runs += _runs(line, self.clearance[_at(line, self.cloth.shape)] > CLEAR["hem"], gap=3)
        strokes = self._strokes("hem", runs)
        long = [stroke for stroke in strokes if stroke.length * self.image.size > 2 * DASH * self.cm]
        dash, gap = DASH * self.cm / self.image.size, GAP * self.cm / self.image.size
        return [piece for stroke in long for piece in dashed(stroke, dash, gap)]

    def folds(self) -> list[SketchLine]:
        """Valleys of the brightness under a lamp at the camera."""
        sigma = FOLD_SCALE * self.cm
        bright, known = self._brightness(sigma)
        segments, strength = valleys(np.where(known, bright, 1.0), sigma=0.5 * sigma)
        strength = strength * self.cm**2
        lines: list[np.ndarray] = []
        for line in chains(segments):
            at = _at(line, strength.shape)
            good = (strength[at] > FOLD_STRENGTH) & (self.clearance[at] > CLEAR["fold"]) & self.cloth[at]
            runs = _runs(line, good, gap=2)
            lines += [run for run in runs if strength[_at(run, strength.shape)].max() > FOLD_PEAK]
        return [_tapered(stroke) for stroke in self._strokes("fold", lines)]

    def _jump_lines(self, surface: Bool[np.ndarray, "h w"]) -> list[np.ndarray]:
        """Lines along which the depth of a surface jumps: by ``LEAST_JUMP`` all along, by ``JUMP`` in places."""
        both = surface[:, :-1] & surface[:, 1:], surface[:-1] & surface[1:]
        least = [(jump > LEAST_JUMP) & pair for jump, pair in zip(self.jumps, both, strict=True)]
        strong = _distance_to(*(jump > JUMP for jump in self.jumps)) <= 1.0
        whole = [line for line in chains(cracks(*least)) if len(line) > SPECK * self.cm]
        lines = linked(whole, LINK * self.cm)
        return [line for line in lines if strong[_at(line, strong.shape)].mean() > JUMP_SHARE]

    def _clearance(self) -> Float[np.ndarray, "h w"]:
        across, down = (border.copy() for border in self.border)
        beside = np.zeros(self.cloth.shape, bool)
        for line in self.edge_lines:
            beside[_at(line, beside.shape)] = True
        across, down = across | beside[:, :-1], down | beside[:-1]
        return _distance_to(across, down) / self.cm

    def _strokes(self, kind: str, lines: Sequence[np.ndarray]) -> list[SketchLine]:
        """Smooth strokes of the lines that are long enough; from pixels to shares of the picture."""
        strokes = []
        for line in lines:
            curve = smoothed(line, SMOOTH)
            points = (curve + 0.5) / self.image.size
            stroke = SketchLine(points, WIDTHS[kind], INKS[kind])
            if stroke.length * self.image.size >= SHORTEST.get(kind, 0.0) * self.cm:
                strokes.append(stroke)
        return strokes

    def _in_sight(self, points: Float[np.ndarray, "n 3"], pixels: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Whether points of the cloth are seen, and clear of outline and edges."""
        camera, shape = self.image.camera, self.image.face.shape
        depth = (points - camera.eye) @ camera.rotation[2]
        at = _at(pixels, shape)
        nearest = np.full(len(points), np.inf)
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                row, column = np.clip(at[0] + down, 0, shape[0] - 1), np.clip(at[1] + right, 0, shape[1] - 1)
                there = self.cloth[row, column]
                gap = np.where(there, np.abs(self.image.depth[row, column] - depth), np.inf)
                nearest = np.minimum(nearest, gap)
        inside = ((pixels >= 0) & (pixels < np.array(shape[::-1]))).all(axis=1)
        return inside & (nearest < HIDDEN) & (self.clearance[at] > CLEAR["seam"])

    def _distance_to_hems(self) -> Float[np.ndarray, "h w"]:
        """Distance along the cloth to the next edge without a seam [cm]; NaN off the cloth's outside."""
        scene, image = self.image.scene, self.image
        ends = self.borders.ends[self.borders.seam == HEM]
        distance = np.full(image.face.shape, np.nan)
        outside = self.cloth & ~self.turned
        if not len(ends) or not outside.any():
            return distance
        a, b = scene.uv[ends].transpose(1, 0, 2)
        share = np.linspace(0.0, 1.0, 9)[:, None, None]
        # Panels lie on one plane each; a third coordinate keeps them apart.
        along = np.column_stack(
            [((1 - share) * a + share * b).reshape(-1, 2), np.tile(scene.panel_of_row[ends[:, 0]], 9) * 1e3]
        )
        here = np.column_stack([_uv_at(image, outside), image.panel[outside] * 1e3])
        most = HEM_STITCH + 3.0
        found, _ = cKDTree(along).query(here, distance_upper_bound=most)
        distance[outside] = np.minimum(found, most)
        return distance

    def _brightness(self, sigma: float) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
        """Cosine between normal and line of sight, of normals averaged over the cloth within ``sigma`` pixels."""
        share = gaussian_filter(self.cloth.astype(np.float32), sigma)
        known = self.cloth & (share > 0.05)
        normals = self.image.normals * self.cloth[..., None]
        mean = np.stack([gaussian_filter(normals[..., k], 0.7 * sigma) for k in range(3)], axis=-1)
        mean /= np.maximum(np.linalg.norm(mean, axis=2, keepdims=True), 1e-6)
        return -mean @ self.image.camera.rotation[2], known


def _range_image(scene: Scene, camera: Camera, style: SketchStyle, device: str) -> RangeImage:
    scene = scene if style.body else replace(scene, body=NOBODY)
    if not len(scene.faces):
        raise ConfigError("a sketch of a scene without cloth: give a draped garment")
    with Ranger(scene, device=device) as ranger:
        [image] = ranger.images([camera], PIXELS)
    return image


def _seen_from_behind(image: RangeImage) -> Bool[np.ndarray, "h w"]:
    """Pixels that show the inside of the cloth."""
    a, b, c = image.scene.vertices[image.scene.faces].transpose(1, 0, 2)
    away = np.einsum("fc,fc->f", np.cross(b - a, c - a), a - image.camera.eye) > 0
    own = image.garment
    return own & away[np.where(own, image.face, 0)]


def _differ(mask: Bool[np.ndarray, "h w"]) -> tuple[np.ndarray, np.ndarray]:
    return mask[:, :-1] != mask[:, 1:], mask[:-1] != mask[1:]


def _jumps(image: RangeImage, turned: Bool[np.ndarray, "h w"]) -> tuple[np.ndarray, np.ndarray]:
    """How far each of two neighbours, across and down, lies off the other's tangent plane [cm].

    Infinite between the two sides of the cloth.
    """
    place, normal = image.positions(), image.normals
    jumps = []
    for a, b in (((slice(None), slice(None, -1)), (slice(None), slice(1, None))), (slice(None, -1), slice(1, None))):
        apart = place[b] - place[a]
        off = [np.abs(np.einsum("hwc,hwc->hw", apart, normal[side])) for side in (a, b)]
        jumps.append(np.where(turned[a] != turned[b], np.inf, np.maximum(*off)))
    return jumps[0], jumps[1]


def _distance_to(across: np.ndarray, down: np.ndarray) -> Float[np.ndarray, "h w"]:
    """Distance of each pixel from the next pixel beside a line [pixels]."""
    beside = np.zeros((across.shape[0], down.shape[1]), bool)
    beside[:, :-1] |= across
    beside[:-1] |= down
    if not beside.any():
        return np.full(beside.shape, np.inf)
    return distance_transform_edt(~beside)


def _at(line: Float[np.ndarray, "n 2"], shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the pixels under a line."""
    row, column = np.rint(np.nan_to_num(line[:, 1])).astype(int), np.rint(np.nan_to_num(line[:, 0])).astype(int)
    return np.clip(row, 0, shape[0] - 1), np.clip(column, 0, shape[1] - 1)


def _runs(line: Float[np.ndarray, "n d"], kept: Bool[np.ndarray, " n"], *, gap: int) -> list[np.ndarray]:
    """The parts of a line that are kept; gaps of up to ``gap`` points are closed."""
    if gap and len(kept):
        kept = binary_dilation(kept, iterations=gap)
        kept = ~binary_dilation(~kept, iterations=gap) if len(kept) > 2 * gap else kept
    bounds = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(int)))
    return [line[a:b] for a, b in zip(bounds[::2], bounds[1::2], strict=True) if b - a > 1]


def _resampled(line: Float[np.ndarray, "n 3"], spacing: float) -> Float[np.ndarray, "m 3"]:
    along = lengths_along(line)
    return points_at(line, along, np.linspace(0.0, along[-1], max(2, round(float(along[-1]) / spacing))))


def _uv_at(image: RangeImage, pixels: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "n 2"]:
    """Panel-plane coordinates of pixels of cloth [cm]."""
    corner = image.scene.uv[image.scene.corners[image.face[pixels]]]
    u, v = image.weights[pixels].T.astype(float)
    return u[:, None] * corner[:, 0] + v[:, None] * corner[:, 1] + (1 - u - v)[:, None] * corner[:, 2]


def _tapered(stroke: SketchLine) -> SketchLine:
    """A fold runs out at both ends."""
    share = np.linspace(0.0, 1.0, len(stroke.points))
    return replace(stroke, pressure=0.25 + 0.75 * np.sqrt(np.sin(np.pi * share).clip(0.0)))


def _paper(image: RangeImage, size: int) -> UInt8[np.ndarray, "h w"]:
    """White, and grey where the inside of the cloth is seen, blended at its border."""
    inside = gaussian_filter(_seen_from_behind(image).astype(float), 0.7 * max(1.0, image.size / size))
    at = (np.arange(size) + 0.5) * image.size / size - 0.5
    low = np.clip(np.floor(at).astype(int), 0, image.size - 2)
    share = np.clip(at - low, 0.0, 1.0)
    rows = inside[low] * (1 - share)[:, None] + inside[low + 1] * share[:, None]
    blended = rows[:, low] * (1 - share) + rows[:, low + 1] * share
    return np.rint(255.0 - (255.0 - INSIDE) * blended).astype(np.uint8)
