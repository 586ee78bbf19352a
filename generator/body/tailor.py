"""The tailor's measures of our own bodies, as GarmentCode's measurement files define them.

Girths are tapes drawn tight round level sections. The level is searched near a ring of vertices: fullest bust, fullest
hips, narrowest waist; the points beside them (bust, sides, buttocks, mid back) are moved to the section found.
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial import cKDTree

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.asset import body_model, landmarks
from gcd_dataset.generator.body.geodesic import WayNet
from gcd_dataset.generator.body.section import clipped, girth, outline, rough_girths, section, section_points, tape
from gcd_dataset.generator.body.subdivide import unique_edges
from gcd_dataset.records import Body, BodyPart, Measurements, Record

__all__ = ["Sites", "find_sites", "measure", "take_measures"]

GIRTHS = ("bust", "underbust", "waist", "hips")
X, Y = 0, 1
XZ, ZY = [0, 2], [2, 1]
BACK = (0.0, -1.0)  # in the (x, z) plane of a level section, and as (z, y) = (-1, 0) in an upright one
SEARCH = np.arange(-4, 5) * 0.5  # cm about the ring's mean height, GarmentCodeData
LEG_STEP = 0.5  # cm by which the thigh's section is lowered until the legs part
NECK_CLEARANCE = 0.5  # cm by which the plane over the bust keeps outside the side of the neck
SIDEWAYS = -0.4  # a tape's normal may lean this far away and still count as front or back, GarmentCodeData

_Points = dict[str, np.ndarray]


def measure(body: Body) -> Measurements:
    """The measures of a body of our own mesh. Raises ``BodyError`` for another: its landmarks are not known."""
    if not np.array_equal(body.faces, body_model().faces):
        raise BodyError(
            f"{body.name}: no mesh of ours ({len(body.vertices)} vertices), so its landmarks are not known: "
            "give its measures in a file (--measurements)"
        )
    return take_measures(np.asarray(body.vertices, float), _own_sites())


def take_measures(vertices: Float[np.ndarray, "v 3"], sites: "Sites") -> Measurements:
    """The measures of any body whose mesh the sites belong to."""
    points: _Points = {name: vertices[vertex] for name, vertex in landmarks().points.items()}
    bust = _ring(vertices, sites, "bust", np.argmax)
    waist = _ring(vertices, sites, "waist", np.argmin)
    hips = _ring(vertices, sites, "hips", np.argmax)
    underbust = _level_section(vertices, sites, "underbust")
    _move(points, bust, "bust_left", "bust_right", "bust_side_left", "bust_side_right")
    _move(points, waist, "waist_side_left", "waist_side_right", "mid_waist_back")
    _move(points, hips, "hips_side_left", "hips_side_right", "bum_left", "bum_right")
    over_bust = _over_bust(vertices, sites, points)
    return Measurements(
        bust=girth(bust[:, XZ]),
        underbust=girth(underbust[:, XZ]),
        waist=girth(waist[:, XZ]),
        hips=girth(hips[:, XZ]),
        leg_circ=_leg_girth(vertices, sites),
        back_width=_back_width(bust, points["bust_side_left"], points["bust_side_right"]),
        waist_back_width=_back_width(waist, points["waist_side_left"], points["waist_side_right"]),
        hip_back_width=_back_width(hips, points["hips_side_left"], points["hips_side_right"]),
        waist_line=_waist_line(vertices, sites, points),
        bust_line=_tape_down_to(points["bust_right"][Y], over_bust, (1.0, 1.0), 0.0),
        waist_over_bust_line=_tape_down_to(points["mid_waist_back"][Y], over_bust, (1.0, 0.5), SIDEWAYS),
        arm_length=sites.arm.length(vertices),
        **_along_rings(vertices),
        **_between_points(vertices, points),
    )


# --------------------------------------------------------------------------------------------------------------- sites


@dataclass(frozen=True, eq=False)
class Sites(Record):
    """Where on the mesh each measure is taken: what its plane can meet on any body of the population."""

    rings: Mapping[str, Int[np.ndarray, "e 2"]]
    """Edges about each girth."""
    thighs: Int[np.ndarray, "f 3"]
    breast: Int[np.ndarray, "f 3"]
    spine: Int[np.ndarray, "f 3"]
    arm: WayNet


@functools.cache
def _own_sites() -> Sites:
    model = body_model()
    return find_sites(model.mean, model.faces, model.parts)


def find_sites(mean: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], parts: UInt8[np.ndarray, " v"]) -> Sites:
    """The sites on a mean body, with room for bodies unlike it."""
    rings, points = landmarks().rings, landmarks().points
    arms = [BodyPart.LEFT_ARM.value, BodyPart.RIGHT_ARM.value, BodyPart.HANDS.value]
    trunk = faces[~np.isin(parts, arms)[faces].any(axis=1)]

    def between(low: float, high: float) -> Int[np.ndarray, "f 3"]:
        height = mean[trunk, Y]
        return trunk[(height.max(axis=1) > low) & (height.min(axis=1) < high)]

    level = {name: mean[ring, Y].mean() for name, ring in rings.items()}
    torso = between(level["waist"] - 8.0, mean[points["neck_right"], Y] + 4.0)
    x = mean[torso, X]
    return Sites(
        rings={name: unique_edges(between(level[name] - 7.0, level[name] + 7.0))[0] for name in GIRTHS},
        thighs=between(level["leg_right"] - 18.0, level["leg_right"] + 8.0),
        breast=torso[(x.max(axis=1) < -2.0) & (x.min(axis=1) > -22.0)],
        spine=torso[(np.abs(x).max(axis=1) < 4.0) & (mean[torso, 2].mean(axis=1) < 2.0)],
        arm=_arm_net(mean, faces, points["shoulder_right"], points["wrist_right"]),
    )


def _arm_net(mean: np.ndarray, faces: np.ndarray, shoulder: int, wrist: int) -> WayNet:
    """A net over the skin near the arm's shortest way on the mean body."""
    straight = np.linspace(mean[shoulder], mean[wrist], 100)
    rough = WayNet.over(faces[_near(mean, straight, 9.0)[faces].all(axis=1)], shoulder, wrist, points_per_edge=1)
    near = _near(mean, rough.path(mean), 1.6)[faces].all(axis=1)
    # Three points an edge make the way 0.1 cm too long; five would halve that and cost twice the time.
    return WayNet.over(faces[near], shoulder, wrist, points_per_edge=3).leading_on(mean, least=0.8)


