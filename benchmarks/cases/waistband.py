"""Pressure of a waistband cut 5 % smaller than the waist, in each built-in fabric, on the neutral body.

    python -m benchmarks.run waistband --keep

A straight band, 3 cm high, with its upper edge at the waist. `mean` and `p90`: pressure over the band's area
(`maps_of`), with the fabric's measured stiffness in the shape of the drape; `stretch`: median along the band. Published
for a waistband at a reduction of 5 %: 17.5 ± 2.1 mmHg (Sen'i Gakkaishi 47(6), 1991). The drape keeps cloth 0.35 cm off
the skin, and the band covers the widening below the waist: it is stretched by more than 5 %. The body is rigid. No
parameter is fitted to the published figure.
"""

import argparse
from dataclasses import replace

import numpy as np

from benchmarks.cases import CaseResult, Figure
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.drape import FABRICS, DrapeJob, drape_batch, maps_of
from gcd_dataset.generator.garments.waistband import Waistband, WaistbandDesign, waistband
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.pattern import assemble
from gcd_dataset.records import PanelRole

HEIGHT = 3.0  # cm
REDUCTION = 0.05
MMHG = 7.50062  # per kPa


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--resolution", type=float, default=1.0, help="edge length of the mesh [cm]")
    parser.add_argument("--device", default="cpu")


def run(options: argparse.Namespace) -> CaseResult:
    """Drape the band in each fabric."""
    body = build_body(neutral_shape())
    size = measure(body)
    girth, design = (1 - REDUCTION) * size.waist, WaistbandDesign(waist=1.0, width=HEIGHT / size.hips_line)
    band = waistband(replace(size, waist=girth, hips=girth), design, Waistband.STRAIGHT, rise=1.0)
    mesh = build_box_mesh(assemble(band.labelled(PanelRole.BODY), "waistband"), spacing=options.resolution)
    jobs, rows = [DrapeJob(mesh, body, size, fabric) for fabric in FABRICS.values()], []
    for name, job, drape in zip(FABRICS, jobs, drape_batch(jobs, device=options.device), strict=True):
        maps, weft = maps_of(job, drape), job.fabric.pull.weft
        mean, p90 = (MMHG * float(of(maps.pressure)) for of in (np.mean, lambda each: np.quantile(each, 0.9)))
        stretch = float(np.median(maps.stretch[:, 0]))
        rows.append({"fabric": name, "weft [N/m]": weft, "stretch": stretch, "mean [mmHg]": mean, "p90 [mmHg]": p90})
    return CaseResult([Figure(f"{row['fabric']}_mean", row["mean [mmHg]"], "mmHg") for row in rows], rows)
