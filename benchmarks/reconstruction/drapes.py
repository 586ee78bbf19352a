"""Predicted drapes and motions (tasks T6 and T8): scores, and drapes by our own solver to compare with."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import shapely
import torch
from jaxtyping import Float

from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.wearers import box_mesh_of, measurements_of, wearer_of
from gcd_dataset.errors import MeshError
from gcd_dataset.generator.body.pose import pose_body
from gcd_dataset.generator.drape import DrapeJob, drape_batch
from gcd_dataset.generator.dressing.sewing_start import sewing_start
from gcd_dataset.generator.mesh.box_mesh import build_box_mesh
from gcd_dataset.generator.mesh.coarse import coarse_start
from gcd_dataset.generator.mesh.triangulate import barycentric
from gcd_dataset.metrics import DrapeScore, score_drape, score_motion
from gcd_dataset.records import BoxMesh
from gcd_dataset.scoring.draping import crossings_of, motion_crossings
from gcd_dataset.scoring.inputs import poses_of
from gcd_dataset.workers import parallel_map


@dataclass(frozen=True, eq=False)
class DrapedVertices:
    """Predicted positions of a garment's vertices: an answer."""

    vertices: Float[np.ndarray, "*t v 3"]
    """Of T8 in each frame, of which the first is given [cm]."""
    ms: float
    """Time of this garment in its batch [ms], without the preparation of meshes."""


@dataclass(frozen=True)
class TimedScore(DrapeScore):
    """Scores of the predicted drape of one garment, with its time."""

    ms: float
    """Time of a garment."""


def score_drapes(
    answers: Sequence[DrapedVertices], garments: GarmentSet, *, device: str = "auto", crossings: bool = True
) -> list[TimedScore]:
    """The scores of answers for garments; without ``crossings`` they are 0."""
    none = [[(0, 0, 0)] * len(asked(answer.vertices)) for answer in answers]
    counts = counted([answer.vertices for answer in answers], garments, device=device) if crossings else none
    found = []
    for k, (answer, count) in enumerate(zip(answers, counts, strict=True)):
        flat = garments.ragged["uv"][k].astype(float)[garments.ragged["corners"][k]]
        given, true, faces = answer.vertices, truth_of(garments, k), garments.ragged["faces"][k]
        if true.ndim == 3:
            score = score_motion(given, true, faces, flat, count)
        else:
            score = score_drape(given, true, faces, flat, count[0])
        found.append(TimedScore(**vars(score), ms=answer.ms))
    return found


def asked(vertices: Float[np.ndarray, "*t v 3"]) -> Float[np.ndarray, "t v 3"]:
    """The positions that are predicted: the drape, or the frames of a motion after the first."""
    return vertices[1:] if vertices.ndim == 3 else vertices[None]


def truth_of(garments: GarmentSet, k: int) -> Float[np.ndarray, "*t v 3"]:
    """The true positions of garment ``k``, of T8 in each frame [cm]."""
    if "motion" in garments.ragged:
        return np.asarray(garments.ragged["motion"][k].transpose(1, 0, 2), float)
    return np.asarray(garments.ragged["verts"][k], float)


# -------------------------------------------------------------------------------------------------------- the crossings


def counted(
    drapes: Sequence[Float[np.ndarray, "*t v 3"]], garments: GarmentSet, *, device: str = "auto"
) -> list[list[tuple[int, int, int]]]:
    """Crossing edges of each drape, or frame that is ``asked``, as our solver counts them: cloth and cloth, cloth and
    skin, skin and cloth.
    """
    jobs = (
        DrapeJob(box_mesh_of(garments, k), wearer_of(garments, k), measurements_of(garments, k))
        for k in range(len(drapes))
    )
    if "turns" not in garments.ragged:
        return [[counts] for counts in crossings_of(jobs, drapes, device=device)]
    found = []
    for k, (job, places) in enumerate(zip(jobs, drapes, strict=True)):
        bodies = (pose_body(job.body, pose) for pose in poses_of(garments.ragged["turns"][k][1:].astype(float)))
        found.append(list(motion_crossings(job, bodies, asked(places), device=device)))
    return found


# ------------------------------------------------------------------------------------------------------- the own solver


def redraped(garments: GarmentSet, *, spacing: float, device: torch.device, workers: int = 0) -> list[DrapedVertices]:
    """The garments draped by our solver at ``spacing`` [cm], interpolated in the panels' planes to their own meshes.

    The time is that of the drape and the interpolation. A garment that cannot be meshed keeps its box mesh.
    """
    bare = garments.without_points()
    alone = [bare.select([k]) for k in range(len(bare))]
    jobs = list(parallel_map(partial(_job, spacing), alone, workers))
    drape_batch(jobs[:1], device=str(device))  # loads the kernels
    begun = time.perf_counter()
    drapes = drape_batch(jobs, device=str(device))
    ms = 1e3 * (time.perf_counter() - begun) / len(jobs)
    tasks = zip(alone, (job.box_mesh for job in jobs), (drape.vertices for drape in drapes), strict=True)
    return list(parallel_map(partial(_interpolated, ms), tasks, workers))


def _job(spacing: float, garment: GarmentSet) -> DrapeJob:
    mesh, body = _meshed(garment, 0, spacing), wearer_of(garment, 0)
    coarse = coarse_start(mesh)
    start = sewing_start(coarse.mesh if coarse else mesh, body)
    return DrapeJob(mesh, body, measurements_of(garment, 0), coarse=coarse, start=start)


def _interpolated(ms: float, draped: tuple[GarmentSet, BoxMesh, np.ndarray]) -> DrapedVertices:
    garment, mesh, places = draped
    begun = time.perf_counter()
    vertices = transferred(places, mesh, garment, 0)
    lost = ~np.isfinite(vertices)
    vertices[lost] = garment.ragged["box"][0][lost]
    return DrapedVertices(vertices, ms + 1e3 * (time.perf_counter() - begun))


def _meshed(garments: GarmentSet, k: int, spacing: float) -> BoxMesh:
    try:
        return build_box_mesh(garments.pattern(k), spacing=spacing)
    except MeshError:
        return box_mesh_of(garments, k)


def transferred(
    values: Float[np.ndarray, "m 3"], mesh: BoxMesh, garments: GarmentSet, k: int
) -> Float[np.ndarray, "v 3"]:
    """Positions of another mesh of the same pattern, interpolated to the vertices of garment ``k``'s mesh.

    In each panel's plane the mesh is interpolated linearly; a vertex on a seam takes the mean over its panels.
    """
    ragged = garments.ragged
    uv, vertex = ragged["uv"][k].astype(float), ragged["uv_vertex"][k]
    panel = np.full(len(uv), -1)
    panel[ragged["corners"][k].ravel()] = np.repeat(ragged["panel_id"][k], 3)
    total, times = np.zeros((len(ragged["box"][k]), 3)), np.zeros(len(ragged["box"][k]))
    for number in range(len(mesh.panel_names)):
        rows, faces = np.flatnonzero(panel == number), np.flatnonzero(mesh.panel_id == number)
        if not len(rows) or not len(faces):
            continue
        flat = mesh.corners[faces]
        inside = shapely.STRtree(shapely.polygons(mesh.uv[flat])).nearest(shapely.points(uv[rows]))
        weights = barycentric(mesh.uv, flat[inside], uv[rows])
        np.add.at(total, vertex[rows], np.einsum("kn,nkd->nd", weights, values[mesh.faces[faces[inside]]]))
        np.add.at(times, vertex[rows], 1.0)
    return total / np.where(times > 0, times, np.nan)[:, None]
