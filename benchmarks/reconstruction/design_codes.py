"""Designs as rows of numbers: a number for each parameter of ``GarmentDesign``, and which of them have an effect."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.garments import GarmentDesign, design_from_dict
from gcd_dataset.generator.garments.parameter import Choice, Space, plain
from gcd_dataset.generator.garments.space import DesignSpace, Leaf, leaves
from gcd_dataset.generator.garments.wardrobe import GARMENTS

UNDER_COLLAR = {"Turtle": (False, False), "Hood2Panels": (False, False), "SimpleLapel": (True, False)}
"""Whether a collar leaves the neckline's shape in front and behind to the design; otherwise it is a circle."""
CUT = ("cut.add", "cut.depth", "cut.width", "cut.place")
SLITS = ("front_slit", "back_slit", "left_slit", "right_slit", "bottom_cut")
"""Parameters of a skirt without a second skirt below it and without godets."""
BENT = ("CurvyNeckHalf", "CircleArcNeckHalf", "Bezier2NeckHalf")
"""Necklines that may bulge either way."""
OWN = {
    "SkirtCircle": ("flare-skirt", ("suns", *CUT)),
    "AsymmSkirtCircle": ("flare-skirt", ("asymm.front_length", *CUT)),
    "SkirtManyPanels": (
        "flare-skirt", ("suns", "skirt-many-panels.n_panels", "skirt-many-panels.panel_curve"),
    ),
    "Skirt2": ("skirt", ("ruffle", "bottom_cut", "flare")),
    "PencilSkirt": (
        "pencil-skirt",
        ("flare", "low_angle", "front_slit", "back_slit", "left_slit", "right_slit", "style_side_cut"),
    ),
}  # fmt: skip
"""Section and parameters of skirts, without length and rise."""

KNOWN = {"front", "cape", "poncho"}
"""Sections drawn on request alone that have rows: the kept weights were trained with them."""


def _on_request() -> Iterator[str]:
    """Sections that random designs leave at their defaults unless an overlay names them."""
    yield from (garment.section for garment in GARMENTS if not garment.weight)
    for entry in DesignSpace.declared(GarmentDesign).entries:
        first = entry.space.entries[0].space if isinstance(entry.space, DesignSpace) else None
        if isinstance(first, Choice) and len(first.range) == 1:
            yield entry.key


ON_REQUEST = frozenset(_on_request()) - KNOWN
PARAMETERS: tuple[Leaf, ...] = tuple(
    leaf for leaf in leaves(GarmentDesign, added=True) if leaf.path.partition(".")[0] not in ON_REQUEST
)
"""The parameters of random designs and of the ``KNOWN`` sections, in the order of a row."""
UNLEARNED = np.array([leaf.path.partition(".")[0] in KNOWN for leaf in PARAMETERS])
"""Parameters that no random design changes: what a network says of them is arbitrary."""


def encode_design(values: Mapping[str, Any]) -> Float[np.ndarray, " d"]:
    """The row of a design in plain values (``design_to_dict``): numbers as they are, choices by the row of the option.

    NaN stands for a parameter that is missing or outside its range, such as one of another version, and for a garment
    ``ON_REQUEST``.
    """
    return np.array([_code(leaf.space, _at(values, leaf.path)) for leaf in PARAMETERS], np.float32)


def decode_design(row: Float[np.ndarray, " d"]) -> GarmentDesign:
    """The design of a row; numbers are moved into their ranges, NaN becomes the default."""
    tree: dict[str, Any] = {}
    for leaf, code in zip(PARAMETERS, row.tolist(), strict=True):
        if np.isnan(code):
            continue
        *parents, name = leaf.path.split(".")
        node = tree
        for key in parents:
            node = node.setdefault(key, {})
        node[name] = _value(leaf.space, code)
    return design_from_dict(tree)


def _at(values: Mapping[str, Any], path: str) -> Any:
    node: Any = values
    for key in path.split("."):
        if not isinstance(node, Mapping) or key not in node:
            return _MISSING
        node = node[key]
    return node.get("v", node) if isinstance(node, Mapping) else node  # published designs have entries with ranges


_MISSING = object()


def _code(space: Space, value: Any) -> float:
    if value is _MISSING:
        return np.nan
    try:
        read = space.read(value)
    except ConfigError:
        return np.nan
    if not isinstance(space, Choice):
        return float(read)
    options = options_of(space)
    return float(options.index(plain(read))) if plain(read) in options else np.nan


def options_of(space: Choice) -> list[Any]:
    """The plain values of the options, each once; without garments ``ON_REQUEST``."""
    garments = ((option, getattr(option, "garment", None)) for option in space.options)
    return list(dict.fromkeys(plain(o) for o, garment in garments if not garment or garment.section not in ON_REQUEST))


def _value(space: Space, code: float) -> Any:
    if isinstance(space, Choice):
        options = options_of(space)
        return options[int(np.clip(round(code), 0, len(options) - 1))]
    low, high = space.range
    return type(low)(np.clip(round(code) if space.kind == "int" else code, low, high))


# ---------------------------------------------------------------------------------------------------------- the effects


def have_effect(design: GarmentDesign) -> Bool[np.ndarray, " d"]:
    """Mask of the parameters that change the pattern of a design; the others can take any value."""
    found = set(_effective(design))
    return np.array([leaf.path in found for leaf in PARAMETERS])


