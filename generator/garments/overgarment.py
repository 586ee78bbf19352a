"""Parts of capes and ponchos: a front and a back that hang from the neck over shoulders and arms.

Drawings begin at the right side of the neck, ``(-half_width, 0)``, where neck and shoulder meet, and are placed with
that point on the body; x = 0 is the wearer's middle.
"""

from dataclasses import dataclass, replace
from math import cos, sin, tan

from gcd_dataset.curves import Point, Quadratic, to_frame
from gcd_dataset.generator.garments.neckline import Neckline, NecklineDesign, neckline_shape
from gcd_dataset.generator.pattern import Outline, Piece, Stroke, chain_from
from gcd_dataset.records import EdgeRole, Measurements

NECK_WIDTH = 0.8  # straight width of the neck over neck_w, which is measured round the back of the neck
FRONT_DROP, BACK_DROP = 0.42, 0.1  # depth of throat and of nape below the sides of the neck, over neck_w
FRONT, BACK = 30.0, -25.0  # cm: z of front and back before sewing


@dataclass(frozen=True, slots=True)
class NeckHole:
    """The opening for the neck [cm]."""

    half_width: float
    front: float
    """Depth in front."""
    back: float
    """Depth behind."""


def neck_hole(size: Measurements, ease: float) -> NeckHole:
    """The opening for the base of the neck, enlarged by the factor ``ease``."""
    around = ease * size.neck_w
    return NeckHole(0.5 * NECK_WIDTH * around, FRONT_DROP * around, BACK_DROP * around)


def right_neck(hole: NeckHole, kind: Neckline, *, front: bool) -> tuple[Stroke, ...]:
    """The right half of the neckline, from the side of the neck to the middle."""
    design = NecklineDesign(f_collar=kind, b_collar=kind)
    depth = hole.front if front else hole.back
    drawn = neckline_shape(design, front=front, half_width=hole.half_width, depth=depth)
    named = (replace(stroke, name="neck", label=EdgeRole.RIGHT_COLLAR) for stroke in drawn)
    return chain_from((-hole.half_width, 0.0), *named)


def with_shoulder(outline: Outline, size: Measurements, *, fall: float, length: float) -> Outline:
    """The outline with a shoulder seam added: straight from the neck along the shoulder, then a curve to the hem.

    ``length``: length of the whole seam [cm]; ``fall``: slope of its end below the horizontal [rad], which also limits
    the slope along the shoulder.
    """
    slope, (x, y) = min(size.shoulder_incl, fall), outline.pen
    shoulder = min((0.5 * size.shoulder_w + x) / cos(slope), 0.5 * length)
    end, bend = (
        _point_towards_right((x, y), slope, shoulder),
        _point_towards_right((x, y), slope, 0.5 * (shoulder + length)),
    )
    hem = _point_towards_right(bend, fall, 0.5 * (length - shoulder))
    return outline.line(*end, name="shoulder").curve(*hem, Quadratic(to_frame(end, hem, bend)), name="side")


def both_halves(right: Outline, neck: tuple[Stroke, ...]) -> Outline:
    """A whole front or back from its right half, drawn from the neck to the middle of the hem, and half its neckline.

    Edges of the mirror image have the prefix ``left_``.
    """
    left = [replace(stroke.mirrored(), name=f"left_{stroke.name}").reversed() for stroke in reversed(right.strokes)]
    left_neck = [replace(stroke.mirrored(), label=EdgeRole.LEFT_COLLAR) for stroke in neck]
    return right.then(*left, *left_neck, *(stroke.reversed() for stroke in reversed(neck)))


def placed_at_neck(piece: Piece, size: Measurements, hole: NeckHole, *, front: bool) -> Piece:
    """The piece placed with the sides of its neckline at the sides of the neck."""
    level = size.height - size.head_l - hole.half_width * tan(size.shoulder_incl)
    return piece.at(0, level, FRONT if front else BACK)


def _point_towards_right(start: Point, sinking: float, length: float) -> Point:
    """The point ``length`` cm towards the wearer's right, along a line of slope ``sinking`` [rad]."""
    return start[0] - length * cos(sinking), start[1] - length * sin(sinking)
