"""A fabric drawn at random between two measured fabrics."""

import math

import numpy as np

from gcd_dataset.generator.drape.fabric import Bending, Fabric, Tensile, bias_stiffness, shear_stiffness
from gcd_dataset.generator.drape.fabrics import FABRICS

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
"""Fabrics between which ``draw_fabric`` draws. Adding a fabric changes the samples of every seed."""


def draw_fabric(rng: np.random.Generator) -> Fabric:
    """A fabric between two of ``MEASURED``: all pairs are equally likely, and the fraction between the two is uniform.

    The logarithms of density, thickness, bending, tensile and shear stiffness are interpolated with the same fraction.
    So each quantity stays within the range of the measurements, and stiffnesses stay correlated, unlike with
    independent draws. Friction is the same as for all named fabrics. ``source`` names both fabrics and the fraction.

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
