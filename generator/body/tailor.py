"""Measures a body with known landmarks: finds the level of each girth, moves landmarks there, takes the measures.

Girths are lengths of tight tapes round level sections. The level is searched near a ring of points: fullest bust,
fullest hips, narrowest waist; landmarks beside it (bust, sides, buttocks, mid back) move to the section found. On the
model's mesh landmarks are known by vertex; on other meshes ``find_landmarks`` finds them first.
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Float, Int, UInt8

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.asset import body_model, landmark_table
from gcd_dataset.generator.body.geodesic import GeodesicGraph
from gcd_dataset.generator.body.landmarks import Landmarks, model_landmarks
from gcd_dataset.generator.body.section import clipped, girth, rough_girths, section, section_points, tape
from gcd_dataset.generator.body.surface import near
from gcd_dataset.measurements import MEASURE, SIDEWAYS
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import BodyPart, Measurements, Record

GIRTHS = ("bust", "underbust", "waist", "hips")
LANDMARKS_AT_LEVEL = {
    "bust": ("bust_left", "bust_right", "bust_side_left", "bust_side_right"),
    "waist": ("waist_side_left", "waist_side_right", "mid_waist_back"),
    "hips": ("hips_side_left", "hips_side_right", "bum_left", "bum_right"),
}
"""Girth to the landmarks that are moved to its section."""
X, Y, Z = 0, 1, 2
XZ, ZY = slice(0, 3, 2), slice(2, 0, -1)
BACK = (0.0, -1.0)  # the backward direction as (x, z), in a level section
# The lengths below are for a body of USUAL_HEIGHT; they scale with the height.
USUAL_HEIGHT = 172.0  # cm
SEARCH = np.arange(-4, 5) * 0.5  # cm: levels searched about the ring's mean height, as in GarmentCodeData
LEG_STEP = 0.5  # cm: step by which the thigh's section is lowered until the legs are separate
LEG_STEPS = 30
LEG_LOWERED = 0.75  # cm: a girth lowered by more may be over half a centimetre too small
MIDDLES = np.array([0.0, 0.25, -0.25, 0.5, -0.5, 1.0, -1.0])  # cm from the crotch: sagittal planes to try
NECK_CLEARANCE = 1.4  # cm from the side of the neck outwards to the plane over the bust, as in GarmentCodeData


@dataclass(frozen=True)
class MeasureResult:
    """The measures of a body, and the levels of its girths."""

    measurements: Measurements
    levels: Mapping[str, float]
    """Height of each girth [cm]."""
    at_border: Mapping[str, float]
    """Girths with their extremum at the end of the search: level minus the centre of the search [cm].

    Also ``leg_circ``, if its level was lowered by more than ``LEG_LOWERED``.
    """


def take_measures(vertices: Float[np.ndarray, "v 3"], sites: "Sites") -> Measurements:
    """The measures of a body with the model's mesh; ``sites``: see ``model_sites``."""
    return measure_at(vertices, model_landmarks(vertices), sites).measurements


def measure_at(vertices: Float[np.ndarray, "v 3"], marks: Landmarks, sites: "Sites") -> MeasureResult:
    """The measures of any body, from its landmarks and the sites on its mesh. Raises ``BodyError``."""
    heights = vertices[:, Y].copy()  # contiguous: argmin and argmax take a third of the time
    upright = vertices[[heights.argmin(), heights.argmax()]]
    scale = relative_height(upright)
    corners, local = sites.compact
    skin = vertices.take(corners, axis=0)
    offsets = SEARCH * scale
    found = {
        "bust": _section_near(skin, local, marks, "bust", offsets, np.argmax),
        "underbust": _section_near(skin, local, marks, "underbust", np.zeros(1), np.argmax),
        "waist": _section_near(skin, local, marks, "waist", offsets, np.argmin),
        "hips": _section_near(skin, local, marks, "hips", offsets, np.argmax),
    }
    points = dict(marks.points)
    for name, names in LANDMARKS_AT_LEVEL.items():
        cut = section(skin, local.bands[name], Y, found[name][0, Y])
        points |= zip(names, _nearest_on(cut, np.stack([points[point] for point in names])), strict=True)
    over_bust = _over_bust(skin, local, marks, scale)
    spine_x = (points["nape_of_neck"][X] + points["mid_waist_back"][X]) / 2
    spine = section(skin, local.spine, X, spine_x).reshape(-1, 3)
    leg_level, leg_circ = _leg_girth(skin, local, marks, scale)
    tape = _Tape(upright, points, marks.rings, found, spine, over_bust, leg_circ, sites.arm.length(vertices))
    measurements = Measurements(**{name: float(known.formula(tape)) for name, known in MEASURE.items()})
    levels = {name: float(cut[0, Y]) for name, cut in found.items()} | {"leg_circ": leg_level}
    return MeasureResult(measurements, levels, _at_border(levels, marks, scale))


