"""Fabrics: standard tests in the solver beside published targets, and one skirt in several fabrics.

    python -m benchmarks.run fabrics --sheet fabrics.jpg
    python -m benchmarks.run fabrics --fabrics gcd_soft denim --resolution 1 --device cuda:0 --sheet fabrics.jpg

The tests: Cusick's drape coefficient of a disc of 30 cm on a support of 18 cm (BS 5058, ISO 9073-9; the mean of two
discs on different meshes; one at 0.5 cm, with measured stiffness and without a target); the bending length of a strip
over an edge (Peirce; ISO 9073-7); the tensile stiffness of a hanging strip of 5 × 20 cm with a weight, at 1 % strain,
along warp, weft and bias. The targets with their citations are in `benchmarks/data/fabric_targets.csv`. Basis:
`measured` on this cloth; of its `class`; by a `relation` between measurements of other cloths; `set` by us without a
test; `none`. The relation gives drape coefficients from bending lengths, for woven fabrics between the limpest and the
stiffest of the four cloths behind it: a straight line, and as the band its residual deviation of 9.9 points. Other
bands are ours, ± 10 %.

Drape coefficient and mesh: a cotton disc stores half of its bending energy within 1 cm of the support's edge, which a
mesh of 1 or 2 cm does not resolve. The discs' spacing is therefore halved toward that edge down to 0.25 cm
(`drapemeter.EDGE`); a mesh of 2 cm reaches its spacing 3.7 cm outside the edge. `cotton_uniform_mesh_off` is the result
without: there the coefficient falls by 4 to 5 points for each doubling of the spacing. Garments have no such edge.

`in_band` is judged with the fabric as draped: `Fabric.softened` limits the tensile stiffness along warp, weft and bias
to 500 N·m/kg. `measured_stiffness` is the result at 1 cm without that limit. `-`: not run, or no target. Seconds are
those of the skirt's drape, set-up included, kernels loaded.

Off band, and why. Tensile stiffness of woven cloth: a drape limits it; with the published stiffness every test is in
band, and substeps of woven cloth are 1.7 to 5.6 times shorter (`DrapeConfig(stiffest=…)`). The limit also lowers the
drape coefficient of stiff cloth, since stretch relieves the cloth at the support's edge. Bending lengths below an edge
are not resolved. The rigidity of `cotton` is set at 1 cm.
"""

import argparse
import csv
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from benchmarks.cases import CaseResult, Figure, jpeg_file
from benchmarks.cloth_tests import Direction, bending_length, cantilever, drape_coefficient, tensile_stiffness
from gcd_dataset.errors import ConfigError
from gcd_dataset.files import write_whole
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.drape import FABRICS, DrapeConfig, DrapeJob, drape_batch, fabric_named, resolve_device
from gcd_dataset.generator.drape.fabrics import STIFFEST
from gcd_dataset.generator.drawing import contact_sheet, jpeg_bytes
from gcd_dataset.generator.garments import sample_design
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.pipeline import build_pattern
from gcd_dataset.generator.render import render_garment
from gcd_dataset.records import Drape, Outcome
from gcd_dataset.seeding import Stage, rng

FABRICS_SHOWN = ("gcd_soft", "wool_light", "denim", "gcd_stiff")
SKIRT = Overlay.from_dict(
    {
        "meta": {"upper": "none", "wb": "StraightWB", "bottom": "SkirtCircle"},
        "waistband": {"waist": 1.0, "width": 0.3},
        "flare-skirt": {"length": 0.5, "suns": 1.2, "cut": {"add": False}},
    }
)
TILE = 1024  # side of a picture before it is cropped [pixels]
CROP = np.s_[340:840, 262:762]  # rows and columns that show the skirt from waist to knees
COTTON = 68.4  # %, drape coefficient of plain-woven cotton: Gan, Ly and Steven, J. Textile Inst. 82(1), 1991


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--fabrics",
        nargs="+",
        default=FABRICS_SHOWN,
        metavar="NAME",
        help=f"fabrics of the skirt: {', '.join(FABRICS)}",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the skirt's design")
    parser.add_argument("--resolution", type=float, default=2.0, help="edge length of the skirt's mesh [cm]")
    parser.add_argument(
        "--spacing", type=float, nargs="+", default=[0.5, 1.0, 2.0], help="edge lengths of the tests' meshes [cm]"
    )
    parser.add_argument("--tests", nargs="+", default=list(FABRICS), metavar="NAME", help="fabrics that are tested")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--sheet", type=jpeg_file, help="picture of the skirt in each fabric, side by side")


