"""The wardrobe: design parameters, random designs, and the patterns of designs.

A new garment, for example a skirt, takes one file and one line. ``gathered_skirt.py`` is a short example.

1. The file, in this folder, has three parts: a frozen ``Design`` (``space.py``), each field with default, range and
   docstring; a function of the wearer's measures [cm], that design and a ``Cutting``, which returns a ``Component`` of
   ``gcd_dataset.generator.pattern``; and a record, ``BottomGarment`` for a skirt (``garment.py``), with both and all
   facts for garments, sampling, rules and statistics: length, gathers, tags and words for captions, sampling weight, ….
2. The line is a member of ``Bottom`` in ``wardrobe.py``. It adds the section to the design, to design files
   and to overlays; sampling draws the garment by its weight (0: only if an overlay names it); the test battery draws it
   for all test wearers.

``capes.py`` has such uppers. Shirts are in ``upper.py``, waistbands in ``waistband.py``, the rules
that reject designs in ``rules.py``. A comment that ends in "GarmentCode" marks a value taken from GarmentCode.
"""

from gcd_dataset.generator.garments.assembly import draw_garment
from gcd_dataset.generator.garments.description import TAGS
from gcd_dataset.generator.garments.design import GarmentDesign, Kind, design_from_dict, design_to_dict, read_design
from gcd_dataset.generator.garments.drawn import garment_tags
from gcd_dataset.generator.garments.rules import DrawnGarment, Reject, check_design, try_on
from gcd_dataset.generator.garments.sampling import (
    attempted_design,
    drafted_design,
    sample_design,
    sample_draft,
    sample_kind,
)
from gcd_dataset.generator.garments.wearable import DrawnDesign, Redraw

__all__ = [
    "TAGS", "DrawnDesign", "DrawnGarment", "GarmentDesign", "Kind", "Redraw", "Reject", "attempted_design",
    "check_design", "design_from_dict", "design_to_dict", "drafted_design", "draw_garment", "garment_tags",
    "read_design", "sample_design", "sample_draft", "sample_kind", "try_on",
]  # fmt: skip

outfit_tags = garment_tags  # its earlier name, which programs of others use
