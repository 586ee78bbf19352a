"""Measures with landmarks found on the mesh: against published ones, and against landmarks known by vertex.

``published``: share of the 26 measures of the published mean bodies within 0.5 cm (heights and girths), 1.5 cm or 3°
(measures that depend on landmarks); one row of the table per measure, with the cause of the difference. ``own``: the
same share on drawn bodies, landmarks found against landmarks known by vertex. ``speed``: CPU-milliseconds for all
measures of a drawn body.
"""

import argparse
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.cases import CaseResult, Figure
from gcd_dataset.bodyfiles import read_measurements
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.body import build_body, draw_shape, measure
from gcd_dataset.generator.body.mesh_bodies import measure_file
from gcd_dataset.generator.body.tailor import model_sites, take_measures
from gcd_dataset.records import ANGLES, MEASURES, Measurements
from gcd_dataset.seeding import Stage, rng

GIRTHS_AND_HEIGHTS = ("height", "bust", "underbust", "waist", "hips", "leg_circ", "wrist")
CLOSE, NEAR, DEGREES = 0.5, 1.5, 3.0  # tolerances: heights and girths [cm], other lengths [cm], angles [degrees]
SPEED_BODIES = 100

LEVEL = "height at which it is measured"
CAUSES = {
    "height": "exact: the extent of the mesh",
    "head_l": "position of the nape point",
    "neck_w": "ends of the path round the neck",
    "shoulder_w": "positions of the shoulder points",
    "shoulder_incl": "our shoulder point lies 1 cm further down the slope",
    "armscye_depth": "our underarm point, where arm and trunk separate, is 1 cm lower",
    "arm_length": "positions of the shoulder and wrist points",
    "arm_pose_angle": "position of the wrist point",
    "wrist": "our tape follows the narrowest section, theirs a loop of mesh edges",
    "bust": f"{LEVEL}; both searches end at their limit",
    "underbust": f"{LEVEL}; below the breasts the girth changes by 1 cm per cm of height",
    "waist": f"{LEVEL}; both searches end at their limit",
    "hips": f"{LEVEL}; both searches end at their limit",
    "leg_circ": LEVEL,
    "waist_back_width": "depth of the side points: moved 1 cm forward, they lengthen the tape by 2 cm",
    "back_width": "depth of the side points: moved 1 cm forward, they lengthen the tape by 2 cm",
    "hip_back_width": "depth of the side points: moved 1 cm forward, they lengthen the tape by 2 cm",
    "bust_points": "positions of the breast points",
    "bum_points": "positions of the apexes of the buttocks, whose maximum is flat",
    "waist_line": "nape point and waist level",
    "waist_over_bust_line": "distance of the section plane from the middle, near the start of the neck's slope",
    "bust_line": "distance of the section plane from the middle, near the start of the neck's slope",
    "vert_bust_line": "nape point and bust level",
    "hips_line": "waist and hip levels",
    "hip_inclination": "positions of the side points",
    "crotch_hip_diff": "crotch point and hip level",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, help="folder with bodies NAME.obj and their measures NAME.yaml")
    parser.add_argument("--own", type=int, default=10, help="drawn bodies (default: 10)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the drawn bodies (default: 0)")


def run(options: argparse.Namespace) -> CaseResult:
    """Measure all bodies. Raises ``ConfigError`` for a folder without bodies."""
    names = sorted(path.stem for path in options.folder.glob("*.obj") if path.with_suffix(".yaml").is_file())
    if not names:
        raise ConfigError(f"{options.folder}: no body NAME.obj with its measures NAME.yaml in it")
    differences = {name: _published_differences(options.folder / name) for name in names}
    own = [_own_differences(options.seed, index) for index in range(options.own)]
    figures = [
        Figure("published", float(np.mean([_within(one) for one in differences.values()])), "of measures"),
        Figure("own", float(np.mean([_within(one) for one in own])) if own else np.nan, "of measures"),
        Figure("speed", _speed(options.seed), "CPU-ms"),
    ]
    return CaseResult(figures, [_row(key, differences, own) for key in MEASURES])


def tolerance(key: str) -> float:
    """Tolerance of a measure [cm, degrees]."""
    if key in ANGLES:
        return DEGREES
    return CLOSE if key in GIRTHS_AND_HEIGHTS else NEAR


def _within(differences: Mapping[str, float]) -> float:
    return float(np.mean([abs(difference) <= tolerance(key) for key, difference in differences.items()]))


def _row(key: str, differences: Mapping[str, Mapping[str, float]], own: list[dict[str, float]]) -> dict[str, object]:
    row: dict[str, object] = {"measure": key, "within": tolerance(key)}
    row |= {name: f"{one[key]:+.2f}" for name, one in differences.items()}
    return row | {"ours, worst": max((one[key] for one in own), key=abs, default=np.nan), "cause": CAUSES[key]}


def _published_differences(path: Path) -> dict[str, float]:
    found, _ = measure_file(path.with_suffix(".obj"))
    return _differences(found.measurements, read_measurements(path.with_suffix(".yaml")))


def _own_differences(seed: int, index: int) -> dict[str, float]:
    body = build_body(draw_shape(rng(seed, index, Stage.BODY)))
    unknown = replace(body, faces=np.roll(body.faces, 1, axis=0))
    return _differences(measure(unknown), measure(body))


def _differences(found: Measurements, known: Measurements) -> dict[str, float]:
    values, expected = found.to_file_values(), known.to_file_values()
    return {key: values[key] - expected[key] for key in MEASURES if key in expected}


def _speed(seed: int) -> float:
    bodies = [build_body(draw_shape(rng(seed, index, Stage.BODY))).vertices for index in range(SPEED_BODIES)]
    take_measures(bodies[0], model_sites())
    start = time.process_time()
    for vertices in bodies:
        take_measures(vertices, model_sites())
    return 1000 * (time.process_time() - start) / SPEED_BODIES
