"""The wardrobe: what can be designed, what chance designs, and the patterns of designs.

A garment of your own, a skirt for instance, is one file and one line. ``gathered_skirt.py`` is a short example.

1. The file, in this folder: a frozen ``Design`` (``space.py``), whose fields hold default, range and docstring; a
   function of the wearer's measures [cm], that design and the ``Cutting`` that returns a ``Component`` of
   ``gcd_dataset.generator.pattern``; and a record, ``SimpleBottom`` for a skirt (``garment.py``), that names both and
   says what outfits, chance, rules and statistics must know: length, gathers, weight in the draw, ….
2. The line: a member of ``Bottom`` in ``wardrobe.py``. Its section joins the design, design files and overlays; chance
   draws it by its weight (0: only where an overlay names it); the battery of tests draws it for all of its wearers.

``cape.py`` and ``poncho.py`` are uppers made in this way. Shirts are in ``upper.py``, waistbands in ``waistband.py``,
rules that turn designs down in ``rules.py``.
"""

from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.garments.kind import Kind
from gcd_dataset.generator.garments.outfit import outfit
from gcd_dataset.generator.garments.rules import DrawnOutfit, Reject, check_outfit, try_on
from gcd_dataset.generator.garments.sampling import design_from_dict, design_to_dict, sample_design, sample_kind

__all__ = [
    "DrawnOutfit",
    "Kind",
    "OutfitDesign",
    "Reject",
    "check_outfit",
    "design_from_dict",
    "design_to_dict",
    "outfit",
    "sample_design",
    "sample_kind",
    "try_on",
]
