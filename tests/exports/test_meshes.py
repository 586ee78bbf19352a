"""GLB, OBJ, PLY and USD files, read back."""

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from pxr import Usd, UsdGeom, UsdShade

from gcd_dataset import exports
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.exports.meshes import seam_vertices, smooth_normals, texture_coordinates
from gcd_dataset.generator.body import build_body, named_shape
from gcd_dataset.generator.fitting import Fitting
from gcd_dataset.outfits import apart
from gcd_dataset.records import Drape, GarmentMotion, Outcome, Pattern, Pose, Sample
from tests import helpers
from tests.exports.patterns import NAMES
from tests.helpers import parts, patch, tube
from tests.shards.folders import fake_outfit
from tools.blender_import import read_facts


def test_a_glb_has_a_node_and_a_material_for_each_panel(worn: Sample, tmp_path: Path) -> None:
    exports.glb(worn, tmp_path / "a.glb")
    scene, (mesh, drape) = trimesh.load(tmp_path / "a.glb"), parts(worn)
    assert set(scene.geometry) == {*mesh.panel_names, "body"}
    for number, name in enumerate(mesh.panel_names):
        panel = scene.geometry[name]
        assert panel.visual.material.name == name
        assert len(panel.faces) == (mesh.panel_id == number).sum()
        exact = drape.vertices[mesh.faces[mesh.panel_id == number]] / 100
        assert panel.triangles == pytest.approx(exact, abs=1e-6)  # metres
    body = scene.geometry["body"]
    assert worn.shape is not None
    assert body.extents == pytest.approx(np.ptp(build_body(worn.shape).vertices, axis=0) / 100, rel=1e-5)


