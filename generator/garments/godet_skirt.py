"""The godet skirt: a base skirt with triangular inserts (godets) in its hem."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import atan2, hypot, sqrt
from typing import Any

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.description import Description, Detail, Setting, Tag, Zone, number_word
from gcd_dataset.generator.garments.garment import BottomGarment, Combined, Cutting, GarmentChoice, Ring
from gcd_dataset.generator.garments.gathered_skirt import GATHERED_SKIRT
from gcd_dataset.generator.garments.mends import ALL_MENDS
from gcd_dataset.generator.garments.pencil_skirt import PENCIL_SKIRT
from gcd_dataset.generator.garments.space import Design, choice, integer
from gcd_dataset.generator.garments.trunk import girth_below_waist
from gcd_dataset.generator.pattern import Component, Outline, Piece, chain_from
from gcd_dataset.records import Measurements

LEAST_HEM = 0.01  # share of the remaining hem: a smaller gap before a cut is dropped, GarmentCode
NARROWEST, SHALLOWEST = 1.0, 1.0  # cm: least width and depth of a cut, GarmentCode
CLOSED = 1e-6  # cm: shorter pieces of hem are left out
DEEPEST_SLIT = 0.9  # share of a pencil skirt's length, its parameter's limit
STAND_OFF = 5.0  # cm from a panel to its godets, away from the body, GarmentCode


class GodetBase(GarmentChoice):
    """Base skirts for godets."""

    garment: BottomGarment[Any]

    GATHERED = GATHERED_SKIRT
    PENCIL = PENCIL_SKIRT


@dataclass(frozen=True)
class GodetSkirtDesign(Design):
    """Godets in a hem."""

    base: GodetBase = choice(GodetBase.PENCIL, *GodetBase, keep=0.7)
    """The base skirt, with the parameters of its own section."""
    insert_w: int = integer(15, 10, 50)
    """Width of a godet at the hem [cm]."""
    insert_depth: int = integer(20, 10, 50)
    """Height of a godet [cm]."""
    num_inserts: int = choice(4, 4, 6, 8, 10, 12)
    """Number of godets, front and back together."""
    cuts_distance: int = integer(5, 0, 10)
    """Length of hem between two cuts [cm]."""


@dataclass(frozen=True, slots=True)
class _Cut:
    """The cut for a godet [cm]; its sides have the length of the godet's sides."""

    width: float
    depth: float
    distance: float  # length of hem between two cuts; half of this length lies before the first cut


