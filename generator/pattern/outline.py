"""Outlines: the contour of a piece, drawn edge by edge; edges have names.

>>> square = Outline.start(0, 0).line(10, 0, name="hem").line(10, 10).line(0, 10, name="top").close()
>>> square.edge("hem").length
10.0
>>> square.area
100.0
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import LINE, Curve, Point
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.pattern.stroke import Stroke
from gcd_dataset.records import EdgeRole

CLOSED = 1e-6  # cm between the last point and the first, at most


@dataclass(frozen=True)
class Outline:
    """A chain of strokes, each from the end of the previous stroke. Drawing methods return a new outline."""

    origin: Point
    strokes: tuple[Stroke, ...] = ()

    @classmethod
    def start(cls, x: float, y: float) -> Self:
        """An empty outline with the pen at a point [cm]."""
        return cls((float(x), float(y)))

    @property
    def pen(self) -> Point:
        """The end of the drawing so far [cm]."""
        return self.strokes[-1].end if self.strokes else self.origin

    def line(self, x: float, y: float, *, name: str = "", label: EdgeRole | str = "") -> Self:
        """With a straight line to a point [cm]."""
        return self.curve(x, y, LINE, name=name, label=label)

    def curve(self, x: float, y: float, curve: Curve, *, name: str = "", label: EdgeRole | str = "") -> Self:
        """With a curve, given in the edge frame, to a point [cm]."""
        return self.then(Stroke(self.pen, (float(x), float(y)), curve, name, label))

    def then(self, *strokes: Stroke) -> Self:
        """With more strokes. Raises ``PatternError`` unless each stroke begins at the end of the previous one."""
        pen = self.pen
        for stroke in strokes:
            if not _meet(pen, stroke.start):
                raise PatternError(
                    f"edge {stroke.name} begins at {_text(stroke.start)}, but the pen is at {_text(pen)}"
                )
            pen = stroke.end
        return type(self)(self.origin, (*self.strokes, *strokes))

    def close(self, *, name: str = "") -> Self:
        """Closed by a straight edge to the origin, unless the pen is there already."""
        if _meet(self.pen, self.origin):
            return self
        return self.line(*self.origin, name=name)

    @property
    def closed(self) -> bool:
        """Whether the pen is back at the origin."""
        return bool(self.strokes) and _meet(self.pen, self.origin)

    def run(self, name: str) -> tuple[Stroke, ...]:
        """All parts of the edge of that name, in drawing order. Raises ``PatternError`` with the known names."""
        found = tuple(stroke for stroke in self.strokes if stroke.name == name)
        if not found:
            names = dict.fromkeys(stroke.name for stroke in self.strokes if stroke.name)
            raise PatternError(f"no edge named {name}: there are {', '.join(names)}")
        return found

    def edge(self, name: str) -> Stroke:
        """The edge of that name. Raises ``PatternError`` if it is missing or divided."""
        found = self.run(name)
        if len(found) > 1:
            raise PatternError(f"edge {name} was divided into {len(found)} pieces: ask for the run")
        return found[0]

    def length(self, name: str) -> float:
        """Length of the edge of that name, all parts together [cm]."""
        return sum(stroke.length for stroke in self.run(name))

    def with_strokes(self, old: tuple[Stroke, ...], new: tuple[Stroke, ...]) -> Self:
        """With neighbouring strokes replaced by a chain between the same two points.

        Replacing the first stroke may move the origin, and with it the closing point.
        """
        first = self.strokes.index(old[0])
        if self.strokes[first : first + len(old)] != old:
            raise PatternError(f"edges {', '.join(stroke.name for stroke in old)} do not follow one another")
        strokes = (*self.strokes[:first], *new, *self.strokes[first + len(old) :])
        return type(self)(strokes[0].start).then(*strokes)

    def labelled(self, labels: Iterable[EdgeRole | str]) -> Self:
        """With a label on every stroke."""
        strokes = (stroke.called(stroke.name, label) for stroke, label in zip(self.strokes, labels, strict=True))
        return type(self)(self.origin, tuple(strokes))

    def mirrored(self) -> Self:
        """The mirror image about the y axis, drawn in the same order."""
        return type(self)((-self.origin[0], self.origin[1]), tuple(stroke.mirrored() for stroke in self.strokes))

    def points(self) -> Float[np.ndarray, "n 2"]:
        """Points along the outline, dense enough for a bounding box [cm]."""
        return np.concatenate([stroke.points() for stroke in self.strokes])

    @cached_property
    def area(self) -> float:
        """Area of a closed outline [cm²], positive if drawn counter-clockwise."""
        return sum(stroke.swept_area for stroke in self.strokes)


def _meet(a: Point, b: Point) -> bool:
    return abs(a[0] - b[0]) <= CLOSED and abs(a[1] - b[1]) <= CLOSED


def _text(point: Point) -> str:
    return f"({point[0]:.2f}, {point[1]:.2f})"