def _effective(design: GarmentDesign) -> Iterator[str]:
    meta = design.meta
    yield from ("meta.upper", "meta.wb", "meta.bottom")
    if meta.wb is not None:
        yield from ("waistband.waist", "waistband.width")
    if design.halves():
        yield from _of_shirt(design)
    elif meta.upper is not None:
        section = meta.upper.garment.section
        yield from (leaf.path for leaf in PARAMETERS if leaf.path.startswith(f"{section}."))
    if meta.bottom is not None:
        yield from _of_bottom(design)


def _of_shirt(design: GarmentDesign) -> Iterator[str]:
    fitted = getattr(design.meta.upper.garment, "fitted") if design.meta.upper else False  # noqa: B009
    yield "left.enable_asym"
    yield from () if fitted else ("shirt.length",)
    for prefix, (shirt, neck, arm) in zip(("", "left."), design.halves(), strict=False):
        if fitted:
            yield f"{prefix}shirt.strapless"
        else:
            yield from (f"{prefix}shirt.width", f"{prefix}shirt.flare")
        yield from ("collar.fc_depth", "collar.bc_depth", f"{prefix}sleeve.connecting_width")
        if fitted and shirt.strapless:
            continue
        yield f"{prefix}collar.width"
        style = plain(neck.component.style)
        if not design.left.enable_asym:
            yield from _of_collar(style)
        own = UNDER_COLLAR.get(style, (True, True))
        for side, shape, is_own in zip("fb", (neck.f_collar, neck.b_collar), own, strict=True):
            yield from _of_neckline(f"{prefix}collar", side, plain(shape), style) if is_own else ()
        yield from _of_sleeve(f"{prefix}sleeve", arm)


def _of_collar(style: str | None) -> Iterator[str]:
    yield "collar.component.style"
    if style in ("Turtle", "SimpleLapel"):
        yield "collar.component.depth"
    if style == "SimpleLapel":
        yield "collar.component.lapel_standing"
    if style == "Hood2Panels":
        yield from ("collar.component.hood_depth", "collar.component.hood_length")


def _of_neckline(section: str, side: str, shape: str, style: str | None) -> Iterator[str]:
    """``side``: ``f`` for the front, ``b`` for the back."""
    yield f"{section}.{side}_collar"
    if shape in ("TrapezoidNeckHalf", "CircleArcNeckHalf"):
        yield f"{section}.{side}c_angle"
    if shape == "Bezier2NeckHalf" and not (side == "f" and style == "SimpleLapel"):
        yield from (f"{section}.{side}_bezier_x", f"{section}.{side}_bezier_y")
    if shape in BENT:
        yield f"{section}.{side}_flip_curve"


def _of_sleeve(section: str, arm: Any) -> Iterator[str]:
    yield from (f"{section}.sleeveless", f"{section}.armhole_shape")
    if plain(arm.armhole_shape) != "ArmholeCurve":
        yield f"{section}.smoothing_coeff"
    if arm.sleeveless:
        return
    names = ("length", "end_width", "sleeve_angle", "opening_dir_mix", "standing_shoulder", "connect_ruffle")
    yield from (f"{section}.{name}" for name in names)
    if arm.standing_shoulder:
        yield f"{section}.standing_shoulder_len"
    yield from _of_cuff(f"{section}.cuff", plain(arm.cuff.type))


def _of_cuff(section: str, kind: str | None) -> Iterator[str]:
    yield f"{section}.type"
    if kind is not None:
        yield from (f"{section}.top_ruffle", f"{section}.cuff_len")
    if kind == "CuffBandSkirt":
        yield f"{section}.skirt_fraction"
    if kind in ("CuffSkirt", "CuffBandSkirt"):
        yield from (f"{section}.skirt_flare", f"{section}.skirt_ruffle")


def _of_bottom(design: GarmentDesign) -> Iterator[str]:
    bottom = plain(design.meta.bottom)
    free = design.meta.upper is None or not design.meta.upper.garment.at_waist  # otherwise it begins at the waist
    if bottom == "Pants":
        yield from ("pants.length", "pants.width", "pants.flare", *(["pants.rise"] if free else []))
        yield from _of_cuff("pants.cuff", plain(design.pants.cuff.type))
    elif bottom == "GodetSkirt":
        yield from (leaf.path for leaf in PARAMETERS if leaf.path.startswith("godet-skirt."))
        yield from _of_skirt(design, plain(design.godet_skirt.base), length=True, rise=free, slits=False)
    elif bottom == "SkirtLevels":
        names = (leaf.path for leaf in PARAMETERS if leaf.path.startswith("levels-skirt."))
        yield from (name for name in names if free or name != "levels-skirt.rise")
        base, level = (plain(part) for part in (design.levels_skirt.base, design.levels_skirt.level))
        yield from _of_skirt(design, base, slits=False)
        yield from _of_skirt(design, level, slits=False, gathers=False)
    else:
        yield from _of_skirt(design, bottom, length=True, rise=free)


def _of_skirt(
    design: GarmentDesign,
    kind: str,
    *,
    length: bool = False,
    rise: bool = False,
    slits: bool = True,
    gathers: bool = True,
) -> Iterator[str]:
    """``slits``: whether it may have slits and cuts; ``gathers``: whether its own parameter gathers it."""
    section, names = OWN[kind]
    hidden: set[str] = set() if slits else {*SLITS, *CUT}
    hidden |= set() if design.flare_skirt.cut.add else set(CUT[1:])
    hidden |= set() if gathers else {"ruffle"}
    yield from (f"{section}.{name}" for name in names if name not in hidden)
    yield from [f"{section}.length"] if length else []
    yield from [f"{section}.rise"] if rise else []