@dataclass(frozen=True, eq=False)
class _Tape:
    """Implements ``measurements.Tape`` for one body."""

    upright: Float[np.ndarray, "2 3"]  # the lowest and the highest vertex
    points: Mapping[str, Float[np.ndarray, "3"]]
    rings: Mapping[str, Float[np.ndarray, "n 3"]]
    sections: Mapping[str, Float[np.ndarray, "n 3"]]
    spine: Float[np.ndarray, "n 3"]
    breast: Float[np.ndarray, "s 2 3"]
    larger_thigh: float
    arm: float

    def height(self) -> float:
        return float(np.ptp(self.upright[:, Y]))

    def to_crown(self, point: str) -> float:
        return float(self.upright[:, Y].max() - self.points[point][Y])

    def apart(self, point: str, other: str) -> float:
        return float(np.linalg.norm(self.points[point] - self.points[other], axis=-1))

    def above(self, point: str, other: str) -> float:
        return float(np.abs(self.points[point][Y] - self.points[other][Y]))

    def sinking(self, start: str, end: str) -> float:
        return sinking(self.points[start], self.points[end])

    def leaning(self, upper: str, lower: str) -> float:
        return -sinking(self.points[lower], self.points[upper], axis=X)

    def along(self, ring: str) -> float:
        return float(np.linalg.norm(np.diff(self.rings[ring], axis=0), axis=-1).sum())

    def around(self, ring: str) -> float:
        closed = np.concatenate([self.rings[ring], self.rings[ring][:1]])
        return float(np.linalg.norm(np.diff(closed, axis=0), axis=-1).sum())

    def down_arm(self) -> float:
        return self.arm

    def girth(self, section: str) -> float:
        return girth(self.sections[section][:, XZ])

    def thigh(self) -> float:
        return self.larger_thigh

    def over_back(self, section: str, left: str, right: str) -> float:
        return over_back(self.sections[section], self.points[left], self.points[right])

    def down_spine(self, upper: str, lower: str) -> float:
        high, low = self.points[upper], self.points[lower]
        between = (self.spine[:, Y] < high[Y]) & (self.spine[:, Y] > low[Y])
        return tape(np.concatenate([self.spine[between], [high, low]])[:, ZY], (-1.0, 0.0))

    def over_breast(self, level: str, facing: tuple[float, float], over: float) -> float:
        origin = np.array([0.0, float(self.points[level][Y]), 0.0])
        return tape(clipped(self.breast, (0.0, 1.0, 0.0), origin).reshape(-1, 3)[:, ZY], facing, over=over)


