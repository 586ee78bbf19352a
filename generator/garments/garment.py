"""Garments as records: all that outfits, chance, rules, mends and statistics know of each.

Every upper and bottom has one record, which stands at the end of the file that draws it; ``wardrobe.py`` lists them.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from gcd_dataset.generator.garments.mends import Mend
from gcd_dataset.generator.garments.space import Design, choice, part
from gcd_dataset.generator.pattern import Component
from gcd_dataset.records import Measurements, PanelRole

if TYPE_CHECKING:
    from gcd_dataset.generator.garments.design import OutfitDesign

__all__ = [
    "BottomGarment",
    "CombinedBottom",
    "Cutting",
    "DesignedBottom",
    "Garment",
    "GarmentChoice",
    "SimpleBottom",
    "SimpleUpper",
    "UpperGarment",
    "one_of",
    "section_of",
]

D = TypeVar("D", bound=Design)


@dataclass(frozen=True, kw_only=True)
class Garment(ABC, Generic[D]):
    """What is known of any garment."""

    name: str
    """In design files: GarmentCode's name, where GarmentCode has this garment."""
    section: str
    """The section of an outfit's design that the garment is drawn from, as design files call it."""
    design: type[D]
    """The kind of that section."""
    weight: int = 1
    """Chance of being drawn beside garments of weight 1; at 0, a garment is drawn only where an overlay names it."""
    mends: frozenset[Mend] = frozenset()
    """The faults of GarmentCode's drawing of this garment that ours mends."""

    @property
    def field(self) -> str:
        """The section as a field of ``OutfitDesign``."""
        return self.section.replace("-", "_")

    def section_design(self, design: "OutfitDesign") -> D:
        """The garment's section of an outfit's design."""
        section: D = getattr(design, self.field)
        return section


class GarmentChoice(Enum):
    """Garments to choose from. A member is declared by its record; its value is the record's name."""

    _value_: str
    garment: Garment[Any]

    def __new__(cls, garment: Garment[Any]) -> "GarmentChoice":
        member = object.__new__(cls)
        member._value_, member.garment = garment.name, garment
        return member


def one_of(kind: type[GarmentChoice], *, keep: float) -> Any:
    """A parameter of a design: one of the garments of a kind, each with the weight of its record, or none."""
    return choice(None, *kind, None, keep=keep, weights=(*(member.garment.weight for member in kind), 1))


def section_of(garment: Garment[Any]) -> Any:
    """A part of a design: the section that a garment is drawn from."""
    return part(garment.design, key=garment.section)


# -------------------------------------------------------------------------------------------------------------- uppers


@dataclass(frozen=True, kw_only=True)
class UpperGarment(Garment[D]):
    """A garment that hangs from the shoulders."""

    carries: bool = True
    """Whether a waistband or a bottom can be sewn to its hem."""
    at_waist: bool = False
    """Whether it always ends at the waist, so that what is sewn to it begins there."""

    @abstractmethod
    def draw(self, size: Measurements, design: "OutfitDesign", *, mends: frozenset[Mend]) -> Component:
        """The garment for an outfit's design; offers ``bottom`` [ring] if it carries anything."""

    @abstractmethod
    def length(self, size: Measurements, design: "OutfitDesign") -> float:
        """From the nape to the hem behind, for an outfit's design [cm]."""

    def sections_used(self, design: "OutfitDesign") -> tuple[str, ...]:
        """The sections of an outfit's design that the garment is drawn from, as fields."""
        return (self.field,)


@dataclass(frozen=True, kw_only=True)
class SimpleUpper(UpperGarment[D]):
    """An upper that is drawn from one section: anything but a shirt."""

    cut: Callable[[Measurements, D], Component]
    length_of: Callable[[Measurements, D], float]

    def draw(self, size: Measurements, design: "OutfitDesign", *, mends: frozenset[Mend]) -> Component:
        return self.cut(size, self.section_design(design)).labelled(PanelRole.BODY)

    def length(self, size: Measurements, design: "OutfitDesign") -> float:
        return self.length_of(size, self.section_design(design))


# ------------------------------------------------------------------------------------------------------------- bottoms


@dataclass(frozen=True, slots=True)
class Cutting:
    """How a bottom is cut to its place in an outfit."""

    rise: float
    """Where its top sits: 0 at the hips, 1 at the waist."""
    length: float
    """From the top to the hem [cm]."""
    mends: frozenset[Mend]
    suffix: str = ""
    """What the names of its panels end in."""


