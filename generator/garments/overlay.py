"""Overlays: what a data set asks of its designs ("only hoodies", "no asymmetry"), as a narrower design space.

An overlay is a TOML file under the names of a design file. A value fixes a parameter; a table narrows what may be
drawn: ``range`` (of a number) or ``options`` (of a choice; ``"none"`` for none of them), and ``keep``, the probability
of the default::

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
from gcd_dataset.generator.garments.design import MetaDesign, OutfitDesign
from gcd_dataset.generator.garments.kind import choice_of, possible_kinds
from gcd_dataset.generator.garments.parameter import Choice, Space
from gcd_dataset.generator.garments.space import DesignSpace, Leaf, require_known
from gcd_dataset.tomlfile import read_toml

__all__ = ["NO_OVERLAY", "Overlay", "read_overlay"]

NONE = "none"  # TOML has no null


@dataclass(frozen=True)
class Overlay:
    """What is narrower than GarmentCode's design space; made by ``from_dict`` or ``read_overlay``, which check it."""

    changes: tuple[Leaf, ...] = ()
    """The parameters it speaks of, as it leaves them, in the order of a design file."""

    @cached_property
    def space(self) -> DesignSpace[OutfitDesign]:
        """The design space that is left: what ``draw`` draws from, whole or by its parts (``space.of(...)``)."""
        return DesignSpace.declared(OutfitDesign).changed(dict(self.changes))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """The overlay of nested plain values, as TOML and JSON hold them.

        Raises ``ConfigError`` with the path of a name that no parameter has, or of what it could not be before, and
        where no garment is left.
        """
        declared = DesignSpace.declared(OutfitDesign)
        require_known(declared, values)
        overlay = cls(tuple(_changes(declared, values, "")))
        if not possible_kinds(overlay.space.of(MetaDesign)):
            raise ConfigError(_no_garment(overlay.space.of(MetaDesign)))
        return overlay

    def to_dict(self) -> dict[str, Any]:
        """Nested plain values, which ``from_dict`` reads: for the manifest of a data set."""
        tree: dict[str, Any] = {}
        for path, space in self.changes:
            *above, name = path.split(".")
            node = tree
            for key in above:
                node = node.setdefault(key, {})
            node[name] = _said(space)
        return tree


NO_OVERLAY = Overlay()
"""GarmentCode's whole design space."""


def read_overlay(path: Path | str) -> Overlay:
    """The overlay in a TOML file. Raises ``ConfigError`` with the file, and the line or parameter that is wrong."""
    values = read_toml(path)
    try:
        return Overlay.from_dict(values)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def _no_garment(meta: DesignSpace[MetaDesign]) -> str:
    """Why no garment is left."""
    if all(choice_of(meta, name).range == [None] for name in ("upper", "bottom")):
        return "meta.upper and meta.bottom are both none, so there is no garment: leave one of them in"
    uppers = ", ".join(name for name in choice_of(meta, "upper").range if name is not None)
    return f"nothing is sewn to meta.upper = {uppers}, so there is no garment: let meta.wb and meta.bottom be none"


def _changes(space: DesignSpace[Any], values: Mapping[str, Any], above: str) -> Iterator[Leaf]:
    for entry in space.entries:
        if entry.key not in values:
            continue
        path, said = above + entry.key, values[entry.key]
        if isinstance(entry.space, DesignSpace):
            yield from _changes(entry.space, said, f"{path}.")
            continue
        try:
            yield Leaf(path, _changed(entry.space, said))
        except ConfigError as error:
            raise ConfigError(f"{path} {error}") from error


def _changed(space: Space, said: Any) -> Space:
    """The space narrowed by what an overlay says of it: a value, or a table."""
    word = _word(space)
    if not isinstance(said, Mapping):
        value = _null(space, said)
        return space.narrowed([value] if isinstance(space, Choice) else [value, value])
    if unknown := [key for key in said if key not in (word, "keep")]:
        raise ConfigError(f"takes no {shown(unknown[0])}: it is {space}, so give {word}, keep, or a value")
    if not said:
        raise ConfigError(f"is an empty table: give {word}, keep, or a value")
    if word in said:
        if not isinstance(said[word], list):
            raise ConfigError(f"has {word} = {said[word]!r}, not a list: write {word} = [{said[word]!r}]")
        space = space.narrowed([_null(space, value) for value in said[word]])
    return space.with_keep(_probability(said["keep"])) if "keep" in said else space


def _said(space: Space) -> dict[str, Any]:
    values = [NONE if value is None else value for value in space.range]
    return {_word(space): values} | ({} if space.keep is None else {"keep": space.keep})


def _word(space: Space) -> str:
    """What an overlay calls the values of a parameter."""
    return "options" if isinstance(space, Choice) else "range"


def _null(space: Space, value: Any) -> Any:
    empty = isinstance(space, Choice) and space.accepts(None) and isinstance(value, str) and value.lower() == NONE
    return None if empty else value


def _probability(value: Any) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not 0 <= value <= 1:
        raise ConfigError(f"has keep = {value!r}, not a probability from 0 to 1")
    return float(value)