def _near(vertices: np.ndarray, path: np.ndarray, radius: float) -> np.ndarray:
    return cKDTree(path).query(vertices, distance_upper_bound=radius)[0] < radius


# ------------------------------------------------------------------------------------------------------ level sections


def _ring(
    vertices: np.ndarray, sites: Sites, name: str, best: Callable[[np.ndarray], np.intp]
) -> Float[np.ndarray, "n 3"]:
    """The points of the section with the greatest or smallest girth near a ring."""
    levels = vertices[landmarks().rings[name], Y].mean() + SEARCH
    points, level = section_points(vertices, sites.rings[name], Y, levels)
    chosen = best(rough_girths(points[:, XZ], level))
    return points[level == levels[chosen]]


def _level_section(vertices: np.ndarray, sites: Sites, name: str) -> Float[np.ndarray, "n 3"]:
    levels = vertices[landmarks().rings[name], Y].mean(keepdims=True)
    return section_points(vertices, sites.rings[name], Y, levels)[0]


def _move(points: _Points, ring: np.ndarray, *names: str) -> None:
    """Named points go to the nearest point of the section."""
    for name in names:
        points[name] = ring[((ring - points[name]) ** 2).sum(axis=1).argmin()]


def _back_width(ring: np.ndarray, left: np.ndarray, right: np.ndarray) -> float:
    """Tape over the back from side to side."""
    x, z = (left - right)[XZ]
    behind = (ring - left)[:, XZ] @ [z, -x] >= 0
    return tape(np.concatenate([ring[behind], [left, right]])[:, XZ], BACK, over=SIDEWAYS)


