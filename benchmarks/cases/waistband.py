"""Pressure of a waistband cut 5 % smaller than the waist, in each built-in fabric, on the neutral body.

    python -m benchmarks.run waistband --keep

A straight band, 3 cm high, with its upper edge at the waist, on a mesh of 1 cm: mean pressure of its vertices, with the
fabric's measured stiffness in the shape of the drape (`maps_of`), and median stretch. Published, at the same reduction:
17.5 ± 2.1 mmHg (Sen'i Gakkaishi 47(6), 1991). The body is rigid, cloth keeps 0.35 cm off the skin, and the body widens
below the waist: the band is stretched by more than 5 %. Nothing is fitted to the published figure.
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

MMHG = 7.50062  # per kPa


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The case has no options."""


def run(options: argparse.Namespace) -> CaseResult:
    """Drape the band in each fabric."""
    body = build_body(neutral_shape())
    size = measure(body)
    cut_for, design = replace(size, waist=0.95 * size.waist), WaistbandDesign(width=3.0 / size.hips_line)
    band = waistband(replace(cut_for, hips=cut_for.waist), design, Waistband.STRAIGHT, rise=1.0)
    mesh = build_box_mesh(assemble(band.labelled(PanelRole.BODY), "waistband"), spacing=1.0)
    jobs, figures, rows = [DrapeJob(mesh, body, size, fabric) for fabric in FABRICS.values()], [], []
    for name, job, drape in zip(FABRICS, jobs, drape_batch(jobs, device="cpu"), strict=True):
        maps, weft = maps_of(job, drape), job.fabric.pull.weft
        figures.append(Figure(name, MMHG * float(maps.pressure.mean()), "mmHg"))
        rows.append({"fabric": name, "weft [N/m]": weft, "stretch": float(np.median(maps.stretch[:, 0]))})
    return CaseResult(figures, rows)
