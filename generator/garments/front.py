"""Fronts: how the two halves of a shirt are joined at the centre front.

A cardigan and an open vest have an open front, a jacket has a zip, a shirt with a button stand has buttons. The seam of
the fronts records closure and closed part (``Seam``).

Each front with buttons is drawn wider than its half by half the stand. The centre front is then a line inside each
front, and the seam joins the two lines, so that the fronts overlap by the stand: the extension of one lies over the
other front, that of the other under the first. The extensions' own edges are free. The neckline, its collar and the
seam to a part below end at the centre front.
"""

from dataclasses import dataclass, replace
from enum import Enum

from gcd_dataset.generator.garments.description import NO_WORDS, Detail, Tag, Words, Zone
from gcd_dataset.generator.garments.space import Design, choice, real
from gcd_dataset.generator.pattern import Component, Interface, Piece
from gcd_dataset.records import Closure, LineRole


class Over(Enum):
    """The front that lies over the other one, by the wearer's side."""

    LEFT = "left"
    RIGHT = "right"


@dataclass(frozen=True)
class FrontDesign(Design):
    """The centre front of a shirt; sampling leaves it sewn unless an overlay names a closure."""

    closure: Closure = choice(Closure.SEWN, *Closure, weights=(1, 0, 0, 0))
    """How the two fronts are joined: sewn, open, or by zip or buttons."""
    open_top: float = real(0.0, 0.0, 0.5, keep=0.6)
    """Open part below the neckline of a front with zip or buttons, as a fraction of the front edge; opens a collar."""
    open_hem: float = real(0.0, 0.0, 0.4, keep=0.8)
    """Open part above the hem of a front with zip or buttons, as a fraction of the front edge."""
    stand: float = real(3.0, 2.0, 5.0)
    """Width of the button stand, by which the fronts overlap [cm]."""
    over: Over = choice(Over.LEFT, *Over)
    """The upper front of a front with buttons."""

    @property
    def extension(self) -> float:
        """Width by which each front is drawn beyond the centre [cm]."""
        return 0.5 * self.stand if self.closure is Closure.BUTTONS else 0.0


def with_extension(piece: Piece, edge: str, width: float) -> Piece:
    """The piece drawn ``width`` cm beyond a straight edge, which becomes a line of the same name inside it."""
    stroke = piece.outline.edge(edge)
    (x, y), outwards = stroke.chord, width / stroke.length * (1.0 if piece.outline.area > 0.0 else -1.0)
    beyond = stroke.moved((outwards * y, -outwards * x)).called("extension", "")
    ends = replace(beyond, end=beyond.start, start=stroke.start), replace(beyond, start=beyond.end, end=stroke.end)
    outline = piece.outline.with_strokes((stroke,), (ends[0], beyond, ends[1]))
    return replace(piece, outline=outline, lines=(*piece.lines, stroke.called(edge, LineRole.PLACEMENT)))


def sewn_fronts(whole: Component, right: Interface, left: Interface, design: FrontDesign) -> Component:
    """The halves joined along their centre fronts, from the neckline down, and along the edges of their collars."""
    if design.closure is Closure.SEWN:
        return whole.sewn(right, left)
    if design.closure is Closure.OPEN:
        return whole.sewn(right, left, closure=Closure.OPEN)
    is_left_over = design.closure is Closure.BUTTONS and design.over is Over.LEFT
    over, under = (left, right) if is_left_over else (right, left)
    closed = (design.open_top, 1.0 - design.open_hem)
    whole = whole.sewn(over[:1], under[:1], closure=design.closure, closed=closed)
    collar = Closure.OPEN if design.open_top else design.closure
    return whole.sewn(over[1:], under[1:], closure=collar) if over[1:] else whole


TAGS = {Closure.OPEN: Tag.OPEN_FRONT, Closure.ZIP: Tag.ZIP, Closure.BUTTONS: Tag.BUTTONS}
"""The tag of each closure but ``SEWN``."""
WORDS: dict[Closure, Words] = {
    Closure.OPEN: ("an open front", "a front that is open from neck to hem"),
    Closure.ZIP: ("a zip", "a zip down the front"),
    Closure.BUTTONS: ("buttons", "buttons down the front"),
}
OPEN_AT: dict[tuple[bool, bool], Words] = {
    (False, False): NO_WORDS,
    (True, False): ("a front worn open at the neck",),
    (False, True): ("a front worn open at the hem",),
    (True, True): ("a front worn open at neck and hem",),
}


def front_details(design: FrontDesign) -> tuple[Detail, ...]:
    """The closure, and the parts of a closed front that are open; nothing for a front that is sewn."""
    if design.closure is Closure.SEWN:
        return ()
    found = (Detail(Zone.BODY, WORDS[design.closure], main=True),)
    words = NO_WORDS if design.closure is Closure.OPEN else OPEN_AT[design.open_top > 0.0, design.open_hem > 0.0]
    return (*found, Detail(Zone.BODY, words)) if words else found
