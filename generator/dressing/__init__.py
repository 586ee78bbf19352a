"""Dressing: a pattern of any origin made ready for a drape, and what had to be assumed for that."""

from dataclasses import dataclass

from gcd_dataset.generator.dressing.body_parts import label_panels
from gcd_dataset.generator.dressing.hold_edges import has_legs, label_edges
from gcd_dataset.generator.dressing.placing import place_panels
from gcd_dataset.generator.dressing.wearer import wearer_of
from gcd_dataset.records import Body, Measurements, Pattern

__all__ = ["Dressing", "dress", "has_legs"]


@dataclass(frozen=True)
class Dressing:
    """A pattern that hangs round a body, every panel and every edge that holds it labelled."""

    pattern: Pattern
    assumed: tuple[str, ...]
    """What its file did not say, with the reason; one sentence each."""


def dress(pattern: Pattern, body: Body, size: Measurements) -> Dressing:
    """The pattern ready for a drape on that body; what its file says stays as it is.

    Raises ``PatternError`` where the panels' places cannot be told, ``BodyError`` for a body without a trunk or a
    measure.
    """
    wearer = wearer_of(body, size)
    placed, moved = place_panels(pattern, wearer)
    labelled, parts = label_panels(placed, wearer)
    held, holds = label_edges(labelled, wearer)
    return Dressing(held, (*moved, *parts, *holds, *_loose(held)))


def _loose(pattern: Pattern) -> tuple[str, ...]:
    if len(pattern.panels) > 1 and not pattern.seams:
        return ("the pattern has no stitches: its panels fall one by one; add pattern.stitches",)
    return ()
