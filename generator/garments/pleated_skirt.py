"""The pleated skirt, which GarmentCode lacks: knife, box or inverted pleats. Panels ``skirt_front`` and ``skirt_back``.

A panel is drawn folded, as a ring sector from waist to hem, and unfolded by reflections in its folds: so its layers lie
on each other exactly, and its top is a zigzag, as if folded paper were cut along the waist. Along the top a pleat lies
in three layers, sewn to each other; the uppermost one is sewn to the waistband. A fitted waistband of most of the
height from waist to hips is a yoke: the pleats begin at its lower edge. The cloth of pleats is heavy: the band has
elastic for wearers whose hips are hardly wider than the waist.
"""

from dataclasses import dataclass
from enum import Enum
from itertools import accumulate, pairwise
from math import cos, sin
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import LINE, Point, reflection
from gcd_dataset.generator.garments.description import Description, Detail, Setting, Tag, Words, Zone
from gcd_dataset.generator.garments.garment import BottomGarment, Cutting
from gcd_dataset.generator.garments.gathered_skirt import BACK, FRONT
from gcd_dataset.generator.garments.skirt import SHORTEST, STRAIGHT, sewn_at_sides, skirt_length
from gcd_dataset.generator.garments.space import Design, choice, integer, real
from gcd_dataset.generator.garments.trunk import back_share, girth_at_rise, waist_front
from gcd_dataset.generator.pattern import Component, Interface, Outline, Piece, backwards
from gcd_dataset.generator.pattern.stroke import Stroke
from gcd_dataset.records import LineRole, Measurements

PRESSED = 180.0  # degrees
BOX = 0.3  # half the width of a box pleat, as a share of the room of a pleat
SLIT = 0.02  # half the distance of the folds that face each other over an inverted pleat, as a share of its room
LEAST_SLOPE_HEIGHT = 5.0  # cm: least height between waist and hips over which a skirt widens


class Pleats(Enum):
    """Kind of pleats."""

    KNIFE = "knife"
    BOX = "box"
    INVERTED = "inverted"


@dataclass(frozen=True)
class PleatedSkirtDesign(Design):
    """A skirt with pleats pressed from waist to hem."""

    length: float = real(0.2, 0.0, 0.6)
    """Depth of the hem below the hips as worn, with or without a waistband, as a fraction of hips to floor."""
    rise: float = real(0.7, 0.5, 1.0, keep=0.3)
    """Where the top sits: 0 at the hips, 1 at the waist."""
    pleats: Pleats = choice(Pleats.KNIFE, *Pleats)
    """Knife pleats all turn to the wearer's right; a box stands out between two folds; an inverted pleat is a box seen
    from inside."""
    count: int = integer(3, 2, 4)
    """Number of box or inverted pleats in the front, and in the back; knife pleats are twice as many."""
    depth: float = real(0.7, 0.5, 0.9)
    """Depth of the folds, as a fraction of the room that the kind of pleats leaves for them."""
    hips: float = real(1.05, 1.03, 1.2)
    """Girth of the folded skirt at the hips, as a fraction of the body's girth; at least as wide as the top."""


class Fold(NamedTuple):
    """A fold of a panel, in the order of the cloth from the wearer's right to left."""

    place: float
    """Share of the folded panel's width, from the right."""
    side: int
    """1 for a mountain fold, -1 for a valley fold."""


def folds_of(design: PleatedSkirtDesign) -> list[Fold]:
    """The folds of a panel."""
    count, folds = design.count * (2 if design.pleats is Pleats.KNIFE else 1), []
    for number in range(count):
        room, middle = 1.0 / count, (number + 0.5) / count
        match design.pleats:
            case Pleats.KNIFE:
                half = 0.5 * design.depth * room
                folds += [Fold(middle + half, 1), Fold(middle - half, -1)]
            case Pleats.BOX:
                half, depth = BOX * room, design.depth * BOX * room
                folds += [Fold(middle - half + depth, -1), Fold(middle - half, 1)]
                folds += [Fold(middle + half, 1), Fold(middle + half - depth, -1)]
            case Pleats.INVERTED:
                slit, depth = SLIT * room, 0.5 * design.depth * room
                folds += [Fold(middle - slit, 1), Fold(middle - depth, -1)]
                folds += [Fold(middle + depth, -1), Fold(middle + slit, 1)]
    return folds


def pleated_skirt(size: Measurements, design: PleatedSkirtDesign, cutting: Cutting) -> Component:
    """Front and back; offers the ring ``top``."""
    rise, length = cutting.rise, max(cutting.length, SHORTEST)
    girth = girth_at_rise(size, rise)
    back_width = girth * back_share(size, rise)
    wider = _hem(size, design, rise, length) / girth
    panels = [
        PleatedPanel(f"skirt_{side}{cutting.suffix}", width, wider * width, length, folds_of(design))
        for side, width in (("front", girth - back_width), ("back", back_width))
    ]
    front, back = (panel.piece.at(0, size.waist_level, z) for panel, z in zip(panels, (FRONT, BACK), strict=True))
    whole = sewn_at_sides(front, back)
    for panel, piece in zip(panels, (front, back), strict=True):
        for upper, lower in panel.stacked:
            whole = whole.sewn(piece.along(upper), piece.against(lower))
    tops = (
        panel.top(ruffle=panel.width / waist)
        for panel, waist in zip(panels, (waist_front(size), size.waist_back_width), strict=True)
    )
    ring_front, ring_back = tops
    return whole.offering(top=ring_front + backwards(ring_back))


