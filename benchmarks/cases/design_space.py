"""Proposed against accepted: how the rules of sewing and wearing change the declared distribution of each parameter.

Designs are drawn for the neutral body and a random one. *Proposed* are the values that the declared rule draws (the
default with probability ``keep``, else uniform over the range), *accepted* those of the designs that fit both bodies. A
parameter is compared over the designs whose garment uses its section. ``moved`` is the total variation between the
two, over 20 bins and the default: the share of designs whose value had to change; ``noise`` is the value to expect
from chance alone. ``redrawn for``: the rules that drew the parameter again, in redraws per design. ``hardly ever``:
proposed values of which under a fifth is accepted.

``moved, GarmentCode`` is the same for GarmentCode's sampler, which draws the whole design again. ``distance`` is
between what both samplers accept: the largest difference of the distribution functions (Kolmogorov-Smirnov), for
choices the total variation.

The rules that move a parameter by more than 5 %, and why:

- ``self_crossing``, ``sharp_corner``, ``short_edge`` of ``collar.bc_depth`` and ``collar.fc_depth``: a neckline much
  deeper than wide bulges over the shoulder line, or cuts the armhole or the tip of a dart; the same rules of
  ``godet-skirt.insert_depth``, ``pencil-skirt.low_angle`` and ``levels-skirt.level_ruffle``: cuts meet each other or
  the hips, the hem meets the side, the last level is over five metres wide (``unsewable``);
- ``cannot_be_drawn`` of ``godet-skirt.insert_depth``: the godet is deeper than the skirt is long;
- ``tight_cuff``: a leg or an arm does not fit through its cuff, or an arm through the end of a sleeve without cuff;
- ``too_heavy`` of ``flare-skirt.length``, ``flare-skirt.suns`` and ``levels-skirt.length``: a long or wide flared skirt
  alone needs a firm waistband, as in GarmentCode;
- ``overloaded_hips`` and ``overloaded_straps`` of the same parameters: friction on the hips holds no more cloth, or
  shoulder seams stretch by more than 40 % under its weight;
- ``too_tight`` of ``shirt.length`` and ``waistband.width``: a band or bottom cut for the waist is worn at the hips, and
  would stretch by more than 20 %;
- ``nothing_holds`` of ``meta.bottom`` and ``meta.wb``: a skirt alone on a wearer whose waist is nearly as wide as the
  hips gets a band, or trousers are drawn;
- ``slides_off`` and ``loose_gathers`` of ``waistband.waist``: a bottom alone may not be wider than the trunk, and
  gathers need a band no wider than the body;
- ``off_the_waist`` of ``shirt.length``: a shirt with a part sewn to its hem ends near the waist;
- ``reaches_floor``: lengths end above the floor.
"""

import argparse
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import pi, sqrt
from typing import Any, TypeAlias

import numpy as np

from benchmarks.cases import CaseResult, Figure
from benchmarks.draping.workload import reference_design, reject_reason
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.body import build_body, draw_shape, measure, neutral_shape
from gcd_dataset.generator.garments import (
    DrawnDesign,
    GarmentDesign,
    Redraw,
    Reject,
    attempted_design,
    design_to_dict,
    drafted_design,
    try_on,
)
from gcd_dataset.generator.garments.parameter import Choice
from gcd_dataset.generator.garments.space import Leaf, leaves
from gcd_dataset.records import Measurements
from gcd_dataset.seeding import Stage, rng

LARGE = 0.05  # least total variation of a parameter that counts as moved
Values = Mapping[str, list[Any]]
"""The values of each parameter, one for each design; ``UNUSED`` in designs without the parameter."""