@dataclass(frozen=True, kw_only=True)
class BottomGarment(Garment[D]):
    """A garment that hangs from the waist."""

    legs: bool = False
    """Whether the legs go through it one by one."""
    gather_parameter: str = ""
    """The parameter of its section that gathers its top; empty where the top is never gathered."""
    flared: bool = False
    """Whether it is heavy where it is long or wide, so that a firm band must hold it."""
    fullness_parameter: str = ""
    """The parameter of its section that makes a flared one wide; empty where all are as wide."""
    cuffs: Callable[[Measurements, D, float], tuple[float, float]] | None = None
    """Girth of a band at the end of its legs and of the leg inside the band, for a rise [cm]; ``None``: has no legs."""
    always_sewable: Callable[[D], bool] = field(default=lambda design: False)
    """Whether nothing is cut into the panels of such a design that could run into anything else."""
    statistics_length_section: str = ""
    """The section whose ``length`` the statistics of GarmentCodeData's authors give; empty for its own."""

    @abstractmethod
    def draw(self, size: Measurements, design: "OutfitDesign", *, rise: float, mends: frozenset[Mend]) -> Component:
        """The garment for an outfit's design, its top at ``rise``; offers ``top`` [ring]."""

    @abstractmethod
    def rise(self, design: "OutfitDesign") -> float:
        """Where its top sits by an outfit's design: 0 at the hips, 1 at the waist."""

    @abstractmethod
    def length(self, size: Measurements, design: "OutfitDesign", rise: float) -> float:
        """From the top, at a rise, to the hem, for an outfit's design [cm]."""

    def parts(self, design: "OutfitDesign") -> "tuple[BottomGarment[Any], ...]":
        """The bottoms that it is made of in an outfit's design, from the top down; none where it is one piece."""
        return ()

    def top(self, design: "OutfitDesign") -> "BottomGarment[Any]":
        """The bottom whose top is that of the whole: itself, where it is one piece."""
        return next(iter(self.parts(design)), self)

    def length_garment(self, design: "OutfitDesign") -> "BottomGarment[Any]":
        """The bottom whose section holds the ``length`` of the whole: itself, unless it borrows that of a part."""
        return self


@dataclass(frozen=True, kw_only=True)
class SimpleBottom(BottomGarment[D]):
    """A bottom that is drawn from one section."""

    cut: Callable[[Measurements, D, Cutting], Component]
    """The component; it offers ``top``, and ``bottom`` if levels may hang under it [rings]."""
    length_of: Callable[[Measurements, D, float], float]
    """From the top, at a rise, to the hem [cm]."""
    without_slits: Callable[[D], D] = field(default=lambda design: design)
    """The design without slits and cuts, which would be in the way of what is sewn to the hem."""
    ungathered: Callable[[D], D] = field(default=lambda design: design)
    """The design without gathers at the top."""
    hem_tilt: Callable[[D], float] = field(default=lambda design: 0.0)
    """Of the hem [degrees]."""

    def draw(self, size: Measurements, design: "OutfitDesign", *, rise: float, mends: frozenset[Mend]) -> Component:
        own = self.section_design(design)
        return self.cut(size, own, Cutting(rise, self.length_of(size, own, rise), mends))

    def rise(self, design: "OutfitDesign") -> float:
        rise: float = self.section_design(design).rise  # type: ignore[attr-defined]
        return rise

    def length(self, size: Measurements, design: "OutfitDesign", rise: float) -> float:
        return self.length_of(size, self.section_design(design), rise)


@dataclass(frozen=True, slots=True)
class DesignedBottom(Generic[D]):
    """A simple bottom and the design it is to be drawn from, for a bottom made of several."""

    garment: SimpleBottom[D]
    design: D

    @property
    def rise(self) -> float:
        """Where its top sits by its own section."""
        rise: float = self.design.rise  # type: ignore[attr-defined]
        return rise

    def length(self, size: Measurements, rise: float) -> float:
        """By its own section [cm]."""
        return self.garment.length_of(size, self.design, rise)

    def cut(self, size: Measurements, cutting: Cutting) -> Component:
        """Without slits and cuts."""
        return self.garment.cut(size, self.garment.without_slits(self.design), cutting)

    def ungathered(self) -> "DesignedBottom[D]":
        """The same without gathers at its top."""
        return DesignedBottom(self.garment, self.garment.ungathered(self.design))

    @property
    def hem_tilt(self) -> float:
        """Of its hem [degrees]."""
        return self.garment.hem_tilt(self.design)


@dataclass(frozen=True, kw_only=True)
class CombinedBottom(BottomGarment[D]):
    """A bottom that is made of simple ones, which have sections of their own."""

    parts_of: Callable[[D], tuple[SimpleBottom[Any], ...]]
    """Its parts by its section, from the top down."""
    combine: Callable[[Measurements, D, tuple[DesignedBottom[Any], ...], float, frozenset[Mend]], Component]
    """The component, its top at a rise; it offers ``top`` [ring]."""
    rise_of: Callable[[D, tuple[DesignedBottom[Any], ...]], float]
    """Where its top sits: 0 at the hips, 1 at the waist."""
    length_of: Callable[[Measurements, D, tuple[DesignedBottom[Any], ...], float], float]
    """From the top, at a rise, to the hem [cm]."""
    inherits_length: bool = False
    """Whether it has no length of its own, but that of its first part."""

    def draw(self, size: Measurements, design: "OutfitDesign", *, rise: float, mends: frozenset[Mend]) -> Component:
        return self.combine(size, self.section_design(design), self._designed_parts(design), rise, mends)

    def rise(self, design: "OutfitDesign") -> float:
        return self.rise_of(self.section_design(design), self._designed_parts(design))

    def length(self, size: Measurements, design: "OutfitDesign", rise: float) -> float:
        return self.length_of(size, self.section_design(design), self._designed_parts(design), rise)

    def parts(self, design: "OutfitDesign") -> tuple[SimpleBottom[Any], ...]:
        return self.parts_of(self.section_design(design))

    def length_garment(self, design: "OutfitDesign") -> BottomGarment[Any]:
        return self.top(design) if self.inherits_length else self

    def _designed_parts(self, design: "OutfitDesign") -> tuple[DesignedBottom[Any], ...]:
        return tuple(DesignedBottom(part, part.section_design(design)) for part in self.parts(design))
