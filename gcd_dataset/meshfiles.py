"""Draped garments as mesh files for other programs: OBJ with the flat pattern as texture coordinates, PLY, GLB."""

import numpy as np
import trimesh
from jaxtyping import Float

from gcd_dataset.records import Body, BoxMesh

__all__ = ["glb_bytes", "obj_bytes", "ply_bytes"]

CM_IN_METRE = 0.01  # glTF is in metres
SKIN, CLOTH = (205, 196, 188, 255), (120, 150, 190, 255)


def obj_bytes(vertices: Float[np.ndarray, "v 3"], mesh: BoxMesh) -> bytes:
    """Wavefront OBJ [cm]: one vertex list, texture coordinates in the panels' planes [cm], one group per panel.

    Vertices keep the order of the mesh. White space in a panel's name becomes an underscore, since OBJ would read
    the words as several groups.
    """
    lines = ["# gcd_dataset: centimetres, y up; vt: panel-plane coordinates in centimetres"]
    lines += [f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in vertices]
    lines += [f"vt {u:.6g} {v:.6g}" for u, v in mesh.uv]
    for panel, name in enumerate(mesh.panel_names):
        of_panel = mesh.panel_id == panel
        lines.append(f"g {'_'.join(name.split())}")
        for corner, face in zip(mesh.corners[of_panel] + 1, mesh.faces[of_panel] + 1, strict=True):
            lines.append("f " + " ".join(f"{v}/{c}" for v, c in zip(face, corner, strict=True)))
    return ("\n".join(lines) + "\n").encode()


def ply_bytes(vertices: Float[np.ndarray, "v 3"], mesh: BoxMesh) -> bytes:
    """Binary PLY [cm]."""
    return _trimesh(vertices, mesh).export(file_type="ply")


def glb_bytes(vertices: Float[np.ndarray, "v 3"], mesh: BoxMesh, body: Body) -> bytes:
    """Binary glTF [m]: the garment on its body."""
    garment = _trimesh(vertices, mesh)
    garment.visual.face_colors = CLOTH
    skin = trimesh.Trimesh(body.vertices, body.faces, process=False)
    skin.visual.face_colors = SKIN
    scene = trimesh.Scene({"garment": garment, "body": skin})
    return scene.scaled(CM_IN_METRE).export(file_type="glb")


def _trimesh(vertices: Float[np.ndarray, "v 3"], mesh: BoxMesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(np.asarray(vertices, np.float32), mesh.faces, process=False)