@dataclass(frozen=True)
class Selection:
    """The values that a sampler proposes, the values that it accepts, and its redraws."""

    proposed: Values
    accepted: Values
    redraws: Mapping[Redraw, int]
    paired: bool
    """Whether accepted value k replaces proposed value k; if not, the accepted values are some of the proposed ones."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=1000, help="accepted designs of our sampler")
    parser.add_argument("--reference-count", type=int, default=1000, help="accepted designs of GarmentCode's")
    parser.add_argument("--seed", type=int, default=0)


def run(options: argparse.Namespace) -> CaseResult:
    """Draw with both samplers and compare. Raises ``ConfigError`` for too few designs to compare."""
    for name in ("count", "reference_count"):
        if getattr(options, name) < FEWEST:
            raise ConfigError(f"{name} is {getattr(options, name)}: give {FEWEST} or more")
    ours = _ours(options.seed, options.count)
    reasons: Counter[str] = Counter()
    theirs = _theirs(options.seed, options.reference_count, reasons)
    rows = [_row(leaf, ours, theirs) for leaf in leaves(GarmentDesign)]
    moved = [row["moved"] for row in rows if isinstance(row["moved"], float)]
    distances = [row["distance"] for row in rows if isinstance(row["distance"], float)]
    figures = [
        Figure("moved_mean", float(np.mean(moved)), "total variation, over parameters"),
        Figure("moved_by_5_percent", sum(value > LARGE for value in moved), "parameters"),
        Figure("redraws", sum(ours.redraws.values()) / options.count, "per design"),
        Figure("distance_mean", float(np.mean(distances)), "over parameters"),
        Figure("distance_max", max(distances), ""),
        Figure("reference_accepted", options.reference_count / reasons.total(), "of attempts"),
        *(
            Figure(f"reference_{reason}".replace(" ", "_"), count / reasons.total(), "of attempts")
            for reason, count in reasons.most_common()
            if reason
        ),
    ]
    return CaseResult(figures, sorted(rows, key=lambda row: str(row["moved"]), reverse=True))


# ------------------------------------------------------------------------------------------------------------ samplers


def _sizes(seed: int, number: int) -> tuple[Measurements, Measurements]:
    random = measure(build_body(draw_shape(rng(seed, number, Stage.BODY))))
    return measure(build_body(neutral_shape())), random


def _ours(seed: int, count: int) -> Selection:
    drawn = [_accepted(seed, number) for number in range(count)]
    redraws: Counter[Redraw] = Counter()
    for design in drawn:
        redraws.update(design.redraws)
    drafts = (drafted_design(seed, number, 0) for number in range(count))
    return Selection(_values(drafts), _values(design.design for design in drawn), redraws, paired=True)


def _accepted(seed: int, number: int) -> DrawnDesign:
    """A design accepted by our rules, with the redraws of all attempts."""
    sizes, attempt = _sizes(seed, number), 0
    redraws: Counter[Redraw] = Counter()
    while True:
        drawn = attempted_design(seed, number, attempt, sizes)
        redraws.update(drawn.redraws)
        faults = [found for size in sizes if isinstance(found := try_on(size, drawn.design), Reject)]
        if not faults:
            return DrawnDesign(drawn.design, redraws)
        redraws[Redraw(faults[0].rule, "design")] += 1
        attempt += 1


def _theirs(seed: int, count: int, reasons: Counter[str]) -> Selection:
    """GarmentCode's sampler; ``reasons`` counts all its verdicts."""
    proposed: list[GarmentDesign] = []
    accepted: list[GarmentDesign] = []
    while len(accepted) < count:
        number = len(proposed)
        design = reference_design(rng(seed, number, Stage.DESIGN))
        reason = reject_reason(design, _sizes(seed, number))
        reasons[reason] += 1
        proposed.append(design)
        if not reason:
            accepted.append(design)
    return Selection(_values(proposed), _values(accepted), {}, paired=False)


def _values(designs: Iterable[GarmentDesign]) -> Values:
    found: dict[str, list[Any]] = {leaf.path: [] for leaf in leaves(GarmentDesign)}
    for design in designs:
        tree, sections = design_to_dict(design), design.sections_used()
        for path, values in found.items():
            values.append(_at(tree, path) if _section(path) in sections else UNUSED)
    return found


def _section(path: str) -> str:
    """Field of the section that holds the parameter at ``path``; designs without this section do not use it."""
    return "shirt" if path == "left.enable_asym" else path.split(".")[0].replace("-", "_")


def _at(tree: Mapping[str, Any], path: str) -> Any:
    for key in path.split("."):
        tree = tree[key]
    return tree


# ---------------------------------------------------------------------------------------------------------- comparison


def _row(leaf: Leaf, ours: Selection, theirs: Selection) -> dict[str, Any]:
    path = leaf.path
    shifts = [shift(leaf, own.proposed[path], own.accepted[path], paired=own.paired) for own in (ours, theirs)]
    accepted = [used(own.accepted[path]) for own in (ours, theirs)]
    enough = [len(values) >= FEWEST for values in accepted]
    return {
        "parameter": path,
        "moved": round(shifts[0].moved, 3) if enough[0] else "too few",
        "noise": round(shifts[0].noise, 3),
        "redrawn for": _rules(path, ours.redraws, len(accepted[0])),
        "hardly ever": ", ".join(shifts[0].rare) or "-",
        "proposed": _summary(leaf, used(ours.proposed[path])),
        "accepted": _summary(leaf, accepted[0]),
        "moved, GarmentCode": f"{shifts[1].moved:.3f}, noise {shifts[1].noise:.3f}" if enough[1] else "too few",
        "accepted, GarmentCode": _summary(leaf, accepted[1]),
        "distance": round(_distance(leaf, *accepted), 3) if all(enough) else "too few",
        "designs, ours": len(accepted[0]),
        "designs, GarmentCode": len(accepted[1]),
    }


