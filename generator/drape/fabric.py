"""Mechanics of a fabric: density, tensile and bending stiffness, friction, thickness. SI units, but lengths in cm."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

from gcd_dataset.errors import ConfigError

GRAMS_PER_CM2 = 0.1  # one kg/m²
DYNES_PER_CM = 1e3  # one N/m
DYNE_CM = 1e7  # one N·m
POISSON = 1 / 3  # Poisson's ratio of every fabric: that of a triangular mesh of springs
STIFFEST = 500.0  # N·m/kg: tensile stiffness over density, see ``Fabric.softened``


class Tensile(NamedTuple):
    """Tensile stiffness along the warp, along the weft and at 45° to both: force per width at unit strain [N/m]."""

    warp: float
    weft: float
    bias: float


class Bending(NamedTuple):
    """Bending rigidity of a strip cut along the warp and of a strip cut along the weft [N·m].

    On a mesh of equilateral triangles with a side along the weft, a bias strip bends like a weft strip.
    """

    warp: float
    weft: float


@dataclass(frozen=True, slots=True)
class Fabric:
    """Mechanics of a fabric. The solver's options were tuned with the default fabric.

    Grain: the warp runs along the y axis of each panel's plane, the weft along its x axis. GarmentCode's specification
    does not state the grain; its programs draw every panel upright, as worn.

    The default's ratio of tensile stiffness to density is that of Korosteleva et al. (ECCV 2024), from the effective
    stiffness of their springs; woven cloth is ten to a hundred times as stiff, see ``softened``. The default's bending
    rigidity is three times that of their middle fabric.
    """

    density: float = 0.2
    """Mass per area [kg/m²]."""
    tensile: float | Tensile = 100.0
    """Tensile stiffness, one number for an isotropic fabric: force per width at unit strain [N/m]."""
    bending: float | Bending = 4.2e-5
    """Bending rigidity, one number for an isotropic fabric [N·m]."""
    friction: float = 0.5
    """Coulomb coefficient of cloth against the body."""
    layer_friction: float = 0.3
    """Coulomb coefficient of cloth against cloth."""
    thickness: float = 0.2
    """Thickness of the cloth [cm]; layers keep at least ``DrapeConfig.layer_gap`` apart."""
    source: str = ""
    """Publication that the figures are from."""

    def __post_init__(self) -> None:
        for name in ("density", "thickness", "tensile", "bending"):
            value = getattr(self, name)
            if not min(value if isinstance(value, tuple) else (value,)) > 0:
                raise ConfigError(f"fabric {name} is {value}: give a value above 0")
        for name in ("friction", "layer_friction"):
            if not getattr(self, name) >= 0:
                raise ConfigError(f"fabric {name} is {getattr(self, name)}: give 0 or more")
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
    def isotropic(self) -> bool:
        """Whether the tensile stiffness is the same in every direction."""
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
        """The fabric with limited tensile stiffness, which allows longer substeps.

        Tensile stiffness along warp, weft and bias is limited to ``limit`` times the density [N·m/kg]: at the limit a
        metre of hanging cloth stretches by 9.81 / limit. Values below the limit do not change: the bias of most woven
        cloth, and all stiffnesses of knitted cloth and of the default. Where a limited warp or weft makes the bias
        softer, the shear stiffness becomes larger. Bending, density, thickness and friction do not change, since they
        decide the folds.
        """
        ceiling = limit * self.density
        if max(self.pull) <= ceiling:
            return self
        if self.isotropic:
            return replace(self, tensile=ceiling)
        return replace(self, tensile=Tensile(*(min(stiffness, ceiling) for stiffness in self.pull)))


def bias_stiffness(warp: float, weft: float, shear: float) -> float:
    """Tensile stiffness of an orthotropic sheet at 45° to the threads [N/m], from warp, weft and shear stiffness.

    4 / E45 = 1 / E1 + 1 / E2 - 2 nu / sqrt(E1 E2) + 1 / G: the compliance of an orthotropic sheet turned by 45° (Kilby,
    Planar stress-strain relationships in woven fabrics, J. Textile Inst. 54, 1963), with sqrt(E1 E2) for E in nu / E.
    """
    return 4 / (1 / warp + 1 / weft - 2 * POISSON / math.sqrt(warp * weft) + 1 / shear)


def shear_stiffness(pull: Tensile) -> float:
    """Shear stiffness, force per width at unit shear [N/m]: the inverse of ``bias_stiffness``.

    Raises ``ConfigError`` for a bias stiffness that no orthotropic sheet with this warp and weft can have.

    >>> shear = shear_stiffness(Tensile(warp=100.0, weft=100.0, bias=100.0))
    >>> round(shear, 6) == round(100.0 / (2 * (1 + POISSON)), 6)  # isotropic
    True
    """
    warp, weft, bias = pull
    compliance = 4 / bias - 1 / warp - 1 / weft + 2 * POISSON / math.sqrt(warp * weft)
    if not compliance > 0:
        limit = 4 / (1 / warp + 1 / weft - 2 * POISSON / math.sqrt(warp * weft))
        raise ConfigError(
            f"fabric tensile on the bias is {bias} N/m: with {warp} along the warp and {weft} along the weft it must "
            f"be below {limit:.4g}"
        )
    return 1 / compliance
