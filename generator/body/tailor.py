"""A tailor at work: finds the level of each girth, moves the landmarks there, and takes the measures.

Girths are tapes drawn tight round level sections. The level is searched near a ring of points: fullest bust, fullest
hips, narrowest waist; the points beside them (bust, sides, buttocks, mid back) are moved to the section found. On our
own mesh landmarks are known by vertex; on any other they are found first (``find_landmarks``).
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial import cKDTree

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body import measures as m
from gcd_dataset.generator.body.asset import body_model, landmarks
from gcd_dataset.generator.body.geodesic import WayNet
from gcd_dataset.generator.body.marks import Marks, own_marks
from gcd_dataset.generator.body.section import clipped, girth, rough_girths, section, section_points
from gcd_dataset.generator.body.subdivide import unique_edges
from gcd_dataset.measurements import MEASURE
from gcd_dataset.records import BodyPart, Measurements, Record

__all__ = [
    "USUAL_HEIGHT",
    "Sites",
    "Taken",
    "arm_net",
    "find_sites",
    "own_sites",
    "room",
    "sites_of",
    "take",
    "take_measures",
]

GIRTHS = ("bust", "underbust", "waist", "hips")
BESIDE = {
    "bust": ("bust_left", "bust_right", "bust_side_left", "bust_side_right"),
    "waist": ("waist_side_left", "waist_side_right", "mid_waist_back"),
    "hips": ("hips_side_left", "hips_side_right", "bum_left", "bum_right"),
}
"""Points that move to the section found."""
X, Y, Z = 0, 1, 2
XZ = slice(0, 3, 2)
SEARCH = np.arange(-4, 5) * 0.5  # cm about the ring's mean height, GarmentCodeData; on a body of USUAL_HEIGHT
LEG_STEP = 0.5  # cm by which the thigh's section is lowered until the legs part
LEG_STEPS = 30
LEG_LOWERED = 0.75  # cm of lowering from which the thigh may be more than half a centimetre thinner
USUAL_HEIGHT = 172.0  # cm; that of the bodies the widths of sites are for
MIDDLES = np.array([0.0, 0.25, -0.25, 0.5, -0.5, 1.0, -1.0])  # cm beside the crotch
NECK_CLEARANCE = 1.4  # cm that the plane over the bust keeps outside the side of the neck, as on the published bodies


@dataclass(frozen=True)
class Taken:
    """The measures of a body, and where their girths were found."""

    measurements: Measurements
    levels: Mapping[str, float]
    """Height at which each girth was taken [cm]."""
    at_border: Mapping[str, float]
    """Girths that go on growing (bust, hips) or shrinking (waist) where the search ends: by the end reached [cm].

    Also the leg's, where it was lowered by a centimetre and more until the legs parted.
    """


def take_measures(vertices: Float[np.ndarray, "v 3"], sites: "Sites") -> Measurements:
    """The measures of a body of our own mesh."""
    return take(vertices, own_marks(vertices), sites).measurements


def take(vertices: Float[np.ndarray, "v 3"], marks: Marks, sites: "Sites") -> Taken:
    """The measures of any body, with the landmarks on it and the sites on its mesh. Raises ``BodyError``."""
    upright = vertices[_ends(vertices[:, Y])]
    tall = float(m.height(upright))
    wide = tall / USUAL_HEIGHT
    corners, local = sites.cut_out
    skin = vertices.take(corners, axis=0)
    found = {
        "bust": _searched(skin, local, marks, "bust", np.argmax, wide),
        "underbust": _at_level(skin, local, marks, "underbust"),
        "waist": _searched(skin, local, marks, "waist", np.argmin, wide),
        "hips": _searched(skin, local, marks, "hips", np.argmax, wide),
    }
    at = dict(marks.points)
    for name, beside in BESIDE.items():
        cut = section(skin, local.bands[name], Y, found[name][0, Y])
        at |= zip(beside, _nearest_on(cut, np.stack([at[point] for point in beside])), strict=True)
    over_bust = _over_bust(skin, local, marks, wide)
    spine = section(skin, local.spine, X, (at["nape_of_neck"][X] + at["mid_waist_back"][X]) / 2).reshape(-1, 3)
    leg_level, leg_circ = _leg_girth(skin, local, marks, wide)
    tape = _Tape(upright, at, marks.rings, found, spine, over_bust, leg_circ, sites.arm.length(vertices))
    measurements = Measurements(**{name: float(known.formula(tape)) for name, known in MEASURE.items()})
    levels = {name: float(points[0, Y]) for name, points in found.items()} | {"leg_circ": leg_level}
    return Taken(measurements, levels, _at_border(levels, marks, wide))


@dataclass(frozen=True, eq=False)
class _Tape:
    """A ``measurements.Tape`` on one body."""

    upright: Float[np.ndarray, "2 3"]
    """The lowest vertex and the highest."""
    points: Mapping[str, Float[np.ndarray, "3"]]
    rings: Mapping[str, Float[np.ndarray, "n 3"]]
    sections: Mapping[str, Float[np.ndarray, "n 3"]]
    spine: Float[np.ndarray, "n 3"]
    breast: Float[np.ndarray, "s 2 3"]
    larger_thigh: float
    arm: float

    def height(self) -> float:
        return float(m.height(self.upright))

    def to_crown(self, point: str) -> float:
        return float(m.to_crown(self.upright, self.points[point]))

    def apart(self, point: str, other: str) -> float:
        return float(m.apart(self.points[point], self.points[other]))

    def above(self, point: str, other: str) -> float:
        return float(m.above(self.points[point], self.points[other]))

    def sinking(self, start: str, end: str) -> float:
        return float(m.sinking(self.points[start], self.points[end]))

    def leaning(self, upper: str, lower: str) -> float:
        return float(m.leaning(self.points[upper], self.points[lower]))

    def along(self, ring: str) -> float:
        return float(m.along(self.rings[ring]))

    def around(self, ring: str) -> float:
        return float(m.around(self.rings[ring]))

    def down_arm(self) -> float:
        return self.arm

    def girth(self, section: str) -> float:
        return m.round_section(self.sections[section])

    def thigh(self) -> float:
        return self.larger_thigh

    def over_back(self, section: str, left: str, right: str) -> float:
        return m.over_back(self.sections[section], self.points[left], self.points[right])

    def down_spine(self, upper: str, lower: str) -> float:
        return m.down_spine(self.spine, self.points[upper], self.points[lower])

    def over_breast(self, level: str, facing: tuple[float, float], over: float) -> float:
        return m.over_breast(self.breast, float(self.points[level][Y]), facing, over)


def room(vertices: Float[np.ndarray, "v 3"]) -> float:
    """By how much a body is taller than the usual one: the tailor's steps grow with it."""
    return float(m.height(vertices)) / USUAL_HEIGHT


