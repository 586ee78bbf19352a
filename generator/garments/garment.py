"""Garment records: all facts about a garment for outfits, sampling, rules, mends and statistics.

Every upper and bottom has one record, at the end of the file that draws it; ``wardrobe.py`` lists them. A ring is an
interface that goes once round the body.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from gcd_dataset.generator.garments.description import Description, Setting
from gcd_dataset.generator.garments.mends import Mend
from gcd_dataset.generator.garments.space import Design, choice, part
from gcd_dataset.generator.pattern import Component
from gcd_dataset.records import Measurements, PanelRole

if TYPE_CHECKING:
    from gcd_dataset.generator.garments.design import GarmentDesign

D = TypeVar("D", bound=Design)


class Ring(NamedTuple):
    """A closed line of cloth round the body."""

    name: str
    cloth: float
    """Length of the ring [cm]."""
    body: float
    """Girth of the body inside the ring [cm]."""
    remedy: str
    """Advice for messages: the parameters that widen the ring."""

    @property
    def stretch(self) -> float:
        """Ratio of girth to length: the ring must stretch by this factor."""
        return self.body / self.cloth


@dataclass(frozen=True, kw_only=True)
class Garment(ABC, Generic[D]):
    """The facts common to all garments."""

    name: str
    """Name in design files; GarmentCode's name if GarmentCode has this garment."""
    section: str
    """Name in design files of the section of an outfit's design that the garment is drawn from."""
    design: type[D]
    """Design class of the section."""
    weight: int = 1
    """Sampling weight relative to the other garments; with 0, only overlays that name the garment sample it."""
    mends: frozenset[Mend] = frozenset()
    """Corrections of faults in GarmentCode's drawing of this garment."""

    @property
    def field(self) -> str:
        """The section's field in ``GarmentDesign``."""
        return self.section.replace("-", "_")

    def section_design(self, design: "GarmentDesign") -> D:
        """The garment's section of an outfit's design."""
        section: D = getattr(design, self.field)
        return section

    @abstractmethod
    def describe(self, setting: Setting, design: "GarmentDesign") -> Description:
        """The garment of an outfit's design in words, as drawn."""


class GarmentChoice(Enum):
    """Base of enums of garments. A member is declared by a record; its value is the record's name."""

    _value_: str
    garment: Garment[Any]

    def __new__(cls, garment: Garment[Any]) -> "GarmentChoice":
        member = object.__new__(cls)
        member._value_, member.garment = garment.name, garment
        return member


def one_of(kind: type[GarmentChoice], *, keep: float) -> Any:
    """A design parameter: one of the garments of an enum, each with the weight of its record, or ``None``."""
    return choice(None, *kind, None, keep=keep, weights=(*(member.garment.weight for member in kind), 1))


def section_of(garment: Garment[Any]) -> Any:
    """A part of a design: the section of a garment."""
    return part(garment.design, key=garment.section)


# -------------------------------------------------------------------------------------------------------------- uppers


@dataclass(frozen=True, kw_only=True)
class UpperGarment(Garment[D]):
    """A garment that hangs from the shoulders."""

    carries: bool = True
    """Whether a waistband or a bottom can be sewn to its hem."""
    at_waist: bool = False
    """Whether the garment always ends at the waist; the part sewn to its hem then begins at the waist."""

    @abstractmethod
    def draw(self, size: Measurements, design: "GarmentDesign", *, mends: frozenset[Mend]) -> Component:
        """The component for an outfit's design; offers the ring ``bottom`` if ``carries``."""

    @abstractmethod
    def length(self, size: Measurements, design: "GarmentDesign") -> float:
        """Length from the nape to the hem behind, for an outfit's design [cm]."""

    def sections_used(self, design: "GarmentDesign") -> tuple[str, ...]:
        """The fields of an outfit's design that the garment is drawn from."""
        return (self.field,)


@dataclass(frozen=True, kw_only=True)
class SimpleUpper(UpperGarment[D]):
    """An upper that is drawn from one section: any upper but a shirt."""

    cut: Callable[[Measurements, D], Component]
    """Draws the component from a design of the section."""
    length_of: Callable[[Measurements, D], float]
    """Returns the length from the nape to the hem behind [cm], from a design of the section."""
    description_of: Callable[[D], Description]
    """Returns the garment in words, from a design of the section."""

    def draw(self, size: Measurements, design: "GarmentDesign", *, mends: frozenset[Mend]) -> Component:
        return self.cut(size, self.section_design(design)).labelled(PanelRole.BODY)

    def length(self, size: Measurements, design: "GarmentDesign") -> float:
        return self.length_of(size, self.section_design(design))

    def describe(self, setting: Setting, design: "GarmentDesign") -> Description:
        return self.description_of(self.section_design(design))


# ------------------------------------------------------------------------------------------------------------- bottoms


