"""The right half of a front or a back before its cuts: what straight and fitted shirts have in common."""

from dataclasses import dataclass, replace
from typing import Self

from gcd_dataset.generator.pattern import Outline

__all__ = ["TorsoHalf"]


@dataclass(frozen=True, slots=True)
class TorsoHalf:
    """Half a front or back: upright at the centre, sloping at the shoulder."""

    outline: Outline
    """From the centre of the hem to the side, up to the shoulder and back: edges bottom, side, shoulder, centre."""
    shoulder: float
    """From the centre to the shoulder's outer end [cm]."""
    level: float
    """Height of that end over the origin of the drawing [cm]."""
    rise: float
    """From there up to the base of the neck [cm]."""
    lean: float = 0.0
    """How much wider it gets for each cm below the shoulder's outer end."""
    gather: float = 1.0
    """Length of the hem over what it counts for in the seam at the waist."""
    darts: tuple[str, ...] = ()
    """Their names; the legs are the edges NAME.0 and NAME.1."""

    @property
    def neck_base(self) -> float:
        """Height of the shoulder line's inner end, at the centre [cm]."""
        return self.level + self.rise

    @property
    def upper_side(self) -> float:
        """Length of the side between the shoulder, or the armhole, and the dart or the hem under it [cm]."""
        return self.outline.run("side")[-1].length

    @property
    def room(self) -> float:
        """Length of the centre below the level of the shoulder's outer end, as long as no neckline is cut [cm]."""
        return self.outline.length("centre") - self.rise

    def armhole_room(self, shoulder_end: float) -> float:
        """How deep an armhole may get whose upper end leaves ``shoulder_end`` cm from the centre [cm].

        That end lies on the shoulder, over its outer end, so the other is less deep under it. The upper end moves in
        by the lean of that rise.
        """
        slope = self.rise / self.shoulder
        over = slope * (self.shoulder - shoulder_end) / (1 - slope * self.lean)
        return self.level - self.outline.run("side")[-1].start[1] + over

    def width_below_shoulder(self, depth: float) -> float:
        """From the centre to the side, ``depth`` cm under the shoulder's outer end."""
        return self.shoulder + depth * self.lean

    def cut_to(self, outline: Outline) -> Self:
        """The same half with cuts in its outline."""
        return replace(self, outline=outline)
