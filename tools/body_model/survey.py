"""Figures of the anthropometric survey ANSUR II, and its measures taken on the model's bodies.

``survey.json`` holds means, standard deviations and correlations, and for each measure how the survey's
definition differs from ours. The survey measures the waist at the navel, tailors measure it at its narrowest
level; the functions here use the survey's definition.
"""

import functools
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.generator.body.asset import body_model, landmark_table
from gcd_dataset.generator.body.section import girth, rough_girths, section_points, tape
from gcd_dataset.generator.body.shape import FEMALE_SHARE, SEXES
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import Body, BodyPart, Measurements, Record

X, Y, Z = range(3)
XZ, ZY = [0, 2], [2, 1]
BACK = (-1.0, 0.0)  # the backward direction as (z, y), in a sagittal section
NAVEL = "navel"
BODY_DENSITY = 1.0
"""[kg/l] with half-filled lungs. Lean tissue has 1.1, fat 0.9 (Siri, 1961): with a quarter of fat it is 1.04,
and with 3 l of air in 70 l of body 1.00."""
CALF = np.linspace(0.14, 0.27, 27)  # levels between ankle and knee, as shares of the height
HANGING = np.radians(-35.0)
"""``arm_angle`` of hanging arms [rad]: 10° off the vertical, as surveys measure the breadth of shoulders."""
SPINE = 3.0  # cm; distance from the median plane within which skin counts as the spine


@dataclass(frozen=True, eq=False)
class Survey(Record):
    """The survey's figures for one sex, or for women and men together [cm, kg]."""

    measures: tuple[str, ...]
    mean: Float[np.ndarray, " m"]
    sd: Float[np.ndarray, " m"]
    tolerance: Float[np.ndarray, " m"]
    """Accepted error of a mean; NaN if the definitions differ, so that only the variation can be compared."""
    correlated: tuple[str, ...]
    """The measures with published correlations."""
    correlation: Float[np.ndarray, "c c"]


@functools.cache
def survey_of(sex: str) -> Survey:
    """The published figures for ``female`` or ``male``; ``random``: for the mixed population."""
    if sex not in SEXES:
        return _mixed(*map(survey_of, SEXES))
    table = _table()
    names, found = tuple(table["measures"]), table[sex]
    mean = np.array([found["mean"][name] for name in names])
    shares = np.array([table["measures"][name]["mean_tolerance"] for name in names], float)
    return Survey(
        measures=names,
        mean=mean,
        sd=np.array([found["sd"][name] for name in names]),
        tolerance=shares * mean,
        correlated=tuple(table["correlated"]),
        correlation=np.array(found["correlation"]),
    )


def shoulders_of(sex: str) -> dict[str, tuple[float, float]]:
    """The published breadths of shoulders with hanging arms, by name: mean and standard deviation [cm]."""
    return {name: (mean, sd) for name, (mean, sd) in _table()["shoulders"][sex].items()}


def _table() -> dict[str, Any]:
    return json.loads(Path(__file__).with_name("survey.json").read_bytes())


def _mixed(women: Survey, men: Survey) -> Survey:
    """The figures of a population of ``FEMALE_SHARE`` women, by the law of total covariance."""
    shares = np.array([FEMALE_SHARE, 1.0 - FEMALE_SHARE])
    apart = np.sqrt(shares.prod()) * (men.mean - women.mean)
    columns = [women.measures.index(name) for name in women.correlated]
    covariances = np.array([each.correlation * np.outer(each.sd[columns], each.sd[columns]) for each in (women, men)])
    covariance = np.tensordot(shares, covariances, axes=1) + np.outer(apart[columns], apart[columns])
    sd = np.sqrt(np.diag(covariance))
    mean = shares @ [women.mean, men.mean]
    return replace(
        women,
        mean=mean,
        sd=np.sqrt(shares @ [women.sd**2, men.sd**2] + apart**2),
        tolerance=women.tolerance / women.mean * mean,
        correlation=covariance / np.outer(sd, sd),
    )


