"""Losses of the encodings of published models: each pattern encoded, decoded and scored against itself.

    python -m benchmarks.reconstruction.encoding_losses --count 100 --seed 1 [FILE...]

Prints a Markdown table over sampled patterns, or over the specification files given. An upper bound for any model that
predicts in the encoding.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from gcd_dataset.encodings import aipparel, garmentdiffusion, neuraltailor, sewformer, sewingldm
from gcd_dataset.errors import ConfigError, GcdError, PatternError
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.metrics import score_pattern
from gcd_dataset.records import Pattern
from gcd_dataset.spec import read_pattern

AGAIN: Mapping[str, Callable[[Pattern], Pattern]] = {
    "NeuralTailor, 23 × 14 × 4": lambda p: neuraltailor.decode(neuraltailor.encode(p)),
    "SewFormer, 25 × 14 × 4": lambda p: sewformer.decode(sewformer.encode(p)),
    "SewFormer, 25 × 14 × 7": lambda p: sewformer.decode(sewformer.encode(p, numbers=7)),
    "SewingLDM, 39 × 37 × 29": lambda p: sewingldm.decode(sewingldm.encode(p)),
    "GarmentDiffusion, 37 × 39 × 16": lambda p: garmentdiffusion.decode(garmentdiffusion.encode(p)),
    "AIpparel, tokens": lambda p: aipparel.decode(aipparel.encode(p)),
}
"""Encoding to encode and decode in its published size, with the thresholds of its code."""

COLUMNS = ("edge_count_acc", "iou", "panel_l2", "rot_deg", "stitch_f1", "combinatorial")


def losses_of(again: Callable[[Pattern], Pattern], patterns: Sequence[Pattern]) -> tuple[float, Mapping[str, float]]:
    """The share of the patterns for which there is room, and their mean scores; NaN if there is room for none."""
    scores = []
    for pattern in patterns:
        try:
            scores.append(score_pattern(again(pattern), pattern))
        except PatternError:
            continue
    means = {name: float(np.mean([getattr(s, name) for s in scores])) if scores else float("nan") for name in COLUMNS}
    return len(scores) / len(patterns), means


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code: 0, or 1 for a file or an option that cannot be used."""
    parser = argparse.ArgumentParser(prog="benchmarks.reconstruction.encoding_losses", description=__doc__)
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE", help="specification files, in place of samples")
    parser.add_argument("--count", type=int, default=100, help="sampled patterns (100)")
    parser.add_argument("--seed", type=int, default=1, help="of the samples (1)")
    options = parser.parse_args(arguments)
    try:
        for line in _table(options):
            print(line, flush=True)
    except GcdError as error:
        print(f"encoding_losses: {error}", file=sys.stderr)
        return 1
    return 0


def _table(options: argparse.Namespace) -> Iterator[str]:
    for name, least in (("count", 1), ("seed", 0)):
        if getattr(options, name) < least:
            raise ConfigError(f"--{name} {getattr(options, name)}: give {least} or more")
    if options.files:
        patterns = [read_pattern(path) for path in options.files]
    else:
        samples = produce(options.seed, range(options.count), MakeConfig(bodies="neutral", stage="pattern"))
        patterns = [sample.pattern for sample in samples]
    yield f"| {len(patterns)} patterns | fit | {' | '.join(COLUMNS)} |"
    yield "|---" * (len(COLUMNS) + 2) + "|"
    for name, again in AGAIN.items():
        share, means = losses_of(again, patterns)
        yield f"| {name} | {share:.2f} | {' | '.join(f'{means[column]:.3f}' for column in COLUMNS)} |"


if __name__ == "__main__":
    sys.exit(main())
