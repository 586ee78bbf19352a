"""Sewability of drawn parts: checks for crossings, spikes, short edges, mismatched seams and tight cuffs."""

from collections.abc import Callable, Sequence
from functools import partial
from math import cos, inf, pi
from typing import NamedTuple, TypeAlias

import numpy as np
import shapely
from jaxtyping import Complex, Float

from gcd_dataset.crossings import edge_hulls, find_crossings
from gcd_dataset.curves import sample_curve
from gcd_dataset.errors import PatternError
from gcd_dataset.faults import LARGEST, SHORTEST_EDGE
from gcd_dataset.generator.garments.assembly import bottom, upper
from gcd_dataset.generator.garments.cuff import arm_girth_in_end
from gcd_dataset.generator.garments.design import GarmentDesign
from gcd_dataset.generator.garments.mends import ALL_MENDS
from gcd_dataset.generator.garments.neckline import NecklineDesign, neckline_width, neckline_width_parameter
from gcd_dataset.generator.garments.shirt import UpperHalf, armhole_from_centre, right_half, right_torso
from gcd_dataset.generator.garments.sleeve import sleeve_of
from gcd_dataset.generator.garments.upper import Shirt
from gcd_dataset.generator.pattern import Component, MeasuredJoin, Outline, Piece, measure_joins, panel_of
from gcd_dataset.records import Measurements, Panel

CLOTH_OFF_SKIN = 0.35  # cm between skin and cloth in a drape, ``DrapeConfig.body_gap``
CLOTH_GIVES = 1.2  # stretched length over rest length: the most that cloth stretches without losing its shape
SHARPEST_CORNER = 10.0  # degrees: a sharper corner can be neither meshed nor sewn
NARROWEST_STRAP = 1.0  # cm: seam allowances take up the cloth between a nearer neckline and armhole
DIRECTIONS = np.exp(1j * np.linspace(0.0, np.pi, 16, endpoint=False))[:, None]  # across strips that separate hulls
STRAP_POINTS = 33  # points along an edge: a neckline of 80 cm lies within a millimetre or two of its chords
SHORTEST_SHOULDER = 3.0  # cm: a shorter shoulder seam is a strap, which these programs do not draw
SHOULDER_SHARE = 0.5  # share of the shoulder beside the neck: a doll's shoulder seam may be as short as this
ROUNDING = 1e-6  # cm, degrees: margin against a limit, such as of the shoulder beside a neckline at its widest
SHOULDER_TOLERANCE = 1e-3  # cm: margin of shoulder seams whose length is computed before they are drawn
SEAM_SLACK, SEAM_SHARE = 1.5, 0.12  # cm, and of the shorter side: ungathered sides may differ by the larger of both
TIGHTEST_GATHERS = 3.2  # length of cloth over its gathered length: slightly above the design space's maximum


class SewingFault(NamedTuple):
    """The first reason why a part of a garment cannot be sewn or worn."""

    rule: str
    """Name of the rule in ``rules.py``."""
    part: str
    """The panel at fault; empty if it is not one panel."""


SoundOutlines: TypeAlias = set[tuple[Outline, bool]]
"""Outlines found without fault, with ``Piece.faces_out``: pieces that a redraw leaves as they are need no new check."""


def half_fault(size: Measurements, design: GarmentDesign, half: UpperHalf, sound: SoundOutlines) -> SewingFault | None:
    """Why one half cannot be sewn: a misfit of armhole, neckline or flared cuff, for example; ``None`` if it can."""
    drawings = [right_torso, right_half] if half[-1].has_flared_cuff else [right_torso]
    fitted = _is_fitted(design)
    faults = (_sewing_fault(partial(draw, size, *half, fitted=fitted, mends=ALL_MENDS), sound) for draw in drawings)
    return next((fault for fault in faults if fault is not None), None)


def sleeve_tightness(size: Measurements, design: GarmentDesign, half: UpperHalf) -> float:
    """Girth of cloth on the arm over the stretched girth of the end of a half's sleeve; above 1 it is too tight.

    0 without a sleeve, and for a half that cannot be drawn.
    """
    shirt, _, sleeve = half
    try:  # The girth does not depend on the neckline: the same drawing serves all necklines.
        end, arm = end_and_arm_girth(size, design, (shirt, NecklineDesign(), sleeve))
    except PatternError:
        return 0.0
    return girth_of_cloth(arm) / (end * CLOTH_GIVES) if end else 0.0


