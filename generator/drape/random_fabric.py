"""A fabric drawn at random between two measured fabrics."""

import math

import numpy as np

from gcd_dataset.generator.drape.fabric import Bending, Fabric, Tensile, bias_stiffness, shear_stiffness
from gcd_dataset.generator.drape.fabrics import FABRICS

__all__ = ["MEASURED", "RANDOM_FABRIC", "draw_fabric"]

RANDOM_FABRIC = "random"
MEASURED = (
    "denim",
    "drill",
    "polyester_woven",
    "polyester_light",
    "interlock",
    "ponte_roma",
    "wool_light",
)
"""Fabrics between which ``draw_fabric`` draws. Another fabric here would change the samples of every seed."""


def draw_fabric(rng: np.random.Generator) -> Fabric:
    """A fabric between two of ``MEASURED``: all pairs are equally likely, and the place between the two is uniform.

    Density, thickness, bending, tensile and shear stiffness are interpolated together, in logarithms: each stays within
    the range of the measurements, and stiff cloth stays stiff in all respects, which independent draws would not keep.
    Friction is that of all named fabrics. ``source`` names the two and the place.

    >>> fabric = draw_fabric(np.random.default_rng(0))
    >>> 0.113 <= fabric.density <= 0.324
    True
    """
    first, second = (MEASURED[k] for k in rng.choice(len(MEASURED), size=2, replace=False))
    place = float(rng.uniform())
    density, thickness, warp, weft, shear, *bending = (
        math.exp((1 - place) * math.log(a) + place * math.log(b))
        for a, b in zip(_figures(FABRICS[first]), _figures(FABRICS[second]), strict=True)
    )
    return Fabric(
        density=density,
        tensile=Tensile(warp, weft, bias_stiffness(warp, weft, shear)),
        bending=Bending(*bending),
        thickness=thickness,
        source=f"drawn: {place:.4f} of the way from {first} to {second}, in logarithms",
    )


def _figures(fabric: Fabric) -> tuple[float, ...]:
    pull = fabric.pull
    return fabric.density, fabric.thickness, pull.warp, pull.weft, shear_stiffness(pull), *fabric.bend
