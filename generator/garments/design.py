"""The design of a garment: all its parameters, in the order and under the names of GarmentCode's design files."""

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from itertools import islice
from pathlib import Path
from reprlib import repr as short
from typing import Any

import yaml

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import write_whole
from gcd_dataset.generator.garments.circle_skirt import CIRCLE_SKIRT, FlareSkirtDesign
from gcd_dataset.generator.garments.front import FrontDesign
from gcd_dataset.generator.garments.garment import Garment, one_of, section_of
from gcd_dataset.generator.garments.gathered_skirt import GATHERED_SKIRT, GatheredSkirtDesign
from gcd_dataset.generator.garments.godet_skirt import GODET_SKIRT, GodetSkirtDesign
from gcd_dataset.generator.garments.levels_skirt import LEVELS_SKIRT, LevelsSkirtDesign
from gcd_dataset.generator.garments.mends import Mend
from gcd_dataset.generator.garments.neckline import LeftNecklineDesign, NecklineDesign
from gcd_dataset.generator.garments.pants import PANTS, PantsDesign
from gcd_dataset.generator.garments.parameter import Choice, plain
from gcd_dataset.generator.garments.pencil_skirt import PENCIL_SKIRT, PencilSkirtDesign
from gcd_dataset.generator.garments.pocket import PocketDesign
from gcd_dataset.generator.garments.shirt import LeftShirtDesign, ShirtDesign, UpperHalf
from gcd_dataset.generator.garments.sleeve import LeftSleeveDesign, SleeveDesign
from gcd_dataset.generator.garments.space import (
    Design,
    DesignSpace,
    choice,
    flag,
    part,
    read_values,
    require_no_fault,
    to_dict,
    unknown_parameters,
    with_parts,
)
from gcd_dataset.generator.garments.trim import TrimDesign
from gcd_dataset.generator.garments.upper import STRAIGHT_SHIRT, Shirt
from gcd_dataset.generator.garments.waistband import Waistband, WaistbandDesign
from gcd_dataset.generator.garments.wardrobe import GARMENTS, Bottom, Upper
from gcd_dataset.jsonfile import read_toml
from gcd_dataset.records import Closure
from gcd_dataset.yamlfile import read_yaml


@dataclass(frozen=True)
class MetaDesign(Design):
    """The parts of the garment: upper, waistband, bottom."""

    upper: Upper | None = one_of(Upper, keep=0.3)
    """The garment from the shoulders down, or none."""
    wb: Waistband | None = choice(None, *Waistband, None, keep=0.5)
    """The waistband at the top of the bottom or at the hem of the upper, or none."""
    bottom: Bottom | None = one_of(Bottom, keep=0.3)
    """The trousers or skirt, or none."""


@dataclass(frozen=True)
class LeftDesign(Design):
    """The left half of the upper body, if it is not the mirror image of the right one."""

    enable_asym: bool = flag(False, keep=0.8)
    """Whether the left half is drawn from this section; such a shirt has no collar."""
    shirt: LeftShirtDesign = part(LeftShirtDesign)
    collar: LeftNecklineDesign = part(LeftNecklineDesign)
    sleeve: LeftSleeveDesign = part(LeftSleeveDesign)


