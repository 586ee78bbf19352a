"""The wardrobe: what can be designed, what chance designs, and the patterns of designs.

A garment of your own, a skirt for instance, takes four steps. ``gathered_skirt.py`` is a short example of the first.

1. A file of its own in this folder. In it a frozen ``Design`` (``space.py``), whose fields hold default, range and
   docstring, and a function of the wearer's measures [cm] and the design that returns a ``Component`` of
   ``gcd_dataset.generator.pattern``: pieces, their seams, and an interface ``top`` to sew it to the rest by.
2. A name: a member of ``Bottom`` in ``design.py``, and its ``Design`` as a field of ``OutfitDesign`` there. Chance
   draws it from then on, ``[design.…]`` tables narrow it, and design files hold it.
3. A program in ``BOTTOMS`` of ``bottoms.py``: how it is drawn, where its top sits, how long it is.
4. A line in ``OUTFITS`` of ``tests/generator/garments/conftest.py``: the battery then draws it for all of its wearers,
   checks seams and outlines, and sends it through a specification file and back.

Parts of the upper body are listed in ``upper.py``, waistbands in ``waistband.py``, rules that turn designs down in
``rules.py``.
"""

from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.garments.kind import Kind
from gcd_dataset.generator.garments.outfit import outfit
from gcd_dataset.generator.garments.rules import Fitted, Reject, check_outfit, try_on
from gcd_dataset.generator.garments.sampling import design_from_dict, design_to_dict, sample_design, sample_kind

__all__ = [
    "Fitted",
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
