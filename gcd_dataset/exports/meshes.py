"""Draped garments as GLB, OBJ, PLY and USD, panel by panel: a material each, texture coordinates in one scale."""

import json
import re
import struct
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float, Int
from PIL import Image

from gcd_dataset.curves import sample_curve
from gcd_dataset.errors import ConfigError, shown
from gcd_dataset.exports.inputs import (
    Draped,
    body_of,
    body_shapes,
    draped_mesh,
    key_of,
    motion_of,
    optional,
    require_suffix,
)
from gcd_dataset.files import open_whole, plain_names, write_whole
from gcd_dataset.generator.lay_plan import PALETTE
from gcd_dataset.generator.render.images import read_image
from gcd_dataset.generator.render.textures import require_panels
from gcd_dataset.outfits import apart
from gcd_dataset.records import Body, BoxMesh, Pattern, Sample

TILE = 10.0  # cm of cloth that a texture covers
SMALLEST_TILE, LARGEST_TILE = 0.01, 10_000.0  # cm: beyond, texture coordinates lose their digits as f32
SKIN = (0.80, 0.77, 0.74)
CURVE_POINTS = 129  # of an edge, to order the vertices of a seam along it


def texture_coordinates(mesh: BoxMesh, tile: float = TILE) -> Float[np.ndarray, "c 2"]:
    """Texture coordinates of the seam-split vertices: 1 is ``tile`` cm of cloth in all panels; v runs along the grain.

    Panels drawn from the inside are mirrored, so that a print reads from the outside. Raises ``ConfigError`` for
    a ``tile`` under 0.1 mm or over 100 m.
    """
    if not SMALLEST_TILE <= tile <= LARGEST_TILE:
        raise ConfigError(f"a texture tile of {tile:g} cm: give one from {SMALLEST_TILE:g} to {LARGEST_TILE:g} cm")
    a, b, c = (mesh.uv[mesh.corners[:, i]] for i in range(3))
    doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    is_mirrored = np.bincount(mesh.panel_id, doubled, minlength=len(mesh.panel_names)) < 0
    side = np.ones(len(mesh.uv))
    side[mesh.corners.ravel()] = np.repeat(np.where(is_mirrored, -1.0, 1.0)[mesh.panel_id], 3)
    return mesh.uv * np.stack([side, np.ones(len(side))], axis=1) / tile


