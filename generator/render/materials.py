"""Drawn appearances: cloth by fabric, prints, thread, skin, underwear and hair."""

import colorsys
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render.appearance import (
    MONK_TONES,
    RGB,
    Appearance,
    ClothLook,
    Hair,
    Print,
    PrintKind,
    Skin,
    Stitching,
    Underwear,
    Weave,
    WeaveKind,
)
from gcd_dataset.generator.render.scene import Scene

P = PrintKind
WOVEN_PRINTS = (P.STRIPES, P.CHECKS, P.TARTAN, P.DOTS, P.FLORAL, P.NOISE, P.GRADIENT)
KNIT_PRINTS = (P.STRIPES, P.DOTS, P.FLORAL, P.NOISE, P.GRADIENT)


@dataclass(frozen=True)
class Look:
    """A kind of cloth. The figures are chosen by eye, in close-ups; no measured reflectance stands behind them."""

    weave: Weave
    prints: tuple[PrintKind, ...] = WOVEN_PRINTS
    printed: float = 1.0
    """Factor of the share of printed cloth."""
    thickness: tuple[float, float] = (0.04, 0.10)
    """[cm]"""
    translucency: tuple[float, float] = (0.0, 0.0)
    transmission: float = 0.06
    wrong_side: float = 0.5
    """How much of a print shows on the wrong side."""
    top_stitch: float = 0.15
    """Share of garments with top-stitched seams."""
    contrast: float = 0.1
    """Share of garments with thread of another colour."""
    blue: bool = False
    """Dyed with indigo, mostly."""


LOOKS: Mapping[str, Look] = MappingProxyType(
    {
        "poplin": Look(Weave(WeaveKind.PLAIN, 0.04, 0.2, 0.75, 0.035, 0.06, 0.02, 0.22), printed=1.2),
        "linen": Look(Weave(WeaveKind.PLAIN, 0.09, 0.4, 0.85, 0.03, 0.08, 0.12, 0.4), printed=0.6),
        "voile": Look(
            Weave(WeaveKind.PLAIN, 0.05, 0.2, 0.8, 0.03, 0.10, 0.03, 0.2),
            translucency=(0.25, 0.6),
            transmission=0.25,
            thickness=(0.02, 0.03),
            wrong_side=0.9,
        ),
        "denim": Look(
            Weave(WeaveKind.TWILL, 0.11, 0.5, 0.9, 0.025, 0.06, 0.22, 0.3),
            prints=(P.NOISE, P.GRADIENT),
            printed=0.2,
            thickness=(0.09, 0.13),
            wrong_side=0.15,
            transmission=0.0,
            top_stitch=0.9,
            contrast=0.7,
            blue=True,
        ),
        "drill": Look(
            Weave(WeaveKind.TWILL, 0.08, 0.35, 0.82, 0.03, 0.05, 0.05, 0.25),
            prints=(P.NOISE, P.CHECKS, P.STRIPES),
            printed=0.5,
            top_stitch=0.6,
            contrast=0.2,
            transmission=0.02,
        ),
        "gabardine": Look(
            Weave(WeaveKind.TWILL, 0.05, 0.2, 0.7, 0.04, 0.08, 0.02, 0.12),
            prints=(P.STRIPES, P.CHECKS, P.TARTAN),
            printed=0.6,
            transmission=0.02,
        ),
        "satin": Look(Weave(WeaveKind.SATIN, 0.03, 0.15, 0.38, 0.10, 0.10, 0.0, 0.12), printed=0.7, wrong_side=0.3),
        "crepe": Look(Weave(WeaveKind.CREPE, 0.06, 0.3, 0.8, 0.03, 0.12, 0.02, 0.12)),
        "jersey": Look(Weave(WeaveKind.JERSEY, 0.08, 0.35, 0.88, 0.025, 0.12, 0.05, 0.12), prints=KNIT_PRINTS),
        "melange": Look(
            Weave(WeaveKind.JERSEY, 0.08, 0.35, 0.9, 0.02, 0.14, 0.16, 0.12), prints=KNIT_PRINTS, printed=0.3
        ),
        "rib": Look(
            Weave(WeaveKind.RIB, 0.35, 0.5, 0.9, 0.02, 0.14, 0.05, 0.05),
            prints=(P.STRIPES,),
            printed=0.4,
            thickness=(0.1, 0.2),
        ),
        "ponte": Look(
            Weave(WeaveKind.JERSEY, 0.06, 0.2, 0.8, 0.03, 0.10, 0.02, 0.08),
            prints=(P.STRIPES, P.CHECKS, P.TARTAN, P.DOTS),
            printed=0.7,
            thickness=(0.08, 0.12),
        ),
        "flannel": Look(
            Weave(WeaveKind.FELT, 0.15, 0.25, 0.95, 0.015, 0.22, 0.12, 0.15),
            prints=(P.TARTAN, P.CHECKS, P.STRIPES),
            printed=1.4,
            thickness=(0.08, 0.15),
            transmission=0.02,
        ),
        "corduroy": Look(
            Weave(WeaveKind.CORDUROY, 0.30, 0.7, 0.92, 0.02, 0.30, 0.08, 0.12),
            prints=(),
            printed=0.0,
            thickness=(0.1, 0.2),
            transmission=0.0,
            top_stitch=0.5,
        ),
        "velvet": Look(
            Weave(WeaveKind.FELT, 0.05, 0.1, 0.9, 0.01, 0.55, 0.05, 0.12),
            prints=(P.FLORAL,),
            printed=0.2,
            thickness=(0.1, 0.2),
            transmission=0.0,
        ),
    }
)
"""Kinds of cloth by name."""