def run(options: argparse.Namespace) -> CaseResult:
    """Run the standard tests of every fabric, and drape the skirt."""
    device = resolve_device(options.device)
    targets = [target for target in read_targets() if target.fabric in options.tests]
    rows = list(results(targets, options.spacing, device))
    job = _skirt(options.seed, options.resolution)
    drapes = _drape(job, options.fabrics, device)
    if options.sheet:
        pictures = [render_garment(drape.vertices, job.box_mesh, job.body, size=TILE)[0] for drape, _ in drapes]
        sheet = contact_sheet([picture[CROP] for picture in pictures], columns=len(pictures))
        write_whole(options.sheet, jpeg_bytes(sheet))
    return CaseResult(
        [
            *_shares(rows, options.spacing),
            *(_uniform(options.spacing, device) if "cotton" in options.tests else ()),
            *(Figure(f"{name}_s", seconds, "s") for name, (_, seconds) in zip(options.fabrics, drapes, strict=True)),
            *(Figure(f"{name}_frames", d.frames, "") for name, (d, _) in zip(options.fabrics, drapes, strict=True)),
            Figure("settled", float(np.mean([d.outcome is Outcome.SETTLED for d, _ in drapes])), "share"),
        ],
        rows,
    )


def _shares(rows: list[dict[str, Any]], spacings: list[float]) -> Iterator[Figure]:
    """Tests in band at each spacing, as draped and with measured stiffness; and how far cotton is from its target."""
    columns = [*(f"{spacing:g}_cm" for spacing in spacings), "measured_stiffness"]
    for test in dict.fromkeys(row["test"] for row in rows):
        for column in columns:
            judged = [row[f"in_band {column}"] for row in rows if row["test"] == test]
            judged = [inside for inside in judged if isinstance(inside, bool)]
            if judged:
                yield Figure(f"{test}_in_band_{column}", sum(judged), f"of {len(judged)}")
    for row in rows:
        if (row["fabric"], row["test"]) == ("cotton", "drape_coefficient"):
            yield from (Figure(f"cotton_off_{name}", row[name] - COTTON, "points") for name in columns[:-1])


def _uniform(spacings: list[float], device: str) -> Iterator[Figure]:
    """Error of cotton's drape coefficient on discs of uniform mesh."""
    for spacing in spacings:
        found = drape_coefficient(
            fabric_named("cotton"), spacing=spacing, specimens=SPECIMENS, edge=spacing, device=device
        )
        yield Figure(f"cotton_uniform_mesh_off_{spacing:g}_cm", found - COTTON, "points")


def _skirt(seed: int, resolution: float) -> DrapeJob:
    body = build_body(neutral_shape())
    size = measure(body)
    pattern = build_pattern(size, sample_design(rng(seed, 0, Stage.DESIGN), [size], overlay=SKIRT))
    return DrapeJob(build_box_mesh(pattern, spacing=resolution), body, size)


def _drape(job: DrapeJob, names: list[str], device: str) -> list[tuple[Drape, float]]:
    """The skirt's drape and seconds in each fabric."""
    if not names:
        raise ConfigError("give --fabrics one name or more")
    jobs = [DrapeJob(job.box_mesh, job.body, job.measurements, fabric_named(name)) for name in names]
    drape_batch(jobs[:1], DrapeConfig(max_frames=1), device=device)
    drapes = []
    for each in jobs:
        start = time.perf_counter()
        [drape] = drape_batch([each], device=device)
        drapes.append((drape, time.perf_counter() - start))
    return drapes


TARGETS = Path(__file__).resolve().parents[1] / "data" / "fabric_targets.csv"
BASES = ("measured", "class", "relation", "set", "none")
SPECIMENS = 2  # discs, whose mean is the drape coefficient; one for a fabric without a measured one
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
