"""The right half of a front or back before armhole and neckline are cut, for straight and fitted shirts."""

from dataclasses import dataclass
from typing import Self

from gcd_dataset.generator.pattern import Outline


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
