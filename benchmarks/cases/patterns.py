"""Sampling designs: CPU time, acceptance, and the mix of garments.

Every design is drawn for the neutral body and a random one, as in ``gcd generate --bodies both --stage pattern``; it is
accepted if it fits both. CPU time covers drawing the design, both patterns and all checks; bodies and their
measures are timed separately. ``redraws`` are the parameters, parts and whole designs drawn again because of a rule,
rejected attempts included. ``defects`` are patterns in which ``check_pattern`` finds an error or an edge under 0.5 cm.
"""

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from benchmarks.cases import CaseResult, Figure, jpeg_file
from gcd_dataset.errors import ConfigError
from gcd_dataset.faults import Rule, Severity, check_pattern
from gcd_dataset.files import write_whole
from gcd_dataset.generator.body import build_body, draw_shape, measure, neutral_shape
from gcd_dataset.generator.drawing import design_sheet, jpeg_bytes
from gcd_dataset.generator.garments import GarmentDesign, Kind, Reject, attempted_design, try_on
from gcd_dataset.generator.garments.design import kind_of
from gcd_dataset.records import Measurements, Pattern
from gcd_dataset.seeding import Stage, rng

MOST_ATTEMPTS = 30
ON_SHEET = 64  # most designs on the sheet


@dataclass(frozen=True)
class AcceptedDesign:
    """An accepted design: kind, size, rejects, redraws and CPU time."""

    kind: Kind
    counts: tuple["Counts", ...]
    """One entry per pattern."""
    rejects: tuple[Reject, ...]
    redraws: Counter[str]
    """Rule to its number of redraws within all attempts."""
    seconds: float
    """CPU time, including rejected attempts."""


class Counts(NamedTuple):
    """Numbers of parts of a pattern."""

    panels: int
    edges: int
    stitches: int
    defective: bool

    @classmethod
    def of(cls, pattern: Pattern) -> Self:
        faults = check_pattern(pattern)
        defective = any(fault.severity is Severity.ERROR or fault.rule is Rule.SHORT_EDGE for fault in faults)
        return cls(len(pattern.panels), sum(len(p.edges) for p in pattern.panels), len(pattern.seams), defective)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=1000, help="accepted designs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sheet", type=jpeg_file, help="JPEG with the first 64 designs, drawn for their random bodies")


def run(options: argparse.Namespace) -> CaseResult:
    """Sample designs and count. Raises ``ConfigError`` for ``--count`` below 1."""
    if options.count < 1:
        raise ConfigError(f"count is {options.count}: give 1 or more")
    neutral = measure(build_body(neutral_shape()))
    drawn, body_seconds, shown = [], [], []
    for number in range(options.count):
        begun = time.process_time()
        size = measure(build_body(draw_shape(rng(options.seed, number, Stage.BODY))))
        body_seconds.append(time.process_time() - begun)
        design, (_, pattern) = _accepted(options.seed, number, (neutral, size))
        drawn.append(design)
        if options.sheet and number < ON_SHEET:
            shown.append(replace(pattern, name=f"{number}: {design.kind.value}"))
    if shown:
        write_whole(options.sheet, jpeg_bytes(design_sheet(shown, columns=8, size=240)))
    return CaseResult([*_costs(drawn, body_seconds), *_shares(drawn)], _reasons(drawn))


def _accepted(seed: int, number: int, sizes: Sequence[Measurements]) -> tuple[AcceptedDesign, tuple[Pattern, ...]]:
    """Design ``number`` and its patterns: the first attempt that fits all wearers."""
    begun = time.process_time()
    rejects: list[Reject] = []
    redraws: Counter[str] = Counter()
    for attempt in range(MOST_ATTEMPTS):
        drawn = attempted_design(seed, number, attempt, sizes)
        redraws += drawn.by_rule()
        patterns = _worn_by_all(sizes, drawn.design)
        if not isinstance(patterns, Reject):
            seconds = time.process_time() - begun
            counts = tuple(map(Counts.of, patterns))
            return AcceptedDesign(kind_of(drawn.design.meta), counts, tuple(rejects), redraws, seconds), patterns
        rejects.append(patterns)
    raise ConfigError(f"design {number} of seed {seed}: {MOST_ATTEMPTS} attempts, the last: {rejects[-1]}")


def _worn_by_all(sizes: Sequence[Measurements], design: GarmentDesign) -> tuple[Pattern, ...] | Reject:
    patterns = []
    for size in sizes:
        pattern = try_on(size, design)
        if isinstance(pattern, Reject):
            return pattern
        patterns.append(pattern)
    return tuple(patterns)


def _costs(drawn: Sequence[AcceptedDesign], body_seconds: Sequence[float]) -> list[Figure]:
    cost = 1e3 * np.array([design.seconds for design in drawn])
    attempts = sum(1 + len(design.rejects) for design in drawn)
    redraws = sum(design.redraws.total() for design in drawn)
    return [
        Figure("cpu_ms_mean", float(cost.mean()), "ms per accepted design for two bodies"),
        Figure("cpu_ms_p95", float(np.quantile(cost, 0.95)), "ms"),
        Figure("body_cpu_ms", 1e3 * float(np.mean(body_seconds)), "ms per random body with its measures"),
        Figure("accepted", len(drawn) / attempts, "of attempts"),
        Figure("redraws", attempts / len(drawn) - 1 + redraws / len(drawn), "per accepted design"),
        Figure("designs", len(drawn), ""),
    ]


def _shares(drawn: Sequence[AcceptedDesign]) -> list[Figure]:
    counts = [counts for design in drawn for counts in design.counts]
    kinds = Counter(design.kind for design in drawn)
    figures = [Figure(f"share_{kind.value}", kinds[kind] / len(drawn), "of designs") for kind in Kind]
    panels, edges, stitches, defects = np.mean(counts, axis=0)
    return [
        *figures,
        Figure("panels_mean", float(panels), "per pattern"),
        Figure("edges_mean", float(edges), "per pattern"),
        Figure("stitches_mean", float(stitches), "per pattern"),
        Figure("defects", float(defects), "of patterns"),
    ]


def _reasons(drawn: Sequence[AcceptedDesign]) -> list[dict[str, object]]:
    """Rules by their redraws, most frequent first, with the designs that they rejected and an example."""
    rejects = [reject for design in drawn for reject in design.rejects]
    examples = {reject.rule: reject.figures for reject in reversed(rejects)}
    rejected = Counter(reject.rule for reject in rejects)
    redraws = sum((design.redraws for design in drawn), rejected)
    return [
        {"rule": rule, "redraws": count, "rejected designs": rejected[rule], "such as": examples.get(rule, "-")}
        for rule, count in redraws.most_common()
    ]
