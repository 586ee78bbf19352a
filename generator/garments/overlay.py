"""Overlays: a data set's restrictions on its designs ("only hoodies", "no asymmetry"), as a narrower design space.

An overlay is a TOML file with the names of a design file. A value fixes a parameter; a table narrows its space:
``range`` (for a number) or ``options`` (for a choice; ``"none"`` stands for ``None``), and ``keep``, the probability of
the default::

    [meta]
    bottom = { options = ["Pants", "none"], keep = 0.2 }

    [collar.component]
    style = "Hood2Panels"

    [pants]
    length = { range = [0.7, 0.9] }

>>> from numpy.random import default_rng
>>> from gcd_dataset.generator.garments.space import draw
>>> hoodies = Overlay.from_dict({"collar": {"component": {"style": "Hood2Panels"}}})
>>> draw(hoodies.space, default_rng(0)).collar.component.style
<Collar.HOOD: 'Hood2Panels'>
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from gcd_dataset.errors import ConfigError, shown
from gcd_dataset.generator.garments.design import GarmentDesign, MetaDesign, choice_of, possible_kinds
from gcd_dataset.generator.garments.parameter import NONE, Choice, Space
from gcd_dataset.generator.garments.space import DesignSpace, Leaf, require_no_fault, unknown_parameters
from gcd_dataset.jsonfile import read_toml


@dataclass(frozen=True)
class Overlay:
    """The parameters with a space narrower than GarmentCode's. Make one with ``from_dict`` or ``read_overlay``."""

    changes: tuple[Leaf, ...] = ()
    """The changed parameters with their new spaces, in the order of a design file."""

    @cached_property
    def space(self) -> DesignSpace[GarmentDesign]:
        """The narrowed design space, for ``draw``; ``space.of(...)`` is one of its parts."""
        return DesignSpace.declared(GarmentDesign).changed(dict(self.changes))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """The overlay from nested plain values, as in TOML and JSON.

        Raises ``ConfigError`` with the path of an unknown parameter or of a value outside its space, and for an overlay
        that allows no garment.
        """
        declared = DesignSpace.declared(GarmentDesign)
        require_no_fault(one.fault(declared) for one in unknown_parameters(declared, values))
        overlay = cls(tuple(_changes(declared, values, "")))
        if not possible_kinds(overlay.space.of(MetaDesign)):
            raise ConfigError(_no_garment(overlay.space.of(MetaDesign)))
        return overlay

    def to_dict(self) -> dict[str, Any]:
        """Nested plain values for a manifest; ``from_dict`` reads them."""
        tree: dict[str, Any] = {}
        for path, space in self.changes:
            *parents, name = path.split(".")
            node = tree
            for key in parents:
                node = node.setdefault(key, {})
            values = [NONE if value is None else value for value in space.range]
            node[name] = {_range_key(space): values} | ({} if space.keep is None else {"keep": space.keep})
        return tree


NO_OVERLAY = Overlay()
"""No restriction: GarmentCode's whole design space."""


def read_overlay(path: Path | str) -> Overlay:
    """The overlay in a TOML file. Raises ``ConfigError`` with the file and the wrong line or parameter."""
    values = read_toml(path)
    try:
        return Overlay.from_dict(values)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def _no_garment(meta: DesignSpace[MetaDesign]) -> str:
    """The error message for a ``meta`` section that allows no garment."""
    if all(choice_of(meta, name).range == [None] for name in ("upper", "bottom")):
        return "meta.upper and meta.bottom are both none, so there is no garment: allow one of them"
    uppers = ", ".join(name for name in choice_of(meta, "upper").range if name is not None)
    return f"nothing can be sewn to meta.upper = {uppers}, so there is no garment: set meta.wb and meta.bottom to none"


def _changes(space: DesignSpace[Any], values: Mapping[str, Any], prefix: str) -> Iterator[Leaf]:
    for entry in space.entries:
        if entry.key not in values:
            continue
        path, given = prefix + entry.key, values[entry.key]
        if isinstance(entry.space, DesignSpace):
            yield from _changes(entry.space, given, f"{path}.")
            continue
        try:
            yield Leaf(path, _changed(entry.space, given))
        except ConfigError as error:
            raise ConfigError(f"{path} {error}") from error


def _changed(space: Space, given: Any) -> Space:
    """The space narrowed by an overlay's entry: a value or a table."""
    range_key = _range_key(space)
    if not isinstance(given, Mapping):
        return space.narrowed([given] if isinstance(space, Choice) else [given, given])
    if unknown := [key for key in given if key not in (range_key, "keep")]:
        raise ConfigError(f"takes no {shown(unknown[0])}: it is {space}, so give {range_key}, keep, or a value")
    if not given:
        raise ConfigError(f"is an empty table: give {range_key}, keep, or a value")
    if range_key in given:
        if not isinstance(given[range_key], list):
            raise ConfigError(
                f"has {range_key} = {given[range_key]!r}, not a list: write {range_key} = [{given[range_key]!r}]"
            )
        space = space.narrowed(given[range_key])
    if "keep" not in given:
        return space
    keep = given["keep"]
    if not isinstance(keep, int | float) or isinstance(keep, bool) or not 0 <= keep <= 1:
        raise ConfigError(f"has keep = {keep!r}, not a probability from 0 to 1")
    return space.with_keep(float(keep))


def _range_key(space: Space) -> str:
    """The key for a parameter's values in an overlay's table."""
    return "options" if isinstance(space, Choice) else "range"
