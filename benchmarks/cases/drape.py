"""Patterns from specification files draped on a body: seconds, outcomes, crossings.

    python -m benchmarks.run drape PATTERNS/*/default_body/*_specification.json \\
        --body mean_all.obj --body-apart mean_all_apart.obj --measurements mean_all.yaml --segmentation parts.json

Kernels are loaded before the clock starts. With ``--batch 1`` a garment's seconds are its own, with more its share.
"""

import argparse
from pathlib import Path

import numpy as np

from benchmarks.cases.figures import Figure, Measured
from gcd_dataset.generator.body import named_body
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_batch
from gcd_dataset.generator.fitting import Fitting, fit, needs_legs_apart, read_patterns, write_fitting
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.records import Body, Measurements, Outcome, Pattern

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the case."""
    parser.add_argument("spec", nargs="+", type=Path, help="specification JSON")
    parser.add_argument("--body", default="neutral", help="as of gcd drape")
    parser.add_argument("--body-apart", help="the same body with its legs apart, for trousers (default: --body)")
    parser.add_argument("--measurements", type=Path)
    parser.add_argument("--segmentation", type=Path)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--resolution", type=float, default=1.0, help="[cm]")
    parser.add_argument("--batch", type=int, default=1, help="garments draped at a time")
    parser.add_argument("--repeat", type=int, default=1, help="times each pattern is in the list, to fill a batch")
    parser.add_argument("--pictures", type=Path, help="folder for meshes and pictures")


def run(options: argparse.Namespace) -> Measured:
    """Drape, and gather the figures of DESIGN section 8."""
    bodies = {apart: _body(options, apart) for apart in (False, True)}

    def body_for(pattern: Pattern) -> tuple[Body, Measurements]:
        return bodies[needs_legs_apart(pattern)]

    once = read_patterns(options.spec)
    _warm_up(once[0], body_for(once[0]), options.device)
    patterns = [pattern for pattern in once for _ in range(options.repeat)]
    fitted = fit(patterns, body_for, resolution=options.resolution, device=options.device, batch=options.batch)
    fittings = []
    for fitting in fitted:
        fittings.append(fitting)
        if options.pictures:
            write_fitting(fitting, body_for(fitting.pattern)[0], options.pictures, device=options.device)
    return Measured(_figures(fittings), [fitting.row for fitting in fittings])


def _body(options: argparse.Namespace, apart: bool) -> tuple[Body, Measurements]:
    name = options.body_apart if apart and options.body_apart else options.body
    found = named_body(name, measurements=options.measurements, segmentation=options.segmentation, legs_apart=apart)
    return found[0], found[1]


def _warm_up(pattern: Pattern, wearer: tuple[Body, Measurements], device: str) -> None:
    """Compile and load what the first drape would wait for."""
    mesh = build_box_mesh(pattern, spacing=3.0)
    drape_batch([DrapeJob(mesh, *wearer)], DrapeConfig(max_frames=1), device=device)


def _figures(fittings: list[Fitting]) -> list[Figure]:
    drapes = [fitting.drape for fitting in fittings]
    crossings = {"self": [d.self_crossings for d in drapes], "body": [d.body_crossings for d in drapes]}
    return [
        Figure("s_per_garment", float(np.mean([f.drape_seconds for f in fittings])), "s"),
        Figure("mesh_s_per_garment", float(np.mean([f.mesh_seconds for f in fittings])), "s"),
        Figure("passed", float(np.mean([d.outcome is Outcome.SETTLED for d in drapes])), "share"),
        *(
            Figure(f"{kind}_p{share}", float(np.percentile(counts, share)), "edges")
            for kind, counts in crossings.items()
            for share in (50, 80, 95)
        ),
    ]
