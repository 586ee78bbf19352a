"""The shirt: its design, and the half front and half back of a straight shirt."""

from dataclasses import dataclass
from math import tan
from typing import Self

from gcd_dataset.generator.garments.space import Design, flag, real
from gcd_dataset.generator.garments.trunk import waist_back, waist_front
from gcd_dataset.generator.pattern import Outline
from gcd_dataset.records import Measurements


@dataclass(frozen=True, slots=True)
class TorsoHalf:
    """Half a front or back: upright at the centre, sloping at the shoulder."""

    outline: Outline
    """Drawn from the centre of the hem to the side, up to the shoulder and back: bottom, side, shoulder, centre."""
    shoulder: float
    """Distance from the centre to the shoulder's outer end [cm]."""
    level: float
    """Height of the shoulder's outer end over the origin of the drawing [cm]."""
    rise: float
    """Height of the base of the neck over the shoulder's outer end [cm]."""
    lean: float = 0.0
    """Increase of the half's width per cm below the shoulder's outer end."""
    gather: float = 1.0
    """Length of the hem over its projected length in the waist seam."""
    darts: tuple[str, ...] = ()
    """Names of the darts; their legs are the edges NAME.0 and NAME.1."""

    @property
    def neck_base(self) -> float:
        """Height of the shoulder line's inner end, at the centre [cm]."""
        return self.level + self.rise

    @property
    def upper_side(self) -> float:
        """Length of the uppermost part of the side: from the shoulder or armhole to the next dart or the hem [cm]."""
        return self.outline.run("side")[-1].length

    @property
    def room(self) -> float:
        """Length of the centre edge below the level of the shoulder's outer end, before a neckline is cut [cm]."""
        return self.outline.length("centre") - self.rise

    def armhole_room(self, shoulder_end: float) -> float:
        """Largest depth of an armhole with its upper end ``shoulder_end`` cm from the centre [cm].

        The upper end lies on the shoulder seam, ``over`` cm above the shoulder's outer end. This rise adds to the
        depth, and moves the upper end inwards by ``lean * over`` cm.
        """
        slope = self.rise / self.shoulder
        over = slope * (self.shoulder - shoulder_end) / (1 - slope * self.lean)
        return self.level - self.outline.run("side")[-1].start[1] + over

    def width_below_shoulder(self, depth: float) -> float:
        """Width from the centre to the side, ``depth`` cm below the shoulder's outer end [cm]."""
        return self.shoulder + depth * self.lean

    def cut_to(self, outline: Outline) -> Self:
        """The half with another outline, after cuts."""
        return type(self)(outline, self.shoulder, self.level, self.rise, self.lean, self.gather, self.darts)


@dataclass(frozen=True)
class ShirtDesign(Design):
    """The body of a shirt; a fitted shirt ignores length, width and flare."""

    strapless: bool = flag(False, keep=0.8)
    """Whether a fitted shirt ends above the bust."""
    length: float = real(1.2, 0.5, 3.5, keep=0.7)
    """Length, as a fraction of nape to waist."""
    width: float = real(1.05, 1.0, 1.3, keep=0.4)
    """Girth of the chest, as a fraction of the bust."""
    flare: float = real(1.0, 0.7, 1.6, keep=0.4)
    """Girth of the hem, as a fraction of the chest."""


@dataclass(frozen=True)
class LeftShirtDesign(Design):
    """The left half of a shirt that differs from the right one; both have the same length."""

    strapless: bool = flag(False, keep=0.8)
    width: float = real(1.0, 1.0, 1.3, keep=0.4)
    flare: float = real(1.0, 0.7, 1.6, keep=0.4)

    def beside(self, right: ShirtDesign) -> ShirtDesign:
        """The complete design of the left half: length from the right one."""
        return ShirtDesign(strapless=self.strapless, length=right.length, width=self.width, flare=self.flare)


def straight_front(size: Measurements, design: ShirtDesign) -> TorsoHalf:
    """Half a front; if wider than the back it is drawn shorter, so that both shoulders end at the same height."""
    slope, chest = tan(size.shoulder_incl), 0.5 * design.width * (size.bust - size.back_width)
    side = design.length * size.waist_line - slope * (0.5 * size.bust - size.back_width)
    return _straight(chest, design.flare * chest, side, slope, waist=0.5 * waist_front(size))


def straight_back(size: Measurements, design: ShirtDesign) -> TorsoHalf:
    """Half a back."""
    slope, chest = tan(size.shoulder_incl), 0.5 * design.width * size.back_width
    return _straight(chest, design.flare * chest, design.length * size.waist_line, slope, waist=0.5 * waist_back(size))


def _straight(chest: float, hem: float, side: float, slope: float, *, waist: float) -> TorsoHalf:
    """A half with its shoulder ``side`` cm over the hem; ``waist``: projected length of the hem in its seam [cm]."""
    rise = slope * chest
    outline = (
        Outline.start(0, 0)
        .line(-hem, 0, name="bottom")
        .line(-chest, side, name="side")
        .line(0, side + rise, name="shoulder")
        .close(name="centre")
    )
    return TorsoHalf(outline, chest, side, rise, lean=(hem - chest) / side, gather=hem / waist)
