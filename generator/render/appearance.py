"""Records of materials: prints and weaves of the cloth, skin, underwear and hair."""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.records import Record

RGB = tuple[float, float, float]
"""sRGB, 0 to 1."""


class PrintKind(IntEnum):
    """The motif of a print; ``colours[0]`` is always the ground."""

    PLAIN = 0
    STRIPES = 1
    CHECKS = 2
    """Gingham: two sets of stripes, mixed where they cross."""
    TARTAN = 3
    DOTS = 4
    FLORAL = 5
    NOISE = 6
    """Marbled or camouflage blotches."""
    GRADIENT = 7
    """Dip dye: the garment's lowest ``period`` fades from ``colours[1]`` to ``colours[0]``."""
    IMAGE = 8
    """A tile that repeats."""
    PANELS = 9
    """A colour for each panel: the plain renderer's look."""


class WeaveKind(IntEnum):
    """Structure of the cloth, as it shows in close-ups and in highlights."""

    PLAIN = 0
    TWILL = 1
    """Diagonal ribs: denim, drill, gabardine."""
    SATIN = 2
    JERSEY = 3
    """Columns of knitted V."""
    RIB = 4
    CORDUROY = 5
    CREPE = 6
    FELT = 7
    """Fulled wool: no visible thread."""


@dataclass(frozen=True, eq=False)
class Print(Record):
    """A print, laid on each panel in cm with its second axis along the grain."""

    kind: PrintKind = PrintKind.PLAIN
    colours: tuple[RGB, RGB, RGB, RGB] = ((0.5, 0.5, 0.5),) * 4
    """Ground and up to three colours of the motif."""
    period: float = 4.0
    """Distance of two motifs [cm]; the length of a gradient; the width of an image tile."""
    fill: float = 0.5
    """Share of the period that a stripe, dot or flower fills."""
    angle: float = 0.0
    """Direction of the motif against the grain [rad]."""
    jitter: float = 0.0
    """Irregularity of the places of motifs, 0 to 1."""
    matched: bool = False
    """Whether all panels are cut at the same place of the motif; else each panel begins elsewhere."""
    seed: int = 0
    """Key of the motif's variations."""
    image: Float[np.ndarray, "h w 3"] | None = None
    """Linear colours of the tile, from its upper left corner."""


@dataclass(frozen=True)
class Weave:
    """Relief and gloss of the cloth."""

    kind: WeaveKind = WeaveKind.PLAIN
    pitch: float = 0.05
    """Distance of threads, ribs or wales [cm]."""
    depth: float = 0.3
    """Slope of the relief."""
    roughness: float = 0.8
    """GGX roughness of the highlight."""
    specular: float = 0.03
    """Reflectance at normal incidence."""
    sheen: float = 0.1
    """Brightness of the rim that fuzz gives."""
    mottle: float = 0.05
    """Variation of the colour, as yarns differ: slub, melange, washed-out denim."""
    wrinkles: float = 0.15
    """Slope of fine wrinkles that the mesh is too coarse for."""


@dataclass(frozen=True)
class Stitching:
    """Visible stitches beside seams and hems."""

    colour: RGB = (0.5, 0.5, 0.5)
    length: float = 0.3
    """Of one stitch [cm]."""
    seam: float = 0.0
    """Distance of the top stitch from a seam [cm]; 0: none."""
    hem: float = 2.0
    """Depth of the hem: distance of its stitch from the edge [cm]; 0: none."""


@dataclass(frozen=True, eq=False)
class ClothLook(Record):
    """The cloth of a garment or of a part of it."""

    print: Print = field(default_factory=Print)
    weave: Weave = field(default_factory=Weave)
    stitching: Stitching = field(default_factory=Stitching)
    wrong_side: float = 0.6
    """How much of the print shows on the wrong side, 0 to 1."""
    translucency: float = 0.0
    """Share of light that passes straight through, 0 to 1: voile has 0.5."""
    transmission: float = 0.05
    """Share of light that passes through scattered."""
    thickness: float = 0.1
    """Thickness of the cloth's edge at hems [cm]."""
    look: str = ""
    """Name of the kind of cloth, such as ``denim``."""


@dataclass(frozen=True)
class Skin:
    """Skin of the body."""

    colour: RGB = (0.84, 0.74, 0.59)
    tone: int = 5
    """Monk skin tone, 1 to 10; 0 for a colour off the scale."""
    gloss: float = 0.3


@dataclass(frozen=True)
class Underwear:
    """Plain underwear, as colour on the body: briefs, and a top where ``top`` is set."""

    colour: RGB = (0.75, 0.75, 0.75)
    top: bool = True


@dataclass(frozen=True)
class Hair:
    """Colour of the hair; its shape is ``Scene.hair``."""

    colour: RGB = (0.12, 0.08, 0.06)


@dataclass(frozen=True, eq=False)
class Appearance(Record):
    """All materials of a scene."""

    cloths: tuple[ClothLook, ...]
    cloth_of_panel: Int[np.ndarray, " p"]
    """Row of ``cloths`` for each panel."""
    skin: Skin = field(default_factory=Skin)
    underwear: Underwear | None = field(default_factory=Underwear)
    """``None``: bare skin."""
    hair: Hair = field(default_factory=Hair)
    eyes: RGB = (0.35, 0.25, 0.18)
    """Colour of the eyes."""


MONK_TONES: tuple[RGB, ...] = tuple(
    (((code >> 16) & 255) / 255, ((code >> 8) & 255) / 255, (code & 255) / 255)
    for code in (
        0xF6EDE4, 0xF3E7DB, 0xF7EAD0, 0xEADABA, 0xD7BD96, 0xA07E56, 0x825C43, 0x604134, 0x3A312A, 0x292420,
    )
)  # fmt: skip
"""The ten tones, sRGB. E. Monk, The Monk Skin Tone Scale, 2019, doi:10.31235/osf.io/pdf4c; skintone.google."""
