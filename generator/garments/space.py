"""Design spaces: parameters declared with default, range and probability in one place, and random draws from them.

A design is a frozen dataclass derived from ``Design``, with fields made by ``real``, ``integer``, ``choice``, ``flag``
and, for a design inside a design, ``part``. The constructor raises ``ConfigError`` for a value outside its range.

>>> from dataclasses import dataclass
>>> @dataclass(frozen=True)
... class HemDesign(Design):
...     depth: float = real(2.0, 1.0, 5.0, keep=0.5)
...     rows: int = integer(1, 1, 3)
>>> drawn = draw(HemDesign, np.random.default_rng(1))
>>> round(drawn.depth, 3), drawn.rows
(4.802, 1)
>>> to_dict(HemDesign())
{'depth': 2.0, 'rows': 1}
>>> for leaf in leaves(HemDesign):
...     print(leaf.path, "is", leaf.space)
depth is a number from 1 to 5
rows is a whole number from 1 to 3
"""

import ast
import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from enum import Enum
from functools import cache
from itertools import islice, pairwise
from reprlib import repr as short
from textwrap import dedent, fill
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from gcd_dataset.errors import ConfigError, shown
from gcd_dataset.generator.garments.parameter import Choice, Flag, Integer, Real, Space, plain

LONGEST = 60  # characters of a name in a message
MOST_FAULTS = 12  # sentences in one message
D = TypeVar("D", bound="Design")
P = TypeVar("P", bound="Design")


class _Doc:
    """The docstring of a design: its own, and a line for each parameter, read from the source on demand."""

    def __init__(self, own: str | None) -> None:
        self.own = own

    def __get__(self, design: "Design | None", kind: "type[Design]") -> str:
        own = inspect.cleandoc(self.own or kind.__name__)
        if "__match_args__" not in vars(kind):  # ``dataclass`` looks for a docstring before the class is complete
            return own
        lines = (
            fill(line, 110, subsequent_indent="    ", break_on_hyphens=False)
            for line in parameter_lines(DesignSpace.declared(kind))
        )
        return "\n".join([own, "", *lines])


@dataclass(frozen=True)
class Design:
    """A frozen set of parameters. Raises ``ConfigError`` for a value outside its parameter's range."""

    def __init_subclass__(cls) -> None:
        cls.__doc__ = _Doc(cls.__doc__)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        for name, space in _parameters(type(self)):  # type: ignore[arg-type]
            value = getattr(self, name)
            if not space.accepts(value):
                raise ConfigError(f"{type(self).__name__}: {name} is {plain(value)}, not {space}")

    def includes(self, name: str) -> bool:
        """Whether design files include the part of this name, which ``with_parts`` added."""
        return True


@cache
def _parameters(kind: type[Design]) -> tuple[tuple[str, Space], ...]:
    """Names and spaces of the parameters of a design, without its parts."""
    return tuple((entry.name, entry.metadata["space"]) for entry in fields(kind) if "space" in entry.metadata)


def real(default: float, low: float, high: float, *, keep: float | None = None) -> Any:
    """A number."""
    return _parameter(Real(default, keep, low, high))


def integer(default: int, low: int, high: int, *, keep: float | None = None) -> Any:
    """A whole number, both ends included."""
    return _parameter(Integer(default, keep, low, high))


def choice(
    default: Enum | float | None, *options: Enum | float | None, keep: float | None = None, weights: Sequence[int] = ()
) -> Any:
    """One of several options, enum members or numbers; ``None`` means none of them. ``weights``: see ``Choice``."""
    return _parameter(Choice(default, keep, options, tuple(weights)))


def flag(default: bool, *, keep: float | None = None) -> Any:
    """Yes or no."""
    return _parameter(Flag(default, keep, (True, False)))


def part(kind: type[Design], *, key: str | None = None, added: bool = False) -> Any:
    """A design inside a design; ``key``: its name in design files, if different; ``added``: see ``with_parts``."""
    return field(default_factory=kind, metadata={"part": kind, "key": key} | ({"added": True} if added else {}))


