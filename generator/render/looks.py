"""Kinds of cloth as a shop would name them: weave, gloss, stitching, and the prints they are sold in."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from gcd_dataset.generator.render.appearance import PrintKind, Weave, WeaveKind

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