LOOKS_OF_FABRIC: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "cotton": ("poplin", "linen", "voile"),
        "denim": ("denim",),
        "drill": ("drill", "corduroy"),
        "polyester_woven": ("gabardine", "crepe", "poplin"),
        "polyester_light": ("satin", "voile", "crepe"),
        "interlock": ("jersey", "melange", "rib"),
        "ponte_roma": ("ponte",),
        "wool_light": ("flannel", "gabardine"),
        "gcd_soft": ("jersey", "satin", "voile", "crepe"),
        "gcd_medium": ("poplin", "linen", "drill", "flannel"),
        "gcd_stiff": ("denim", "drill", "corduroy", "gabardine"),
    }
)
"""Kinds of cloth that hang like a fabric of the drape; a fabric that is not listed may be any of them."""


def looks_of(fabric: str | None) -> tuple[str, ...]:
    """Names of the kinds of cloth that a fabric may be."""
    return LOOKS_OF_FABRIC.get(fabric or "", tuple(LOOKS))


NEUTRALS: tuple[RGB, ...] = (
    (0.95, 0.95, 0.94), (0.93, 0.91, 0.86), (0.86, 0.80, 0.70), (0.72, 0.66, 0.58), (0.62, 0.62, 0.63),
    (0.35, 0.35, 0.37), (0.16, 0.16, 0.18), (0.09, 0.09, 0.10), (0.13, 0.17, 0.28), (0.30, 0.25, 0.21),
)  # fmt: skip
HUED: tuple[RGB, ...] = (
    (0.70, 0.12, 0.15), (0.48, 0.10, 0.18), (0.85, 0.40, 0.33), (0.90, 0.62, 0.60), (0.93, 0.75, 0.74),
    (0.84, 0.50, 0.20), (0.80, 0.62, 0.22), (0.94, 0.83, 0.50), (0.45, 0.47, 0.26), (0.25, 0.36, 0.27),
    (0.55, 0.67, 0.58), (0.72, 0.82, 0.76), (0.12, 0.42, 0.44), (0.35, 0.58, 0.72), (0.66, 0.78, 0.88),
    (0.18, 0.30, 0.58), (0.30, 0.38, 0.68), (0.45, 0.32, 0.55), (0.74, 0.67, 0.82), (0.78, 0.30, 0.50),
)  # fmt: skip
INDIGOS: tuple[RGB, ...] = (
    (0.15, 0.20, 0.32), (0.22, 0.31, 0.46), (0.34, 0.45, 0.60), (0.55, 0.65, 0.76), (0.13, 0.13, 0.15),
)  # fmt: skip