def with_parts(kinds: Mapping[str, type[Design]]) -> Callable[[type[P]], type[P]]:
    """A decorator that adds parts to a design, from names in design files to classes. Write it below ``dataclass``.

    Names that the design declares stay unchanged. Added parts follow the declared ones; ``draw`` and ``leaves`` skip
    them, and design files include them if ``Design.includes`` returns true.
    """

    def extend(design: type[P]) -> type[P]:
        for key, kind in kinds.items():
            name = key.replace("-", "_")
            if name not in design.__annotations__:
                design.__annotations__[name] = kind
                setattr(design, name, field(default_factory=kind, metadata={"part": kind, "key": key, "added": True}))
        return design

    return extend


def _parameter(space: Space) -> Any:
    return field(default=space.default, metadata={"space": space})


class FieldEntry(NamedTuple):
    """One field of a design."""

    name: str
    key: str
    """Its name in design files."""
    space: "Space | DesignSpace[Any]"
    added: bool = False
    """Whether ``with_parts`` added it."""


class Leaf(NamedTuple):
    """One parameter of a design or of one of its parts."""

    path: str
    """Its path in design files: ``flare-skirt.cut.depth``."""
    space: Space


@dataclass(frozen=True)
class DesignSpace(Generic[D]):
    """The spaces of all parameters of a design class, as declared or narrowed."""

    kind: type[D]
    entries: tuple[FieldEntry, ...]

    @classmethod
    def declared(cls, kind: type[D]) -> "DesignSpace[D]":
        """The space declared by the fields of a design class."""
        entries = []
        for each in fields(kind):
            inner = each.metadata.get("part")
            space = cls.declared(inner) if inner else each.metadata["space"]
            entries.append(FieldEntry(each.name, _key(each), space, "added" in each.metadata))
        return cls(kind, tuple(entries))

    def of(self, kind: type[P]) -> "DesignSpace[P]":
        """The space of the part of this class. Raises ``ConfigError`` unless there is exactly one."""
        found = [space for space in self._parts() if space.kind is kind]
        if len(found) != 1:
            raise ConfigError(f"{self.kind.__name__} has {len(found)} parts of kind {kind.__name__}: name another kind")
        return found[0]

    def entry(self, key: str) -> FieldEntry:
        """The field with this name in design files. Raises ``ConfigError`` for an unknown name."""
        found = next((entry for entry in self.entries if entry.key == key), None)
        if found is None:
            known = ", ".join(entry.key for entry in self.entries)
            raise ConfigError(f"{self.kind.__name__} has no {shown(key)}: it has {known}")
        return found

    def at(self, path: str) -> "Space | DesignSpace[Any]":
        """The space of the parameter or part at a path of design files. Raises ``ConfigError`` for an unknown path."""
        key, _, rest = path.partition(".")
        space = self.entry(key).space
        return space.at(rest) if rest and isinstance(space, DesignSpace) else space

    def changed(self, spaces: Mapping[str, Space]) -> "DesignSpace[D]":
        """The space with new spaces for the parameters at some paths. Raises ``ConfigError`` for an unknown path."""
        if unknown := spaces.keys() - {leaf.path for leaf in leaves(self, added=True)}:
            raise ConfigError(f"no design parameter is called {min(unknown)}: make the overlay again from its file")
        return self._changed(spaces, "")

    def _changed(self, spaces: Mapping[str, Space], prefix: str) -> "DesignSpace[D]":
        entries = []
        for entry in self.entries:
            path, space = prefix + entry.key, entry.space
            new = space._changed(spaces, f"{path}.") if isinstance(space, DesignSpace) else spaces.get(path, space)
            entries.append(entry._replace(space=new))
        return replace(self, entries=tuple(entries))

    def _parts(self) -> "Iterator[DesignSpace[Any]]":
        for entry in self.entries:
            if isinstance(entry.space, DesignSpace):
                yield entry.space
                yield from entry.space._parts()