def girth_of_cloth(body: float) -> float:
    """Girth of a ring of cloth that lies on a body of this girth [cm]: 2 cm more, a tenth on a wrist."""
    return body + 2 * pi * CLOTH_OFF_SKIN


def end_and_arm_girth(size: Measurements, design: GarmentDesign, half: UpperHalf) -> tuple[float, float]:
    """Girth of the end of a half's sleeve, and of the arm inside it [cm]; 0 without a sleeve.

    The end is the narrowest ring of the cuff, or the hem of a sleeve without cuff: ``end_width`` may be a fifth of the
    width at the armhole, while the arm at the elbow has three quarters of its girth there. Between armhole and end a
    sleeve is straight, and no narrower for the arm than at its end: of 42 sampled sleeves, each on two wearers, none.
    Raises ``PatternError`` for a half that cannot be drawn.
    """
    if half[-1].sleeveless or (_is_fitted(design) and half[0].strapless):
        return 0.0, 0.0
    torso = right_torso(size, *half, fitted=_is_fitted(design), mends=ALL_MENDS)
    drawn = sleeve_of(size, half[-1], torso, mends=ALL_MENDS)
    return drawn.length("band" if "band" in drawn.interfaces else "end"), arm_girth_in_end(size, half[-1])


def widest_neckline(size: Measurements, design: GarmentDesign, half: UpperHalf) -> float:
    """The largest ``width`` of a half's neckline that leaves shoulder seams of ``shortest_shoulder``.

    Infinite if the shoulder seams are long enough, for a half without shoulder seams, and for a half that cannot be
    drawn. A shoulder seam has the slope ``shoulder_incl``: for 1 cm more of it, half the neckline becomes narrower by
    the cosine of this angle.
    """
    (shirt, neck, arm), fitted = half, _is_fitted(design)
    if fitted and shirt.strapless:
        return inf
    try:
        room = armhole_from_centre(size, shirt, arm, fitted=fitted) - 0.5 * neckline_width(size, neck)
        if room / cos(size.shoulder_incl) > shortest_shoulder(size) + SHOULDER_TOLERANCE:
            return inf
        drawn = right_torso(size, *half, fitted=fitted, mends=ALL_MENDS)
    except PatternError:  # drawing the garment reports it
        return inf
    seams = ([edge.length for edge in piece.outline.strokes if edge.name == "shoulder"] for piece in drawn.pieces)
    missing = shortest_shoulder(size) + ROUNDING - min(sum(parts) or inf for parts in seams)
    if missing <= ROUNDING:
        return inf
    return neckline_width_parameter(size, neckline_width(size, neck) - 2 * missing * cos(size.shoulder_incl))


def shortest_shoulder(size: Measurements) -> float:
    """The least length of a shoulder seam for a wearer [cm]."""
    beside_neck = 0.5 * (size.sleeve_balance - size.neck_w) / cos(size.shoulder_incl)
    return min(SHORTEST_SHOULDER, SHOULDER_SHARE * beside_neck)


def bottom_fault(size: Measurements, design: GarmentDesign, sound: SoundOutlines) -> SewingFault | None:
    """Why the bottom, with its slits, darts and godets, cannot be drawn or sewn."""
    return _sewing_fault(partial(bottom, size, design, ALL_MENDS), sound)


def upper_fault(size: Measurements, design: GarmentDesign, sound: SoundOutlines) -> SewingFault | None:
    """Why an upper other than a shirt cannot be drawn or sewn."""
    return _sewing_fault(partial(upper, size, design, ALL_MENDS), sound)


def _is_fitted(design: GarmentDesign) -> bool:
    garment = design.meta.upper.garment if design.meta.upper else None
    return isinstance(garment, Shirt) and garment.fitted


def _sewing_fault(draw: Callable[[], Component], sound: SoundOutlines) -> SewingFault | None:
    """The first fault of a part of a garment: in drawing, in the match of its seams, or in a panel."""
    try:
        drawn = draw()
        outlines: dict[tuple[Outline, bool], Piece] = {}
        for piece in drawn.pieces:
            outlines.setdefault((piece.outline, piece.faces_out), piece)
        panels = [panel_of(piece) for key, piece in outlines.items() if key not in sound]
        if any(map(is_mismatched, measure_joins(drawn))):
            return SewingFault("mismatched_seam", "")
        fault = panel_fault(panels) if panels else None
    except PatternError:
        return SewingFault("cannot_be_drawn", "")
    if fault is None:
        sound.update(outlines)
    return fault