@dataclass(frozen=True, slots=True)
class Cutting:
    """Rise and length of a bottom as drawn in an outfit; the values in its section may differ."""

    rise: float
    """Position of its top: 0 at the hips, 1 at the waist."""
    length: float
    """From the top to the hem [cm]."""
    mends: frozenset[Mend]
    suffix: str = ""
    """Suffix of its panels' names."""


@dataclass(frozen=True, kw_only=True)
class BottomGarment(Garment[D]):
    """A garment that hangs from the waist."""

    legs: bool = False
    """Whether it has two legs."""
    gather_parameter: str = ""
    """The parameter of its section that gathers its top; empty if the top is never gathered."""
    flared: bool = False
    """Whether it is heavy if long or wide, so that it needs a firm band."""
    fullness_parameter: str = ""
    """The parameter of its section for the width of a flared bottom; empty if the width is fixed."""
    cuffs: Callable[[Measurements, D, float], tuple[float, float]] | None = None
    """Girths of the band at the end of its legs and of the leg inside the band, for a rise [cm]; ``None``: no legs."""
    rings_of: Callable[[Measurements, D, float, float], Iterable[Ring]] = field(default=lambda size, design, *drawn: ())
    """The rings below the hips that may be narrower than the legs; empty for a wide skirt.

    For a rise, and a length from the top to the hem [cm].
    """
    always_sewable: Callable[[D], bool] = field(default=lambda design: False)
    """Whether a design needs no sewability check in sampling, since no cut can run into another edge."""
    remedies: tuple[str, ...] = ()
    """Parameters to draw again, in this order, if it cannot be sewn or a cuff is too tight: paths in its section.

    A path that ends in ``-`` (``+``) is drawn below (above) the value at fault.
    """
    widened_by: str = ""
    """The parameter of its section to raise if one of its rings is too tight; empty without one."""
    statistics_length_section: str = ""
    """The section whose ``length`` GarmentCodeData's published statistics report; empty for its own section."""

    @abstractmethod
    def draw(self, size: Measurements, design: "GarmentDesign", *, rise: float, mends: frozenset[Mend]) -> Component:
        """The component for an outfit's design, its top at ``rise``; offers the ring ``top``."""

    @abstractmethod
    def rise(self, design: "GarmentDesign") -> float:
        """Position of its top in an outfit's design: 0 at the hips, 1 at the waist."""

    @abstractmethod
    def length(self, size: Measurements, design: "GarmentDesign", rise: float) -> float:
        """Length from the top, at a rise, to the hem, for an outfit's design [cm]."""

    def drawn_length(self, size: Measurements, design: "GarmentDesign", rise: float) -> float:
        """``length`` as drawn [cm]: longer if a part of the garment has a least length."""
        return self.length(size, design, rise)

    def rings(self, size: Measurements, design: "GarmentDesign", rise: float) -> Iterable[Ring]:
        """The rings of the garment in an outfit's design, its top at ``rise``: see ``rings_of``."""
        return self.rings_of(size, self.section_design(design), rise, self.length(size, design, rise))

    def parts(self, design: "GarmentDesign") -> "tuple[BottomGarment[Any], ...]":
        """The parts of a combined bottom, from the top down; empty for a simple bottom."""
        return ()

    def top(self, design: "GarmentDesign") -> "BottomGarment[Any]":
        """The uppermost part of a combined bottom; a simple bottom itself."""
        return next(iter(self.parts(design)), self)

    def length_garment(self, design: "GarmentDesign") -> "BottomGarment[Any]":
        """The bottom with the ``length`` parameter: this bottom, or its uppermost part if the length is inherited."""
        return self


@dataclass(frozen=True, kw_only=True)
class SimpleBottom(BottomGarment[D]):
    """A bottom that is drawn from one section."""

    cut: Callable[[Measurements, D, Cutting], Component]
    """The component; it offers the ring ``top``, and ``bottom`` if levels may hang under it."""
    length_of: Callable[[Measurements, D, float], float]
    """Length from the top, at a rise, to the hem [cm]."""
    description_of: Callable[[Setting, D], Description]
    """The garment in words, as drawn."""
    without_slits: Callable[[D], D] = field(default=lambda design: design)
    """The design without slits and cuts, so that another part can be sewn to the hem."""
    ungathered: Callable[[D], D] = field(default=lambda design: design)
    """The design without gathers at the top."""
    hem_tilt: Callable[[D], float] = field(default=lambda design: 0.0)
    """Tilt of the hem [degrees]."""

    def draw(self, size: Measurements, design: "GarmentDesign", *, rise: float, mends: frozenset[Mend]) -> Component:
        section = self.section_design(design)
        return self.cut(size, section, Cutting(rise, self.length_of(size, section, rise), mends))

    def rise(self, design: "GarmentDesign") -> float:
        rise: float = self.section_design(design).rise  # type: ignore[attr-defined]
        return rise

    def length(self, size: Measurements, design: "GarmentDesign", rise: float) -> float:
        return self.length_of(size, self.section_design(design), rise)

    def describe(self, setting: Setting, design: "GarmentDesign") -> Description:
        return self.description_of(setting, self.section_design(design))