def luminance(colour: RGB) -> float:
    """Relative luminance of an sRGB colour (IEC 61966-2-1, with a gamma of 2.2)."""
    red, green, blue = (channel**2.2 for channel in colour)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def nudged(rng: np.random.Generator, colour: RGB, amount: float = 0.04) -> RGB:
    """A colour near another: hue, saturation and value move."""
    hue, saturation, value = colorsys.rgb_to_hsv(*colour)
    turn, fade, lift = rng.normal(size=3).tolist()
    return colorsys.hsv_to_rgb(
        (hue + turn * (0.5 * amount)) % 1.0,
        min(max(saturation + fade * amount, 0.0), 1.0),
        min(max(value + lift * amount, 0.04), 0.97),
    )


def draw_cloth_colour(rng: np.random.Generator, *, blue: bool = False) -> RGB:
    """A colour for plain cloth: neutral in two of five garments; any saturated hue in one of seven."""
    choice, wild = rng.random(), (rng.random(), rng.uniform(0.2, 0.9), rng.uniform(0.15, 0.95))
    palette = NEUTRALS if choice < 0.4 else HUED
    if blue and choice < 0.85:
        palette = INDIGOS
    colour = palette[int(rng.integers(len(palette)))]
    if choice > 0.86 and not blue:
        return colorsys.hsv_to_rgb(*wild)
    return nudged(rng, colour)


def draw_print_colours(rng: np.random.Generator) -> tuple[RGB, RGB, RGB, RGB]:
    """A ground and three colours of a motif; the first stands out from the ground."""
    ground = draw_cloth_colour(rng)
    others = [draw_cloth_colour(rng) for _ in range(5)]
    first = max(others, key=lambda colour: _contrast(ground, colour))
    rest = [colour for colour in others if colour is not first]
    second, third = sorted(rest, key=lambda colour: -min(_contrast(ground, colour), _contrast(first, colour)))[:2]
    return ground, first, second, third


@dataclass(frozen=True)
class AppearanceRanges:
    """What appearances are drawn from; hold out prints or looks for a test by leaving them out."""

    prints: tuple[PrintKind, ...] = tuple(kind for kind in PrintKind if kind not in (PrintKind.IMAGE, PrintKind.PANELS))
    plain: float = 0.45
    """Share of garments without a print."""
    looks: tuple[str, ...] = ()
    """Kinds of cloth; empty: all, or those of the garment's fabric."""
    parts: float = 0.3
    """Share of garments with a second cloth for some of their parts."""
    tones: tuple[int, ...] = tuple(range(1, 11))
    """Monk skin tones."""
    tiles: tuple[Float[np.ndarray, "h w 3"], ...] = ()
    """Users' image tiles, linear colours."""
    images: float = 0.3
    """Share of garments with an image tile, if there are any."""


def draw_appearance(
    rng: np.random.Generator,
    scene: Scene,
    *,
    fabric: str | Sequence[str | None] | None = None,
    ranges: AppearanceRanges | None = None,
) -> Appearance:
    """Materials of a scene: cloth by the name of its fabric (any cloth without one), a print, skin and hair.

    The upper part and the bottom each have a cloth of their own; some have a second for their trim or sleeves.
    ``fabric``: of the garment, or of each panel of an outfit. Raises ``ConfigError`` for ranges that leave nothing to
    draw from.
    """
    ranges = ranges or AppearanceRanges()
    fabrics = [fabric] * len(scene.panel_names) if fabric is None or isinstance(fabric, str) else fabric
    _check(ranges)
    skin, hair, eyes, underwear = _draw_figure(rng, ranges)
    garment, part = parts_of(scene)
    cloths: list[ClothLook] = []
    cloth_of_panel = np.zeros(len(scene.panel_names), int)
    for number in range(int(garment.max(initial=-1)) + 1):
        own = garment == number
        names = ranges.looks or looks_of(fabrics[int(own.argmax())])
        cloth_of_panel[own] = len(cloths)
        cloths.append(_draw_cloth(rng, names, ranges))
        second, other = rng.random() < ranges.parts, _draw_cloth(rng, names, ranges)
        chosen = [(TRIM,), (SLEEVE,), (LOWER,), (TRIM, SLEEVE)][int(rng.integers(4))]
        of_part = own & np.isin(part, chosen)
        if second and of_part.any() and not of_part[own].all():
            cloth_of_panel[of_part] = len(cloths)
            cloths.append(other)
    return Appearance(tuple(cloths) or (ClothLook(),), cloth_of_panel, skin, underwear, hair, eyes)


