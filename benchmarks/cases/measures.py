"""Measures of meshes whose landmarks are found, against the published ones, against ours by vertex, and when broken.

``published``: share of the 26 measures of the published mean bodies within 0.5 cm (heights and girths), 1.5 cm or 3°
(what hangs on landmarks); each is a row of the table, with the cause of the difference. ``own``: the same share on
drawn bodies of ours, landmarks found against landmarks known by vertex. ``speed``: all measures of a body of ours, in
CPU-milliseconds. ``broken``: what came of damaged files (``benchmarks/broken_bodies.py``); ``wrong`` counts those that
were measured wrongly without a word.
"""

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.broken_bodies import KINDS, broken_body
from benchmarks.cases.figures import Figure, Measured
from gcd_dataset.bodyfiles import read_measurements
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.generator.body import build_body, draw_shape, measure
from gcd_dataset.generator.body.mesh_bodies import measure_file
from gcd_dataset.generator.body.tailor import model_sites, take_measures
from gcd_dataset.records import ANGLES, MEASURES, Measurements
from gcd_dataset.seeding import Stage, rng

__all__ = ["add_arguments", "run", "tolerance"]

GIRTHS_AND_HEIGHTS = ("height", "bust", "underbust", "waist", "hips", "leg_circ", "wrist")
CLOSE, NEAR, DEGREES = 0.5, 1.5, 3.0  # cm, cm, degrees
STATED = "doubtful"  # in a remark
LOOSE = {"fused": 2.5}
"""Kinds of damage that leave bumps of millimetres, on which a tape rides: by how much their tolerances grow."""
SPEED_BODIES = 100

LEVEL = "the level where it is taken"
CAUSES = {
    "height": "none: the extent of the mesh",
    "head_l": "nape vertex",
    "neck_w": "ends of the chain round the neck",
    "shoulder_w": "shoulder points",
    "shoulder_incl": "our shoulder point lies 1 cm further down the slope",
    "armscye_depth": "our underarm point is where arm and trunk part, 1 cm lower",
    "arm_length": "shoulder and wrist points",
    "arm_pose_angle": "wrist point",
    "wrist": "our tape is drawn round the narrowest section, theirs along a loop of edges",
    "bust": f"{LEVEL}; the search ends on its border in both",
    "underbust": f"{LEVEL}, under breasts the girth changes 1 cm a cm",
    "waist": f"{LEVEL}; the search ends on its border in both",
    "hips": f"{LEVEL}; the search ends on its border in both",
    "leg_circ": LEVEL,
    "waist_back_width": "depth of the side points; 1 cm forward is 2 cm of tape",
    "back_width": "depth of the side points; 1 cm forward is 2 cm of tape",
    "hip_back_width": "depth of the side points; 1 cm forward is 2 cm of tape",
    "bust_points": "breast points",
    "bum_points": "apexes of the buttocks, on a flat maximum",
    "waist_line": "nape, and the level of the waist",
    "waist_over_bust_line": "the plane's distance from the middle, where the neck's slope begins",
    "bust_line": "the plane's distance from the middle, where the neck's slope begins",
    "vert_bust_line": "nape, and the level of the bust",
    "hips_line": "levels of waist and hips",
    "hip_inclination": "side points",
    "crotch_hip_diff": "crotch point, and the level of the hips",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the case."""
    parser.add_argument("folder", type=Path, help="folder with bodies NAME.obj and their measures NAME.yaml")
    parser.add_argument("--own", type=int, default=10, help="drawn bodies of ours (default: 10)")
    parser.add_argument("--broken", type=int, default=len(KINDS), help="damaged files (default: one of each kind)")
    parser.add_argument("--seed", type=int, default=0, help="names the drawn bodies (default: 0)")


def run(options: argparse.Namespace) -> Measured:
    """Measure. Raises ``ConfigError`` for a folder without bodies."""
    names = sorted(path.stem for path in options.folder.glob("*.obj") if path.with_suffix(".yaml").is_file())
    if not names:
        raise ConfigError(f"{options.folder}: holds no body NAME.obj with its measures NAME.yaml")
    off = {name: _off_published(options.folder / name) for name in names}
    own = [_off_own(options.seed, index) for index in range(options.own)]
    broken = Counter(_fate(options.seed, index) for index in range(options.broken))
    figures = [
        Figure("published", float(np.mean([_within(one) for one in off.values()])), "of measures"),
        Figure("own", float(np.mean([_within(one) for one in own])) if own else np.nan, "of measures"),
        Figure("speed", _speed(options.seed), "CPU-ms"),
        *(Figure(f"broken_{fate}", broken[fate], "files") for fate in ("right", "stated", "error", "wrong")),
    ]
    return Measured(figures, [_row(key, off, own) for key in MEASURES])


def tolerance(key: str) -> float:
    """By how much a measure may differ [cm, degrees]."""
    if key in ANGLES:
        return DEGREES
    return CLOSE if key in GIRTHS_AND_HEIGHTS else NEAR


def _within(off: Mapping[str, float]) -> float:
    return float(np.mean([abs(by) <= tolerance(key) for key, by in off.items()]))


def _row(key: str, off: Mapping[str, Mapping[str, float]], own: list[dict[str, float]]) -> dict[str, object]:
    row: dict[str, object] = {"measure": key, "within": tolerance(key)}
    row |= {name: f"{one[key]:+.2f}" for name, one in off.items()}
    return row | {"ours, worst": max((one[key] for one in own), key=abs, default=np.nan), "cause": CAUSES[key]}


def _off_published(path: Path) -> dict[str, float]:
    taken, _ = measure_file(path.with_suffix(".obj"))
    return _off(taken.measurements, read_measurements(path.with_suffix(".yaml")))


def _off_own(seed: int, index: int) -> dict[str, float]:
    body = build_body(draw_shape(rng(seed, index, Stage.BODY)))
    unknown = replace(body, faces=np.roll(body.faces, 1, axis=0))
    return _off(measure(unknown), measure(body))


def _off(found: Measurements, known: Measurements) -> dict[str, float]:
    values, expected = found.to_file_values(), known.to_file_values()
    return {key: values[key] - expected[key] for key in MEASURES if key in expected}


def _speed(seed: int) -> float:
    bodies = [build_body(draw_shape(rng(seed, index, Stage.BODY))).vertices for index in range(SPEED_BODIES)]
    take_measures(bodies[0], model_sites())
    start = time.process_time()
    for vertices in bodies:
        take_measures(vertices, model_sites())
    return 1000 * (time.process_time() - start) / SPEED_BODIES


def _fate(seed: int, index: int) -> str:
    """``right``, ``stated`` (measured, but said to be doubtful), ``error`` or ``wrong``."""
    kind = list(KINDS)[index % len(KINDS)]
    made = broken_body(kind, rng(seed, index, Stage.BODY, 1))
    with tempfile.TemporaryDirectory() as folder:
        try:
            taken, remarks = measure_file(made.write(Path(folder)))
        except GcdError as error:
            print(f"{kind}: {str(error).replace(folder, '')}")
            return "error"
    off = {} if made.truth is None else _off(taken.measurements, made.truth)
    far = {key: round(by, 2) for key, by in off.items() if abs(by) > LOOSE.get(kind, 1.0) * tolerance(key)}
    stated = any(remark.startswith(STATED) for remark in remarks) or set(far) == {"leg_circ"} <= taken.at_border.keys()
    if made.truth is not None and not far:
        return "right"
    print(f"{kind} {index}: {far or 'measured, although nothing true can be said'}{' (stated)' if stated else ''}")
    return "stated" if stated else "wrong"
