"""Garment records: all facts about an upper or a bottom for designs, sampling, rules, mends and statistics.

Every one has its record at the end of the file that draws it; ``wardrobe.py`` lists them. A ring is an
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
    """Name in design files of the section of a design that the garment is drawn from."""
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
        """The garment's section of a design."""
        section: D = getattr(design, self.field)
        return section

    @abstractmethod
    def describe(self, setting: Setting, design: "GarmentDesign") -> Description:
        """The garment of a design in words, as drawn."""


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


@dataclass(frozen=True, kw_only=True)
class UpperGarment(Garment[D]):
    """A garment that hangs from the shoulders."""

    carries: bool = True
    """Whether a waistband or a bottom can be sewn to its hem."""
    at_waist: bool = False
    """Whether the garment always ends at the waist; the part sewn to its hem then begins at the waist."""

    @abstractmethod
    def draw(self, size: Measurements, design: "GarmentDesign", *, mends: frozenset[Mend]) -> Component:
        """The component for a design; offers the ring ``bottom`` if ``carries``."""

    @abstractmethod
    def length(self, size: Measurements, design: "GarmentDesign") -> float:
        """Length from the nape to the hem behind, for a design [cm]."""

    def sections_used(self, design: "GarmentDesign") -> tuple[str, ...]:
        """The fields of a design that the garment is drawn from."""
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


@dataclass(frozen=True, slots=True)
class Cutting:
    """Rise and length of a bottom as drawn in a garment; the values in its section may differ."""

    rise: float
    """Position of its top: 0 at the hips, 1 at the waist."""
    length: float
    """From the top to the hem [cm]."""
    mends: frozenset[Mend]
    suffix: str = ""
    """Suffix of its panels' names."""


class DesignedBottom(NamedTuple):
    """A part of a combined bottom, with its section."""

    garment: "BottomGarment[Any]"
    design: Any

    @property
    def plain(self) -> Any:
        """The section without slits and cuts, so that another part can be sewn to the hem."""
        return self.garment.without_slits(self.design)


class Combined(NamedTuple, Generic[D]):
    """The section of a combined bottom, and its parts from the top down."""

    design: D
    parts: tuple[DesignedBottom, ...]


@dataclass(frozen=True, kw_only=True)
class BottomGarment(Garment[D]):
    """A garment that hangs from the waist.

    Its functions take its section of a design; those of a combined bottom, with ``parts_of``, take ``Combined``.
    """

    cut: Callable[[Measurements, Any, Cutting], Component]
    """The component; it offers the ring ``top``, and ``bottom`` if levels may hang under it."""
    length_of: Callable[[Measurements, Any, float], float]
    """Length from the top, at a rise, to the hem [cm]."""
    description_of: Callable[[Setting, Any], Description]
    """The garment in words, as drawn."""
    rise_of: Callable[[Any], float] = field(default=lambda design: float(design.rise))
    """Position of its top: 0 at the hips, 1 at the waist."""
    drawn_length_of: Callable[[Measurements, Any, float], float] | None = None
    """``length_of`` as drawn, if a part has a least length [cm]."""
    without_slits: Callable[[Any], Any] = field(default=lambda design: design)
    """The section without slits and cuts, so that another part can be sewn to the hem."""
    ungathered: Callable[[Any], Any] = field(default=lambda design: design)
    """The section without gathers at the top."""
    hem_tilt: Callable[[Any], float] = field(default=lambda design: 0.0)
    """Tilt of the hem [degrees]."""
    parts_of: Callable[[D], "tuple[BottomGarment[Any], ...]"] = field(default=lambda design: ())
    """The parts of a combined bottom, each with its own section, from the top down."""
    inherits_length: bool = False
    """Whether its length is the ``length`` of its uppermost part."""
    legs: bool = False
    """Whether it has two legs."""
    gather_parameter: str = ""
    """The parameter of its section that gathers its top; empty if the top is never gathered."""
    flared: bool = False
    """Whether it is heavy if long or wide, so that it needs a firm band."""
    elastic: bool = False
    """Whether its band has elastic for a wearer whose hips do not hold it, see ``waistband``."""
    fullness_parameter: str = ""
    """The parameter of its section for the width of a flared bottom; empty if the width is fixed."""
    cuffs: Callable[[Measurements, D, float], tuple[float, float]] | None = None
    """Girths of the band at the end of its legs and of the leg inside the band, for a rise [cm]; ``None``: no legs."""
    rings_of: Callable[[Measurements, Any, float, float, Measurements], Iterable[Ring]] = field(
        default=lambda *drawn: ()
    )
    """The rings below the hips that may be narrower than the legs; empty for a wide skirt.

    For a rise, a length from the top to the hem [cm], and a wearer, on whom the top hangs at the same rise.
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

    def drawn_from(self, design: "GarmentDesign") -> Any:
        """The argument of its functions, from a whole design."""
        section = self.section_design(design)
        parts = tuple(DesignedBottom(part, part.section_design(design)) for part in self.parts_of(section))
        return Combined(section, parts) if parts else section

    def draw(self, size: Measurements, design: "GarmentDesign", *, rise: float, mends: frozenset[Mend]) -> Component:
        """The component for a design, its top at ``rise``; offers the ring ``top``."""
        section = self.drawn_from(design)
        return self.cut(size, section, Cutting(rise, self.length_of(size, section, rise), mends))

    def rise(self, design: "GarmentDesign") -> float:
        """Position of its top in a design: 0 at the hips, 1 at the waist."""
        return self.rise_of(self.drawn_from(design))

    def length(self, size: Measurements, design: "GarmentDesign", rise: float) -> float:
        """Length from the top, at a rise, to the hem, for a design [cm]."""
        return self.length_of(size, self.drawn_from(design), rise)

    def drawn_length(self, size: Measurements, design: "GarmentDesign", rise: float) -> float:
        """``length`` as drawn [cm]: longer if a part of the garment has a least length."""
        return (self.drawn_length_of or self.length_of)(size, self.drawn_from(design), rise)

    def rings(
        self, size: Measurements, design: "GarmentDesign", rise: float, wearer: Measurements | None = None
    ) -> Iterable[Ring]:
        """The rings of the garment in a design, its top at ``rise``: see ``rings_of``; ``wearer``: default ``size``."""
        return self.rings_of(size, self.drawn_from(design), rise, self.length(size, design, rise), wearer or size)

    def describe(self, setting: Setting, design: "GarmentDesign") -> Description:
        return self.description_of(setting, self.drawn_from(design))

    def parts(self, design: "GarmentDesign") -> "tuple[BottomGarment[Any], ...]":
        """The parts of a combined bottom, from the top down; empty for a simple bottom."""
        return self.parts_of(self.section_design(design))

    def top(self, design: "GarmentDesign") -> "BottomGarment[Any]":
        """The uppermost part of a combined bottom; a simple bottom itself."""
        return next(iter(self.parts(design)), self)

    def length_garment(self, design: "GarmentDesign") -> "BottomGarment[Any]":
        """The bottom with the ``length`` parameter: this bottom, or its uppermost part if the length is inherited."""
        return self.top(design) if self.inherits_length else self