def sinking(start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"], *, axis: int = Y) -> float:
    """Slope of the line from ``start`` to ``end`` to the plane normal to an axis, by default the horizontal [rad]."""
    return float(np.arcsin((start - end)[axis] / np.linalg.norm(start - end, axis=-1)))


def larger_thigh(section: Float[np.ndarray, "s 2 3"], middle: float) -> float:
    """Length of a tape round the larger thigh, in a level section with the legs on both sides of x = ``middle`` [cm].

    GarmentCode measures the contour, which is 0.005 cm longer on smooth thighs, and 2 cm on the rough skin of a scan.
    """
    right = section[:, :, X].mean(axis=1) < middle
    return max(girth(section[side, 0][:, XZ]) for side in (right, ~right))


def over_back(section: Float[np.ndarray, "n 3"], left: Float[np.ndarray, "3"], right: Float[np.ndarray, "3"]) -> float:
    """Length of a tape over the back of a level section, from ``left`` to ``right`` [cm]."""
    x, z = (left - right)[XZ]
    behind = (section - left)[:, XZ] @ [z, -x] >= 0
    return tape(np.concatenate([section[behind], [left, right]])[:, XZ], BACK, over=SIDEWAYS)


def relative_height(vertices: Float[np.ndarray, "v 3"]) -> float:
    """Height over ``USUAL_HEIGHT``: the factor on lengths in the search for measures."""
    return float(np.ptp(vertices[:, Y])) / USUAL_HEIGHT


def _at_border(levels: Mapping[str, float], marks: Landmarks, scale: float) -> dict[str, float]:
    """See ``MeasureResult.at_border``."""
    reach = dict.fromkeys(("bust", "waist", "hips"), SEARCH[-1] * scale - 1e-6) | {"leg_circ": LEG_LOWERED * scale}
    centres = {**marks.levels, "leg_circ": marks.levels["leg_right"]}
    offsets = {name: levels[name] - centres[name] for name in reach}
    return {name: round(offset, 3) for name, offset in offsets.items() if abs(offset) > reach[name]}


@dataclass(frozen=True, eq=False)
class Sites(Record):
    """The faces and edges near each measure: all that its plane may cut on any body with the same mesh."""

    rings: Mapping[str, Int[np.ndarray, "e 2"]]
    """Edges near each girth, for sections at many levels at once."""
    bands: Mapping[str, Int[np.ndarray, "f 3"]]
    """The faces of these edges."""
    thighs: Int[np.ndarray, "f 3"]
    breast: Int[np.ndarray, "f 3"]
    spine: Int[np.ndarray, "f 3"]
    arm: GeodesicGraph

    @functools.cached_property
    def compact(self) -> tuple[Int[np.ndarray, " n"], Self]:
        """The vertices of the sites, and the sites renumbered to these: sections then test fewer vertices."""
        faces = (*self.bands.values(), self.thighs, self.breast, self.spine)
        corners = np.unique(np.concatenate([ids.ravel() for ids in (*self.rings.values(), *faces)]))

        def renumbered(ids: np.ndarray) -> np.ndarray:
            return np.searchsorted(corners, ids)

        return corners, replace(
            self,
            rings={name: renumbered(ring) for name, ring in self.rings.items()},
            bands={name: renumbered(band) for name, band in self.bands.items()},
            thighs=renumbered(self.thighs),
            breast=renumbered(self.breast),
            spine=renumbered(self.spine),
        )


@functools.cache
def model_sites() -> Sites:
    """The sites on the model's mesh."""
    model = body_model()
    return find_sites(model.mean, model.faces, model.parts)


def find_sites(mean: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], parts: UInt8[np.ndarray, " v"]) -> Sites:
    """The sites on the model's mesh, from its mean body, wide enough for other bodies."""
    points = landmark_table().points
    arm = arm_graph(mean, faces, points["shoulder_right"], points["wrist_right"])
    return sites_of(mean, faces, parts, model_landmarks(mean), arm)


def sites_of(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    parts: UInt8[np.ndarray, " v"],
    marks: Landmarks,
    arm: GeodesicGraph,
) -> Sites:
    """The sites on any mesh, with widths that scale with the height."""
    scale = relative_height(vertices)
    arms = [BodyPart.LEFT_ARM.value, BodyPart.RIGHT_ARM.value, BodyPart.HANDS.value]
    trunk = faces[~np.isin(parts, arms)[faces].any(axis=1)]

    def between(low: float, high: float) -> Int[np.ndarray, "f 3"]:
        heights = vertices[trunk, Y]
        return trunk[(heights.max(axis=1) > low) & (heights.min(axis=1) < high)]

    nape, leg = marks.points["nape_of_neck"], marks.levels["leg_right"]
    torso = between(marks.levels["waist"] - 8.0 * scale, marks.points["neck_right"][Y] + 4.0 * scale)
    x = (vertices[torso, X] - nape[X]) / scale
    back = (nape[Z] + marks.points["bust_right"][Z]) / 2
    level = {name: marks.levels[name] for name in GIRTHS}
    bands = {name: between(at - 7.0 * scale, at + 7.0 * scale) for name, at in level.items()}
    return Sites(
        rings={name: mesh_edges(band).ends for name, band in bands.items()},
        bands=bands,
        thighs=between(leg - 18.0 * scale, leg + 8.0 * scale),
        breast=torso[(x.max(axis=1) < -2.0) & (x.min(axis=1) > -22.0)],
        spine=torso[(np.abs(x).max(axis=1) < 4.0) & (vertices[torso, Z].mean(axis=1) < back)],
        arm=arm,
    )


