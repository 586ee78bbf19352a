"""Fabrics: the parameters of a cloth, the measured fabrics by name, and random fabrics between them.

Where a figure of a named cloth is not published for a cloth, ``source`` names the cloth, or class of cloth, that
supplies it. All fabrics have the reference drape's friction of 0.5 against skin: Temel et al. (Tribology Letters 70,
2022) measured 0.25 to 0.79 for one cotton at six sites of the body.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple, Self

import numpy as np

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


DEFAULT_FABRIC = "default"
# ``Fabric.source`` is stored in samples: rewording a source changes their bytes.
GARMENTCODE = (
    "GarmentCodeData (Korosteleva et al., ECCV 2024): the stiffness that its springs and hinges have in effect, over a "
    "weight of 0.2 kg/m²; hinge stiffness {}"
)
# Conversion of the figures of Wang et al. Warp: their v axis, along which their denim is stiffer. Tensile stiffness:
# their matrix at small strain without the cross term; shear stiffness is half of their c33, which multiplies the tensor
# shear strain. Bending rigidity, at small curvature: a mesh of hinges has a quarter of the hinge stiffness, which they
# fitted to strips.
WANG = (
    "Wang, O'Brien and Ramamoorthi, Data-driven elastic models for cloth, ACM Trans. Graph. 30(4), 2011: {}; "
    "thickness: {}"
)
PENAVA = "of the class: Penava et al., Fibres & Textiles in Eastern Europe 22(2), 2014, Table 1, {}"
UNKNOWN = f"not published; {Fabric().thickness} cm is assumed, the least distance of layers in a drape"


def _measured(warp: float, weft: float, shear: float) -> Tensile:
    """Tensile stiffness of a cloth from measured shear, where the bias was not measured [N/m]."""
    return Tensile(warp, weft, round(bias_stiffness(warp, weft, shear), 1))


FABRICS: Mapping[str, Fabric] = MappingProxyType(
    {
        DEFAULT_FABRIC: Fabric(),
        "gcd_soft": Fabric(bending=1.4e-7, source=GARMENTCODE.format("1, its default")),
        "gcd_medium": Fabric(bending=1.4e-5, source=GARMENTCODE.format("100, mid_bending")),
        "gcd_stiff": Fabric(bending=6.9e-5, source=GARMENTCODE.format("500, minimal_bending")),
        "cotton": Fabric(
            density=0.15, tensile=_measured(2030.0, 2020.0, 52.0), bending=1.65e-5, thickness=0.032,
            source="plain-woven cotton: bending rigidity set so that a virtual Cusick drapemeter of 1 cm spacing shows "
            "the drape coefficient of 68.4 % that Gan, Ly and Steven measured (J. Textile Inst. 82(1), 1991); density: "
            "assumed; tensile and shear stiffness: those of drill; thickness: " + PENAVA.format("cotton"),
        ),
        "denim": Fabric(
            density=0.324, tensile=_measured(1010.0, 205.0, 27.0), bending=Bending(2.4e-5, 1.6e-5), thickness=0.107,
            source=WANG.format(
                "11 oz black denim, 99 % cotton, 1 % spandex",
                "of the class: Kumari and Khurana, J. Textiles 2016, 4614168, Table 5, A, whose bending rigidity "
                "by KES, 0.172 gf cm²/cm = 1.7e-5 N·m, is alike",
            ),
        ),
        "drill": Fabric(
            density=0.220, tensile=_measured(2030.0, 2020.0, 52.0), bending=Bending(3.1e-5, 3.1e-5), thickness=0.032,
            source=WANG.format("royal target, 65 % cotton, 35 % polyester, for trousers", PENAVA.format("cotton")),
        ),
        "polyester_woven": Fabric(
            density=0.128, tensile=_measured(2030.0, 2000.0, 9.6), bending=Bending(7.8e-6, 1.3e-5), thickness=0.025,
            source=WANG.format("white dots on black, polyester, for table cloths", PENAVA.format("polyester")),
        ),
        "polyester_light": Fabric(
            density=0.113, tensile=_measured(171.0, 43.0, 7.2), bending=Bending(5.1e-6, 3.6e-6), thickness=0.025,
            source=WANG.format("tango red jet set, polyester, for jackets", PENAVA.format("polyester")),
        ),
        "interlock": Fabric(
            density=0.187, tensile=_measured(34.5, 16.6, 18.0), bending=Bending(3.6e-6, 5.8e-6),
            source=WANG.format("gray interlock knit, 60 % cotton, 40 % polyester, for T-shirts", UNKNOWN),
        ),
        "ponte_roma": Fabric(
            density=0.284, tensile=_measured(44.0, 31.0, 16.0), bending=Bending(9.3e-6, 9.1e-6),
            source=WANG.format("camel ponte roma knit, 60 % polyester, 40 % rayon, for jackets", UNKNOWN),
        ),
        "wool_light": Fabric(
            density=0.168, tensile=Tensile(2130.0, 1670.0, 104.0), bending=Bending(5.56e-6, 5.02e-6), thickness=0.057,
            source="plain-woven wool, FAST (CSIRO): bending length 15.0 and 14.5 mm, extension at 98.1 N/m 4.60 and "
            "5.87 %, on the bias at 4.9 N/m 4.7 % (laboratory report, bartleby.com, 2014); thickness: "
            + PENAVA.format("wool"),
        ),
    }
)  # fmt: skip
"""The built-in fabrics by name. A drape limits their tensile stiffness, see ``Fabric.softened``."""


def fabric_named(name: str) -> Fabric:
    """The built-in fabric called ``name``. Raises ``ConfigError``, which lists the names, for any other."""
    if name not in FABRICS:
        raise ConfigError(f"unknown fabric {name!r}: choose one of {', '.join(FABRICS)}")
    return FABRICS[name]


RANDOM_FABRIC = "random"
MEASURED = ("denim", "drill", "polyester_woven", "polyester_light", "interlock", "ponte_roma", "wool_light")
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
