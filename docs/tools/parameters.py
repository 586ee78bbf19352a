"""Pictures of the design parameters: patterns at both ends of a range, or with each option of a choice."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from gcd_dataset.errors import GcdError
from gcd_dataset.generator.body import named_body
from gcd_dataset.generator.garments import DrawnGarment, GarmentDesign, design_from_dict
from gcd_dataset.generator.garments.parameter import Choice, plain
from gcd_dataset.generator.garments.rules import check_design
from gcd_dataset.generator.garments.space import DesignSpace, Leaf, leaves, with_value
from gcd_dataset.generator.garments.wardrobe import GARMENTS, Upper
from gcd_dataset.generator.lay_plan import PALETTE, lay_out

SPACE = DesignSpace.declared(GarmentDesign)
SHIRT = {"meta": {"upper": "Shirt"}}
ARMS = ({"sleeveless": False, "sleeve_angle": 30, "length": 0.5}, {"armhole_shape": "ArmholeAngle"})
BASES: Mapping[str, Sequence[Mapping[str, Any]]] = {
    "meta": [{}],
    "waistband": [{"meta": {"wb": "FittedWB", "bottom": "Pants"}}],
    "collar": [SHIRT],
    "sleeve": [SHIRT | {"sleeve": arm} for arm in ARMS],
    "left": [
        *(SHIRT | {"left": {"enable_asym": True, "sleeve": arm}} for arm in ARMS),
        {"meta": {"upper": "FittedShirt"}, "left": {"enable_asym": True}},
    ],
    "front": [SHIRT | {"front": {"closure": "buttons"}}],
    "pocket": [SHIRT | {"pocket": {"chest": "both"}}, {"meta": {"bottom": "Pants"}, "pocket": {"back": "both"}}],
    "trim": [SHIRT | {"trim": {"tucks": 4}}, SHIRT | {"front": {"closure": "buttons", "stand": 5.0}}],
}
"""Section to designs that show its parameters. A garment's section has none: its parameters change its defaults."""
COLUMNS, ROWS = 11, 12
TILE = 84, 112  # pixels, with the texts
LEAST = 16.0  # cm, least size of what a tile shows

Lines = list[Float[np.ndarray, "n 2"]]
Drawing = dict[tuple[bool, str], tuple[Lines, Lines]]
"""Panel (whether it is in front, name) to its outline and the lines inside it, and its edges without a seam [cm]."""


def draw_parameters(axes: Axes, section: str) -> None:
    """Draw the parameters of a section in ``ROWS`` and ``COLUMNS`` of tiles, without those that change no line."""
    axes.set(position=(0, 0, 1, 1), xlim=(0, COLUMNS), ylim=(-ROWS, 0))
    x = y = 0
    for leaf in _leaves(section):
        drawings = _drawings(leaf)
        if x + len(drawings) > COLUMNS:
            x, y = 0, y - 1
        for number, (value, drawing) in enumerate(drawings.items()):
            name = leaf.path.partition(".")[2] if number == 0 else ""
            axes.text(x + 0.05, y - 0.03, name, fontsize=7, weight="bold", va="top")
            axes.text(x + 0.5, y - 0.97, value, fontsize=6, ha="center")
            tile = axes.inset_axes((x + 0.02, y - 0.87, 0.96, 0.72), transform=axes.transData)
            _draw(tile, drawing, list(drawings.values()))
            x += 1
    assert y > -ROWS, "raise ROWS"


