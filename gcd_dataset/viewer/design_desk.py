"""Designing by hand: parameters of a design and measures of its wearer as controls, and the resulting pattern."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gcd_dataset.errors import BodyError, ConfigError, PatternError
from gcd_dataset.generator.garments import DrawnGarment, GarmentDesign, check_design, design_from_dict
from gcd_dataset.generator.garments.design import design_tree
from gcd_dataset.generator.garments.parameter import Integer, Real, plain
from gcd_dataset.generator.garments.space import DesignSpace, leaves, value_at
from gcd_dataset.measurements import ANGLES, MEASURES, Measurements
from gcd_dataset.records import Body, Pattern
from gcd_dataset.viewer.content import Content, crossing_vertices, vertex_stretch

COARSE = 3.0  # cm, of the mesh that is draped on request
DRESS: Mapping[str, Any] = {"meta": {"upper": "FittedShirt", "bottom": "SkirtCircle"}}
"""The design to start from."""
SPREAD = 0.25  # of a measure, to both sides of the wearer's


@dataclass(frozen=True)
class Control:
    """One parameter of a design or one measure, as a page shows it."""

    path: str
    kind: str
    """``number``, ``whole``, ``choice`` or ``flag``."""
    value: Any
    low: float = 0.0
    high: float = 1.0
    options: tuple[Any, ...] = ()

    @property
    def section(self) -> str:
        """The part of the design that the parameter belongs to."""
        return self.path.partition(".")[0]


@dataclass(frozen=True)
class Drawing:
    """What a design gives."""

    pattern: Pattern | None
    """``None`` if it cannot be drawn."""
    faults: tuple[str, ...]
    """Why it cannot be drawn or worn."""
    used: frozenset[str]
    """Sections of the design that the garment is drawn from, by their names in design files."""


def controls(design: GarmentDesign | None = None) -> list[Control]:
    """A control for each design parameter, in the order of design files."""
    design, space = design or GarmentDesign(), DesignSpace.declared(GarmentDesign)
    return [_control(*leaf, plain(value_at(space, design, leaf.path))) for leaf in leaves(space, added=True)]


def measure_controls(size: Measurements) -> list[Control]:
    """A control for each measure that the wearer has [cm, degrees]."""
    found = []
    for name, value in size.to_file_values().items():
        if np.isfinite(value):
            reach = max(SPREAD * abs(value), 5.0)
            found.append(Control(name, "number", round(value, 1), round(value - reach, 1), round(value + reach, 1)))
    return found


class Desk:
    """Draws designs for a wearer whose measures may be changed.

    ``wearer(legs_apart)`` returns body and measures, by default of the neutral body.
    """

    def __init__(
        self, design: GarmentDesign | None = None, wearer: Callable[[bool], tuple[Body, Measurements]] | None = None
    ) -> None:
        from gcd_dataset.generator.body import named_body

        self.start = design or design_from_dict(DRESS)
        wearer = wearer or (lambda legs_apart: named_body("neutral", legs_apart=legs_apart)[:2])
        (self._body, self.size), (self._apart, _) = wearer(False), wearer(True)

    def draw(self, values: Mapping[str, Any], measures: Mapping[str, Any]) -> Drawing:
        """The pattern of the parameters and measures, by path. Raises ``ConfigError`` for values out of range."""
        design = self._design(values)
        sections = design.sections_used() | ({"front"} if design.halves() else set())  # sewn fronts leave it unused
        used = frozenset(name.replace("_", "-") for name in sections)
        if design.meta.upper is None and design.meta.bottom is None:
            return Drawing(None, ("empty: choose meta.upper or meta.bottom",), used)
        try:
            drawn = DrawnGarment.of(self._size(measures), design, name="design")
            return Drawing(drawn.pattern, tuple(map(str, check_design(drawn))), used)
        except PatternError as error:
            return Drawing(None, (str(error),), used)

    def file_text(self, values: Mapping[str, Any]) -> str:
        """The parameters as a design file, which ``gcd show --design`` reads: JSON, and so YAML too."""
        return json.dumps({"design": design_tree(self._design(values))}, indent=1) + "\n"

    def draped(self, values: Mapping[str, Any], measures: Mapping[str, Any]) -> Content:
        """The garment draped coarsely on the wearer; takes seconds. Raises ``GcdError`` if it cannot be made."""
        from gcd_dataset.generator.drape import DrapeJob, drape_batch
        from gcd_dataset.generator.dressing import dress
        from gcd_dataset.generator.dressing.hold_edges import has_legs
        from gcd_dataset.generator.mesh import build_box_mesh

        drawing, size = self.draw(values, measures), self._size(measures)
        if drawing.pattern is None:
            raise ConfigError(f"no pattern to drape: {drawing.faults[0]}")
        body = self._wearer(measures, legs_apart=has_legs(drawing.pattern))
        pattern = dress(drawing.pattern, body, size).pattern
        mesh = build_box_mesh(pattern, spacing=COARSE)
        [drape] = drape_batch([DrapeJob(mesh, body, size)], device="auto")
        placed = np.asarray(drape.vertices, float)
        return Content(
            "Design",
            pattern,
            mesh,
            draped=drape.vertices,
            body=body,
            values={"stretch": vertex_stretch(mesh, drape.vertices)},
            crossed=crossing_vertices(placed, mesh.faces, body),
            outcome=drape.outcome,
        )

    def _design(self, values: Mapping[str, Any]) -> GarmentDesign:
        tree: dict[str, Any] = {}
        for path, value in values.items():
            *sections, name = path.split(".")
            node = tree
            for section in sections:
                node = node.setdefault(section, {})
                if not isinstance(node, dict):
                    raise ConfigError(f"parameter {path!r:.60}: {section} is given as a number too: leave it out")
            node[name] = value
        return design_from_dict(tree)

    def _size(self, measures: Mapping[str, Any]) -> Measurements:
        changed = {}
        for name, value in measures.items():
            if name not in MEASURES or not isinstance(value, int | float) or not np.isfinite(value):
                raise ConfigError(f"measure {name!r:.60} is {value!r:.60}: give a number for one of {len(MEASURES)}")
            changed[name] = float(np.radians(value)) if name in ANGLES else float(value)
        return replace(self.size, **changed)

    def _wearer(self, measures: Mapping[str, Any], *, legs_apart: bool) -> Body:
        """The body: the wearer's own, or for other measures the likeliest one with these."""
        own = measure_controls(self.size)
        if all(abs(float(measures.get(one.path, one.value)) - one.value) < 0.05 for one in own):
            return self._apart if legs_apart else self._body
        from gcd_dataset.generator.body import build_body, fit_shape

        try:
            shape = fit_shape(self._size(measures)).shape
        except BodyError as error:
            raise ConfigError(f"no body has these measures: {error}") from error
        return build_body(replace(shape, legs_apart=legs_apart), name="designed")


def _control(path: str, space: Any, value: Any) -> Control:
    if isinstance(space, Integer | Real):
        kind = "whole" if isinstance(space, Integer) else "number"
        return Control(path, kind, value, float(space.low), float(space.high))
    options = tuple(map(plain, space.options))
    return Control(path, "flag" if set(options) == {True, False} else "choice", value, options=options)