def with_godets(skirt: Component, design: GodetSkirtDesign) -> Component:
    """The skirt of two panels with godets in both hems; offers the ring ``top``."""
    front, back = skirt.pieces
    opened = (_opened(front, design, from_right=True), _opened(back, design, from_right=False))
    godets = tuple(godet for piece in skirt.pieces for godet in _godets(piece, design))
    whole = replace(skirt, pieces=(*opened, *godets), interfaces={"top": skirt.interface("top")})
    for piece in opened:
        for number in range(design.num_inserts // 2):
            godet = whole.piece(_name(piece, number))
            whole = whole.sewn(godet.along("right"), piece.against(f"cut_{number}_right"))
            whole = whole.sewn(godet.against("left"), piece.along(f"cut_{number}_left"))
    return whole


def _name(piece: Piece, number: int) -> str:
    return f"ins_{piece.name}_{number}"


def _godets(piece: Piece, design: GodetSkirtDesign) -> tuple[Piece, ...]:
    """The godets of a panel from the wearer's right to left, side by side at the level of the hem's lower end."""
    count, width, depth = design.num_inserts // 2, design.insert_w, design.insert_depth
    triangle = Outline.start(0, 0).line(0.5 * width, depth, name="right").line(width, 0, name="left").close(name="hem")
    x, y, z = piece.translation
    hem = piece.outline.edge("bottom")
    low = y + min(hem.start[1], hem.end[1])
    out = z + STAND_OFF if z > 0 else z - STAND_OFF
    return tuple(
        Piece(_name(piece, number), triangle).at(x + (number - 0.5 * count) * width, low, out)
        for number in range(count)
    )


def _opened(piece: Piece, design: GodetSkirtDesign, *, from_right: bool) -> Piece:
    """The panel with cuts in its straight hem, which is drawn from the wearer's left to right.

    The cuts are laid out from one end of the hem, and the remaining hem is at the other end. Cuts are numbered from the
    wearer's right. Raises ``PatternError`` for cuts deeper than the panel.
    """
    hem, count = piece.outline.edge("bottom"), design.num_inserts // 2
    cut, low = _cut(hem.length, count, design), -min(hem.start[1], hem.end[1])
    if cut.depth >= low:
        figures = f"a godet asks for a cut {cut.depth:.1f} cm deep in a skirt {low:.1f} cm long"
        raise PatternError(f"{figures}: lower godet-skirt.insert_depth, or lengthen the skirt")
    starts = _starts(hem.length, count, cut)
    if from_right:
        starts = [hem.length - start - cut.width for start in reversed(starts)]
    drawn = Outline.start(0, 0)
    for number, start in zip(reversed(range(count)), starts, strict=True):
        if start - drawn.pen[0] > CLOSED:
            drawn = drawn.line(start, 0, name="bottom")
        drawn = drawn.line(start + 0.5 * cut.width, -cut.depth, name=f"cut_{number}_left")
        drawn = drawn.line(start + cut.width, 0, name=f"cut_{number}_right")
    if drawn.pen[0] < hem.length - CLOSED:
        drawn = drawn.line(hem.length, 0, name="bottom")
    rotated = (stroke.rotated(atan2(hem.chord[1], hem.chord[0])) for stroke in drawn.strokes)
    return replace(piece, outline=piece.outline.with_strokes((hem,), chain_from(hem.start, *rotated)))


def _cut(hem: float, count: int, design: GodetSkirtDesign) -> _Cut:
    """A cut of an equal share of the hem; a godet too narrow for that share gets a shallow cut."""
    width, distance = hem / count - design.cuts_distance, float(design.cuts_distance)
    if width < NARROWEST:
        width, distance = NARROWEST, hem / count - NARROWEST
    side = hypot(0.5 * design.insert_w, design.insert_depth)
    if side <= 0.5 * width:
        return _Cut(2 * sqrt(side**2 - SHALLOWEST**2), SHALLOWEST, distance)
    return _Cut(width, sqrt(side**2 - 0.25 * width**2), distance)


def _starts(hem: float, count: int, cut: _Cut) -> list[float]:
    """Start of each cut along the hem [cm], from the end where the layout begins."""
    starts: list[float] = []
    reached, gap = 0.0, 0.5 * cut.distance
    for _ in range(count):
        start = reached + gap if gap >= LEAST_HEM * (hem - reached) else reached
        starts.append(start)
        reached, gap = start + cut.width, cut.distance
    return starts


def _combined(size: Measurements, drawn: Combined[GodetSkirtDesign], cutting: Cutting) -> Component:
    (base,) = drawn.parts
    return with_godets(base.garment.cut(size, base.plain, cutting), drawn.design)


def _rings(
    size: Measurements, drawn: Combined[GodetSkirtDesign], rise: float, length: float, wearer: Measurements
) -> Iterator[Ring]:
    """The rings of the base above its cuts, and the hem: godets narrower than their cuts draw it in."""
    design, (base,) = drawn
    count = design.num_inserts // 2
    panels = base.garment.cut(size, base.plain, Cutting(rise, length, ALL_MENDS)).pieces
    hems = [piece.outline.length("bottom") for piece in panels]
    cuts = [_cut(hem, count, design) for hem in hems]
    shown = base.plain
    if base.garment is PENCIL_SKIRT:
        opened = max(cut.depth for cut in cuts) / (length - rise * size.hips_line)
        shown = replace(shown, front_slit=min(opened, DEEPEST_SLIT))
    yield from base.garment.rings_of(size, shown, rise, length, wearer)
    cloth = sum(hem + count * (design.insert_w - cut.width) for hem, cut in zip(hems, cuts, strict=True))
    body = girth_below_waist(wearer, length + (1 - rise) * wearer.hips_line)
    yield Ring("a hem with godets", cloth, body, "raise godet-skirt.insert_w, or godet-skirt.num_inserts")


def _describe(setting: Setting, drawn: Combined[GodetSkirtDesign]) -> Description:
    (part,) = drawn.parts
    base, count = part.garment.description_of(setting, part.plain), number_word(drawn.design.num_inserts)
    words = (f"{count} godets in the hem", f"{count} triangular godets set into the hem")
    return replace(base.adding(Detail(Zone.HEM, words, main=True)), tags=(Tag.GODETS, *base.tags))


GODET_SKIRT = BottomGarment(
    name="GodetSkirt",
    section="godet-skirt",
    design=GodetSkirtDesign,
    parts_of=lambda design: (design.base.garment,),
    cut=_combined,
    rise_of=lambda drawn: float(drawn.parts[0].design.rise),
    length_of=lambda size, drawn, rise: drawn.parts[0].garment.length_of(size, drawn.parts[0].design, rise),
    description_of=_describe,
    rings_of=_rings,
    inherits_length=True,
    remedies=("insert_depth-", "cuts_distance-"),
    widened_by="insert_w",
    statistics_length_section="skirt",
)