def _rules(path: str, redraws: Mapping[Redraw, int], designs: int) -> str:
    """The rules that redrew a parameter or a part with it, most frequent first, in redraws per design."""
    counts: Counter[str] = Counter()
    for redraw, count in redraws.items():
        if f"{path}.".startswith(f"{redraw.path}."):
            counts[redraw.rule] += count
    return ", ".join(f"{rule} {count / designs:.2f}" for rule, count in counts.most_common(3)) or "-"


def _distance(leaf: Leaf, ours: Sequence[Any], theirs: Sequence[Any]) -> float:
    if isinstance(leaf.space, Choice):
        shares = [Counter(map(str, values)) for values in (ours, theirs)]
        return 0.5 * sum(abs(shares[0][o] / len(ours) - shares[1][o] / len(theirs)) for o in shares[0] | shares[1])
    both = np.unique(np.concatenate([ours, theirs]))
    distributions = [np.searchsorted(np.sort(values), both, side="right") / len(values) for values in (ours, theirs)]
    return float(np.abs(distributions[0] - distributions[1]).max())


def _summary(leaf: Leaf, values: Sequence[Any]) -> str:
    if not values:
        return "-"
    if isinstance(leaf.space, Choice):
        counts = Counter(str(value) for value in values)
        return ", ".join(f"{option} {100 * n / len(values):.0f} %" for option, n in counts.most_common(3))
    share = np.mean(np.isclose(values, leaf.space.default))
    return f"mean {np.mean(values):.2f}, default {100 * share:.0f} %"


UNUSED = "unused"
"""The value of a parameter in a design that does not use it."""
FEWEST = 20  # least number of designs for a comparison
BINS = 20  # equal parts of a number's range
RARE = 0.2  # ratio of the accepted to the proposed share of a value: smaller for a rare value
Bin: TypeAlias = int | str
"""Number of one of ``BINS`` parts of the range; or the name of an option, of the default, or ``UNUSED``."""


@dataclass(frozen=True)
class Shift:
    """The shift of a parameter's distribution by selection."""

    moved: float
    """Total variation between proposed and accepted values, 0 to 1."""
    noise: float
    """The expected ``moved`` if designs were changed or accepted at random."""
    rare: tuple[str, ...]
    """Proposed values with an accepted share below ``RARE`` times the proposed share."""


def shift(leaf: Leaf, proposed: Sequence[Any], accepted: Sequence[Any], *, paired: bool) -> Shift:
    """The shift of one parameter.

    ``paired``: value k was accepted in place of proposed value k; otherwise the accepted values are some of the
    proposed ones.
    """
    before, after = ([_bin(leaf, value) for value in values] for values in (proposed, accepted))
    old, new = (Counter(used(names)) for names in (before, after))
    shares = {name: (old[name] / max(old.total(), 1), new[name] / max(new.total(), 1)) for name in old | new}
    if paired:
        changed = Counter(name for pair in zip(before, after, strict=True) if pair[0] != pair[1] for name in pair)
        variances = [changed[name] / max(new.total(), 1) ** 2 for name in shares]
    else:
        left_out = max(1 / max(new.total(), 1) - 1 / max(old.total(), 1), 0.0)
        variances = [share * (1 - share) * left_out for share, _ in shares.values()]
    rare = [name for name, (share, kept) in shares.items() if old[name] >= FEWEST and kept < RARE * share]
    moved = 0.5 * sum(abs(kept - share) for share, kept in shares.values())
    return Shift(moved, 0.5 * sum(sqrt(2 / pi * variance) for variance in variances), tuple(_named(leaf, rare)))


def used(values: Iterable[Any]) -> list[Any]:
    """The values in designs that use the parameter."""
    return [value for value in values if value is not UNUSED]


def _bin(leaf: Leaf, value: Any) -> Bin:
    if value is UNUSED:
        return UNUSED
    if isinstance(leaf.space, Choice) or value == leaf.space.default:
        return str(value)
    low, high = leaf.space.range
    return min(int(BINS * (value - low) / (high - low)), BINS - 1)


def _named(leaf: Leaf, bins: Iterable[Bin]) -> Iterator[str]:
    """The bins in words; adjacent bins as one range."""
    yield from sorted(name for name in bins if isinstance(name, str))
    numbers = enumerate(sorted(name for name in bins if isinstance(name, int)))
    for _, run in groupby(numbers, key=lambda pair: pair[1] - pair[0]):
        parts = [number for _, number in run]
        low, high = leaf.space.range
        ends = (low + (high - low) * number / BINS for number in (parts[0], parts[-1] + 1))
        yield " to ".join(f"{end:.4g}" for end in ends)