def _ends(heights: Float[np.ndarray, " v"]) -> list[np.intp]:
    """The lowest vertex and the highest."""
    heights = heights.copy()  # side by side in memory: a third of the time
    return [heights.argmin(), heights.argmax()]


def _at_border(levels: Mapping[str, float], marks: Marks, wide: float) -> dict[str, float]:
    """Girths whose search ended on its border, and on which."""
    reach = dict.fromkeys(("bust", "waist", "hips"), SEARCH[-1] * wide - 1e-6) | {"leg_circ": LEG_LOWERED * wide}
    looked_for = {**marks.levels, "leg_circ": marks.levels["leg_right"]}
    off = {name: levels[name] - looked_for[name] for name in reach}
    return {name: round(by, 3) for name, by in off.items() if abs(by) > reach[name]}


# --------------------------------------------------------------------------------------------------------------- sites


@dataclass(frozen=True, eq=False)
class Sites(Record):
    """Where on the mesh each measure is taken: what its plane can meet on any body of the population."""

    rings: Mapping[str, Int[np.ndarray, "e 2"]]
    """Edges about each girth, for many levels at once."""
    bands: Mapping[str, Int[np.ndarray, "f 3"]]
    """The faces of these edges."""
    thighs: Int[np.ndarray, "f 3"]
    breast: Int[np.ndarray, "f 3"]
    spine: Int[np.ndarray, "f 3"]
    arm: WayNet

    @functools.cached_property
    def cut_out(self) -> tuple[Int[np.ndarray, " n"], Self]:
        """The vertices of the sites of sections, and these sites on them alone: a plane is held against few."""
        faces = (*self.bands.values(), self.thighs, self.breast, self.spine)
        corners = np.unique(np.concatenate([ids.ravel() for ids in (*self.rings.values(), *faces)]))

        def on_them(ids: np.ndarray) -> np.ndarray:
            return np.searchsorted(corners, ids)

        return corners, replace(
            self,
            rings={name: on_them(ring) for name, ring in self.rings.items()},
            bands={name: on_them(band) for name, band in self.bands.items()},
            thighs=on_them(self.thighs),
            breast=on_them(self.breast),
            spine=on_them(self.spine),
        )


