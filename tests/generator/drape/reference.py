"""NumPy reference of the drape's energies and intersection tests, by definition; tests compare the kernels to it."""

import numpy as np
from jaxtyping import Bool, Float, Int

from gcd_dataset.generator.drape.fabrics import DYNE_CM, DYNES_PER_CM, POISSON, Fabric, shear_stiffness
from gcd_dataset.generator.drape.kernels.sheet import SLIVER
from gcd_dataset.records import BoxMesh


def stretch_energy(mesh: BoxMesh, x: Float[np.ndarray, "v 3"], fabric: Fabric) -> float:
    """Membrane energy of all triangles, from the strains of their sides [g cm²/s²].

    An isotropic fabric has a spring on each side, stiffness ``membrane A / L²``; other fabrics are an orthotropic sheet
    with the strain that the three side strains determine.

    A seam edge that has different lengths in its two panels has the shorter rest length in both triangles.
    """
    flat = mesh.uv[mesh.corners]
    area = 0.5 * np.abs(_cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]))
    shortest: dict[tuple[int, int], float] = {}
    for face, corners in zip(mesh.faces, flat, strict=True):
        for k in range(3):
            key = _side(face, k)
            length = float(np.linalg.norm(corners[(k + 1) % 3] - corners[k]))
            shortest[key] = min(shortest.get(key, np.inf), length)
    energy = 0.0
    for face, corners, a in zip(mesh.faces, flat, area, strict=True):
        strains = np.zeros(3)
        for k in range(3):
            i, j = _side(face, k)
            own = float(np.linalg.norm(corners[(k + 1) % 3] - corners[k]))
            strains[k] = (float(np.linalg.norm(x[j] - x[i])) - shortest[i, j]) / own
        energy += 0.5 * a * _sheet_energy(corners, strains, fabric)
    return energy


def _sheet_energy(corners: Float[np.ndarray, "3 2"], strains: Float[np.ndarray, "3"], fabric: Fabric) -> float:
    """Twice the energy per area of a sheet, from the strains along the sides of a triangle; springs for slivers."""
    along = np.roll(corners, -1, axis=0) - corners
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    rows = np.stack([*(along**2).T, along[:, 0] * along[:, 1]], axis=1)
    if fabric.isotropic or abs(np.linalg.det(rows)) < SLIVER:
        return float(fabric.membrane * strains @ strains)
    weft, warp, shear = np.linalg.solve(rows, strains)
    compliance = np.array([[1 / fabric.pull.weft, 0.0], [0.0, 1 / fabric.pull.warp]])
    compliance[0, 1] = compliance[1, 0] = -POISSON * np.sqrt(compliance[0, 0] * compliance[1, 1])
    pulled = np.array([weft, warp])
    threads = float(pulled @ np.linalg.solve(compliance, pulled))
    return DYNES_PER_CM * (threads + shear_stiffness(fabric.pull) * float(shear) ** 2)


def bending_energy(mesh: BoxMesh, x: Float[np.ndarray, "v 3"], fabric: Fabric) -> float:
    """Quadratic bending energy of all hinges (Bergou et al. 2006), from the heights of their triangles [g cm²/s²].

    With ``n0, n1`` the in-plane directions from the edge to the two opposite vertices, the bending vector is
    ``L (n0 + n1)``: directions of the *deformed* triangles, foot points and heights of the *flat* ones. The energy of
    the sheet is a third of Bergou's, see ``kernels.sheet``. A hinge that bends by a share ``s`` along the weft has the
    rigidity ``warp + 3/2 s (weft - warp)``, at least half of the softer direction's.
    """
    sides: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for f, face in enumerate(mesh.faces):
        for k in range(3):
            sides.setdefault(_side(face, k), []).append((f, k))
    flat = mesh.uv[mesh.corners]
    energy = 0.0
    for (i, j), faces in sides.items():
        if len(faces) < 2:
            continue
        vector, area, share = np.zeros(3), 0.0, 0.0
        for f, k in faces[:2]:
            a, b, c = flat[f, k], flat[f, (k + 1) % 3], flat[f, (k + 2) % 3]
            along = (b - a) / np.linalg.norm(b - a)
            foot = float((c - a) @ along) / float(np.linalg.norm(b - a))
            height = abs(float(_cross(along, c - a)))
            start, end = (i, j) if mesh.faces[f, k] == i else (j, i)
            across = x[mesh.faces[f, (k + 2) % 3]] - ((1 - foot) * x[start] + foot * x[end])
            vector += float(np.linalg.norm(b - a)) * across / height
            area += 0.5 * height * float(np.linalg.norm(b - a))
            share += 0.5 * float(along[1]) ** 2
        warp, weft = fabric.bend
        rigidity = max(warp + 1.5 * share * (weft - warp), 0.5 * min(warp, weft))
        energy += 0.5 * rigidity * DYNE_CM / area * float(vector @ vector)
    return energy


def segments_cross(*points: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, " n"]:
    """Whether segments pq cross triangles abc, by the signs of five volumes."""
    p, q, a, b, c = points
    apart = _volume(a, b, c, p) * _volume(a, b, c, q) <= 0
    sides = np.sign([_volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)])
    return apart & ((sides >= 0).all(axis=0) | (sides <= 0).all(axis=0))


def _volume(*points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, " n"]:
    a, b, c, d = points
    return (np.cross(b - a, c - a) * (d - a)).sum(axis=1)


def _cross(a: Float[np.ndarray, "*n 2"], b: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _side(face: Int[np.ndarray, "3"], k: int) -> tuple[int, int]:
    i, j = int(face[k]), int(face[(k + 1) % 3])
    return (min(i, j), max(i, j))
