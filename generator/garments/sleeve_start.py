"""Sew a sleeve into its armhole, placed clear of the trunk before sewing."""

from bisect import bisect_left
from math import cos, pi, sin

import shapely
import shapely.affinity

from gcd_dataset.generator.garments.mends import Mend
from gcd_dataset.generator.garments.sleeve import SleeveDesign, sleeve
from gcd_dataset.generator.pattern import Component, Piece
from gcd_dataset.records import Measurements

SLEEVE_GAP = 1.0  # cm by which a sleeve starts inside its armhole, GarmentCode
SLEEVE_GAP_BY_ANGLE = 18 / pi  # cm/rad: a tenth of a centimetre per degree, GarmentCode
OVERLAP = 150.0  # cm²: largest overlap of sleeve and trunk, seen from the front; plain shirts with it drape cleanly
DRAWN_OUT = 24  # cm: upper bound of a sleeve's shift along the arm


def with_sleeve(size: Measurements, design: SleeveDesign, half: Component, *, mends: frozenset[Mend]) -> Component:
    """The right half of an upper body with a sleeve sewn to its armhole; needs ``ArmholeCurve`` in front and behind."""
    front, back = half.piece("right_ftorso"), half.piece("right_btorso")
    half = half.offering(armhole=front.along("armhole") + back.against("armhole"))
    gap = SLEEVE_GAP + SLEEVE_GAP_BY_ANGLE * size.arm_pose_angle
    arm = sleeve_of(size, design, half, mends=mends)
    arm = arm.placed_by("opening", half, "armhole", gap=-gap, top=True)
    if Mend.SLEEVE_START in mends:
        arm = _clear_of(half, arm, size.arm_pose_angle)
    band = {name: ring for name, ring in arm.interfaces.items() if name == "band"}
    sewn = Component.of(arm, half).sewn(arm.interface("opening"), half.interface("armhole"))
    return sewn.offering(**half.interfaces, **band)


def sleeve_of(size: Measurements, design: SleeveDesign, half: Component, *, mends: frozenset[Mend]) -> Component:
    """The right sleeve for the armhole of a half, with its cuff, not yet placed: see ``sleeve``."""
    front, back = (half.piece(name).outline.edge("armhole") for name in ("right_ftorso", "right_btorso"))
    return sleeve(size, design, front, back, mends=mends)


def _clear_of(half: Component, arm: Component, angle: float) -> Component:
    """The sleeve moved out along the arm until it overlaps the trunk by at most ``OVERLAP``, as on a plain shirt.

    Without the shift, shirts with wide sides or gathered sleeves tangle while their seams close.
    """
    trunk = shapely.union_all([_silhouette(piece) for piece in half.pieces])
    silhouette = shapely.union_all([_silhouette(piece) for piece in arm.pieces])
    along = (-cos(angle), -sin(angle))

    def is_clear(step: int) -> bool:
        moved = shapely.affinity.translate(silhouette, step * along[0], step * along[1])
        return bool(moved.intersection(trunk).area <= OVERLAP)

    step = 0 if is_clear(0) else bisect_left(range(DRAWN_OUT), True, lo=1, key=is_clear)
    return arm.moved((step * along[0], step * along[1], 0.0)) if step else arm


def _silhouette(piece: Piece) -> shapely.Polygon:
    """A piece as seen from the front [cm]."""
    return shapely.Polygon(piece.points()[:, :2]).buffer(0)
