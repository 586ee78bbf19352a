"""Draped garments as USD: garment with a subset and a material for each panel, body, and seams as curves."""

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.errors import shown
from gcd_dataset.exports.cloth import (
    SKIN,
    TILE,
    panel_colour,
    seam_vertices,
    smooth_normals,
    texture_coordinates,
)
from gcd_dataset.exports.inputs import Draped, body_of, draped_mesh, key_of, optional, require_suffix
from gcd_dataset.files import plain_names, write_whole
from gcd_dataset.records import Body

METRES_PER_UNIT = 0.01
SEAM_WIDTH = 0.3  # cm
SEAM_COLOUR = (0.15, 0.15, 0.15)
ROUGHNESS = 0.9
LONGEST_NAME = 60  # letters
SUFFIXES = (".usd", ".usda", ".usdc")


def usd(garment: Draped, path: Path | str, *, tile: float = TILE, body: bool = True) -> None:
    """Write the draped garment, on its body, as USD: text for ``.usda``, binary for ``.usd`` and ``.usdc``.

    Centimetres (``metersPerUnit`` 0.01), y up. ``garment`` is one mesh, its vertices in the order of the sample's
    ``verts``, with texture coordinates ``primvars:st`` (1 is ``tile`` cm of cloth) and a ``GeomSubset`` with a material
    for each panel; ``seams`` are linear curves, one for each seam of the pattern, in order, from the start of its left
    edge. ``body``: whether to include the body, if the sample holds its shape. Raises ``ShardError`` for a sample
    without a drape, ``ConfigError`` for another suffix, ``ExtraMissing`` without usd-core, ``OutputError``.
    """
    path = require_suffix(path, *SUFFIXES)
    stage = _stage(garment, tile, body)
    # USD writes by suffix, and to names that it opens itself.
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / f"garment{path.suffix.lower()}"
        stage.GetRootLayer().Export(str(draft))
        write_whole(path, draft.read_bytes())


def _stage(garment: Draped, tile: float, with_body: bool) -> Any:
    pxr_usd, geom = (optional(f"pxr.{name}") for name in ("Usd", "UsdGeom"))
    draped_mesh(garment)
    stage = pxr_usd.Stage.CreateInMemory()
    geom.SetStageUpAxis(stage, geom.Tokens.y)
    geom.SetStageMetersPerUnit(stage, METRES_PER_UNIT)
    root = geom.Xform.Define(stage, f"/{_identifiers([key_of(garment)], 'garment')[0]}")
    root.GetPrim().SetCustomDataByKey("pattern", shown(garment.pattern.name))
    stage.SetDefaultPrim(root.GetPrim())
    top = str(root.GetPath())
    _add_garment(stage, top, garment, tile)
    _add_seams(stage, top, garment)
    if with_body and (body := body_of(garment)) is not None:
        _add_body(stage, top, body)
    return stage


def _add_garment(stage: Any, top: str, garment: Draped, tile: float) -> None:
    geom, shade, sdf = (optional(f"pxr.{name}") for name in ("UsdGeom", "UsdShade", "Sdf"))
    mesh, drape = draped_mesh(garment)
    cloth = _add_mesh(stage, f"{top}/garment", drape.vertices, mesh.faces)
    cloth.CreateDoubleSidedAttr(True)
    st = geom.PrimvarsAPI(cloth).CreatePrimvar("st", sdf.ValueTypeNames.TexCoord2fArray, geom.Tokens.faceVarying)
    st.Set(_array("Vec2fArray", texture_coordinates(mesh, tile)))
    st.SetIndices(_array("IntArray", mesh.corners.ravel()))
    cloth.GetPrim().SetCustomDataByKey("tile_cm", tile)
    colours = np.array([panel_colour(number) for number in range(len(mesh.panel_names))])
    display = cloth.CreateDisplayColorPrimvar(geom.Tokens.uniform)
    display.Set(_array("Vec3fArray", colours))
    display.SetIndices(_array("IntArray", mesh.panel_id))
    names = _identifiers(mesh.panel_names, "piece")
    for number, name in enumerate(names):
        faces = _array("IntArray", np.flatnonzero(mesh.panel_id == number))
        subset = geom.Subset.CreateGeomSubset(
            cloth, name, geom.Tokens.face, faces, shade.Tokens.materialBind, geom.Tokens.partition
        )
        subset.GetPrim().SetCustomDataByKey("panel", mesh.panel_names[number])
        subset.GetPrim().SetDisplayName(mesh.panel_names[number])
        _bind(stage, subset, f"{top}/materials/{name}", panel_colour(number))