def test_each_garment_of_an_outfit_is_a_part_of_its_file(tmp_path: Path) -> None:
    """A node with the panels below it, an object with its groups, a mesh of its own; all with the garment's faces."""
    sample = replace(fake_outfit(1, 3), shape=None)
    counts = [len(parts(one)[0].faces) for one in apart(sample)]
    exports.glb(sample, tmp_path / "a.glb")
    scene = trimesh.load(tmp_path / "a.glb")
    below: dict[str, int] = {}
    for node in scene.graph.nodes_geometry:
        parent = scene.graph.transforms.parents[node]
        below[parent] = below.get(parent, 0) + len(scene.geometry[scene.graph[node][1]].faces)
    assert below == {f"garment_{number}": count for number, count in enumerate(counts)}
    exports.obj(sample, tmp_path / "a.obj")
    lines = (tmp_path / "a.obj").read_text().splitlines()
    objects = [row for row, line in enumerate(lines) if line.startswith("o ")]
    assert [lines[row] for row in objects] == ["o garment", "o garment_1", "o garment_2"]
    faces = [sum(line.startswith("f ") for line in lines[a:b]) for a, b in pairwise([*objects, len(lines)])]
    assert faces == counts
    exports.ply(sample, tmp_path / "a.ply")
    assert len(trimesh.load(tmp_path / "a.ply").faces) == sum(counts)
    exports.usd(sample, tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    found = [prim for prim in stage.GetDefaultPrim().GetChildren() if prim.IsA(UsdGeom.Mesh)]
    meshes = {prim.GetName(): len(UsdGeom.Mesh(prim).GetFaceVertexCountsAttr().Get()) for prim in found}
    assert meshes == {f"garment_{number}": count for number, count in enumerate(counts)}
    exports.dxf(sample, tmp_path / "a.dxf")
    assert b"g2_front" in (tmp_path / "a.dxf").read_bytes()


def renamed(sample: Sample) -> tuple[Sample, list[str]]:
    """The sample with names in many scripts for its panels, and these names."""
    mesh, _ = parts(sample)
    names = [*NAMES[:2], *NAMES[4:7], *NAMES[10:14], *NAMES[15:]][: len(mesh.panel_names)]
    pattern = helpers.renamed(sample.pattern, dict(zip(mesh.panel_names, names, strict=True)))
    return replace(sample, pattern=pattern, box_mesh=replace(mesh, panel_names=tuple(names))), names


def test_names_in_any_script_stay_different(worn: Sample, tmp_path: Path) -> None:
    """Also those that differ in a space, or are names of the body and of a scene's root."""
    sample, names = renamed(worn)
    assert {"body", "world", "front left", "front_left", "前片", "👗"} <= set(names)
    exports.glb(sample, tmp_path / "a.glb")
    scene = trimesh.load(tmp_path / "a.glb")
    assert len(scene.graph.nodes_geometry) == len(scene.geometry) == len(names) + 1
    assert {part.metadata.get("gcd_panel") for part in scene.geometry.values()} == {None, *names}
    exports.obj(sample, tmp_path / "a.obj")
    groups = [line[2:] for line in (tmp_path / "a.obj").read_text().splitlines() if line.startswith("g ")]
    assert len(set(groups)) == len(names) and not any(" " in group or "#" in group for group in groups)
    assert {"前片", "👗", "body_"} <= set(groups)
    exports.usd(sample, tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    found = [prim for prim in stage.Traverse() if prim.GetTypeName() == "GeomSubset"]
    assert {prim.GetDisplayName() for prim in found} == set(names)
    assert all(prim.GetName().isascii() and prim.GetName() != "body" for prim in found)


def test_textures_have_one_scale(worn: Sample, tmp_path: Path) -> None:
    """A texture of 5 cm covers as many squares as the cloth has areas of 25 cm²; none is mirrored."""
    exports.glb(worn, tmp_path / "a.glb", tile=5.0, body=False)
    scene, (mesh, _) = trimesh.load(tmp_path / "a.glb"), parts(worn)
    assert "body" not in scene.geometry
    for number, name in enumerate(mesh.panel_names):
        panel = scene.geometry[name]
        assert areas(panel.visual.uv[panel.faces]) > 0
        exact = areas(mesh.uv[mesh.corners[mesh.panel_id == number]])
        assert areas(panel.visual.uv[panel.faces]) == pytest.approx(abs(exact) / 25.0, rel=1e-4)


def test_an_image_lies_once_over_the_box_round_its_panel(worn: Sample, tmp_path: Path) -> None:
    mesh, _ = parts(worn)
    name, other = mesh.panel_names[:2]
    Image.new("RGB", (8, 4), (200, 30, 30)).save(tmp_path / "red.png")
    exports.glb(worn, tmp_path / "a.glb", textures={name: tmp_path / "red.png"})
    panels = trimesh.load(tmp_path / "a.glb").geometry
    uv, material = panels[name].visual.uv, panels[name].visual.material
    assert [uv.min(axis=0).tolist(), uv.max(axis=0).tolist()] == [[0.0, 0.0], [1.0, 1.0]]
    assert material.baseColorTexture.size == (8, 4)
    assert panels[other].visual.material.baseColorTexture is None
    for files, message in (
        ({"nothing": tmp_path / "red.png"}, "has no panel nothing for a texture"),
        ({name: tmp_path / "absent.png"}, "absent.png: not a picture that can be read"),
    ):
        with pytest.raises(ConfigError, match=message):
            exports.glb(worn, tmp_path / "b.glb", textures=files)
    assert not (tmp_path / "b.glb").exists()


def areas(corners: np.ndarray) -> float:
    """Signed area of flat triangles [f, 3, 2]."""
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    return float(0.5 * (ax * by - ay * bx).sum())


def test_the_facts_of_a_glb_are_read_without_a_library(worn: Sample, tmp_path: Path) -> None:
    exports.glb(worn, tmp_path / "a.glb", tile=20.0)
    facts = read_facts(tmp_path / "a.glb")
    assert facts["panels"] == list(parts(worn)[0].panel_names)
    assert (facts["garment"], facts["tile_cm"], facts["body"]) == (worn.key, 20.0, True)
    exports.glb(replace(worn, shape=None), tmp_path / "b.glb")  # of an unknown body: alone
    assert read_facts(tmp_path / "b.glb")["body"] is False


def test_other_files_are_no_garments(tmp_path: Path) -> None:
    content = json.dumps({"scenes": [{}]}).encode()
    chunk = struct.pack("<I4s", len(content), b"JSON") + content
    (tmp_path / "a.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk)
    with pytest.raises(ValueError, match="no garment of gcd_dataset"):
        read_facts(tmp_path / "a.glb")
    (tmp_path / "a.glb").write_bytes(b"solid")
    with pytest.raises(ValueError, match="not a GLB file"):
        read_facts(tmp_path / "a.glb")


def test_an_obj_is_sewn_and_has_the_vertices_of_the_sample(worn: Sample, tmp_path: Path) -> None:
    exports.obj(worn, tmp_path / "a.obj", body=False)
    lines, (mesh, drape) = (tmp_path / "a.obj").read_text().splitlines(), parts(worn)
    vertices = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    assert vertices == pytest.approx(drape.vertices, abs=1e-3)
    faces = np.array([[c.split("/")[0] for c in line.split()[1:]] for line in lines if line.startswith("f ")], int) - 1
    assert np.array_equal(faces, mesh.faces[np.argsort(mesh.panel_id, kind="stable")])
    used = [line.split()[1] for line in lines if line.startswith("usemtl")]
    made = [line.split()[1] for line in (tmp_path / "a.mtl").read_text().splitlines() if line.startswith("newmtl")]
    assert used == made == list(mesh.panel_names)
    assert "mtllib a.mtl" in lines
    exports.obj(worn, tmp_path / "b.obj")
    scene = trimesh.load(tmp_path / "b.obj", process=False)
    assert {part.visual.material.name for part in scene.geometry.values()} == {*mesh.panel_names, "body"}


def test_a_ply_has_the_vertices_of_the_sample(worn: Sample, tmp_path: Path) -> None:
    exports.ply(worn, tmp_path / "a.ply")
    garment, (mesh, drape) = trimesh.load(tmp_path / "a.ply", process=False), parts(worn)
    assert garment.vertices == pytest.approx(drape.vertices, abs=1e-3)
    assert np.array_equal(garment.faces, mesh.faces)
    assert len({tuple(row) for row in garment.visual.face_colors[mesh.panel_id == 0].tolist()}) == 1


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd"])
def test_a_usd_stage_in_centimetres(suffix: str, worn: Sample, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    exports.usd(worn, path, tile=5.0)
    assert path.read_bytes()[:8] == (b"#usda 1." if suffix == ".usda" else b"PXR-USDC")
    stage, (mesh, drape) = Usd.Stage.Open(str(path)), parts(worn)
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    top = str(stage.GetDefaultPrim().GetPath())
    garment = UsdGeom.Mesh(stage.GetPrimAtPath(f"{top}/garment"))
    assert np.array(garment.GetPointsAttr().Get()) == pytest.approx(drape.vertices, abs=1e-3)
    assert np.array_equal(np.array(garment.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3), mesh.faces)
    st = UsdGeom.PrimvarsAPI(garment).GetPrimvar("st")
    assert st.GetInterpolation() == "faceVarying"
    flat = np.array(st.ComputeFlattened()).reshape(-1, 3, 2)
    assert areas(flat) == pytest.approx(np.abs([areas(mesh.uv[c[None]]) for c in mesh.corners]).sum() / 25.0, rel=1e-4)


def test_usd_subsets_are_the_panels_and_bind_their_materials(worn: Sample, tmp_path: Path) -> None:
    exports.usd(worn, tmp_path / "a.usdc")
    stage, (mesh, _) = Usd.Stage.Open(str(tmp_path / "a.usdc")), parts(worn)
    garment = UsdGeom.Mesh(stage.GetPrimAtPath(f"{stage.GetDefaultPrim().GetPath()}/garment"))
    subsets = UsdGeom.Subset.GetAllGeomSubsets(garment)
    assert [subset.GetPrim().GetCustomDataByKey("panel") for subset in subsets] == list(mesh.panel_names)
    for number, subset in enumerate(subsets):
        assert np.array_equal(np.array(subset.GetIndicesAttr().Get()), np.flatnonzero(mesh.panel_id == number))
        material, _ = UsdShade.MaterialBindingAPI(subset.GetPrim()).ComputeBoundMaterial()
        assert material.GetPath().name == subset.GetPath().name
    valid, reason = UsdGeom.Subset.ValidateFamily(garment, "face", "materialBind")
    assert valid, reason


def test_usd_seams_run_along_the_garment(worn: Sample, tmp_path: Path) -> None:
    """Neighbouring points of a seam are joined by an edge of the mesh; a seam has the vertices that the mesh lists."""
    exports.usd(worn, tmp_path / "a.usdc", body=False)
    stage, (mesh, drape) = Usd.Stage.Open(str(tmp_path / "a.usdc")), parts(worn)
    top = stage.GetDefaultPrim().GetPath()
    curves = UsdGeom.BasisCurves(stage.GetPrimAtPath(f"{top}/seams"))
    assert not stage.GetPrimAtPath(f"{top}/body")
    assert len(curves.GetCurveVertexCountsAttr().Get()) == len(worn.pattern.seams)
    sides = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1)
    edges = {tuple(side) for side in sides.tolist()}
    ordered = seam_vertices(mesh, worn.pattern)
    assert np.array(curves.GetPointsAttr().Get()) == pytest.approx(drape.vertices[np.concatenate(ordered)], abs=1e-3)
    for number, vertices in enumerate(ordered):
        assert set(vertices.tolist()) == set(mesh.seams[mesh.seams[:, 1] == number, 0].tolist())
        steps = np.sort(np.stack([vertices[:-1], vertices[1:]], axis=1), axis=1)
        assert all(tuple(step) in edges for step in steps.tolist())


def test_normals_of_a_tube_are_radial() -> None:
    mesh = tube(24, 6, radius=10.0)
    normals = smooth_normals(mesh.vertices, mesh.faces)
    outward = mesh.vertices * [1.0, 0.0, 1.0] / 10.0
    assert np.abs((normals * outward).sum(axis=1)) == pytest.approx(np.ones(len(normals)), abs=2e-3)


def test_a_panel_drawn_from_the_inside_is_mirrored_in_its_texture() -> None:
    sheet = patch(2, 2)
    inside = replace(sheet, corners=sheet.corners[:, ::-1])
    assert texture_coordinates(inside, 2.0) == pytest.approx(sheet.uv * [-0.5, 0.5])
    assert texture_coordinates(sheet, 2.0) == pytest.approx(sheet.uv / 2.0)


@pytest.mark.parametrize("form", ["glb", "obj", "ply", "usd"])
def test_a_sample_without_a_drape_is_refused(form: str, worn: Sample, tmp_path: Path) -> None:
    write: Callable[..., None] = getattr(exports, form)
    with pytest.raises(ShardError, match=f"sample {worn.key} holds no drape"):
        write(replace(worn, drape=None), tmp_path / f"a.{form}")
    mesh, drape = parts(worn)
    torn = replace(worn, drape=replace(drape, vertices=np.full_like(mesh.vertices, np.nan)))
    with pytest.raises(ShardError, match="its drape diverged"):
        write(torn, tmp_path / f"a.{form}")
    off = replace(worn, drape=replace(drape, outcome=Outcome.CANNOT_BE_PUT_ON))
    with pytest.raises(ShardError, match="it cannot be put on"):
        write(off, tmp_path / f"a.{form}")
    with pytest.raises(ConfigError, match="end its name in"):
        write(worn, tmp_path / "a.txt")
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def walked() -> Fitting:
    """A sheet that sinks 3 cm in the third of three frames, on a body that lifts a thigh."""
    mesh, body = patch(3, 3), build_body(named_shape("neutral"))
    poses = [Pose({"left_thigh": (0.1 * frame, 0.0, 0.0)}) for frame in range(3)]
    sunk = np.stack([mesh.vertices, mesh.vertices, mesh.vertices - [0.0, 3.0, 0.0]]).astype(np.float32)
    motion = GarmentMotion(sunk, mesh.faces, tuple(poses), 25.0, np.zeros((3, 3), int))
    drape = Drape(sunk[0], Outcome.SETTLED, 9, 0, 0, 1.0, 1.0)
    return Fitting(Pattern("sheet", (), ()), body, (), mesh, drape, {}, 0.0, 0.0, motion=motion, home=body)


def test_a_glb_moves_by_morph_targets(walked: Fitting, tmp_path: Path) -> None:
    """Read by trimesh at rest, and by pygltflib in its frames: each target has full weight at its time."""
    pygltflib = pytest.importorskip("pygltflib")
    assert walked.motion is not None
    exports.glb(walked, tmp_path / "a.glb")
    [name] = walked.box_mesh.panel_names
    scene = trimesh.load(tmp_path / "a.glb")
    assert scene.geometry[name].vertices == pytest.approx(walked.motion.vertices[0] / 100)
    gltf = pygltflib.GLTF2().load(tmp_path / "a.glb")

    def values(number: int) -> np.ndarray:
        accessor = gltf.accessors[number]
        view = gltf.bufferViews[accessor.bufferView]
        columns = 3 if accessor.type == "VEC3" else 1
        start = view.byteOffset + (accessor.byteOffset or 0)
        data = np.frombuffer(gltf.binary_blob(), "<f4", accessor.count * columns, start)
        assert accessor.max == pytest.approx(data.reshape(-1, columns).max(axis=0).tolist())
        return data.reshape(-1, columns)

    [animation] = gltf.animations
    [sampler] = animation.samplers
    assert values(sampler.input).ravel() == pytest.approx([0.0, 0.04, 0.08])
    weights = values(sampler.output).reshape(3, 2)
    np.testing.assert_array_equal(weights, [[0, 0], [1, 0], [0, 1]])
    assert {gltf.nodes[channel.target.node].name for channel in animation.channels} == {name, "body"}
    expected = {name: walked.motion.vertices, "body": np.stack([walked.body_in(frame).vertices for frame in range(3)])}
    for mesh in gltf.meshes:
        [primitive] = mesh.primitives
        at = np.stack([values(target["POSITION"]) for target in primitive.targets])
        frames = values(primitive.attributes.POSITION) + np.tensordot(weights, at, 1)
        normals = [values(target["NORMAL"]) + values(primitive.attributes.NORMAL) for target in primitive.targets]
        np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1.0, atol=1e-5)
        rows = walked.box_mesh.uv_vertex if mesh.name == name else slice(None)
        np.testing.assert_allclose(frames, expected[mesh.name][:, rows] / 100, atol=1e-6)


def test_a_usd_moves_by_time_samples(walked: Fitting, tmp_path: Path) -> None:
    assert walked.motion is not None
    exports.usd(walked, tmp_path / "a.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (25.0, 0.0, 2.0)
    for name, frames in (("garment", walked.motion.vertices), ("body", [walked.body_in(k).vertices for k in range(3)])):
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/sheet/{name}"))
        for time in range(3):
            np.testing.assert_allclose(np.array(mesh.GetPointsAttr().Get(time)), frames[time], atol=1e-4)
