"""Tucked cloth: how much narrower it lies below the waistband that is closed over it.

A waistband lays the spare cloth of a shirt in pleats, finer than a mesh can show. Their width is taken off the rest
lengths across the body, evenly round it, so that the cloth lies smooth on the skin and the waistband fits over it.
"""

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.body.section import rough_girths, section
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.holds import hangs_from_shoulders
from gcd_dataset.records import BodyPart, PanelRole

SLICE = 2.0  # cm between two levels at which girths are compared
ROOM = 0.2  # cm between skin and tucked cloth, besides the gap of all cloth
RISEN = 5.0  # cm by which a hem is worn higher than it is placed below the nape: the cloth goes round the shoulders
FULL = 1.0  # cm above the waistband where the cloth is still as narrow
BLOUSED = 8.0  # cm above that over which it widens
NARROWEST = 0.5  # of its width, the least that remains
LOWER_BODY = (BodyPart.TRUNK, BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG)


def widths(job: DrapeJob, config: DrapeConfig) -> Float[np.ndarray, " v"]:
    """The width of the cloth at each vertex across the body, as a share of its flat width; 1 where it is not tucked."""
    mesh, size = job.box_mesh, job.measurements
    width = np.ones(len(mesh.vertices))
    of_body = np.array([role == PanelRole.BODY for role in mesh.panel_labels])[mesh.panel_id]
    own, top = mesh.faces[of_body], job.tucked_below + FULL
    if not len(own) or np.isinf(top):
        return width
    worn = np.array(mesh.vertices, float)
    nape = size.height - size.head_l
    if hangs_from_shoulders(job) and np.isfinite(nape):
        worn[:, 1] += nape + RISEN - worn[own, 1].max()
    heights = worn[:, 1]
    if heights[own].min() > top:
        return width
    levels = np.arange(heights[own].min() + 0.5 * SLICE, min(top, heights[own].max()) + SLICE, SLICE)
    corners = np.concatenate([worn[own], mesh.uv[mesh.corners[of_body]]], axis=2).reshape(-1, 5)
    triangles = np.arange(len(corners)).reshape(-1, 3)
    skin = job.body.faces[np.isin(job.body.parts, [part.value for part in LOWER_BODY])[job.body.faces].all(axis=1)]
    shares: dict[float, float] = {}
    for level in levels.tolist():
        cut = section(corners, triangles, 1, level)[:, :, 3:]
        ring = section(job.body.vertices, skin, 1, level)[:, 0]
        if len(cut) and len(ring):
            [girth] = rough_girths(ring[:, [0, 2]], np.zeros(len(ring)))
            girth += 2.0 * np.pi * (config.body_gap + ROOM)
            shares[level] = float(np.clip(girth / np.linalg.norm(cut[:, 1] - cut[:, 0], axis=1).sum(), NARROWEST, 1.0))
    if not shares:
        return width
    rows = np.unique(own)
    bloused = np.clip((heights[rows] - top) / BLOUSED, 0.0, 1.0)
    width[rows] = np.interp(heights[rows], list(shares), list(shares.values())) * (1.0 - bloused) + bloused
    return width
