"""Draped garments as GLB, OBJ and PLY, panel by panel: a material each, texture coordinates in one scale."""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.errors import shown
from gcd_dataset.exports.cloth import SKIN, TILE, panel_colour, smooth_normals, texture_coordinates
from gcd_dataset.exports.inputs import Draped, body_of, draped_mesh, key_of, require_suffix
from gcd_dataset.files import open_whole, write_whole
from gcd_dataset.records import Body

METRE = 0.01  # of a centimetre: glTF is in metres
ROUGHNESS = 0.9  # of cloth
GLB_FACTS = "gcd"
"""Key in the ``extras`` of the scene of a GLB file: names of garment and panels, centimetres of a texture tile."""

PANEL, BODY = "gcd_panel", "gcd_body"
"""Keys in the ``extras`` of the meshes of panels and body, with their names."""


def glb(garment: Draped, path: Path | str, *, tile: float = TILE, body: bool = True) -> None:
    """Write the draped garment, on its body, as binary glTF [m].

    A node and a material for each panel, named after it. ``tile``: centimetres of cloth that a texture covers, in both
    directions of every panel. ``body``: whether to include the body, if the sample holds its shape. Raises
    ``ShardError`` for a sample without a drape, ``ConfigError`` for a name that does not end in ``.glb``,
    ``OutputError``.
    """
    path = require_suffix(path, ".glb")
    write_whole(path, glb_bytes(garment, tile=tile, body=body))


def obj(garment: Draped, path: Path | str, *, tile: float = TILE, body: bool = True) -> None:
    """Write the draped garment, on its body, as OBJ [cm], and the materials of the panels as MTL beside it.

    The vertices of the garment come first, in the order of the sample's ``verts``: seams are sewn. Else as ``glb``.
    """
    path = require_suffix(path, ".obj")
    materials = path.with_suffix(".mtl")
    text, library = obj_text(garment, materials=materials.name, tile=tile, body=body)
    with open_whole(materials) as mtl_file, open_whole(path) as obj_file:
        mtl_file.write(library.encode())
        obj_file.write(text.encode())


def ply(garment: Draped, path: Path | str) -> None:
    """Write the draped garment as binary PLY [cm], faces in the colours of their panels.

    The vertices have the order of the sample's ``verts``. Raises errors as ``glb`` does.
    """
    path = require_suffix(path, ".ply")
    write_whole(path, ply_bytes(garment))


def glb_bytes(garment: Draped, *, tile: float = TILE, body: bool = True) -> bytes:
    """The content of the file that ``glb`` writes."""
    import trimesh

    mesh, drape = draped_mesh(garment)
    uv, normals = texture_coordinates(mesh, tile), smooth_normals(drape.vertices, mesh.faces)
    scene = trimesh.Scene()
    for number, (name, part) in enumerate(zip(mesh.panel_names, _part_names(mesh.panel_names), strict=True)):
        rows, corners = np.unique(mesh.corners[mesh.panel_id == number], return_inverse=True)
        if not len(rows):
            continue
        vertex = mesh.uv_vertex[rows]
        panel = trimesh.Trimesh(
            METRE * drape.vertices[vertex],
            corners.reshape(-1, 3),
            vertex_normals=normals[vertex],
            visual=trimesh.visual.TextureVisuals(uv=uv[rows], material=_material(name, panel_colour(number), two=True)),
            metadata={PANEL: name},
            process=False,
        )
        scene.add_geometry(panel, geom_name=part, node_name=part)
    worn = body_of(garment) if body else None
    if worn is not None:
        scene.add_geometry(_skin(worn), geom_name="body", node_name="body")
    scene.metadata[GLB_FACTS] = {
        "garment": key_of(garment),
        "pattern": garment.pattern.name,
        "panels": list(mesh.panel_names),
        "tile_cm": tile,
        "body": worn is not None,
    }
    return scene.export(file_type="glb", include_normals=True)


def obj_text(garment: Draped, *, materials: str, tile: float = TILE, body: bool = True) -> tuple[str, str]:
    """The contents of the OBJ file and of the MTL file called ``materials``."""
    mesh, drape = draped_mesh(garment)
    uv, worn = texture_coordinates(mesh, tile), body_of(garment) if body else None
    names = _part_names(re.sub(r"[\s#\\]+", "_", panel) for panel in mesh.panel_names)
    lines = [
        f"# gcd_dataset {shown(key_of(garment))}: centimetres, y up; a texture covers {tile:g} cm",
        f"mtllib {materials}",
        "o garment",
        *(f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in drape.vertices.tolist()),
        *(f"vt {u:.6g} {v:.6g}" for u, v in uv.tolist()),
    ]
    for number, name in enumerate(names):
        of_panel = mesh.panel_id == number
        lines += [f"g {name}", f"usemtl {name}"]
        pairs = np.stack([mesh.faces[of_panel] + 1, mesh.corners[of_panel] + 1], axis=2).reshape(-1, 6)
        lines += ["f {}/{} {}/{} {}/{}".format(*row) for row in pairs.tolist()]
    colours = [(name, panel_colour(number)) for number, name in enumerate(names)]
    if worn is not None:
        lines += ["o body", *(f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in worn.vertices.tolist()), "usemtl body"]
        lines += ["f {} {} {}".format(*row) for row in (worn.faces + 1 + len(drape.vertices)).tolist()]
        colours.append(("body", SKIN))
    library = [
        line for name, (r, g, b) in colours for line in (f"newmtl {name}", f"Kd {r:.4g} {g:.4g} {b:.4g}", "illum 1")
    ]
    return "\n".join(lines) + "\n", "\n".join(library) + "\n"


def ply_bytes(garment: Draped) -> bytes:
    """The content of the file that ``ply`` writes."""
    import trimesh

    mesh, drape = draped_mesh(garment)
    colours = np.array([panel_colour(number) for number in range(len(mesh.panel_names))])
    cloth = trimesh.Trimesh(np.asarray(drape.vertices, np.float32), mesh.faces, process=False)
    cloth.visual.face_colors = np.rint(255 * np.column_stack([colours, np.ones(len(colours))])).astype(np.uint8)[
        mesh.panel_id
    ]
    return cloth.export(file_type="ply")


def _material(name: str, colour: tuple[float, float, float], *, two: bool) -> Any:
    """A material of one colour; ``two``: seen from both sides."""
    from trimesh.visual.material import PBRMaterial

    rgba = np.rint(255 * np.array([*colour, 1.0])).astype(np.uint8)
    return PBRMaterial(name=name, baseColorFactor=rgba, metallicFactor=0.0, roughnessFactor=ROUGHNESS, doubleSided=two)


def _skin(body: Body) -> Any:
    import trimesh

    visual = trimesh.visual.TextureVisuals(
        uv=np.zeros((len(body.vertices), 2)), material=_material("body", SKIN, two=False)
    )
    return trimesh.Trimesh(METRE * body.vertices, body.faces, visual=visual, metadata={BODY: body.name}, process=False)


def _part_names(panels: Iterable[str]) -> list[str]:
    """A name for the part of each panel: none is empty, another's, that of the body, or of the root of a scene."""
    names: list[str] = []
    for name in panels:
        while name in (*names, "", "body", "world"):
            name += "_"
        names.append(name)
    return names
