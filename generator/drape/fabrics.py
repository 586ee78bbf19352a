"""Fabrics by name, with the publications of their measurements.

Where a figure is not published for a cloth, ``source`` names the cloth, or class of cloth, that supplies it. All
fabrics have the reference drape's friction of 0.5 against skin: Temel et al. (Tribology Letters 70, 2022) measured 0.25
to 0.79 for one cotton at six sites of the body.
"""

from collections.abc import Mapping
from types import MappingProxyType

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape.fabric import Bending, Fabric, Tensile, bias_stiffness

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
            density=0.15,
            tensile=_measured(2030.0, 2020.0, 52.0),
            bending=1.65e-5,
            thickness=0.032,
            source="plain-woven cotton: bending rigidity set so that a virtual Cusick drapemeter of 1 cm spacing shows "
            "the drape coefficient of 68.4 % that Gan, Ly and Steven measured (J. Textile Inst. 82(1), 1991); density: "
            "assumed; tensile and shear stiffness: those of drill; thickness: " + PENAVA.format("cotton"),
        ),
        "denim": Fabric(
            density=0.324,
            tensile=_measured(1010.0, 205.0, 27.0),
            bending=Bending(2.4e-5, 1.6e-5),
            thickness=0.107,
            source=WANG.format(
                "11 oz black denim, 99 % cotton, 1 % spandex",
                "of the class: Kumari and Khurana, J. Textiles 2016, 4614168, Table 5, A, whose bending rigidity "
                "by KES, 0.172 gf cm²/cm = 1.7e-5 N·m, is alike",
            ),
        ),
        "drill": Fabric(
            density=0.220,
            tensile=_measured(2030.0, 2020.0, 52.0),
            bending=Bending(3.1e-5, 3.1e-5),
            thickness=0.032,
            source=WANG.format("royal target, 65 % cotton, 35 % polyester, for trousers", PENAVA.format("cotton")),
        ),
        "polyester_woven": Fabric(
            density=0.128,
            tensile=_measured(2030.0, 2000.0, 9.6),
            bending=Bending(7.8e-6, 1.3e-5),
            thickness=0.025,
            source=WANG.format("white dots on black, polyester, for table cloths", PENAVA.format("polyester")),
        ),
        "polyester_light": Fabric(
            density=0.113,
            tensile=_measured(171.0, 43.0, 7.2),
            bending=Bending(5.1e-6, 3.6e-6),
            thickness=0.025,
            source=WANG.format("tango red jet set, polyester, for jackets", PENAVA.format("polyester")),
        ),
        "interlock": Fabric(
            density=0.187,
            tensile=_measured(34.5, 16.6, 18.0),
            bending=Bending(3.6e-6, 5.8e-6),
            source=WANG.format("gray interlock knit, 60 % cotton, 40 % polyester, for T-shirts", UNKNOWN),
        ),
        "ponte_roma": Fabric(
            density=0.284,
            tensile=_measured(44.0, 31.0, 16.0),
            bending=Bending(9.3e-6, 9.1e-6),
            source=WANG.format("camel ponte roma knit, 60 % polyester, 40 % rayon, for jackets", UNKNOWN),
        ),
        "wool_light": Fabric(
            density=0.168,
            tensile=Tensile(2130.0, 1670.0, 104.0),
            bending=Bending(5.56e-6, 5.02e-6),
            thickness=0.057,
            source="plain-woven wool, FAST (CSIRO): bending length 15.0 and 14.5 mm, extension at 98.1 N/m 4.60 and "
            "5.87 %, on the bias at 4.9 N/m 4.7 % (laboratory report, bartleby.com, 2014); thickness: "
            + PENAVA.format("wool"),
        ),
    }
)
"""The built-in fabrics by name. A drape limits their tensile stiffness, see ``Fabric.softened``."""


def fabric_named(name: str) -> Fabric:
    """The built-in fabric called ``name``. Raises ``ConfigError``, which lists the names, for any other."""
    if name not in FABRICS:
        raise ConfigError(f"unknown fabric {name!r}: choose one of {', '.join(FABRICS)}")
    return FABRICS[name]
