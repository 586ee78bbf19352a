"""Write FreeSewing designs as specification JSONs: patterns that no sampler of this package made.

    cd benchmarks/reconstruction/freesewing && npm install --legacy-peer-deps
    python -m benchmarks.reconstruction.freesewing OUT --count 200 --seed 0

Needs Node.js 20 and the packages of ``package.json`` (MIT). Each pattern is a design at a drawn size, with options
drawn between their default and FreeSewing's own limits. Drawings with an error of FreeSewing or of ``validate`` are
skipped and counted.
"""

import argparse
import json
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reconstruction.freesewing.designs import DESIGNS
from benchmarks.reconstruction.freesewing.sewing import pattern_of_drawing
from gcd_dataset.errors import ConfigError, GcdError, PatternError
from gcd_dataset.faults import require_valid
from gcd_dataset.files import make_folder
from gcd_dataset.spec import write_pattern

HERE = Path(__file__).parent
WIDEST = 0.6  # share of the way from an option's default to its limit: beyond it, several designs cannot be sewn


def requests(count: int, seed: int, designs: Sequence[str]) -> list[dict[str, Any]]:
    """``count`` requests for ``draw``, the designs in turn; request *i* depends on the seed and *i* alone."""
    drawn = []
    for number in range(count):
        rng = np.random.default_rng((seed, number))
        name = designs[number % len(designs)]
        design = DESIGNS[name]
        shares = {option: round(float(rng.uniform(-WIDEST, WIDEST)), 4) for option in design.varied}
        model = design.models[rng.integers(len(design.models))]
        drawn.append({"design": design.package, "model": model, "shares": shares, "options": dict(design.options)})
    return drawn


def draw(wanted: Sequence[dict[str, Any]], *, packages: Path = HERE) -> Iterator[dict[str, Any]]:
    """The drawings of ``draw.mjs``, in order. Raises ``ConfigError`` without Node.js or its packages."""
    node = shutil.which("node")
    if node is None:
        raise ConfigError("no program node: install Node.js 20")
    if not (packages / "node_modules" / "@freesewing" / "core").is_dir():
        raise ConfigError(f"{packages}: FreeSewing is not installed: run npm install --legacy-peer-deps there")
    lines = "".join(json.dumps(request) + "\n" for request in wanted)
    done = subprocess.run([node, packages / "draw.mjs"], input=lines, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ConfigError(f"{packages / 'draw.mjs'}: {done.stderr.strip().splitlines()[-1]}: run npm install there")
    yield from (json.loads(line) for line in done.stdout.splitlines())


def main(arguments: Sequence[str] | None = None) -> int:
    """The command. Returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reconstruction.freesewing", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("out", type=Path, help="folder for NAME_specification.json")
    parser.add_argument("--count", type=int, default=90, help="drawings (90)")
    parser.add_argument("--seed", type=int, default=0, help="seed of sizes and options (0)")
    parser.add_argument("--designs", nargs="+", choices=sorted(DESIGNS), default=sorted(DESIGNS), help="default: all")
    options = parser.parse_args(arguments)
    try:
        return _write(options)
    except GcdError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


def _write(options: argparse.Namespace) -> int:
    make_folder(options.out)
    written: Counter[str] = Counter()
    wanted = requests(options.count, options.seed, options.designs)
    for number, drawing in enumerate(draw(wanted)):
        design = options.designs[number % len(options.designs)]
        name = f"{design}_{number:05d}"
        try:
            if drawing["faults"]:
                raise PatternError(f"{name}: {drawing['faults'][0]}")
            pattern = require_valid(pattern_of_drawing(name, DESIGNS[design], drawing), source=name)
        except PatternError as error:
            print(f"skipped {str(error).splitlines()[0]}", file=sys.stderr)
            continue
        write_pattern(pattern, options.out / f"{name}_specification.json")
        written[design] += 1
    listed = ", ".join(f"{written[design]} {design}" for design in options.designs)
    print(f"{sum(written.values())} of {options.count} patterns in {options.out}: {listed}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