def leaves(kind: type[Design] | DesignSpace[Any], *, added: bool = False) -> Iterator[Leaf]:
    """All parameters of a design and its parts, in the order of the fields.

    ``added``: include the parts added by ``with_parts``.
    """
    for entry in _space(kind).entries:
        if entry.added and not added:
            continue
        if isinstance(entry.space, DesignSpace):
            yield from (Leaf(f"{entry.key}.{leaf.path}", leaf.space) for leaf in leaves(entry.space))
        else:
            yield Leaf(entry.key, entry.space)


def draw(kind: type[D] | DesignSpace[D], rng: np.random.Generator) -> D:
    """A random design, drawn field by field."""
    space, values = _space(kind), {}
    for entry in space.entries:
        if entry.added:
            continue
        if isinstance(entry.space, DesignSpace):
            values[entry.name] = draw(entry.space, rng)
        else:
            values[entry.name] = entry.space.draw(rng)
    return space.kind(**values)


def redrawn(
    space: DesignSpace[D], design: D, path: str, rng: np.random.Generator, low: float = -np.inf, high: float = np.inf
) -> D:
    """The design with the parameter, or the whole part, at a path of design files drawn again.

    ``low``, ``high``: limits of a parameter, as in ``Space.draw``. Raises ``ConfigError`` for an unknown path.

    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class CuffDesign(Design):
    ...     depth: float = real(2.0, 1.0, 5.0)
    ...     rows: int = integer(1, 1, 3)
    >>> space = DesignSpace.declared(CuffDesign)
    >>> redrawn(space, CuffDesign(), "depth", np.random.default_rng(1), high=1.0)
    CuffDesign(depth=1.0, rows=1)
    """
    inner = space.at(path)
    value = draw(inner, rng) if isinstance(inner, DesignSpace) else inner.draw(rng, low, high)
    return with_value(space, design, path, value)


def with_value(space: DesignSpace[D], design: D, path: str, value: Any) -> D:
    """The design with the parameter or part at a path of design files changed. Raises ``ConfigError``."""
    key, _, rest = path.partition(".")
    entry = space.entry(key)
    if rest and isinstance(entry.space, DesignSpace):
        value = with_value(entry.space, getattr(design, entry.name), rest, value)
    return replace(design, **{entry.name: value})


def with_new_numbers(space: DesignSpace[D], design: D, rng: np.random.Generator) -> D:
    """The design with all its numbers drawn again, and its choices as they are."""
    values = {}
    for entry in space.entries:
        if isinstance(entry.space, Choice):
            continue
        if isinstance(entry.space, Space):
            values[entry.name] = entry.space.draw(rng)
        else:
            values[entry.name] = with_new_numbers(entry.space, getattr(design, entry.name), rng)
    return replace(design, **values)


def value_at(space: DesignSpace[Any], design: Any, path: str) -> Any:
    """The parameter or part at a path of design files. Raises ``ConfigError`` for an unknown path."""
    key, _, rest = path.partition(".")
    entry = space.entry(key)
    value = getattr(design, entry.name)
    return value_at(entry.space, value, rest) if rest and isinstance(entry.space, DesignSpace) else value


@cache
def field_docs(owner: type) -> dict[str, str]:
    """Attribute to the docstring below it, in Markdown; empty for a class without source file.

    >>> field_docs(Leaf)
    {'path': 'Its path in design files: `flare-skirt.cut.depth`.'}
    """
    try:
        source = dedent(inspect.getsource(owner))
    except (OSError, TypeError):  # typed in, or made by ``exec``
        return {}
    (body,) = (node.body for node in ast.parse(source).body if hasattr(node, "body"))
    found = {}
    for node, below in pairwise(body):
        target = (
            node.target
            if isinstance(node, ast.AnnAssign)
            else node.targets[0]
            if isinstance(node, ast.Assign)
            else None
        )
        if isinstance(target, ast.Name) and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            found[target.id] = " ".join(str(below.value.value).split()).replace("``", "`")
    return found