@dataclass(frozen=True, slots=True)
class DesignedBottom(Generic[D]):
    """A simple bottom with its design: a part of a combined bottom."""

    garment: SimpleBottom[D]
    design: D

    @property
    def rise(self) -> float:
        """Position of its top: 0 at the hips, 1 at the waist."""
        rise: float = self.design.rise  # type: ignore[attr-defined]
        return rise

    def length(self, size: Measurements, rise: float) -> float:
        """Length from the top, at a rise, to the hem [cm]."""
        return self.garment.length_of(size, self.design, rise)

    def cut(self, size: Measurements, cutting: Cutting) -> Component:
        """The component without slits and cuts."""
        return self.garment.cut(size, self.garment.without_slits(self.design), cutting)

    def describe(self, setting: Setting) -> Description:
        """The component of ``cut`` in words."""
        return self.garment.description_of(setting, self.garment.without_slits(self.design))

    def ungathered(self) -> "DesignedBottom[D]":
        """The part without gathers at its top."""
        return DesignedBottom(self.garment, self.garment.ungathered(self.design))

    def rings(self, size: Measurements, rise: float, length: float) -> Iterable[Ring]:
        """The rings of the component of ``cut``, with a length from the top to the hem [cm]."""
        return self.garment.rings_of(size, self.garment.without_slits(self.design), rise, length)

    @property
    def hem_tilt(self) -> float:
        """Tilt of its hem [degrees]."""
        return self.garment.hem_tilt(self.design)


@dataclass(frozen=True, kw_only=True)
class CombinedBottom(BottomGarment[D]):
    """A bottom made of simple bottoms, each with its own section."""

    parts_of: Callable[[D], tuple[SimpleBottom[Any], ...]]
    """Its parts, from its section, from the top down."""
    combine: Callable[[Measurements, D, tuple[DesignedBottom[Any], ...], float, frozenset[Mend]], Component]
    """The component, its top at a rise; it offers the ring ``top``."""
    rise_of: Callable[[D, tuple[DesignedBottom[Any], ...]], float]
    """Position of its top: 0 at the hips, 1 at the waist."""
    length_of: Callable[[Measurements, D, tuple[DesignedBottom[Any], ...], float], float]
    """Length from the top, at a rise, to the hem [cm]."""
    description_of: Callable[[Setting, D, tuple[DesignedBottom[Any], ...]], Description]
    """The garment in words, as drawn."""
    rings_of_parts: Callable[[Measurements, D, tuple[DesignedBottom[Any], ...], float], Iterable[Ring]]
    """In place of ``rings_of``: the rings below the hips that may be narrower than the legs, for a rise."""
    drawn_length_of: Callable[[Measurements, D, tuple[DesignedBottom[Any], ...], float], float] | None = None
    """``length_of`` as drawn, if a part has a least length [cm]."""
    inherits_length: bool = False
    """Whether its length is the ``length`` of its uppermost part."""

    def draw(self, size: Measurements, design: "GarmentDesign", *, rise: float, mends: frozenset[Mend]) -> Component:
        return self.combine(size, self.section_design(design), self._designed_parts(design), rise, mends)

    def rise(self, design: "GarmentDesign") -> float:
        return self.rise_of(self.section_design(design), self._designed_parts(design))

    def length(self, size: Measurements, design: "GarmentDesign", rise: float) -> float:
        return self.length_of(size, self.section_design(design), self._designed_parts(design), rise)

    def rings(self, size: Measurements, design: "GarmentDesign", rise: float) -> Iterable[Ring]:
        return self.rings_of_parts(size, self.section_design(design), self._designed_parts(design), rise)

    def drawn_length(self, size: Measurements, design: "GarmentDesign", rise: float) -> float:
        length_of = self.drawn_length_of or self.length_of
        return length_of(size, self.section_design(design), self._designed_parts(design), rise)

    def describe(self, setting: Setting, design: "GarmentDesign") -> Description:
        return self.description_of(setting, self.section_design(design), self._designed_parts(design))

    def parts(self, design: "GarmentDesign") -> tuple[SimpleBottom[Any], ...]:
        return self.parts_of(self.section_design(design))

    def length_garment(self, design: "GarmentDesign") -> BottomGarment[Any]:
        return self.top(design) if self.inherits_length else self

    def _designed_parts(self, design: "GarmentDesign") -> tuple[DesignedBottom[Any], ...]:
        return tuple(DesignedBottom(part, part.section_design(design)) for part in self.parts(design))