@dataclass(frozen=True)
class PleatedPanel:
    """A panel with folds; its folded shape is a ring sector below the origin, the middle of its top."""

    name: str
    width: float
    """Of the folded top [cm]."""
    hem: float
    """Width of the folded hem [cm]."""
    length: float
    folds: list[Fold]

    def _at(self, place: float) -> Float[np.ndarray, "2 2"]:
        """The points at top and hem of the folded panel, at a share of its width."""
        whole = max((self.hem - self.width) / self.length, STRAIGHT)
        radius, turn = self.width / whole, whole * (place - 0.5)
        top, hem = radius, radius + self.length
        return np.array([[r * sin(turn), radius - r * cos(turn)] for r in (top, hem)])

    @property
    def _layers(self) -> list[tuple[float, float]]:
        """From where to where each layer of the cloth runs."""
        return list(pairwise([0.0, *(fold.place for fold in self.folds), 1.0]))

    def _breaks(self, layer: int) -> list[float]:
        """Where other folds divide the top of a layer, with its ends, in the order of the cloth."""
        start, end = self._layers[layer]
        low, high = sorted((start, end))
        inner = {fold.place for fold in self.folds if low < fold.place < high}
        return sorted({start, end, *inner}, reverse=end < start)

    def _at_place(self, low: float) -> list[tuple[int, str]]:
        """The layers from ``low`` to the next fold, with the names of their edges."""
        return [
            (layer, f"top{layer}_{part}")
            for layer in range(len(self._layers))
            for part, ends in enumerate(pairwise(self._breaks(layer)))
            if min(ends) == low
        ]

    @property
    def _stacks(self) -> list[list[str]]:
        """The edges along the top from the wearer's right to left; of each stack from the uppermost layer down."""
        stacks = []
        for low in sorted({0.0, *(fold.place for fold in self.folds)}):
            found = self._at_place(low)
            upwards = len(found) > 1 and self.folds[found[0][0]].side < 0
            stacks.append([edge for _, edge in (reversed(found) if upwards else found)])
        return stacks

    @property
    def stacked(self) -> list[tuple[str, str]]:
        """Pairs of edges that lie on each other, the upper one first."""
        return [pair for stack in self._stacks for pair in pairwise(stack)]

    def top(self, *, ruffle: float) -> Interface:
        """The visible edges along the top from the wearer's right to left."""
        own = {stroke.name: stroke for stroke in self.piece.outline.strokes}
        walk: Interface = ()
        for edge, *_ in self._stacks:
            layer = int(edge[3:].split("_")[0])
            start, end = self._layers[layer]
            towards = self.piece.against if start < end else self.piece.along
            walk += towards(own[edge].name, ruffle=ruffle)
        return walk

    @property
    def piece(self) -> Piece:
        """The unfolded panel; the cloth in its middle stays where it is when folded."""
        mirrors = [np.eye(3), *(reflection(*self._at(fold.place)) for fold in self.folds)]
        turns = list(accumulate(mirrors, np.matmul))
        stays = np.linalg.inv(turns[len(self.folds) // 2])

        def cloth(layer: int, place: float) -> tuple[Point, Point]:
            points = np.column_stack([self._at(place), np.ones(2)]) @ (stays @ turns[layer]).T
            (x0, y0, _), (x1, y1, _) = points.tolist()
            return (x0, y0), (x1, y1)

        last = len(self._layers) - 1
        outline = Outline.start(*cloth(0, 0.0)[1])
        for layer, (_, end) in enumerate(self._layers):
            outline = outline.line(*cloth(layer, end)[1], name="bottom")
        outline = outline.line(*cloth(last, 1.0)[0], name="left")
        for layer in range(last, -1, -1):
            parts = list(enumerate(pairwise(self._breaks(layer))))
            for part, (start, _) in reversed(parts):
                outline = outline.line(*cloth(layer, start)[0], name=f"top{layer}_{part}")
        lines = tuple(
            Stroke(*cloth(layer, fold.place), LINE, f"fold{layer}", LineRole.FOLD, fold.side * PRESSED)
            for layer, fold in enumerate(self.folds)
        )
        return Piece(self.name, outline.close(name="right"), lines=lines)


def _hem(size: Measurements, design: PleatedSkirtDesign, rise: float, length: float) -> float:
    """Girth of the folded hem [cm]."""
    girth = girth_at_rise(size, rise)
    above = max(rise * size.hips_line, LEAST_SLOPE_HEIGHT)
    return girth + max(design.hips * size.hips - girth, 0.0) * length / above


WORDS: dict[Pleats, Words] = {
    Pleats.KNIFE: ("knife pleats",),
    Pleats.BOX: ("box pleats",),
    Pleats.INVERTED: ("inverted pleats",),
}


def _describe(setting: Setting, design: PleatedSkirtDesign) -> Description:
    return Description(
        ("pleated skirt",), (), (Detail(Zone.LOWER, WORDS[design.pleats], main=True),), tags=(Tag.PLEATED,)
    )


PLEATED_SKIRT = BottomGarment(
    name="PleatedSkirt",
    section="pleated-skirt",
    design=PleatedSkirtDesign,
    weight=0,
    cut=pleated_skirt,
    length_of=skirt_length,
    description_of=_describe,
    elastic=True,
)