def meanings(space: DesignSpace[Any], prefix: str = "") -> Iterator[tuple[Leaf, str]]:
    """All parameters, those of added parts included, with the docstrings below them."""
    owners = reversed(space.kind.__mro__[:-1])
    docs = {name: text for owner in owners for name, text in field_docs(owner).items()}
    for entry in space.entries:
        if isinstance(entry.space, DesignSpace):
            yield from meanings(entry.space, f"{prefix}{entry.key}.")
        else:
            yield Leaf(f"{prefix}{entry.key}", entry.space), docs.get(entry.name, "")


def parameter_lines(space: DesignSpace[Any]) -> Iterator[str]:
    """A line for each parameter: range, default, probability of the default, and meaning."""
    for (path, values), meaning in meanings(space):
        keep = "" if values.keep is None else f" with probability {values.keep:g}"
        yield f"{path}: {values}; default {plain(values.default)}{keep}. {meaning}".rstrip()


def _space(kind: type[D] | DesignSpace[D]) -> DesignSpace[D]:
    return kind if isinstance(kind, DesignSpace) else DesignSpace.declared(kind)


def _key(entry: Any) -> str:
    return str(entry.metadata.get("key") or entry.name)


def to_dict(design: Design) -> dict[str, Any]:
    """The design as nested plain values, with the names of design files."""
    written = (entry for entry in fields(design) if "added" not in entry.metadata or design.includes(entry.name))
    values = {_key(entry): getattr(design, entry.name) for entry in written}
    return {key: to_dict(value) if isinstance(value, Design) else plain(value) for key, value in values.items()}


class Unknown(NamedTuple):
    """A name that a design space lacks, with the value or table under it."""

    path: str
    node: Any
    siblings: Iterable[str]
    """The known names beside it."""

    def fault(self, space: DesignSpace[Any]) -> str:
        """A sentence with the most similar known path."""
        known = [leaf.path for leaf in leaves(space, added=True)]
        tables = {".".join(path.split(".")[:depth]) for path in known for depth in range(1, path.count(".") + 1)}
        near = get_close_matches(self.path, [*known, *sorted(tables)], n=1)
        remedy = f"did you mean {near[0]}?" if near else f"there are {', '.join(self.siblings)}"
        return f"no design parameter is called {shown(self.path[:LONGEST])}: {remedy}"


def unknown_parameters(space: DesignSpace[Any], values: Mapping[str, Any], prefix: str = "") -> Iterator[Unknown]:
    """The names that the space lacks. Raises ``ConfigError`` for a value instead of a table."""
    entries = {entry.key: entry.space for entry in space.entries}
    for key, value in values.items():
        if key not in entries:
            yield Unknown(f"{prefix}{key}", value, entries)
        elif isinstance(inner := entries[key], DesignSpace):
            if not isinstance(value, Mapping):
                raise ConfigError(f"{prefix}{key} is {short(value)}, not a table of parameters")
            yield from unknown_parameters(inner, value, f"{prefix}{key}.")


def require_no_fault(faults: Iterable[str]) -> None:
    """Raise ``ConfigError`` with the faults, if there are any; of many the first ones."""
    found = list(islice(faults, MOST_FAULTS + 1))
    if found:
        raise ConfigError("; ".join([*found[:MOST_FAULTS], *["and more"] * (len(found) > MOST_FAULTS)]))


def read_values(space: DesignSpace[D], values: Mapping[str, Any], prefix: str = "") -> tuple[D, list[str]]:
    """The design from nested plain values or entries of design files, ``{"v": value, …}``.

    With defaults in place of omitted and of invalid values, and a sentence for each invalid one.
    """
    read, faults = {}, []
    for entry in space.entries:
        if entry.key not in values:
            continue
        value, path = values[entry.key], prefix + entry.key
        if isinstance(entry.space, DesignSpace):
            table = value if isinstance(value, Mapping) else {}  # ``unknown_parameters`` reports it
            read[entry.name], inner = read_values(entry.space, table, f"{path}.")
            faults += inner
            continue
        try:
            if isinstance(value, Mapping) and "v" not in value:
                raise ConfigError("has no value: write it as v")
            read[entry.name] = entry.space.read(value["v"] if isinstance(value, Mapping) else value)
        except ConfigError as error:
            faults.append(f"{path} {error}")
    return space.kind(**read), faults