def parts_of(scene: Scene) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Garment and part of each panel: panels that are sewn together are one garment, parts go by the panel's name."""
    panel_of_row = scene.panel_of_row
    some_panel = np.zeros(len(scene.vertices), np.int32)
    some_panel[scene.uv_vertex] = panel_of_row
    count = len(scene.panel_names)
    pairs = np.bincount(count * panel_of_row + some_panel[scene.uv_vertex], minlength=count * count)
    sewn = np.argwhere(pairs.reshape(count, count) > 0)
    garment = np.arange(count)
    for _ in range(count):
        before = garment.copy()
        for one, other in sewn.tolist():
            garment[one] = garment[other] = min(garment[one], garment[other])
        if (garment == before).all():
            break
    _, garment = np.unique(garment, return_inverse=True)
    parts = [next((part for part, words in NAMES_OF_PARTS if words.search(name)), UPPER) for name in scene.panel_names]
    return garment.reshape(-1), np.array(parts, int)


UPPER, SLEEVE, TRIM, LOWER = range(4)
NAMES_OF_PARTS = (
    (TRIM, re.compile(r"wb_|cuff|collar|hood|lapel|band|belt")),
    (SLEEVE, re.compile(r"sleeve|^sl_")),
    (LOWER, re.compile(r"skirt|pant|leg|godet|ins_")),
)
"""Panels of GarmentCode's programs and ours."""
HAIRS: tuple[RGB, ...] = (
    (0.07, 0.06, 0.06), (0.13, 0.09, 0.07), (0.22, 0.14, 0.09), (0.33, 0.21, 0.13), (0.50, 0.34, 0.20),
    (0.68, 0.53, 0.34), (0.45, 0.20, 0.10), (0.55, 0.54, 0.53), (0.80, 0.79, 0.77),
)  # fmt: skip
IRISES: tuple[RGB, ...] = ((0.20, 0.12, 0.07), (0.32, 0.20, 0.11), (0.35, 0.34, 0.20), (0.32, 0.45, 0.55))
PERIODS = {
    PrintKind.STRIPES: (0.8, 9.0),
    PrintKind.CHECKS: (0.8, 7.0),
    PrintKind.TARTAN: (5.0, 18.0),
    PrintKind.DOTS: (1.2, 8.0),
    PrintKind.FLORAL: (3.0, 14.0),
    PrintKind.NOISE: (5.0, 25.0),
    PrintKind.GRADIENT: (20.0, 70.0),
    PrintKind.IMAGE: (6.0, 40.0),
}
"""Ranges of ``Print.period`` [cm]."""
FILLS = {PrintKind.DOTS: (0.2, 0.65), PrintKind.FLORAL: (0.5, 0.95)}
"""Ranges of ``Print.fill``, where they are not those of stripes."""


def _check(ranges: AppearanceRanges) -> None:
    unknown = [name for name in ranges.looks if name not in LOOKS]
    if unknown:
        raise ConfigError(f"unknown looks {', '.join(unknown)}: choose from {', '.join(LOOKS)}")
    if not ranges.tones or not all(1 <= tone <= len(MONK_TONES) for tone in ranges.tones):
        raise ConfigError(f"skin tones {ranges.tones}: give some of 1 to {len(MONK_TONES)}")


def _draw_figure(rng: np.random.Generator, ranges: AppearanceRanges) -> tuple[Skin, Hair, RGB, Underwear]:
    tone = int(rng.choice(ranges.tones))
    skin = Skin(nudged(rng, MONK_TONES[tone - 1], 0.015), tone, float(rng.uniform(0.1, 0.7)))
    # Light hair and eyes are rare with dark skin.
    darkest = len(HAIRS) if tone <= 4 else 5
    hair = HAIRS[int(rng.integers(darkest))]
    eyes = IRISES[int(rng.integers(len(IRISES) if tone <= 5 else 2))]
    grey = float(rng.uniform(0.08, 0.9))
    if abs(grey**2.2 - luminance(skin.colour)) < 0.15:
        grey = 0.9 if luminance(skin.colour) < 0.4 else 0.15  # else the figure would look bare
    plain = nudged(rng, (grey, grey, grey), 0.05)
    return skin, Hair(nudged(rng, hair, 0.02)), eyes, Underwear(plain)


