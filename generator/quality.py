"""Quality of a drape: principal stretches and grades; points sampled on its surface."""

from dataclasses import replace
from math import ceil, floor

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.records import UV_STEP, BoxMesh, Drape, Grade, Outcome, Outfit, Strain, as_stored
from gcd_dataset.shards.codec import spread

__all__ = ["MAX_STRETCH", "grade_of", "grade_of_outfit", "principal_stretches", "strain_of"]

# Largest stretch of a panel (``strain_of``) of a clean garment: stretched further it is too tight. Weight alone
# stretches the default fabric by 1.41 where a dress of 2.5 m² hangs from shoulder seams of 3 cm, the shortest that are
# sampled: four layers of 3 cm carry 4.9 N, at 100 N/m.
MAX_STRETCH = 1.5
WRONG_ORDER = 0.005  # largest share of covered vertices in wrong order of two garments of a clean outfit
OUTLIERS = 1.0  # percent of a garment's faces left out at either end
PANEL_OUTLIERS = 5.0  # percent of a panel's faces; more, since a panel may have few faces
THIN = 1e-6  # cm²: a face with a smaller flat area has no defined stretch


def principal_stretches(mesh: BoxMesh, vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "f 2"]:
    """The larger and the smaller principal stretch of each face: singular values of its deformation gradient.

    1 is unstretched. Faces without flat area have stretches of 1.
    """
    (au, bu), (av, bv) = _sides(mesh.uv, mesh.corners)
    area = au * bv - av * bu
    thin = np.abs(area) < 2.0 * THIN
    scale = 1.0 / np.where(thin, 1.0, area)
    au, bu, av, bv = au * scale, bu * scale, av * scale, bv * scale
    uu, vv, uv = np.zeros((3, len(area)))
    for p, q in _sides(vertices, mesh.faces):
        along_u, along_v = p * bv - q * av, q * au - p * bu
        uu += along_u**2
        vv += along_v**2
        uv += along_u * along_v
    middle, spread = 0.5 * (uu + vv), np.hypot(0.5 * (uu - vv), uv)
    stretches = np.sqrt([middle + spread, np.maximum(middle - spread, 0.0)])
    stretches[:, thin] = 1.0
    return stretches.T


def _sides(points: Float[np.ndarray, "v d"], corners: Int[np.ndarray, "f 3"]) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each coordinate of the points: the differences of each face's second and third corner from its first.

    By coordinates, since NumPy gathers a column several times faster than rows of three.
    """
    first, second, third = np.ascontiguousarray(corners.T)
    columns = np.ascontiguousarray(np.asarray(points, float).T)
    return [(column[second] - column[first], column[third] - column[first]) for column in columns]


def strain_of(mesh: BoxMesh, vertices: Float[np.ndarray, "v 3"]) -> Strain | None:
    """The principal stretches of a garment and of each panel, without outliers; ``None`` for positions not finite.

    They are those of the mesh as shards store it, in steps of ``UV_STEP``.
    """
    if not len(mesh.faces) or not np.isfinite(vertices).all():
        return None
    stored = replace(mesh, uv=as_stored(mesh.uv, UV_STEP))
    by_panel = np.argsort(mesh.panel_id, kind="stable")
    stretches = principal_stretches(stored, vertices)[by_panel]
    first = np.searchsorted(mesh.panel_id[by_panel], range(1, len(mesh.panel_names)))
    return Strain(_ends(stretches, OUTLIERS), tuple(_ends(own, PANEL_OUTLIERS) for own in np.split(stretches, first)))


def _ends(stretches: Float[np.ndarray, "f 2"], outliers: float) -> tuple[float, float]:
    """The largest and the smallest stretch, without a share of the faces at either end [%]; 1 without faces."""
    if not len(stretches):
        return 1.0, 1.0
    largest, smallest = stretches.T
    return quantiles(largest, 1.0 - outliers / 100.0)[0], quantiles(smallest, outliers / 100.0)[0]


def quantiles(values: Float[np.ndarray, " n"], *shares: float) -> list[float]:
    """``np.quantile``, in a tenth of its time: NumPy sorts floats faster than it partitions them."""
    ordered = np.sort(values)
    places = [(floor(place), ceil(place), place % 1.0) for place in (share * (len(values) - 1) for share in shares)]
    return [float(ordered[low]) + part * float(ordered[high] - ordered[low]) for low, high, part in places]


def grade_of(drape: Drape, strain: Strain | None) -> Grade:
    """The grade of a drape by its outcome, crossings and stretch.

    ``clean``: settled, no cloth edge through cloth or the body, no body edge through cloth, and no panel stretched
    beyond ``MAX_STRETCH``. ``paper``: the outcome is ``SETTLED`` or ``OVERSTRETCHED``. The outcome carries the limits
    of Korosteleva et al. (ECCV 2024) on crossings and movement (see ``DrapeConfig``); they do not limit stretch. Else
    ``failed``.
    """
    if drape.outcome not in (Outcome.SETTLED, Outcome.OVERSTRETCHED):
        return Grade.FAILED
    crossings = drape.self_crossings + drape.body_crossings + drape.body_through
    loose = strain is not None and all(largest <= MAX_STRETCH for largest, _ in strain.panels)
    return Grade.CLEAN if drape.outcome is Outcome.SETTLED and crossings == 0 and loose else Grade.PAPER


def grade_of_outfit(outfit: Outfit) -> Grade:
    """The lowest grade of its garments, ``failed`` for one without a drape.

    ``clean`` also requires that no two garments cross, and that at most ``WRONG_ORDER`` of the covered vertices of each
    inner garment have the outer one below them.
    """
    drapes = [garment.drape for garment in outfit.garments]
    grades = {Grade.FAILED if drape is None else grade_of(drape, drape.strain) for drape in drapes}
    in_order = all(layer.crossings == 0 and layer.wrong_order <= WRONG_ORDER for layer in outfit.layers)
    if Grade.FAILED in grades:
        return Grade.FAILED
    return Grade.CLEAN if grades == {Grade.CLEAN} and in_order else Grade.PAPER


def sample_surface(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], count: int, rng: np.random.Generator
) -> Float[np.ndarray, "n 6"]:
    """``count`` points [cm] with the unit normals of their triangles, uniform by area, the first far apart.

    They have the order of the faces, then that of ``shards.codec.spread``.

    Uniform within a triangle after Osada et al., Shape Distributions (ACM TOG 2002), section 3.1.
    """
    (ux, wx), (uy, wy), (uz, wz) = sides = _sides(vertices, faces)
    normals = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    doubled_area = np.sqrt(sum(normal**2 for normal in normals))
    share = np.cumsum(doubled_area)
    # Stratified: one point in each of ``count`` equal shares of the area, so no region is missed.
    chosen = np.searchsorted(share, (np.arange(count) + rng.random(count)) / count * share[-1])
    face = np.minimum(chosen, len(faces) - 1)
    root, along = np.sqrt(rng.random(count)), rng.random(count)
    order = spread(count)
    face, root, along = face[order], root[order], along[order]
    points = np.empty((count, 6))
    points[:, :3] = np.asarray(vertices, float)[faces[face, 0]]
    scale = 1.0 / np.maximum(doubled_area[face], np.finfo(float).tiny)
    for axis in range(3):
        second, third = sides[axis]
        points[:, axis] += root * ((1.0 - along) * second[face] + along * third[face])
        points[:, 3 + axis] = normals[axis][face] * scale
    return points