@functools.cache
def own_sites() -> Sites:
    """The sites on our own mesh."""
    model = body_model()
    return find_sites(model.mean, model.faces, model.parts)


def find_sites(mean: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], parts: UInt8[np.ndarray, " v"]) -> Sites:
    """The sites on our own mean body, with room for bodies unlike it."""
    points = landmarks().points
    arm = arm_net(mean, faces, points["shoulder_right"], points["wrist_right"])
    return sites_of(mean, faces, parts, own_marks(mean), arm)


def sites_of(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    parts: UInt8[np.ndarray, " v"],
    marks: Marks,
    arm: WayNet,
) -> Sites:
    """The sites on any mesh, as wide as bodies of one mesh may differ; taller bodies have wider ones."""
    wide = room(vertices)
    arms = [BodyPart.LEFT_ARM.value, BodyPart.RIGHT_ARM.value, BodyPart.HANDS.value]
    trunk = faces[~np.isin(parts, arms)[faces].any(axis=1)]

    def between(low: float, high: float) -> Int[np.ndarray, "f 3"]:
        heights = vertices[trunk, Y]
        return trunk[(heights.max(axis=1) > low) & (heights.min(axis=1) < high)]

    nape, leg = marks.points["nape_of_neck"], marks.levels["leg_right"]
    torso = between(marks.levels["waist"] - 8.0 * wide, marks.points["neck_right"][Y] + 4.0 * wide)
    x = (vertices[torso, X] - nape[X]) / wide
    back = (nape[Z] + marks.points["bust_right"][Z]) / 2
    level = {name: marks.levels[name] for name in GIRTHS}
    bands = {name: between(at - 7.0 * wide, at + 7.0 * wide) for name, at in level.items()}
    return Sites(
        rings={name: unique_edges(band)[0] for name, band in bands.items()},
        bands=bands,
        thighs=between(leg - 18.0 * wide, leg + 8.0 * wide),
        breast=torso[(x.max(axis=1) < -2.0) & (x.min(axis=1) > -22.0)],
        spine=torso[(np.abs(x).max(axis=1) < 4.0) & (vertices[torso, Z].mean(axis=1) < back)],
        arm=arm,
    )


def arm_net(mean: np.ndarray, faces: np.ndarray, shoulder: int, wrist: int) -> WayNet:
    """A net over the skin near the arm's shortest way on the mean body."""
    straight = np.linspace(mean[shoulder], mean[wrist], 100)
    rough = WayNet.over(faces[_near(mean, straight, 9.0)[faces].all(axis=1)], shoulder, wrist, points_per_edge=1)
    near = _near(mean, rough.path(mean), 1.6)[faces].all(axis=1)
    # Three points an edge make the way 0.1 cm too long; five would halve that and cost twice the time.
    return (
        WayNet.over(faces[near], shoulder, wrist, points_per_edge=3)
        .leading_on(mean, least=0.8)
        .direct_on(mean, most=0.15)
    )


def _near(vertices: np.ndarray, path: np.ndarray, radius: float) -> np.ndarray:
    return cKDTree(path).query(vertices, distance_upper_bound=radius)[0] < radius