def smooth_normals(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "v 3"]:
    """Unit normals of the vertices, weighted by the areas of the faces; continuous across seams."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    of_face = np.cross(b - a, c - a)
    normals = np.stack(
        [np.bincount(faces.ravel(), np.repeat(of_face[:, i], 3), minlength=len(vertices)) for i in range(3)], axis=1
    )
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 0, normals / np.maximum(length, 1e-30), [0.0, 0.0, 1.0])


def seam_vertices(mesh: BoxMesh, pattern: Pattern) -> tuple[Int[np.ndarray, " n"], ...]:
    """The vertices of each seam, from the start of its left edge to the end, in the order of ``pattern.seams``."""
    panel_of = np.zeros(len(mesh.uv), int)
    panel_of[mesh.corners.ravel()] = np.repeat(mesh.panel_id, 3)
    by_vertex = np.argsort(mesh.uv_vertex, kind="stable")
    first = np.searchsorted(mesh.uv_vertex[by_vertex], np.arange(len(mesh.vertices) + 1))
    ordered = []
    for number, seam in enumerate(pattern.seams):
        panel = pattern.panel(seam.left.panel)
        edge = panel.edge(seam.left.edge)
        line = shapely.LineString(sample_curve(*panel.edge_ends(seam.left.edge), edge.curve, CURVE_POINTS))
        number_of_panel = mesh.panel_names.index(panel.name)
        vertices = np.unique(mesh.seams[mesh.seams[:, 1] == number, 0])
        along = []
        for vertex in vertices.tolist():
            rows = by_vertex[first[vertex] : first[vertex + 1]]
            points = shapely.points(mesh.uv[rows[panel_of[rows] == number_of_panel]])
            along.append(float(line.project(points[np.argmin(line.distance(points))])) if len(points) else np.inf)
        ordered.append(vertices[np.argsort(along, kind="stable")])
    return tuple(ordered)


METRE = 0.01  # of a centimetre: glTF is in metres, USD says what its unit is
FLOAT, ARRAY_BUFFER = 5126, 34962  # componentType and target of glTF
ROUGHNESS = 0.9  # of cloth
GLB_FACTS = "gcd"
"""Key in the ``extras`` of the scene of a GLB file: names of garment and panels, centimetres of a texture tile."""

PANEL, BODY = "gcd_panel", "gcd_body"
"""Keys in the ``extras`` of the meshes of panels and body, with their names."""


def glb(
    garment: Draped,
    path: Path | str,
    *,
    tile: float = TILE,
    body: bool = True,
    textures: Mapping[str, Path | str] | None = None,
) -> None:
    """Write the draped garment, on its body, as binary glTF [m].

    A node and a material for each panel, named after it; of an outfit below a node for each garment, ``garment_0``, ….
    A fitting in motion moves: each of its frames is a morph target. ``tile``: centimetres of cloth that a texture
    covers, in both directions of every panel. ``body``: whether to include the body, if the sample holds its shape.
    ``textures``: image files by panel, each laid once over the box round its panel, v up along the grain, and read from
    the outside. Raises ``ShardError`` for a sample without a drape, ``ConfigError`` for a name that does not end in
    ``.glb``, a panel that the garment lacks and an image that cannot be read, ``OutputError``.
    """
    import trimesh

    path = require_suffix(path, ".glb")
    mesh, drape = draped_mesh(garment)
    require_panels(textures or (), mesh.panel_names, key_of(garment))
    images = {name: read_image(file) for name, file in (textures or {}).items()}
    uv, normals = texture_coordinates(mesh, tile), smooth_normals(drape.vertices, mesh.faces)
    scene, garment_of = trimesh.Scene(), _garment_of(garment)
    motion = motion_of(garment)
    frames = [] if motion is None else [smooth_normals(each, mesh.faces) for each in motion.vertices]
    shapes: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for number, (name, part) in enumerate(zip(mesh.panel_names, _part_names(mesh.panel_names), strict=True)):
        rows, corners = np.unique(mesh.corners[mesh.panel_id == number], return_inverse=True)
        if not len(rows):
            continue
        vertex = mesh.uv_vertex[rows]
        material, place = _material(name, PALETTE[number % len(PALETTE)], two=True), uv[rows]
        if name in images:
            material = _material(name, (1.0, 1.0, 1.0), two=True, image=images[name])
            place = (place - place.min(axis=0)) / np.ptp(place, axis=0)
        panel = trimesh.Trimesh(
            METRE * drape.vertices[vertex],
            corners.reshape(-1, 3),
            vertex_normals=normals[vertex],
            visual=trimesh.visual.TextureVisuals(uv=place, material=material),
            metadata={PANEL: name},
            process=False,
        )
        if motion is not None:
            shapes[part] = METRE * motion.vertices[:, vertex], np.stack([each[vertex] for each in frames])
        node = f"garment_{garment_of[number]}" if garment_of else None
        if node is not None and node not in scene.graph.nodes:
            scene.graph.update(frame_to=node)
        scene.add_geometry(panel, geom_name=part, node_name=part, parent_node_name=node)
    worn = body_of(garment) if body else None
    if worn is not None:
        scene.add_geometry(_skin(worn), geom_name="body", node_name="body")
        if motion is not None:
            bodies = body_shapes(garment)
            shapes["body"] = METRE * bodies, np.stack([smooth_normals(each, worn.faces) for each in bodies])
    scene.metadata[GLB_FACTS] = {
        "garment": key_of(garment),
        "pattern": garment.pattern.name,
        "panels": list(mesh.panel_names),
        "tile_cm": tile,
        "body": worn is not None,
    }
    data = scene.export(file_type="glb", include_normals=True)
    write_whole(path, data if motion is None else animated(data, shapes, motion.fps))


def animated(glb: bytes, shapes: Mapping[str, Sequence[Float[np.ndarray, "t v 3"]]], fps: float) -> bytes:
    """The GLB with its meshes in motion. ``shapes``: name of a mesh to its positions [m] and normals in each frame.

    The first frame is the mesh as it is. Each other frame is a morph target, which has full weight at its time.
    """
    _, _, size = struct.unpack_from("<4sII", glb)
    length, _ = struct.unpack_from("<I4s", glb, 12)
    scene: dict[str, Any] = json.loads(glb[20 : 20 + length])
    binary = bytearray(glb[28 + length : size])

    def accessor(values: Float[np.ndarray, "..."], kind: str, **extra: Any) -> int:
        data = np.ascontiguousarray(values, "<f4").tobytes()
        scene["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), **extra})
        binary.extend(data)
        rows = np.asarray(values, "<f4").reshape(-1, 3 if kind == "VEC3" else 1)
        ends = {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        view = len(scene["bufferViews"]) - 1
        scene["accessors"].append(
            {"bufferView": view, "componentType": FLOAT, "count": len(rows), "type": kind, **ends}
        )
        return len(scene["accessors"]) - 1

    binary.extend(bytes(-len(binary) % 4))
    frames = len(next(iter(shapes.values()))[0])
    for mesh in scene["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["targets"] = [
                {
                    name: accessor(each[frame] - each[0], "VEC3", target=ARRAY_BUFFER)
                    for name, each in zip(("POSITION", "NORMAL"), shapes[mesh["name"]], strict=True)
                }
                for frame in range(1, frames)
            ]
        mesh["weights"] = [0.0] * (frames - 1)
    times = accessor(np.arange(frames) / fps, "SCALAR")
    weights = accessor(np.eye(frames)[:, 1:], "SCALAR")
    moving = [number for number, node in enumerate(scene["nodes"]) if "mesh" in node]
    channels = [{"sampler": 0, "target": {"node": node, "path": "weights"}} for node in moving]
    sampler = {"input": times, "output": weights, "interpolation": "LINEAR"}
    scene["animations"] = [{"name": "motion", "channels": channels, "samplers": [sampler]}]
    scene["buffers"][0]["byteLength"] = len(binary)
    text = json.dumps(scene, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    whole = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary))
    return b"".join(
        [whole, struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", len(binary), b"BIN\0"), binary]
    )


def obj(garment: Draped, path: Path | str, *, tile: float = TILE, body: bool = True) -> None:
    """Write the draped garment, on its body, as OBJ [cm], and the materials of the panels as MTL beside it.

    The vertices of the garment come first, in the order of the sample's ``verts``: seams are sewn. The objects of an
    outfit are ``garment``, ``garment_1``, …. Else as ``glb``.
    """
    path = require_suffix(path, ".obj")
    materials = path.with_suffix(".mtl")
    mesh, drape = draped_mesh(garment)
    uv, worn = texture_coordinates(mesh, tile), body_of(garment) if body else None
    names = _part_names(re.sub(r"[\s#\\]+", "_", panel) for panel in mesh.panel_names)
    lines = [
        f"# gcd_dataset {shown(key_of(garment))}: centimetres, y up; a texture covers {tile:g} cm",
        f"mtllib {materials.name}",
        "o garment",
        *(f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in drape.vertices.tolist()),
        *(f"vt {u:.6g} {v:.6g}" for u, v in uv.tolist()),
    ]
    garment_of = _garment_of(garment) or [0] * len(names)
    for number, name in enumerate(names):
        of_panel = mesh.panel_id == number
        if number and garment_of[number] != garment_of[number - 1]:
            lines.append(f"o garment_{garment_of[number]}")
        lines += [f"g {name}", f"usemtl {name}"]
        pairs = np.stack([mesh.faces[of_panel] + 1, mesh.corners[of_panel] + 1], axis=2).reshape(-1, 6)
        lines += ["f {}/{} {}/{} {}/{}".format(*row) for row in pairs.tolist()]
    colours = [(name, PALETTE[number % len(PALETTE)]) for number, name in enumerate(names)]
    if worn is not None:
        lines += ["o body", *(f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in worn.vertices.tolist()), "usemtl body"]
        lines += ["f {} {} {}".format(*row) for row in (worn.faces + 1 + len(drape.vertices)).tolist()]
        colours.append(("body", SKIN))
    library = [
        line for name, (r, g, b) in colours for line in (f"newmtl {name}", f"Kd {r:.4g} {g:.4g} {b:.4g}", "illum 1")
    ]
    with open_whole(materials) as mtl_file, open_whole(path) as obj_file:
        mtl_file.write(("\n".join(library) + "\n").encode())
        obj_file.write(("\n".join(lines) + "\n").encode())


def ply(garment: Draped, path: Path | str) -> None:
    """Write the draped garment as binary PLY [cm], faces in the colours of their panels.

    The vertices have the order of the sample's ``verts``. Raises errors as ``glb`` does.
    """
    import trimesh

    path = require_suffix(path, ".ply")
    mesh, drape = draped_mesh(garment)
    cloth = trimesh.Trimesh(np.asarray(drape.vertices, np.float32), mesh.faces, process=False)
    colours = np.column_stack([_colours(len(mesh.panel_names)), np.ones(len(mesh.panel_names))])
    cloth.visual.face_colors = np.rint(255 * colours).astype(np.uint8)[mesh.panel_id]
    write_whole(path, cloth.export(file_type="ply"))


def _colours(count: int) -> Float[np.ndarray, "n 3"]:
    """Colours of panels, as in pictures, 0 … 1."""
    return np.array([PALETTE[number % len(PALETTE)] for number in range(count)])


def _material(name: str, colour: tuple[float, float, float], *, two: bool, image: Image.Image | None = None) -> Any:
    """A material of one colour, or with an image; ``two``: seen from both sides."""
    from trimesh.visual.material import PBRMaterial

    rgba = np.rint(255 * np.array([*colour, 1.0])).astype(np.uint8)
    options = {"metallicFactor": 0.0, "roughnessFactor": ROUGHNESS, "doubleSided": two, "baseColorTexture": image}
    return PBRMaterial(name=name, baseColorFactor=rgba, **options)


def _skin(body: Body) -> Any:
    import trimesh

    visual = trimesh.visual.TextureVisuals(
        uv=np.zeros((len(body.vertices), 2)), material=_material("body", SKIN, two=False)
    )
    normals = smooth_normals(body.vertices, body.faces)
    return trimesh.Trimesh(
        METRE * body.vertices,
        body.faces,
        vertex_normals=normals,
        visual=visual,
        metadata={BODY: body.name},
        process=False,
    )


def _garment_of(garment: Draped) -> list[int]:
    """The garment of each panel of an outfit; empty for a single garment."""
    outfit = garment.outfit
    return [number for number, worn in enumerate(outfit.garments if outfit else ()) for _ in worn.pattern.panels]


def _part_names(panels: Iterable[str]) -> list[str]:
    """The name of each panel's part: unique, not empty, and neither that of the body nor that of the scene's root."""
    names: list[str] = []
    for name in panels:
        while name in (*names, "", "body", "world"):
            name += "_"
        names.append(name)
    return names


SEAM_WIDTH = 0.3  # cm
SEAM_COLOUR = (0.15, 0.15, 0.15)
LONGEST_NAME = 60  # letters
SUFFIXES = (".usd", ".usda", ".usdc")


def usd(garment: Draped, path: Path | str, *, tile: float = TILE, body: bool = True) -> None:
    """Write the draped garment, on its body, as USD: text for ``.usda``, binary for ``.usd`` and ``.usdc``.

    Centimetres (``metersPerUnit`` 0.01), y up. ``garment`` is one mesh, its vertices in the order of the sample's
    ``verts``, with texture coordinates ``primvars:st`` (1 is ``tile`` cm of cloth) and a ``GeomSubset`` with a material
    for each panel; ``seams`` are linear curves, one for each seam of the pattern, in order, from the start of its left
    edge. Those of an outfit are ``garment_0``, ``seams_0``, …. ``body``: whether to include the body, if the sample
    holds its shape. A fitting in motion has time samples, a time code for each frame. Raises ``ShardError`` for a
    sample without a drape, ``ConfigError`` for another suffix, ``ExtraMissing`` without usd-core, ``OutputError``.
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
    geom.SetStageMetersPerUnit(stage, METRE)
    root = geom.Xform.Define(stage, f"/{_identifiers([key_of(garment)], 'garment')[0]}")
    root.GetPrim().SetCustomDataByKey("pattern", shown(garment.pattern.name))
    stage.SetDefaultPrim(root.GetPrim())
    top = str(root.GetPath())
    garments: Sequence[Draped] = apart(garment) if isinstance(garment, Sample) else [garment]
    for number, one in enumerate(garments):
        place = f"_{number}" if len(garments) > 1 else ""
        _add_garment(stage, top, place, one, tile)
        _add_seams(stage, f"{top}/seams{place}", one)
    motion = motion_of(garment)
    if motion is not None:
        stage.SetTimeCodesPerSecond(motion.fps)
        stage.SetStartTimeCode(0.0)
        stage.SetEndTimeCode(len(motion.poses) - 1.0)
    if with_body and (body := body_of(garment)) is not None:
        skin = _add_mesh(stage, f"{top}/body", body.vertices, body.faces)
        skin.CreateDisplayColorPrimvar(geom.Tokens.constant).Set(_array("Vec3fArray", np.array([SKIN])))
        _bind(stage, skin, f"{top}/materials/body", SKIN)
        if motion is not None:
            _move(skin, body_shapes(garment), body.faces)
    return stage


