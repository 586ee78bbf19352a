"""Standard tests of the named fabrics, run in the solver, beside targets from publications."""

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from benchmarks.drapemeter import drape_coefficient
from benchmarks.strips import Direction, bending_length, cantilever, tensile_stiffness
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape import FABRICS, fabric_named
from gcd_dataset.generator.drape.fabrics import STIFFEST

TARGETS = Path(__file__).resolve().parent / "data" / "fabric_targets.csv"
BASES = ("measured", "class", "relation", "set", "none")
SPECIMENS = 2  # discs whose drape coefficients are averaged; one without a target
FINE = 0.75  # cm: below this spacing only one disc is draped, and none without a target
UNLIMITED_SPACING = 1.0  # cm
NOT_RUN = "-"
UNITS = {"drape_coefficient": "%", "bending_length": "cm", "tensile_stiffness": "N/m"}


@dataclass(frozen=True, slots=True)
class Target:
    """The published result of a standard test of a fabric, and its source."""

    fabric: str
    test: str
    direction: str
    """``warp``, ``weft``, ``bias``, or ``all`` for the drape coefficient."""
    unit: str
    target: float
    """Published value; NaN if only a band is published, or no figure."""
    low: float
    """Lower end of the accepted band; ``low`` and ``high`` are NaN without a published figure."""
    high: float
    basis: str
    """``measured``: on this cloth; ``class``: on cloth of its class; ``relation``: by a relation between
    measurements of other cloths; ``set``: by us, without a test; or ``none``."""
    citation: str

    def has(self, value: float) -> bool:
        """Whether a result lies in the band."""
        return self.low <= value <= self.high

    @property
    def known(self) -> bool:
        return math.isfinite(self.low)


def read_targets(path: Path = TARGETS) -> list[Target]:
    """The targets of a CSV file. Raises ``ConfigError`` with file and line for a row that is not a target."""
    with path.open(newline="", encoding="utf-8") as file:
        return [_target(row, f"{path}: line {number}") for number, row in enumerate(csv.DictReader(file), start=2)]


def _target(row: dict[str, Any], where: str) -> Target:
    try:
        figures = {name: float(row[name] or "nan") for name in ("target", "low", "high")}
        target = Target(**(row | figures))
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{where}: {error}: give fabric, test, direction, unit, figures, basis, citation") from error
    directions = ("all",) if target.test == "drape_coefficient" else get_args(Direction)
    if target.fabric not in FABRICS or UNITS.get(target.test) != target.unit or target.direction not in directions:
        raise ConfigError(f"{where}: no test of a fabric: {target.fabric}, {target.test}, {target.direction}")
    if target.basis not in BASES or not target.citation or target.low > target.high:
        raise ConfigError(f"{where}: give a basis ({', '.join(BASES)}), a citation, and a band with low below high")
    return target


def results(targets: list[Target], spacings: list[float], device: str) -> Iterator[dict[str, Any]]:
    """A row for each target: the result and ``in_band`` at each spacing [cm], ``-`` where the test was not run.

    ``measured_stiffness``: at 1 cm, with the published tensile stiffness; drapes limit it (``Fabric.softened``).
    """
    for target in targets:
        band = f"{target.low:g} to {target.high:g}" if target.known else NOT_RUN
        row: dict[str, Any] = {"fabric": target.fabric, "test": target.test, "direction": target.direction}
        row |= {"unit": target.unit, "band": band, "basis": target.basis}
        for spacing in spacings:
            row |= _columns(f"{spacing:g}_cm", target, _run(target, spacing, STIFFEST, device))
        unlimited = _run(target, UNLIMITED_SPACING, math.inf, device) if _is_limited(target) else None
        yield row | _columns("measured_stiffness", target, unlimited)


def _columns(name: str, target: Target, value: float | None) -> dict[str, Any]:
    if value is None:
        return {name: NOT_RUN, f"in_band {name}": NOT_RUN}
    return {name: value, f"in_band {name}": target.has(value) if target.known else NOT_RUN}


def _is_limited(target: Target) -> bool:
    """Whether the limit on tensile stiffness in drapes can change the result of this test."""
    fabric = fabric_named(target.fabric)
    return target.known and target.test != "bending_length" and fabric.softened() != fabric


def _run(target: Target, spacing: float, stiffest: float, device: str) -> float | None:
    """The result of a test; None if it was not run: strips shorter than an edge, fine discs without a target."""
    fabric = fabric_named(target.fabric)
    if target.test == "drape_coefficient":
        if spacing < FINE and not target.known:
            return None
        specimens = 1 if spacing < FINE or math.isinf(stiffest) or not target.known else SPECIMENS
        return drape_coefficient(fabric, spacing=spacing, specimens=specimens, stiffest=stiffest, device=device)
    if target.test == "bending_length":
        grain: Any = target.direction
        resolved = 2 * bending_length(fabric, grain) >= spacing
        return cantilever(fabric, grain, spacing=spacing, device=device) if resolved else None
    direction: Any = target.direction
    return tensile_stiffness(fabric, direction, spacing=spacing, stiffest=stiffest, device=device)