def panel_fault(panels: Sequence[Panel]) -> SewingFault | None:
    """The first panel with an edge of invalid length or a narrow strap, else with a sharp corner, else a crossing."""
    hulls = [edge_hulls(panel) for panel in panels]
    lengths = [panel.edge_lengths() for panel in panels]
    for panel, edges, drawn in zip(panels, lengths, hulls, strict=True):
        if min(edges) < SHORTEST_EDGE or max(edges) > LARGEST:
            return SewingFault("short_edge" if min(edges) < SHORTEST_EDGE else "unsewable", panel.name)
        if has_narrow_strap(panel, drawn):
            return SewingFault("narrow_strap", panel.name)
    angles = corner_angles(hulls)
    if angles.min() < SHARPEST_CORNER:
        corners = [panel.name for panel in panels for _ in panel.edges]
        return SewingFault("sharp_corner", corners[sharpest(angles)])
    crossed = next(iter(find_crossings(panels, hulls, lengths)), None)
    return None if crossed is None else SewingFault("self_crossing", panels[crossed[0]].name)


def sharpest(angles: Float[np.ndarray, " corners"]) -> int:
    """The first of the sharpest corners: between mirrored panels, rounding would choose, which differs with the CPU."""
    return int((angles <= angles.min() + ROUNDING).argmax())


def is_mismatched(sewn: MeasuredJoin) -> bool:
    """Whether the sides of a join differ too much in length."""
    shorter, longer = sorted((sewn.left_length, sewn.right_length))
    return longer - shorter > max(SEAM_SLACK, (TIGHTEST_GATHERS - 1 if sewn.join.gathered else SEAM_SHARE) * shorter)


def has_narrow_strap(panel: Panel, hulls: Complex[np.ndarray, "e 4"]) -> bool:
    """Whether neckline and armhole of a panel are nearer than ``NARROWEST_STRAP``; ``hulls``: its ``edge_hulls``."""
    names = [edge.name for edge in panel.edges]
    if "neck" not in names or "armhole" not in names:
        return False
    neck, armhole = (hulls[[name == wanted for name in names]].ravel() for wanted in ("neck", "armhole"))
    # Each edge lies within its hull: hulls this far apart need no sampling.
    a, b = ((DIRECTIONS * points).real for points in (neck, armhole))
    strip = np.maximum(a.min(axis=1) - b.max(axis=1), b.min(axis=1) - a.max(axis=1)).max()  # the widest that separates
    return bool(strip <= NARROWEST_STRAP + ROUNDING) and strap_width(panel) < NARROWEST_STRAP


def strap_width(panel: Panel) -> float:
    """The least width of cloth between neckline and armhole of a panel [cm]; infinite without both."""
    neck, armhole = (_drawn(panel, name) for name in ("neck", "armhole"))
    return float(neck.distance(armhole)) if neck and armhole else inf


def _drawn(panel: Panel, name: str) -> shapely.MultiLineString | None:
    """The edges called ``name`` as lines; ``None`` without any."""
    lines = [
        sample_curve(*panel.edge_ends(index), edge.curve, STRAP_POINTS)
        for index, edge in enumerate(panel.edges)
        if edge.name == name
    ]
    return shapely.MultiLineString(lines) if lines else None


def corner_angles(hulls: Sequence[Complex[np.ndarray, "e 4"]]) -> Float[np.ndarray, " corners"]:
    """Interior angles at the starts of all edges, panel after panel, 0 to 360 [degrees], from ``edge_hulls``."""
    edges, sizes = np.concatenate(hulls), np.array([len(panel) for panel in hulls])
    first = np.cumsum(sizes) - sizes
    before, after = np.arange(len(edges)) - 1, np.arange(len(edges)) + 1
    before[first], after[first + sizes - 1] = first + sizes - 1, first
    leaving, arriving = edges[:, 1] - edges[:, 0], (edges[:, 3] - edges[:, 2])[before]
    # With the hulls' inner points: for arcs over half a circle, the corners alone give the wrong orientation.
    areas = (edges.conj() * np.concatenate([edges[:, 1:], edges[after, :1]], axis=1)).imag.sum(axis=1)
    around = np.sign(np.add.reduceat(areas, first))
    return np.degrees(np.pi - np.repeat(around, sizes) * np.angle(leaving / arriving))