def _leg_girth(vertices: np.ndarray, sites: Sites) -> float:
    """Outline of the larger thigh at the first level below the crotch where the legs are two.

    Where thighs overlap all the way down, the tape round the right one's share of the lowest section.
    """
    start = vertices[landmarks().rings["leg_right"], Y].mean()
    steps = np.arange(30)
    middle = section(vertices, sites.thighs, X, 0.0)[:, 0, Y]
    joined = middle.min(initial=np.inf, where=middle > start - LEG_STEP * steps[-1])
    parted = np.flatnonzero(start - LEG_STEP * steps < joined)
    cut = section(vertices, sites.thighs, Y, start - LEG_STEP * (parted[0] if len(parted) else steps[-1]))
    right = cut[:, :, X].mean(axis=1) < 0
    if not len(parted):
        return girth(cut[right, 0][:, XZ])
    return max(outline(cut[right]), outline(cut[~right]))


# ---------------------------------------------------------------------------------------------------- upright sections


def _over_bust(vertices: np.ndarray, sites: Sites, points: _Points) -> Float[np.ndarray, "s 2 3"]:
    """The upright section over the right breast, in front of the upright plane along the shoulder."""
    x = min(vertices[landmarks().rings["bust_line"], X].mean(), points["neck_right"][X] - NECK_CLEARANCE)
    along = points["neck_right"] - points["shoulder_right"]
    forward = np.array([-along[2], 0.0, along[0]])
    return clipped(section(vertices, sites.breast, X, x), forward, points["shoulder_right"])


def _tape_down_to(level: float, cut: np.ndarray, facing: tuple[float, float], over: float) -> float:
    """Tape over the part of an upright section above a level."""
    above = clipped(cut, (0.0, 1.0, 0.0), np.array([0.0, level, 0.0]))
    return tape(above.reshape(-1, 3)[:, ZY], facing, over=over)


def _waist_line(vertices: np.ndarray, sites: Sites, points: _Points) -> float:
    """Tape down the spine from the nape to the waist."""
    nape, waist = points["nape_of_neck"], points["mid_waist_back"]
    cut = section(vertices, sites.spine, X, (nape[X] + waist[X]) / 2)[:, 0]
    between = (cut[:, Y] < nape[Y]) & (cut[:, Y] > waist[Y])
    return tape(np.concatenate([cut[between], [nape, waist]])[:, ZY], (-1.0, 0.0))


# --------------------------------------------------------------------------------------------------- rings and points


def _along_rings(vertices: np.ndarray) -> dict[str, float]:
    rings = landmarks().rings
    neck, wrist = vertices[rings["neck_back"]], vertices[rings["wrist_right"]]
    return {
        "neck_w": float(np.linalg.norm(np.diff(neck, axis=0), axis=1).sum()),
        "wrist": float(np.linalg.norm(wrist - np.roll(wrist, 1, axis=0), axis=1).sum()),
    }


def _between_points(vertices: np.ndarray, points: _Points) -> dict[str, float]:
    """Heights, straight distances, and inclinations [rad]."""
    top = vertices[:, Y].max()
    shoulder, hips, waist = points["shoulder_right"], points["hips_side_right"], points["waist_side_right"]
    return {
        "height": float(top - vertices[:, Y].min()),
        "head_l": float(top - points["nape_of_neck"][Y]),
        "shoulder_w": _apart(points["shoulder_left"], shoulder),
        "armscye_depth": _apart(shoulder, points["underarm_right"]),
        "bust_points": _apart(points["bust_left"], points["bust_right"]),
        "bum_points": _apart(points["bum_left"], points["bum_right"]),
        "vert_bust_line": float(abs(points["nape_of_neck"][Y] - points["bust_side_right"][Y])),
        "hips_line": float(abs(hips[Y] - waist[Y])),
        "crotch_hip_diff": float(abs(hips[Y] - points["crotch_point"][Y])),
        "shoulder_incl": _lean(points["neck_right"], shoulder, Y),
        "arm_pose_angle": _lean(shoulder, points["wrist_right"], Y),
        "hip_inclination": -_lean(hips, waist, X),
    }


def _apart(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b))


def _lean(start: np.ndarray, end: np.ndarray, axis: int) -> float:
    """How far the way from ``start`` to ``end`` sinks against an axis [rad]."""
    return float(np.arcsin((start - end)[axis] / np.linalg.norm(end - start)))