def body_weight(body: Body) -> float:
    """Mass of a body [kg]: volume times ``BODY_DENSITY``."""
    a, b, c = (body.vertices[body.faces[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6 / 1000 * BODY_DENSITY


def survey_measures(body: Body, size: Measurements) -> dict[str, float]:
    """The survey's measures of a body with the model's mesh [cm, kg]; ``size``: its measures by ``measure``."""
    sites, vertices = _sites(), body.vertices
    navel, nape, crotch = (vertices[landmark_table().points[name]] for name in (NAVEL, "nape_of_neck", "crotch_point"))
    bust = vertices[[landmark_table().points[name] for name in ("bust_left", "bust_right")]].mean(axis=0)
    waist, breast = (section_points(vertices, sites.trunk, Y, at[[Y]])[0] for at in (navel, bust))
    return {
        "height": size.height,
        "weight": body_weight(body),
        "bust": size.bust,
        "navel_girth": girth(waist[:, XZ]),
        "hips": size.hips,
        "thigh": size.leg_circ,
        "calf": _calf(vertices, sites.leg, size.height),
        "wrist": size.wrist,
        "nape_height": float(nape[Y]),
        "bust_height": float(bust[Y]),
        "navel_height": float(navel[Y]),
        "crotch_height": float(crotch[Y]),
        "nape_to_navel": _down_the_back(vertices, sites.spine, nape, waist),
        "waist_breadth": float(np.ptp(waist[:, X])),
        "waist_depth": float(np.ptp(waist[:, Z])),
        "bust_depth": float(np.ptp(breast[:, Z])),
        "neck": 2.0 * size.neck_w,
        "shoulder_w": size.shoulder_w,
        "arm_length": size.arm_length,
    }


def shoulder_breadths(body: Body) -> dict[str, float]:
    """The breadths of ``shoulders_of`` on a body with the model's mesh and arms at ``HANGING`` [cm]."""
    points = {name: body.vertices[vertex] for name, vertex in landmark_table().points.items()}
    left, right, underarm = (points[name] for name in ("shoulder_left", "shoulder_right", "underarm_right"))
    upper = body.vertices[(body.vertices[:, Y] > underarm[Y]) & (body.vertices[:, Y] < left[Y])]
    return {"biacromial": float(np.linalg.norm(left - right)), "bideltoid": float(np.ptp(upper[:, X]))}


@dataclass(frozen=True, eq=False)
class _Sites(Record):
    """The edges that each section may cut."""

    trunk: Int[np.ndarray, "e 2"]
    leg: Int[np.ndarray, "e 2"]
    spine: Int[np.ndarray, "e 2"]


@functools.cache
def _sites() -> _Sites:
    model = body_model()
    arms = [part.value for part in (BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM, BodyPart.HANDS)]
    trunk = model.faces[~np.isin(model.parts, arms)[model.faces].any(axis=1)]
    leg = model.faces[(model.parts == BodyPart.RIGHT_LEG.value)[model.faces].all(axis=1)]
    middle = (np.abs(model.mean[trunk, X]) < SPINE).all(axis=1) & (model.mean[trunk, Z] < SPINE).all(axis=1)
    return _Sites(*(mesh_edges(faces).ends for faces in (trunk, leg, trunk[middle])))


def _calf(vertices: np.ndarray, leg: np.ndarray, height: float) -> float:
    points, level = section_points(vertices, leg, Y, CALF * height)
    fullest = np.unique(level)[rough_girths(points[:, XZ], level).argmax()]
    return girth(points[level == fullest][:, XZ])


def _down_the_back(vertices: np.ndarray, spine: np.ndarray, nape: np.ndarray, waist: np.ndarray) -> float:
    """Length of a tape down the spine, from the nape to the level of the waist [cm]."""
    middle = waist[np.abs(waist[:, X]) < SPINE]
    end = middle[middle[:, Z].argmin()]
    cut = section_points(vertices, spine, X, np.array([0.0]))[0]
    between = (cut[:, Y] > end[Y]) & (cut[:, Y] < nape[Y])
    return tape(np.concatenate([cut[between], [nape, end]])[:, ZY], BACK)
