"""Dressing: prepare a pattern of any origin for a drape: place its panels, label panels and held edges."""

from dataclasses import dataclass

from gcd_dataset.generator.dressing.frame import wearer_of
from gcd_dataset.generator.dressing.hanging import label_panels
from gcd_dataset.generator.dressing.hold_edges import has_legs, label_edges
from gcd_dataset.generator.dressing.placing import place_panels, turn_sleeves
from gcd_dataset.records import Body, Measurements, Pattern

__all__ = ["Dressing", "dress", "has_legs"]


@dataclass(frozen=True)
class Dressing:
    """A pattern placed round a body, with labels on every panel and on the edges that hold it up."""

    pattern: Pattern
    assumed: tuple[str, ...]
    """Corrected placements, and assumptions where the file has gaps: one sentence each, with the reason."""


def dress(pattern: Pattern, body: Body, size: Measurements) -> Dressing:
    """The pattern ready for a drape on that body. Existing placements and labels stay if a drape can start from them.

    Raises ``PatternError`` where the seams do not determine the placements of panels, ``BodyError`` for a body without
    a trunk or a missing measure.
    """
    wearer = wearer_of(body, size)
    placed, moved = place_panels(pattern, wearer)
    labelled, parts = label_panels(placed, wearer)
    aimed, turned = turn_sleeves(labelled, wearer)
    held, holds = label_edges(aimed, wearer)
    alone = len(held.panels) > 1 and not held.seams
    lacking = ("the pattern has no stitches: its panels fall one by one; add pattern.stitches",) if alone else ()
    return Dressing(held, (*moved, *parts, *turned, *holds, *lacking))
