"""Distributions of our sampler against those of GarmentCode's sampler, parameter by parameter.

Both draw designs for the neutral body and a random one. A parameter is compared over the designs whose garment uses its
section. ``distance`` is the largest difference of the two distribution functions (Kolmogorov-Smirnov); for choices,
half the sum of absolute differences of the shares (total variation). It is 0 if equal, 1 if disjoint.
"""

import argparse
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases.figures import Figure, Measured
from benchmarks.reference_sampler import reference_design, reject_reason
from gcd_dataset.errors import ConfigError
from gcd_dataset.files import write_whole
from gcd_dataset.generator.body import build_body, draw_shape, measure, neutral_shape
from gcd_dataset.generator.garments import OutfitDesign, Reject, design_to_dict, sample_design, sample_kind, try_on
from gcd_dataset.generator.garments.parameter import Choice
from gcd_dataset.generator.garments.space import Leaf, leaves
from gcd_dataset.records import Measurements
from gcd_dataset.seeding import Stage, rng

__all__ = ["add_arguments", "run"]

FEWEST = 20  # designs that must use a parameter for a comparison
Values = Mapping[str, list[Any]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=1000, help="designs of each sampler")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--plot", type=Path, help="PNG with the distributions of all parameters")


def run(options: argparse.Namespace) -> Measured:
    """Draw with both samplers and compare. Raises ``ConfigError`` for ``--count`` below 1."""
    if options.count < 1:
        raise ConfigError(f"count is {options.count}: give 1 or more")
    ours = _values(_ours(options.seed, options.count))
    reasons: Counter[str] = Counter()
    theirs = _values(_theirs(options.seed, options.count, reasons))
    rows = [_row(leaf, ours[leaf.path], theirs[leaf.path]) for leaf in leaves(OutfitDesign)]
    if options.plot:
        write_whole(options.plot, _plot(ours, theirs))
    distances = [row["distance"] for row in rows if isinstance(row["distance"], float)]
    figures = [
        Figure("distance_mean", float(np.mean(distances)), "over parameters"),
        Figure("distance_max", max(distances), ""),
        Figure("reference_accepted", options.count / reasons.total(), "of attempts"),
        *(
            Figure(f"reference_{reason}".replace(" ", "_"), count / reasons.total(), "of attempts")
            for reason, count in reasons.most_common()
            if reason
        ),
    ]
    return Measured(figures, sorted(rows, key=lambda row: str(row["distance"]), reverse=True))


def _sizes(seed: int, number: int) -> tuple[Measurements, Measurements]:
    random = measure(build_body(draw_shape(rng(seed, number, Stage.BODY))))
    return measure(build_body(neutral_shape())), random


def _ours(seed: int, count: int) -> Iterator[OutfitDesign]:
    """Designs drawn by our sampler and accepted by our rules."""
    for number in range(count):
        sizes, kind, attempt = _sizes(seed, number), sample_kind(rng(seed, number, Stage.KIND)), 0
        while True:
            design = sample_design(rng(seed, number, Stage.DESIGN, attempt), sizes, kind=kind)
            if not any(isinstance(try_on(size, design), Reject) for size in sizes):
                break
            attempt += 1
        yield design


def _theirs(seed: int, count: int, reasons: Counter[str]) -> Iterator[OutfitDesign]:
    """Designs accepted by GarmentCode's sampler; ``reasons`` counts attempts by reject reason, "" if accepted."""
    number = 0
    while reasons[""] < count:
        design = reference_design(rng(seed, number, Stage.DESIGN))
        reason = reject_reason(design, _sizes(seed, number))
        reasons[reason] += 1
        number += 1
        if not reason:
            yield design


def _values(designs: Iterator[OutfitDesign]) -> Values:
    """Values of each parameter in the designs that use it."""
    found: dict[str, list[Any]] = {leaf.path: [] for leaf in leaves(OutfitDesign)}
    for design in designs:
        tree = design_to_dict(design)
        for path, values in found.items():
            if path.split(".")[0].replace("-", "_") in design.sections_used():
                values.append(_at(tree, path))
    return found


def _at(tree: Mapping[str, Any], path: str) -> Any:
    for key in path.split("."):
        tree = tree[key]
    return tree


def _row(leaf: Leaf, ours: Sequence[Any], theirs: Sequence[Any]) -> dict[str, Any]:
    enough = min(len(ours), len(theirs)) >= FEWEST
    return {
        "parameter": leaf.path,
        "distance": round(_distance(leaf, ours, theirs), 3) if enough else "too few",
        "ours": _summary(leaf, ours),
        "GarmentCode": _summary(leaf, theirs),
        "designs, ours": len(ours),
        "designs, GarmentCode": len(theirs),
    }


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


def _plot(ours: Values, theirs: Values) -> bytes:
    """PNG: histograms of all parameters, ours filled, theirs as a line."""
    import io

    from matplotlib.figure import Figure as Page

    shown = [leaf for leaf in leaves(OutfitDesign) if min(len(ours[leaf.path]), len(theirs[leaf.path])) >= FEWEST]
    columns = 8
    page = Page(figsize=(2.6 * columns, 1.5 * -(-len(shown) // columns)), layout="constrained")
    for number, leaf in enumerate(shown, 1):
        axes = page.add_subplot(-(-len(shown) // columns), columns, number)
        _histogram(axes, leaf, ours[leaf.path], theirs[leaf.path])
    file = io.BytesIO()
    page.savefig(file, format="png", dpi=80)
    return file.getvalue()


def _histogram(axes: Any, leaf: Leaf, ours: Sequence[Any], theirs: Sequence[Any]) -> None:
    axes.set_title(leaf.path, fontsize=7)
    axes.tick_params(labelsize=5)
    axes.set_yticks([])
    if isinstance(leaf.space, Choice):
        options = [str(option) for option in leaf.space.range]
        shares = [
            [list(map(str, values)).count(option) / len(values) for option in options] for values in (ours, theirs)
        ]
        axes.bar(range(len(options)), shares[0], color="#7aa6c2")
        axes.step(np.arange(-1, len(options) + 1), [0, *shares[1], 0], where="mid", color="black", linewidth=0.8)
        axes.set_xticks(range(len(options)), [option[:9] for option in options], rotation=40)
        return
    low, high = leaf.space.range
    bins = np.linspace(low, high, 25)
    axes.hist(ours, bins, density=True, color="#7aa6c2")
    axes.hist(theirs, bins, density=True, histtype="step", color="black", linewidth=0.8)
