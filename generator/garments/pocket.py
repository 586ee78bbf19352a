"""Pockets on the front of a straight shirt and on the back of trousers.

A patch pocket is a panel that lies on another one: its sides and its bottom are sewn to lines inside that panel, its
top edge is free. A welt pocket, as on jackets, hangs inside the garment: only its opening is drawn, a line.
"""

from dataclasses import dataclass, replace
from enum import Enum
from math import copysign

from gcd_dataset.curves import LINE, Point
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.description import Detail, Zone
from gcd_dataset.generator.garments.space import Design, choice, real
from gcd_dataset.generator.pattern import Component, Outline, Piece, Stroke
from gcd_dataset.records import LineRole

LIFT = 1.0  # cm between a pocket and the panel under it before sewing
ROOM = 1.0  # cm left between a pocket and the crotch or the hem
OVER_HIPS = 0.15  # height of a back pocket's top over the hips, as a fraction of hips to waist: below the darts
SEWN = ("inner", "bottom", "outer")  # edges of a pocket from top to top


class Pockets(Enum):
    """The sides of the garment that have a pocket, the wearer's."""

    RIGHT = "right"
    LEFT = "left"
    BOTH = "both"


class PocketKind(Enum):
    """How a pocket is made."""

    PATCH = "patch"
    WELT = "welt"


@dataclass(frozen=True)
class PocketDesign(Design):
    """Patch or welt pockets; sampling draws none unless an overlay names one."""

    chest: Pockets | None = choice(None, *Pockets, None, weights=(0, 0, 0, 1))
    """Pockets on the front of a straight shirt."""
    back: Pockets | None = choice(None, *Pockets, None, weights=(0, 0, 0, 1))
    """Pockets on the back of trousers."""
    width: float = real(0.5, 0.4, 0.6)
    """Width, as a fraction of the panel's width from the centre to the side, under the arm or at the hips."""
    depth: float = real(1.15, 1.0, 1.4)
    """Depth, as a fraction of the width; less where there is no room above hem or crotch."""
    drop: float = real(0.1, 0.0, 0.25)
    """Height of a chest pocket's top below the armhole, as a fraction of the side seam."""
    kind: PocketKind = choice(PocketKind.PATCH, *PocketKind, weights=(1, 0))
    """A welt pocket has the width of a patch, and no cloth: its opening is a line where a patch's top edge would be."""

    @staticmethod
    def sides(where: Pockets | None) -> tuple[str, ...]:
        """``right``, ``left`` or both, of one of the choices."""
        return () if where is None else ("right", "left") if where is Pockets.BOTH else (where.value,)


def with_pockets(whole: Component, design: PocketDesign, panels: tuple[str, ...]) -> Component:
    """The garment with a pocket on each of some panels. Raises ``PatternError`` where there is no room."""
    for name in panels:
        piece = whole.piece(name)
        if "ftorso" in name:
            side = piece.outline.run("side")
            (x, under), hem = side[-1].end, side[0].start[1]
            top, room = under - design.drop * (under - hem), under - design.drop * (under - hem) - hem
        else:
            (_, hips), (_, waist) = piece.outline.run("hip")[0].start, piece.outline.run("hip")[-1].end
            x, top = piece.outline.run("centre")[-1].end[0], hips + OVER_HIPS * (waist - hips)
            room = top - piece.outline.run("crotch")[-1].end[1]
        width = design.width * abs(x)
        depth = min(design.depth * width, room - ROOM)
        if depth <= ROOM:
            raise PatternError(f"panel {name} has {room:.1f} cm of room for a pocket: leave the pocket out")
        if design.kind is PocketKind.WELT:
            start, end = (0.5 * (x - width), top), (0.5 * (x + width), top)
            welt = Stroke(start, end, LINE, "pocket_welt", LineRole.PLACEMENT)
            whole = whole.with_piece(replace(piece, lines=(*piece.lines, welt)))
        else:
            whole = _patched(whole, piece, (0.5 * x, top), width, depth)
    return whole


def _patched(whole: Component, under: Piece, middle: Point, width: float, depth: float) -> Component:
    """A pocket sewn to lines inside a piece; ``middle``: of its top edge, in the piece's drawing [cm]."""
    (x, top), half = middle, 0.5 * width
    outline = (
        Outline.start(x + half, top)
        .line(x + half, top - depth, name="inner")
        .line(x - half, top - depth, name="bottom")
        .line(x - half, top, name="outer")
        .close(name="top")
    )
    lines = tuple(outline.edge(name).called(f"pocket_{name}", LineRole.PLACEMENT) for name in SEWN)
    lined = replace(under, lines=(*under.lines, *lines))
    pocket = replace(under, name=f"{under.name}_pocket", outline=outline, lines=())
    pocket = pocket.moved((0.0, 0.0, copysign(LIFT, under.translation[2])))
    along = lined.along(*(line.name for line in lines))
    whole = whole.with_piece(lined)
    return replace(whole, pieces=(*whole.pieces, pocket)).sewn(pocket.along(*SEWN), along)


def pocket_details(place: str, sides: tuple[str, ...], kind: PocketKind) -> tuple[Detail, ...]:
    """The pockets in words; ``place``: chest or back."""
    if not sides:
        return ()
    name = f"{place} welt pocket" if kind is PocketKind.WELT else f"{place} pocket"
    words = f"two {name}s" if len(sides) > 1 else f"a {name} on the {sides[0]}"
    return (Detail(Zone.BODY if place == "chest" else Zone.LOWER, (words,), sided=len(sides) == 1),)
