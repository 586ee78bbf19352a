"""Captions: a garment in plain English, at several levels of detail, from its design and its drawn pattern.

Facts come from the descriptions of garments (``garments.description``), beside the code that draws them, and from the
pattern: gathers, darts, symmetry. Numbers become words at thresholds that those files name. ``(seed, index)`` chooses
among the wordings of a fact.
"""

from collections.abc import Mapping

from gcd_dataset.captions import LEVELS
from gcd_dataset.generator.captions.facts import GarmentFacts, garment_facts
from gcd_dataset.generator.captions.sentences import Said, say
from gcd_dataset.generator.garments import GarmentDesign
from gcd_dataset.records import Measurements, Pattern
from gcd_dataset.seeding import Stage, rng

__all__ = ["LEVELS", "GarmentFacts", "Said", "captions", "garment_facts", "say"]


def captions(
    size: Measurements, design: GarmentDesign, pattern: Pattern, *, seed: int = 0, index: int = 0
) -> Mapping[str, str]:
    """Level to caption, for a design drawn as ``pattern`` for a wearer.

    ``short``: at most twelve words; ``medium``: one or two sentences; ``full``: usually three. A longer caption states
    all facts of a shorter one, and more. ``seed``, ``index``: of the sample; they choose among wordings.
    """
    said = say(garment_facts(size, design, pattern), rng(seed, index, Stage.CAPTION))
    return {level: entry.text for level, entry in said.items()}