def _add_garment(stage: Any, top: str, place: str, garment: Draped, tile: float) -> None:
    geom, shade, sdf = (optional(f"pxr.{name}") for name in ("UsdGeom", "UsdShade", "Sdf"))
    mesh, drape = draped_mesh(garment)
    cloth = _add_mesh(stage, f"{top}/garment{place}", drape.vertices, mesh.faces)
    cloth.CreateDoubleSidedAttr(True)
    motion = motion_of(garment)
    if motion is not None:
        _move(cloth, motion.vertices, mesh.faces)
    st = geom.PrimvarsAPI(cloth).CreatePrimvar("st", sdf.ValueTypeNames.TexCoord2fArray, geom.Tokens.faceVarying)
    st.Set(_array("Vec2fArray", texture_coordinates(mesh, tile)))
    st.SetIndices(_array("IntArray", mesh.corners.ravel()))
    cloth.GetPrim().SetCustomDataByKey("tile_cm", tile)
    colours = _colours(len(mesh.panel_names))
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
        _bind(stage, subset, f"{top}/materials{place}/{name}", PALETTE[number % len(PALETTE)])


def _add_seams(stage: Any, path: str, garment: Draped) -> None:
    geom = optional("pxr.UsdGeom")
    mesh, drape = draped_mesh(garment)
    lines = [line if len(line) > 1 else line.repeat(2) for line in seam_vertices(mesh, garment.pattern) if len(line)]
    if not lines:
        return
    curves = geom.BasisCurves.Define(stage, path)
    curves.CreateTypeAttr(geom.Tokens.linear)
    curves.CreateWrapAttr(geom.Tokens.nonperiodic)
    along = np.concatenate(lines)
    points = drape.vertices[along]
    curves.CreatePointsAttr(_array("Vec3fArray", points))
    for time, vertices in enumerate(motion.vertices if (motion := motion_of(garment)) else ()):
        curves.GetPointsAttr().Set(_array("Vec3fArray", vertices[along]), time)
    curves.CreateCurveVertexCountsAttr(_array("IntArray", np.array([len(line) for line in lines])))
    curves.CreateWidthsAttr(_array("FloatArray", np.array([SEAM_WIDTH])))
    curves.SetWidthsInterpolation(geom.Tokens.constant)
    curves.CreateExtentAttr(_array("Vec3fArray", np.stack([points.min(0), points.max(0)])))
    curves.CreateDisplayColorPrimvar(geom.Tokens.constant).Set(_array("Vec3fArray", np.array([SEAM_COLOUR])))


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


def _move(mesh: Any, frames: Float[np.ndarray, "t v 3"], faces: np.ndarray) -> None:
    for time, vertices in enumerate(frames):
        mesh.GetPointsAttr().Set(_array("Vec3fArray", vertices), time)
        mesh.GetNormalsAttr().Set(_array("Vec3fArray", smooth_normals(vertices, faces)), time)
        mesh.GetExtentAttr().Set(_array("Vec3fArray", np.stack([vertices.min(0), vertices.max(0)])), time)


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
