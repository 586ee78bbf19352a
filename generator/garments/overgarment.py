"""What capes and ponchos have in common: a front and a back that hang from the neck, over shoulders and arms.

Drawings begin at the point where the shoulder meets the neck on the wearer's right, ``(-half_width, 0)``, and hang
with that point where the wearer has it; x = 0 is the wearer's middle.
"""

from dataclasses import dataclass, replace
from math import cos, sin, tan

from gcd_dataset.curves import Point, Quadratic, to_frame
from gcd_dataset.generator.garments.neckline import Neckline, NecklineDesign, neckline_shape
from gcd_dataset.generator.pattern import Outline, Piece, Stroke, chain_from
from gcd_dataset.records import EdgeRole, Measurements

__all__ = ["NeckHole", "both_halves", "hung", "neck_hole", "right_neck", "with_shoulder"]

NECK_WIDTH = 0.8  # of neck_w, the way round the back of the neck: straight across, from shoulder to shoulder
FRONT_DROP, BACK_DROP = 0.42, 0.1  # of neck_w: throat and nape below the sides of the neck
FRONT, BACK = 30.0, -25.0  # cm before and behind the axis


@dataclass(frozen=True, slots=True)
class NeckHole:
    """The opening for the neck [cm]."""

    half_width: float
    front: float
    """Its depth in front."""
    back: float


def neck_hole(size: Measurements, ease: float) -> NeckHole:
    """The opening round the base of the neck, times ``ease``."""
    around = ease * size.neck_w
    return NeckHole(0.5 * NECK_WIDTH * around, FRONT_DROP * around, BACK_DROP * around)


def right_neck(hole: NeckHole, kind: Neckline, *, front: bool) -> tuple[Stroke, ...]:
    """The right half of the neckline, from the shoulder to the middle."""
    design = NecklineDesign(f_collar=kind, b_collar=kind)
    depth = hole.front if front else hole.back
    drawn = neckline_shape(design, front=front, half_width=hole.half_width, depth=depth)
    named = (replace(stroke, name="neck", label=EdgeRole.RIGHT_COLLAR) for stroke in drawn)
    return chain_from((-hole.half_width, 0.0), *named)


def with_shoulder(outline: Outline, size: Measurements, *, fall: float, length: float) -> Outline:
    """Drawn on from the right side of the neck: down the shoulder, and on to the hem in a curve; ``length`` cm in all.

    ``fall``: how far the seam's end sinks below the level [rad]; the shoulder sinks no further.
    """
    slope, (x, y) = min(size.shoulder_incl, fall), outline.pen
    shoulder = min((0.5 * size.shoulder_w + x) / cos(slope), 0.5 * length)
    end, bend = _on((x, y), slope, shoulder), _on((x, y), slope, 0.5 * (shoulder + length))
    hem = _on(bend, fall, 0.5 * (length - shoulder))
    return outline.line(*end, name="shoulder").curve(*hem, Quadratic(to_frame(end, hem, bend)), name="side")


def both_halves(right: Outline, neck: tuple[Stroke, ...]) -> Outline:
    """A whole front or back: its right half, from the neck to the middle of the hem, the mirror image, the neckline.

    The names of the mirror image's edges begin with ``left_``.
    """
    left = [replace(stroke.mirrored(), name=f"left_{stroke.name}").reversed() for stroke in reversed(right.strokes)]
    left_neck = [replace(stroke.mirrored(), label=EdgeRole.LEFT_COLLAR) for stroke in neck]
    return right.then(*left, *left_neck, *(stroke.reversed() for stroke in reversed(neck)))


def hung(piece: Piece, size: Measurements, hole: NeckHole, *, front: bool) -> Piece:
    """The piece with the sides of its neckline at those of the neck."""
    level = size.height - size.head_l - hole.half_width * tan(size.shoulder_incl)
    return piece.at(0, level, FRONT if front else BACK)


def _on(start: Point, sinking: float, length: float) -> Point:
    """The point ``length`` cm towards the wearer's right."""
    return start[0] - length * cos(sinking), start[1] - length * sin(sinking)
