"""Kinds of garments: upper, lower and full-body; and the kinds that a design space allows."""

from collections.abc import Mapping
from enum import Enum
from typing import Any

from gcd_dataset.generator.garments.design import MetaDesign
from gcd_dataset.generator.garments.parameter import Choice, plain
from gcd_dataset.generator.garments.space import DesignSpace
from gcd_dataset.generator.garments.wardrobe import Upper


class Kind(Enum):
    """Kind of a garment by the part of the body that it covers."""

    UPPER = "upper"
    LOWER = "lower"
    FULL = "full-body"


HAS_UPPER_AND_BOTTOM: Mapping[Kind, tuple[bool, bool]] = {
    Kind.UPPER: (True, False),
    Kind.LOWER: (False, True),
    Kind.FULL: (True, True),
}
"""Whether a garment of each kind has an upper, and whether it has a bottom."""


def kind_of(meta: MetaDesign) -> Kind:
    """The kind of a garment with an upper or a bottom."""
    parts = (meta.upper is not None, meta.bottom is not None)
    return next(kind for kind, has in HAS_UPPER_AND_BOTTOM.items() if has == parts)


def choice_of(space: DesignSpace[Any], name: str) -> Choice:
    """The space of the choice parameter with this name."""
    return next(entry.space for entry in space.entries if entry.name == name and isinstance(entry.space, Choice))


def possible_kinds(meta: DesignSpace[MetaDesign]) -> list[Kind]:
    """The kinds of garment that the ``meta`` section of a design space allows."""
    bottoms = choice_of(meta, "bottom").weighted_options
    return [
        kind
        for kind, (_, has_bottom) in HAS_UPPER_AND_BOTTOM.items()
        if _uppers(meta, kind) and any((bottom is not None) == has_bottom for bottom in bottoms)
    ]


def upper_choice(meta: DesignSpace[MetaDesign], kind: Kind) -> Choice:
    """The uppers of a kind of garment, without uppers that cannot carry its bottom or waistband."""
    space = choice_of(meta, "upper")
    return space.narrowed([plain(upper) for upper in _uppers(meta, kind)])


def _uppers(meta: DesignSpace[MetaDesign], kind: Kind) -> list[Upper | None]:
    has_upper, has_bottom = HAS_UPPER_AND_BOTTOM[kind]
    hangs_alone = not has_bottom and None in choice_of(meta, "wb").weighted_options
    return [
        upper
        for upper in choice_of(meta, "upper").weighted_options
        if (upper is not None) == has_upper and (upper is None or upper.garment.carries or hangs_alone)
    ]