def _add_seams(stage: Any, top: str, garment: Draped) -> None:
    geom = optional("pxr.UsdGeom")
    mesh, drape = draped_mesh(garment)
    lines = [drape.vertices[vertices] for vertices in seam_vertices(mesh, garment.pattern)]
    lines = [line if len(line) > 1 else np.repeat(line[:1], 2, axis=0) for line in lines if len(line)]
    if not lines:
        return
    curves = geom.BasisCurves.Define(stage, f"{top}/seams")
    curves.CreateTypeAttr(geom.Tokens.linear)
    curves.CreateWrapAttr(geom.Tokens.nonperiodic)
    points = np.concatenate(lines)
    curves.CreatePointsAttr(_array("Vec3fArray", points))
    curves.CreateCurveVertexCountsAttr(_array("IntArray", np.array([len(line) for line in lines])))
    curves.CreateWidthsAttr(_array("FloatArray", np.array([SEAM_WIDTH])))
    curves.SetWidthsInterpolation(geom.Tokens.constant)
    curves.CreateExtentAttr(_array("Vec3fArray", np.stack([points.min(0), points.max(0)])))
    curves.CreateDisplayColorPrimvar(geom.Tokens.constant).Set(_array("Vec3fArray", np.array([SEAM_COLOUR])))


def _add_body(stage: Any, top: str, body: Body) -> None:
    geom = optional("pxr.UsdGeom")
    skin = _add_mesh(stage, f"{top}/body", body.vertices, body.faces)
    skin.CreateDisplayColorPrimvar(geom.Tokens.constant).Set(_array("Vec3fArray", np.array([SKIN])))
    _bind(stage, skin, f"{top}/materials/body", SKIN)


def _add_mesh(stage: Any, path: str, vertices: np.ndarray, faces: np.ndarray) -> Any:
    """A triangle mesh with smooth normals that is not subdivided."""
    geom = optional("pxr.UsdGeom")
    mesh = geom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(_array("Vec3fArray", vertices))
    mesh.CreateFaceVertexCountsAttr(_array("IntArray", np.full(len(faces), 3)))
    mesh.CreateFaceVertexIndicesAttr(_array("IntArray", faces.ravel()))
    mesh.CreateSubdivisionSchemeAttr(geom.Tokens.none)
    mesh.CreateNormalsAttr(_array("Vec3fArray", smooth_normals(vertices, faces)))
    mesh.SetNormalsInterpolation(geom.Tokens.vertex)
    mesh.CreateExtentAttr(_array("Vec3fArray", np.stack([vertices.min(0), vertices.max(0)])))
    return mesh


def _bind(stage: Any, bound: Any, path: str, colour: tuple[float, float, float]) -> None:
    """Give a mesh or subset a material of one colour."""
    gf, sdf, shade = (optional(f"pxr.{name}") for name in ("Gf", "Sdf", "UsdShade"))
    material = shade.Material.Define(stage, path)
    shader = shade.Shader.Define(stage, f"{path}/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", sdf.ValueTypeNames.Color3f).Set(gf.Vec3f(*colour))
    shader.CreateInput("roughness", sdf.ValueTypeNames.Float).Set(ROUGHNESS)
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    shade.MaterialBindingAPI.Apply(bound.GetPrim()).Bind(material)


def _array(kind: str, values: np.ndarray) -> Any:
    """The values as an array of USD, such as ``Vec3fArray``."""
    dtype = np.int32 if kind == "IntArray" else np.float32
    return getattr(optional("pxr.Vt"), kind).FromNumpy(np.ascontiguousarray(values, dtype))


def _identifiers(names: Sequence[str], stem: str) -> list[str]:
    """A different identifier for each name, in ASCII: USD before 24.03 refuses other letters; none is ``body``."""
    plain = plain_names(names, longest=LONGEST_NAME, stem=stem)
    free = [f"_{name}" if name[0].isdigit() or name == "body" else name for name in plain]
    return [re.sub(r"\W", "_", name) for name in plain_names(free, longest=LONGEST_NAME + 1)]