def arm_graph(mean: np.ndarray, faces: np.ndarray, shoulder: int, wrist: int) -> GeodesicGraph:
    """The graph over the skin near the geodesic from shoulder to wrist on the mean body."""
    straight = np.linspace(mean[shoulder], mean[wrist], 100)
    rough = GeodesicGraph.over(faces[near(mean, straight, 9.0)[faces].all(axis=1)], shoulder, wrist, points_per_edge=1)
    beside = near(mean, rough.path(mean), 1.6)[faces].all(axis=1)
    # Three points on an edge make the path 0.1 cm too long; five would halve the error and double the time.
    return (
        GeodesicGraph.over(faces[beside], shoulder, wrist, points_per_edge=3)
        .without_detours(mean, least=0.8)
        .near_shortest(mean, most=0.15)
    )


def _section_near(
    vertices: np.ndarray,
    sites: Sites,
    marks: Landmarks,
    name: str,
    offsets: Float[np.ndarray, " l"],
    best: Callable[[np.ndarray], np.intp],
) -> Float[np.ndarray, "n 3"]:
    """The points of the section with the largest or smallest girth (``best``: argmax, argmin) near a level [cm]."""
    levels = marks.levels[name] + offsets
    points, level = section_points(vertices, sites.rings[name], Y, levels)
    rough = rough_girths(points[:, XZ], level)
    if len(rough) < len(levels):
        raise BodyError(f"no skin at the level of the {name}, {marks.levels[name]:.1f} cm: correct the mesh there")
    return points[level == levels[best(rough)]]


def _nearest_on(segments: Float[np.ndarray, "s 2 3"], points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """The nearest point of a section to each point [cm]."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    length = np.maximum(np.einsum("si,si->s", along, along), 1e-12)
    ahead = np.einsum("ni,si->ns", points, along) - np.einsum("si,si->s", start, along)
    nearest = start + np.minimum(np.maximum(ahead / length, 0.0), 1.0)[:, :, None] * along
    offset = nearest - points[:, None]
    return nearest[np.arange(len(points)), np.einsum("nsi,nsi->ns", offset, offset).argmin(axis=1)]


def _leg_girth(vertices: np.ndarray, sites: Sites, marks: Landmarks, scale: float) -> tuple[float, float]:
    """Level and girth of the larger thigh, at the first level below the crotch with separate legs.

    If thighs overlap at all levels: the girth of the right part of the lowest section.
    """
    start = marks.levels["leg_right"]
    levels = start - LEG_STEP * scale * np.arange(LEG_STEPS)
    middle, joined = _between_legs(vertices, sites, marks, levels, scale)
    separate = np.flatnonzero(levels < joined)
    level = float(levels[separate[0] if len(separate) else -1])
    cut = section(vertices, sites.thighs, Y, level)
    right = cut[:, :, X].mean(axis=1) < middle
    if not right.any() or right.all():
        raise BodyError(f"no two legs at the level {level:.1f} cm: correct the mesh there")
    return level, larger_thigh(cut, middle) if len(separate) else girth(cut[right, 0][:, XZ])


def _between_legs(
    vertices: np.ndarray, sites: Sites, marks: Landmarks, levels: Float[np.ndarray, " l"], scale: float
) -> tuple[float, float]:
    """The x of the sagittal plane between the legs, and the lowest height above the last level where it cuts skin.

    Planes beside the crotch point are tried too: the first that cuts no skin at any of the ``levels``, else the best.
    """
    best = (float(marks.points["crotch_point"][X]), -np.inf)
    for middle in best[0] + MIDDLES * scale:
        heights = section(vertices, sites.thighs, X, middle)[:, :, Y]
        joined = float(heights.min(initial=np.inf, where=heights > levels[-1]))
        if joined > levels[0]:
            return middle, joined
        best = max(best, (middle, joined), key=lambda one: one[1])
    return best


def _over_bust(vertices: np.ndarray, sites: Sites, marks: Landmarks, scale: float) -> Float[np.ndarray, "s 2 3"]:
    """The sagittal section over the right breast, in front of the vertical plane along the shoulder."""
    neck, shoulder = marks.points["neck_right"], marks.points["shoulder_right"]
    x = min(marks.rings["bust_line"][:, X].mean(), neck[X] - NECK_CLEARANCE * scale)
    along = neck - shoulder
    forward = np.array([-along[Z], 0.0, along[X]])
    return clipped(section(vertices, sites.breast, X, x), forward, shoulder)