# ------------------------------------------------------------------------------------------------------ level sections


def _searched(
    vertices: np.ndarray,
    sites: Sites,
    marks: Marks,
    name: str,
    best: Callable[[np.ndarray], np.intp],
    wide: float,
) -> Float[np.ndarray, "n 3"]:
    """The points of the section with the greatest or smallest girth near a ring."""
    levels = marks.levels[name] + SEARCH * wide
    points, level = section_points(vertices, sites.rings[name], Y, levels)
    rough = rough_girths(points[:, XZ], level)
    if len(rough) < len(levels):
        raise BodyError(f"no skin is met at the level of the {name}, {marks.levels[name]:.1f} cm: mend the mesh there")
    return points[level == levels[best(rough)]]


def _at_level(vertices: np.ndarray, sites: Sites, marks: Marks, name: str) -> Float[np.ndarray, "n 3"]:
    level = marks.levels[name]
    points = section_points(vertices, sites.rings[name], Y, np.array([level]))[0]
    if not len(points):
        raise BodyError(f"no skin is met at the level of the {name}, {level:.1f} cm: mend the mesh there")
    return points


def _nearest_on(segments: Float[np.ndarray, "s 2 3"], points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """The nearest point of a section to each point."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    length = np.maximum(np.einsum("si,si->s", along, along), 1e-12)
    ahead = np.einsum("ni,si->ns", points, along) - np.einsum("si,si->s", start, along)
    nearest = start + np.minimum(np.maximum(ahead / length, 0.0), 1.0)[:, :, None] * along
    off = nearest - points[:, None]
    return nearest[np.arange(len(points)), np.einsum("nsi,nsi->ns", off, off).argmin(axis=1)]


def _leg_girth(vertices: np.ndarray, sites: Sites, marks: Marks, wide: float) -> tuple[float, float]:
    """Level and girth of the larger thigh at the first level below the crotch where the legs are two.

    Where thighs overlap all the way down, the tape round the right one's share of the lowest section.
    """
    start = marks.levels["leg_right"]
    levels = start - LEG_STEP * wide * np.arange(LEG_STEPS)
    middle, joined = _between_legs(vertices, sites, marks, levels, wide)
    parted = np.flatnonzero(levels < joined)
    level = float(levels[parted[0] if len(parted) else -1])
    cut = section(vertices, sites.thighs, Y, level)
    right = cut[:, :, X].mean(axis=1) < middle
    if not right.any() or right.all():
        raise BodyError(f"no two legs are met at {level:.1f} cm: mend the mesh there")
    return level, m.larger_thigh(cut, middle) if len(parted) else girth(cut[right, 0][:, XZ])


def _between_legs(
    vertices: np.ndarray, sites: Sites, marks: Marks, levels: Float[np.ndarray, " l"], wide: float
) -> tuple[float, float]:
    """The x of an upright plane that passes between the legs at all levels, or the one that does so longest.

    With it comes the lowest height above the last level at which it meets skin: legs part beside the crotch point, too.
    """
    best = (float(marks.points["crotch_point"][X]), -np.inf)
    for middle in best[0] + MIDDLES * wide:
        met = section(vertices, sites.thighs, X, middle)[:, :, Y]
        joined = float(met.min(initial=np.inf, where=met > levels[-1]))
        if joined > levels[0]:
            return middle, joined
        best = max(best, (middle, joined), key=lambda one: one[1])
    return best


# ---------------------------------------------------------------------------------------------------- upright sections


def _over_bust(vertices: np.ndarray, sites: Sites, marks: Marks, wide: float) -> Float[np.ndarray, "s 2 3"]:
    """The upright section over the right breast, in front of the upright plane along the shoulder."""
    neck, shoulder = marks.points["neck_right"], marks.points["shoulder_right"]
    x = min(marks.rings["bust_line"][:, X].mean(), neck[X] - NECK_CLEARANCE * wide)
    along = neck - shoulder
    forward = np.array([-along[Z], 0.0, along[X]])
    return clipped(section(vertices, sites.breast, X, x), forward, shoulder)