def _draw_cloth(rng: np.random.Generator, names: tuple[str, ...], ranges: AppearanceRanges) -> ClothLook:
    name = names[int(rng.integers(len(names)))]
    look = LOOKS[name]
    motif = _draw_print(rng, look, ranges)
    return ClothLook(
        print=motif,
        weave=look.weave,
        stitching=_draw_stitching(rng, look, motif),
        wrong_side=look.wrong_side,
        translucency=float(rng.uniform(*look.translucency)),
        transmission=look.transmission,
        thickness=float(rng.uniform(*look.thickness)),
        look=name,
    )


def _draw_print(rng: np.random.Generator, look: Look, ranges: AppearanceRanges) -> Print:
    kinds = [kind for kind in look.prints if kind in ranges.prints]
    printed = rng.random() < look.printed * (1.0 - ranges.plain) and bool(kinds)
    kind = kinds[int(rng.integers(len(kinds)))] if printed else PrintKind.PLAIN
    tiled, tile = rng.random() < ranges.images, int(rng.integers(1 << 30))
    image: Float[np.ndarray, "h w 3"] | None = None
    if ranges.tiles and tiled:
        kind, image = PrintKind.IMAGE, ranges.tiles[tile % len(ranges.tiles)]
    plain, colours = draw_cloth_colour(rng, blue=look.blue), draw_print_colours(rng)
    if kind is PrintKind.PLAIN:
        return Print(kind, (plain,) * 4)
    if look.blue:
        colours = (plain, nudged(rng, plain, 0.15), nudged(rng, plain, 0.15), colours[3])
    return Print(
        kind=kind,
        colours=colours,
        period=math.exp(rng.uniform(*np.log(PERIODS[kind]))),
        fill=0.5 if kind is PrintKind.CHECKS else float(rng.uniform(*FILLS.get(kind, (0.15, 0.6)))),
        angle=_angle(rng, kind),
        jitter=float(rng.random()) if rng.random() < 0.5 else 0.0,
        matched=bool(rng.random() < 0.3),
        seed=int(rng.integers(1 << 20)),
        image=image,
    )


def _angle(rng: np.random.Generator, kind: PrintKind) -> float:
    """Stripes run along, across or, seldom, on the bias; flowers any way; the rest with the grain."""
    straight, bias, any_way = (0.0, 0.5 * math.pi)[int(rng.integers(2))], rng.random() < 0.08, rng.uniform(0, math.tau)
    if kind in (PrintKind.STRIPES, PrintKind.CHECKS, PrintKind.TARTAN):
        return 0.25 * math.pi if bias else straight
    return float(any_way) if kind in (PrintKind.FLORAL, PrintKind.NOISE, PrintKind.DOTS) else 0.0


def _draw_stitching(rng: np.random.Generator, look: Look, motif: Print) -> Stitching:
    ground = motif.colours[0]
    contrast, top, other = rng.random() < look.contrast, rng.random() < look.top_stitch, draw_cloth_colour(rng)
    thread = (0.72, 0.45, 0.18) if look.blue else other
    if not contrast:
        step = 0.10 if luminance(ground) < 0.25 else -0.08
        thread = tuple(min(1.0, max(0.0, channel + step)) for channel in ground)  # type: ignore[assignment]
    return Stitching(
        colour=thread,
        length=float(rng.uniform(0.22, 0.4)),
        seam=float(rng.uniform(0.3, 0.8)) if top else 0.0,
        hem=float(rng.uniform(0.8, 3.0)),
    )


def _contrast(one: RGB, other: RGB) -> float:
    pair: Sequence[float] = sorted((luminance(one) + 0.05, luminance(other) + 0.05))
    return pair[1] / pair[0]
