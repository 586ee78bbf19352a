"""A cloth's mechanics: what it weighs, and how it resists stretch, bend and rub. Everything in SI but lengths in cm."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

from gcd_dataset.errors import ConfigError

__all__ = ["POISSON", "STIFFEST", "Bending", "Fabric", "Tensile", "bias_stiffness", "shear_stiffness"]

GRAMS_PER_CM2 = 0.1  # one kg/m²
DYNES_PER_CM = 1e3  # one N/m
DYNE_CM = 1e7  # one N·m
POISSON = 1 / 3  # of every fabric, as of a triangular mesh of springs
STIFFEST = 500.0  # N·m/kg


class Tensile(NamedTuple):
    """Force per width at unit strain, pulled along the warp, along the weft and at 45° to both [N/m]."""

    warp: float
    weft: float
    bias: float


class Bending(NamedTuple):
    """Bending rigidity of a strip cut along the warp, and of one cut along the weft [N·m].

    On a mesh of equilateral triangles with a side along the weft a strip on the bias bends as one along the weft.
    """

    warp: float
    weft: float


@dataclass(frozen=True, slots=True)
class Fabric:
    """A cloth's mechanics. The default is the one that the solver's options were chosen with.

    The grain: the warp runs along the y axis of each panel's plane, the weft along its x axis. GarmentCode's
    specification has no word for the grain; its programs draw every panel as it is worn, so that y is the vertical.

    The default's tensile stiffness stands for the weight that it carries (Korosteleva et al., ECCV 2024: springs at
    their effective stiffness over the cloth's weight); woven cloth is ten to a hundred times as stiff: see
    ``softened``. Its bending rigidity is three times that of their middle fabric.
    """

    density: float = 0.2
    """Mass per area [kg/m²]."""
    tensile: float | Tensile = 100.0
    """Membrane stiffness, one number where it is alike in every direction: force per width at unit strain [N/m]."""
    bending: float | Bending = 4.2e-5
    """Bending rigidity, one number where it is alike in every direction [N·m]."""
    friction: float = 0.5
    """Coulomb coefficient against the body."""
    layer_friction: float = 0.3
    """The same of cloth against cloth."""
    thickness: float = 0.2
    """Of the cloth [cm]; layers keep at least ``DrapeConfig.layer_gap`` apart."""
    source: str = ""
    """Where the figures are published."""

    def __post_init__(self) -> None:
        for name in ("density", "thickness", "tensile", "bending"):
            value = getattr(self, name)
            if not min(value if isinstance(value, tuple) else (value,)) > 0:
                raise ConfigError(f"fabric {name} is {value}: it must be above 0")
        for name in ("friction", "layer_friction"):
            if not getattr(self, name) >= 0:
                raise ConfigError(f"fabric {name} is {getattr(self, name)}: it must be 0 or more")
        shear_stiffness(self.pull)

    @property
    def pull(self) -> Tensile:
        """Tensile stiffness in each direction [N/m]."""
        return self.tensile if isinstance(self.tensile, Tensile) else Tensile(*3 * (self.tensile,))

    @property
    def bend(self) -> Bending:
        """Bending rigidity in each direction [N·m]."""
        return self.bending if isinstance(self.bending, Bending) else Bending(*2 * (self.bending,))

    @property
    def alike(self) -> bool:
        """Whether it stretches the same in every direction."""
        return math.isclose(max(self.pull), min(self.pull), rel_tol=1e-9)

    @property
    def mass(self) -> float:
        """Mass per area [g/cm²]."""
        return self.density * GRAMS_PER_CM2

    @property
    def membrane(self) -> float:
        """Tensile stiffness along the warp [g/s²]."""
        return self.pull.warp * DYNES_PER_CM

    def softened(self, limit: float = STIFFEST) -> Self:
        """The fabric with threads that give: what a drape needs is kept, what would only shorten its steps is not.

        Tensile stiffness along warp and weft is held to ``limit`` times the density [N·m/kg], where a metre of hanging
        cloth stretches by 9.81 / limit, and the shear stiffness to that of a sheet alike in every direction at the same
        limit. What is softer stays as it is: the shear of most woven cloth, knitted cloth in every direction. Bending,
        weight, thickness and friction are not touched, for they decide the folds.
        """
        ceiling, shear = limit * self.density, shear_stiffness(self.pull)
        if max(self.pull) <= ceiling:
            return self
        if self.alike:
            return replace(self, tensile=ceiling)
        warp, weft = min(self.pull.warp, ceiling), min(self.pull.weft, ceiling)
        bias = bias_stiffness(warp, weft, min(shear, ceiling / (2 * (1 + POISSON))))
        return replace(self, tensile=Tensile(warp, weft, bias))


def bias_stiffness(warp: float, weft: float, shear: float) -> float:
    """Tensile stiffness at 45° to the threads, of a sheet with these along and across them and in shear [N/m].

    4 / E45 = 1 / E1 + 1 / E2 - 2 nu / sqrt(E1 E2) + 1 / G: the compliance of an orthotropic sheet turned by 45° (Kilby,
    Planar stress-strain relationships in woven fabrics, J. Textile Inst. 54, 1963), with the geometric mean for nu / E.
    """
    return 4 / (1 / warp + 1 / weft - 2 * POISSON / math.sqrt(warp * weft) + 1 / shear)


def shear_stiffness(pull: Tensile) -> float:
    """Shear stiffness: force per width at unit shear [N/m]; ``bias_stiffness`` solved for it.

    Raises ``ConfigError`` where no sheet is as stiff on the bias.
    """
    warp, weft, bias = pull
    give = 4 / bias - 1 / warp - 1 / weft + 2 * POISSON / math.sqrt(warp * weft)
    if not give > 0:
        most = 4 / (1 / warp + 1 / weft - 2 * POISSON / math.sqrt(warp * weft))
        raise ConfigError(
            f"fabric tensile on the bias is {bias} N/m: with {warp} along the warp and {weft} along the weft it must "
            f"be below {most:.4g}"
        )
    return 1 / give