def _draw(axes: Axes, drawing: Drawing, others: Sequence[Drawing]) -> None:
    """Draw the garment from the side where the drawings differ, cut off around the panels that do, in colour."""
    changed = sorted(_changed(others))
    shown = [panel[0] for each in others for panel in changed if panel in each]
    front = max((True, False), key=shown.count)
    colours = {panel: PALETTE[number % len(PALETTE)] for number, panel in enumerate(changed) if panel[0] == front}
    for panel in sorted(drawing, key=colours.__contains__):
        if panel[0] == front:
            (outline, *lines), free = drawing[panel]
            axes.fill(*outline.T, facecolor=colours.get(panel, "0.93"), edgecolor="k", linewidth=0.4)
            for line in (*lines, *free):
                axes.plot(*line.T, "k", linewidth=1.2)
    points = np.concatenate([each[panel][0][0] for each in others for panel in colours if panel in each])
    low, high = points.min(axis=0), points.max(axis=0)
    half = np.array([-0.5, 0.5]) * max(1.04 * float((high - low).max()), LEAST)
    axes.set(xlim=0.5 * (low[0] + high[0]) + half, ylim=0.5 * (low[1] + high[1]) + half, aspect="equal")
    axes.set_axis_off()


def _drawings(leaf: Leaf) -> Mapping[str, Drawing]:
    """Value to drawing, of the first design that the parameter changes, if possible without breaking a rule."""
    values = leaf.space.options if isinstance(leaf.space, Choice) else leaf.space.range
    best: dict[str, Drawing] = {}
    for design in _designs(leaf.path.partition(".")[0]):
        drawn = {str(plain(value)): _drawn(with_value(SPACE, design, leaf.path, value)) for value in values}
        drawings = {value: drawing for value, (drawing, _) in drawn.items() if drawing}
        if _changed(drawings.values()):
            if all(worn for _, worn in drawn.values()):
                return drawings
            best = best or drawings
    return best


def _designs(section: str) -> Iterator[GarmentDesign]:
    """The designs that show a section; then each of them with one choice of the section changed."""
    uppers = [each.garment for each in Upper]
    worn = [(("bottom", "upper")[each in uppers], each.name) for each in GARMENTS if each.section == section]
    bases = [design_from_dict(base) for base in BASES.get(section, [{"meta": dict([kind])} for kind in worn])]
    yield from bases
    choices = [(leaf.path, leaf.space.options) for leaf in _leaves(section) if isinstance(leaf.space, Choice)]
    for base in bases:
        yield from (with_value(SPACE, base, path, option) for path, options in choices for option in options)


def _leaves(section: str) -> list[Leaf]:
    return [leaf for leaf in leaves(SPACE, added=True) if leaf.path.startswith(f"{section}.")]


@cache
def _drawn(design: GarmentDesign) -> tuple[Drawing, bool]:
    """The panels of a design, placed before and behind the neutral body, and whether it passes the rules."""
    try:
        garment = DrawnGarment.of(named_body("neutral")[1], design, name="garment")
    except GcdError:
        return {}, False
    drawing: Drawing = {}
    for piece in lay_out(garment.pattern).panels:
        panel, placement = piece.panel, piece.panel.placement
        count = len(panel.edges)
        inner, free = range(count, len(piece.seams)), [i for i in range(count) if piece.seams[i] is None]
        lines = [piece.outline, *(piece.edge_points(index) for index in (*inner, *free))]
        placed = [placement.apply(line) for line in lines]
        middle, (x, y, z) = lines[0].mean(axis=0), placed[0].mean(axis=0)
        is_edge_on = abs(placement.matrix[2, 2]) < 0.7  # turned towards the viewer, on both sides
        flat = [a - middle + (x, y) if is_edge_on else b[:, :2] for a, b in zip(lines, placed, strict=True)]
        own = flat[: 1 + len(inner)], flat[1 + len(inner) :]
        drawing |= {(side, panel.name): own for side in (True, False) if is_edge_on or side == (z >= 0)}
    return drawing, not check_design(garment)


def _changed(drawings: Iterable[Drawing]) -> set[tuple[bool, str]]:
    """The panels whose outlines, with the ends of edges on them, or lines inside differ between drawings."""
    outlines = [{panel: [line.round(1).tolist() for line in own] for panel, (own, _) in e.items()} for e in drawings]
    return {panel for each in outlines for panel in each if any(other.get(panel) != each[panel] for other in outlines)}