@dataclass(frozen=True)
@with_parts({garment.section: garment.design for garment in GARMENTS})
class GarmentDesign(Design):
    """A design independent of the body: each parameter is a choice, a fraction of a measure, an angle, or a length.

    The fields are the sections of GarmentCode's designs, followed by the sections of garments that GarmentCode lacks.
    ``garment.section_design(design)`` is the section of a garment.
    """

    meta: MetaDesign = part(MetaDesign)
    waistband: WaistbandDesign = part(WaistbandDesign)
    shirt: ShirtDesign = section_of(STRAIGHT_SHIRT)
    collar: NecklineDesign = part(NecklineDesign)
    sleeve: SleeveDesign = part(SleeveDesign)
    left: LeftDesign = part(LeftDesign)
    skirt: GatheredSkirtDesign = section_of(GATHERED_SKIRT)
    flare_skirt: FlareSkirtDesign = section_of(CIRCLE_SKIRT)
    godet_skirt: GodetSkirtDesign = section_of(GODET_SKIRT)
    pencil_skirt: PencilSkirtDesign = section_of(PENCIL_SKIRT)
    levels_skirt: LevelsSkirtDesign = section_of(LEVELS_SKIRT)
    pants: PantsDesign = section_of(PANTS)
    front: FrontDesign = part(FrontDesign, added=True)
    pocket: PocketDesign = part(PocketDesign, added=True)
    trim: TrimDesign = part(TrimDesign, added=True)

    def sections_used(self) -> frozenset[str]:
        """The names of the fields that the garment is drawn from."""
        meta, used = self.meta, {"meta"}
        if meta.wb:
            used.add("waistband")
        if meta.upper:
            used.update(meta.upper.garment.sections_used(self))
        if meta.bottom:
            used.update(part.field for part in (meta.bottom.garment, *meta.bottom.garment.parts(self)))
        if self.pockets():
            used.add("pocket")
        if self.worn_trim() != TrimDesign():
            used.add("trim")
        return frozenset(used)

    def pocket_sides(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The sides with a chest pocket and with a back pocket; only straight shirts and trousers have them."""
        chest = self.pocket.sides(self.pocket.chest) if self.meta.upper is Upper.SHIRT else ()
        return chest, self.pocket.sides(self.pocket.back) if self.meta.bottom is Bottom.PANTS else ()

    def pockets(self) -> tuple[str, ...]:
        """The panels that have a pocket."""
        chest, back = self.pocket_sides()
        return (*(f"{side}_ftorso" for side in chest), *(f"pant_b_{side[0]}" for side in back))

    def worn_trim(self) -> TrimDesign:
        """The lines on the fronts of a shirt: tucks of a straight one, buttonholes of one with buttons; or defaults."""
        tucks = self.trim.tucks if self.meta.upper is Upper.SHIRT else None
        has_buttons = bool(self.halves()) and self.front.closure is Closure.BUTTONS
        buttonholes = self.trim.buttonholes if has_buttons else None
        return replace(self.trim, tucks=tucks, buttonholes=buttonholes) if tucks or buttonholes else TrimDesign()

    def mends(self) -> frozenset[Mend]:
        """The mends that may change the pattern of the garment."""
        own = {Mend.EXPORT_PIVOT} | ({Mend.WORN_LENGTH} if self.meta.wb and self.meta.bottom else set())
        worn: list[Garment[Any]] = [] if self.meta.upper is None else [self.meta.upper.garment]
        if self.meta.bottom is not None:
            worn += [self.meta.bottom.garment, *self.meta.bottom.garment.parts(self)]
        return frozenset(own.union(*(garment.mends for garment in worn)))

    def includes(self, name: str) -> bool:
        return name in self.sections_used()

    def halves(self) -> tuple[UpperHalf, ...]:
        """The designs of the two halves of a shirt, one design if they are alike; empty without a shirt."""
        if self.meta.upper is None or not isinstance(self.meta.upper.garment, Shirt):
            return ()
        left = self.left_half()
        return (self.right_half(),) if left is None else (self.right_half(), left)

    def opens_band(self) -> bool:
        """Whether the opening of a shirt goes through the waistband below it."""
        return bool(self.meta.wb and self.halves()) and self.front.closure is not Closure.SEWN

    def right_half(self) -> UpperHalf:
        """The design of the right half of the upper body; without a collar if the left half differs."""
        if not self.left.enable_asym:
            return self.shirt, self.collar, self.sleeve
        bare = replace(self.collar, component=replace(self.collar.component, style=None))
        return self.shirt, bare, self.sleeve

    def left_half(self) -> UpperHalf | None:
        """The design of the left half; ``None`` for the mirror image of the right one."""
        if not self.left.enable_asym:
            return None
        return self.left.shirt.beside(self.shirt), self.left.collar.beside(self.collar), self.left.sleeve


log = logging.getLogger(__name__)

DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
MOST_UNKNOWN = 100  # names that are looked at: aliases of YAML can stand for more than any memory holds
DEEPEST = 4  # points in the path of a parameter
LISTED = 12  # ignored parameters in a message


def read_design(path: Path | str) -> GarmentDesign:
    """The design in a YAML, JSON or TOML file: a tree as ``design_from_dict`` takes it. Raises ``ConfigError``."""
    is_toml = Path(path).suffix.lower() == ".toml"
    content = read_toml(path) if is_toml else read_yaml(path, "design file", error=ConfigError)  # reads JSON too
    sections = {entry.key for entry in DesignSpace.declared(GarmentDesign).entries}
    if not isinstance(content, Mapping) or content.keys().isdisjoint({"design", *sections}):
        if isinstance(content, Mapping) and "pattern" in content:
            raise ConfigError(
                f"{path}: a specification without its design: its panels fit one body and cannot be drawn for another: "
                "give the design_params.yaml that it was drawn from"
            )
        names = short(list(islice(content, 3)) if isinstance(content, Mapping) else content)
        raise ConfigError(f"{path}: holds {names}, no design: give GarmentCode's design_params.yaml, or ours")
    try:
        return _design(content, f"{path}: ")
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def design_from_dict(values: Mapping[str, Any]) -> GarmentDesign:
    """The design from nested plain values or from GarmentCode's tree, below ``design`` or not; others are defaults.

    Logs and ignores parameters of another version of GarmentCode (the tree states their range or type) that change
    nothing: false, zero, null, or of a section that the garment does not use. Raises ``ConfigError`` with the paths of
    all other unknown parameters and of all values outside their ranges.

    >>> design_from_dict({"meta": {"upper": None, "bottom": "SkirtCircle"}, "flare-skirt": {"suns": 1}}).meta.bottom
    <Bottom.CIRCLE: 'SkirtCircle'>
    """
    return _design(values, "")


def design_to_dict(design: GarmentDesign) -> dict[str, Any]:
    """The design as nested plain values, under GarmentCode's names."""
    return to_dict(design)


def write_design(design: GarmentDesign, path: Path | str) -> None:
    """Write the design as a ``design_params.yaml``, numbers at full precision. Raises ``OutputError``."""
    write_whole(path, yaml.dump({"design": design_tree(design)}, Dumper=DUMPER, sort_keys=False).encode())


def design_tree(design: GarmentDesign) -> dict[str, Any]:
    """The tree of parameters: each leaf has its value ``v``, its ``range``, ``type`` and ``default_prob``."""
    return _leaves(DesignSpace.declared(GarmentDesign), to_dict(design))


def _design(values: Mapping[str, Any], source: str) -> GarmentDesign:
    tree, space = values.get("design", values), DesignSpace.declared(GarmentDesign)
    if not isinstance(tree, Mapping):
        raise ConfigError(f"design is {short(tree)}, not a table of parameters")
    design, faults = read_values(space, tree)
    used = {entry.key for entry in space.entries if entry.name in design.sections_used()}
    refused, ignored = [], []
    unknown = list(islice(unknown_parameters(space, tree), MOST_UNKNOWN))
    for one in unknown:
        found = list(islice(_changes(one.path, one.node, used), MOST_UNKNOWN))
        if MOST_UNKNOWN in (len(unknown), len(found)) or any(changes for _, changes in found):
            refused.append(one.fault(space))
        else:
            ignored += [text for text, _ in found]
    require_no_fault([*refused, *faults])
    if ignored:
        more = f" and {len(ignored) - LISTED} more" if len(ignored) > LISTED else ""
        log.warning("%signored, as gcd_dataset lacks them: %s%s", source, ", ".join(ignored[:LISTED]), more)
    return design


def _changes(path: str, node: Any, used: set[str]) -> Iterator[tuple[str, bool]]:
    """The parameters below an unknown name, each with whether it may change the garment, or may be misspelt."""
    if isinstance(node, Mapping) and "v" not in node and node and path.count(".") < DEEPEST:
        for key, inner in node.items():
            yield from _changes(f"{path}.{key}", inner, used)
        return
    value = node.get("v") if isinstance(node, Mapping) else node
    is_foreign = isinstance(node, Mapping) and not node.keys().isdisjoint(("range", "type"))
    is_neutral = value is None or value == 0 or path.partition(".")[0] not in used
    yield f"{path[:60]} = {short(value)}", not (is_foreign and is_neutral)


def _leaves(space: DesignSpace[Any], values: Mapping[str, Any]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for entry in space.entries:
        if entry.key not in values:
            continue
        inner, value = entry.space, values[entry.key]
        if isinstance(inner, DesignSpace):
            tree[entry.key] = _leaves(inner, value)
        else:
            keep = {} if inner.keep is None else {"default_prob": inner.keep}
            tree[entry.key] = {"v": plain(inner.read(value)), "range": inner.range, "type": inner.kind} | keep
    return tree


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
