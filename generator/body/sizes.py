"""Size charts: the sizes in which a garment is cut, from the smallest up, each with the measures of its body.

A chart is a TOML file. A size has an interval for each measure that decides it [cm], and all measures of its body, with
the names and units of a measurement file::

    [sizes.84]
    fits = { bust = [82, 86], waist = [68, 72], hips = [89, 93] }
    body = { height = 161.2, … }

The lower end of an interval belongs to it; the next size begins where it ends. The charts ``women`` and ``men`` are
made by ``tools/body_model/sizes.py`` from the bodies that ``draw_shape`` draws.

>>> chart = read_chart("women")
>>> chart.size_of(chart.body("96")), chart.moved("96", -2)
('96', '88')
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.bodyfiles import parse_measurements
from gcd_dataset.errors import BodyError, ConfigError, did_you_mean, shown
from gcd_dataset.jsonfile import read_toml
from gcd_dataset.measurements import ANGLES, MEASURE, MEASURES
from gcd_dataset.records import Measurements

CHARTS = ("women", "men")
"""The charts in this package."""


@dataclass(frozen=True)
class SizeChart:
    """Sizes in order; ``read_chart`` makes one."""

    source: str
    """Its file, for messages."""
    bodies: Mapping[str, Measurements]
    """Name of each size to the measures of its body."""
    limits: Mapping[str, tuple[float, ...]]
    """Each measure that decides the size, to the ends of its intervals, one more than sizes [cm]."""
    name: str
    """``women``, or the name of its file."""

    def body(self, size: str) -> Measurements:
        """The measures of a size's body. Raises ``ConfigError`` for a size that the chart lacks."""
        if size not in self.bodies:
            known = ", ".join(map(shown, self.bodies))
            raise ConfigError(f"{self.source}: no size {shown(size)}: choose from {known}")
        return self.bodies[size]

    def size_of(self, measures: Measurements) -> str:
        """The smallest size that is large enough in each measure that decides it.

        Raises ``BodyError`` for a body that is smaller than the smallest size in all these measures, or larger than the
        largest in one, or lacks one.
        """
        found = {name: float(getattr(measures.require(*self.limits), name)) for name in self.limits}
        place = max(np.searchsorted(self.limits[name], value, side="right") for name, value in found.items())
        sizes = list(self.bodies)
        if not 1 <= place <= len(sizes):
            figures = ", ".join(f"{name} {value:.1f} cm" for name, value in found.items())
            end = f"larger than size {shown(sizes[-1])}" if place else f"smaller than size {shown(sizes[0])}"
            raise BodyError(f"{self.source}: a body with {figures} is {end}: add a size to the chart")
        return sizes[place - 1]

    def moved(self, size: str, steps: int) -> str:
        """The size that is ``steps`` sizes larger, or smaller if negative.

        Raises ``ConfigError`` for a size that the chart lacks, and beyond the ends of the chart.
        """
        self.body(size)
        sizes = list(self.bodies)
        below = sizes.index(size)
        above = len(sizes) - 1 - below
        if not -below <= steps <= above:
            ends = f"ends at {shown(sizes[-1 if steps > 0 else 0])}"
            raise ConfigError(
                f"{self.source}: size {shown(size)} {steps:+d}: the chart {ends}: give {-below} to {above}"
            )
        return sizes[below + steps]


def read_chart(name_or_path: Path | str) -> SizeChart:
    """One of ``CHARTS``, or the chart in a TOML file.

    Raises ``ConfigError`` with the file, the size and the fault: a hole or an overlap between two intervals, a measure
    that a body lacks, parts of a body that exceed the whole, a body outside its own intervals.
    """
    if str(name_or_path) in CHARTS:
        path = Path(str(files("gcd_dataset.generator") / "data" / f"sizes_{name_or_path}.toml"))
    else:
        path = Path(name_or_path)
        if not path.suffix and not path.exists():
            nearest = did_you_mean(str(path), CHARTS)
            raise ConfigError(f"no chart {shown(str(path))}: there are {', '.join(CHARTS)}, or a TOML file{nearest}")
    table = read_toml(path).get("sizes")
    if not isinstance(table, dict) or not table:
        raise ConfigError(f"{path}: no sizes: give each a table [sizes.NAME] with fits and body")
    bodies, intervals = dict[str, Measurements](), dict[str, dict[str, tuple[float, float]]]()
    for size, entry in table.items():
        place = f"{path}: size {shown(size)}"
        if not (isinstance(entry, dict) and all(isinstance(entry.get(key), dict) for key in ("fits", "body"))):
            raise ConfigError(f"{place}: give it two tables, fits and body")
        intervals[size] = dict(_intervals(entry["fits"], place))
        bodies[size] = _body(entry, place)
    name = str(name_or_path) if str(name_or_path) in CHARTS else path.name
    return SizeChart(str(path), bodies, _limits(intervals, bodies, path), name)


def _body(entry: Mapping[str, Any], place: str) -> Measurements:
    try:
        body = parse_measurements(entry, place)
    except BodyError as error:
        raise ConfigError(str(error)) from error
    if missing := [name for name in MEASURES if name not in body.to_file_values()]:
        raise ConfigError(f"{place}: body lacks {', '.join(missing)}: a size has all measures: add them")
    try:
        return body.require_parts()
    except BodyError as error:
        raise ConfigError(f"{place}: body: {error}") from error


def _intervals(fits: Mapping[str, Any], place: str) -> Iterator[tuple[str, tuple[float, float]]]:
    girths = [name for name in MEASURES if name not in ANGLES]
    for name, ends in fits.items():
        if name not in girths:
            raise ConfigError(f"{place}: fits has {shown(name)}, no measure in cm{did_you_mean(name, girths)}")
        are_numbers = isinstance(ends, list) and all(type(end) in (int, float) for end in ends) and len(ends) == 2
        if not (are_numbers and all(map(MEASURE[name].holds, ends)) and ends[0] < ends[1]):
            raise ConfigError(f"{place}: fits.{name} is {ends!r}: give two lengths in cm, the smaller first")
        yield name, (float(ends[0]), float(ends[1]))


def _limits(
    intervals: Mapping[str, Mapping[str, tuple[float, float]]], bodies: Mapping[str, Measurements], path: Path
) -> dict[str, tuple[float, ...]]:
    """The common ends of the intervals. Raises ``ConfigError`` for holes, overlaps, and bodies outside of theirs."""
    [first, *_] = intervals
    if not intervals[first]:
        raise ConfigError(f"{path}: size {shown(first)}: fits is empty: give the interval of a measure, such as bust")
    limits = {name: [low] for name, (low, _) in intervals[first].items()}
    before = first
    for size, fits in intervals.items():
        place = f"{path}: size {shown(size)}"
        if other := sorted(fits.keys() ^ limits.keys()):
            fault = "lacks" if other[0] in limits else "has"
            raise ConfigError(f"{place}: fits {fault} {other[0]}, unlike size {shown(first)}: give all sizes the same")
        for name, (low, high) in fits.items():
            if low != limits[name][-1]:
                fault, end = "a hole" if low > limits[name][-1] else "an overlap", f"{limits[name][-1]:g}"
                where = f"begins at {low:g} cm, size {shown(before)} ends at {end} cm"
                raise ConfigError(f"{place}: fits.{name} {where}: {fault}: begin at {end}")
            if not low <= (own := getattr(bodies[size], name)) < high:
                raise ConfigError(f"{place}: body.{name} is {own:g}, but it fits {low:g} to {high:g} cm: correct one")
            limits[name].append(high)
        before = size
    return {name: tuple(ends) for name, ends in limits.items()}
