"""Bodies in all mesh formats have the same vertices and measures; malformed files give one-line errors."""

import codecs
import json
import struct
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body import build_body, draw_shape, named_body
from gcd_dataset.generator.body.mesh_bodies import measure_file, read_body, read_mesh
from gcd_dataset.records import Body
from gcd_dataset.release.meshes import read_obj
from gcd_dataset.seeding import Stage, rng


@cache
def person() -> Body:
    return build_body(draw_shape(rng(5, 1, Stage.BODY)))


def mesh_of(*, ours: bool, metres: bool) -> trimesh.Trimesh:
    """The person's mesh; with its faces in another order it is not recognised as the model's."""
    faces = person().faces if ours else np.roll(person().faces, 1, axis=0)
    return trimesh.Trimesh(person().vertices * (0.01 if metres else 1.0), faces, process=False)


@cache
def measures_in_obj(folder: Path, ours: bool) -> dict[str, float]:
    mesh_of(ours=ours, metres=False).export(folder / f"{ours}.obj")
    return measure_file(folder / f"{ours}.obj")[0].measurements.to_file_values()


@pytest.mark.parametrize(("kind", "ours"), [("stl", True), ("ply", True), ("glb", False)])
def test_every_kind_of_file_gives_the_measures_of_obj(
    kind: str, ours: bool, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    mesh_of(ours=ours, metres=kind == "glb").export(tmp_path / f"me.{kind}")
    result, remarks = measure_file(tmp_path / f"me.{kind}")
    assert not any("coarse" in remark for remark in remarks)
    expected = measures_in_obj(tmp_path_factory.getbasetemp(), ours)
    assert result.measurements.to_file_values() == pytest.approx(expected, abs=0.05)


def test_a_body_in_a_mesh_file_can_be_dressed(tmp_path: Path) -> None:
    mesh_of(ours=True, metres=True).export(tmp_path / "me.glb")
    body, size, shape = named_body(tmp_path / "me.glb")
    assert shape is None
    assert np.array_equal(body.parts, person().parts)
    assert body.vertices == pytest.approx(person().vertices, abs=1e-3)
    assert size.height == pytest.approx(np.ptp(person().vertices[:, 1]), abs=1e-3)


def test_corners_of_stl_are_merged_in_order_of_appearance(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=80.0)
    ball.export(tmp_path / "ball.stl")
    vertices, faces = read_mesh(tmp_path / "ball.stl")
    assert len(vertices) == len(ball.vertices)
    assert vertices[faces] == pytest.approx(ball.triangles, abs=1e-4)
    firsts = np.unique(faces.ravel(), return_index=True)[1]
    assert (np.diff(firsts) > 0).all()


def test_transforms_of_nodes_are_honoured(tmp_path: Path) -> None:
    """A body lying on its side at half size, under two nodes that rotate and enlarge it."""
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    scene = trimesh.Scene()
    lying = mesh_of(ours=True, metres=True).apply_transform(np.linalg.inv(turn)).apply_scale(0.5)
    scene.graph.update(frame_from="world", frame_to="outer", matrix=np.diag([2.0, 2.0, 2.0, 1.0]))
    scene.add_geometry(lying, node_name="inner", parent_node_name="outer", transform=turn)
    scene.export(tmp_path / "me.glb")
    vertices, _ = read_mesh(tmp_path / "me.glb")
    assert 100.0 * vertices == pytest.approx(person().vertices, abs=1e-3)


def test_eyes_beside_a_body_are_read_and_a_garment_is_an_error(tmp_path: Path) -> None:
    eye = trimesh.creation.icosphere(radius=0.012).apply_translation([0.03, 1.6, 0.08])
    body = mesh_of(ours=False, metres=True)
    trimesh.Scene({"body": body, "eye": eye}).export(tmp_path / "eye.glb")
    vertices, _ = read_mesh(tmp_path / "eye.glb")
    assert len(vertices) == len(body.vertices) + len(eye.vertices)
    shirt = body.copy().apply_scale(1.02)
    trimesh.Scene({"body": body, "shirt": shirt}).export(tmp_path / "both.glb")
    with pytest.raises(
        BodyError, match=r"both\.glb: holds 2 meshes \(body, shirt\), none .* the body: export it alone"
    ):
        read_mesh(tmp_path / "both.glb")


def test_vertices_of_obj_keep_their_numbers(tmp_path: Path) -> None:
    """With materials, groups, texture seams and an unused vertex; trimesh would renumber them."""
    text = (
        "mtllib a.mtl\no body\nv 0 0 0\nv 1 0 0\nv 9 9 9\nv 0 170 0 1 0 0\nv 5 5 5\n"
        "vt 0 0\nvt 1 1\nvn 0 0 1\nusemtl skin\nf 1/1/1 2/2/1 4/1/1\ng arm\nusemtl nail\nf 4//1 \\\n2//1 5//1\n"
        "f -1 -2 -5\n"
    )
    (tmp_path / "a.obj").write_text(text)
    vertices, faces = read_mesh(tmp_path / "a.obj")
    assert vertices.tolist() == [[0, 0, 0], [1, 0, 0], [9, 9, 9], [0, 170, 0], [5, 5, 5]]
    assert faces.tolist() == [[0, 1, 3], [3, 1, 4], [4, 3, 0]]


def test_relative_vertex_numbers_count_from_their_line(tmp_path: Path) -> None:
    """As written object by object, after a byte order mark; of the published bodies too."""
    triangle = "v 0 0 %d\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\n"
    text = triangle % 1 + "f -3/-1/-1 -2/-1/-1 -1/-1/-1\n" + triangle % 2 + "f -3//-1 -2//-1 3\n"
    (tmp_path / "a.obj").write_bytes(codecs.BOM_UTF8 + text.encode())
    vertices, faces = read_mesh(tmp_path / "a.obj")
    assert faces.tolist() == [[0, 1, 2], [3, 4, 2]]
    assert vertices[:, 2].tolist() == [1, 0, 0, 2, 0, 0]
    published = read_obj(tmp_path / "a.obj")
    assert published.triangles().tolist() == faces.tolist()
    assert published.positions().tolist() == vertices.tolist()


def test_a_floor_of_a_scene_is_not_its_body(tmp_path: Path) -> None:
    floor = trimesh.creation.box((1.3, 0.01, 1.3)).apply_translation([0.0, -0.01, 0.0])
    body = mesh_of(ours=True, metres=True)
    assert not floor.area < 0.2 * (body.area + floor.area)
    trimesh.Scene({"floor": floor, "body": body}).export(tmp_path / "me.glb")
    _, remarks = measure_file(tmp_path / "me.glb")
    assert "left out: 12 triangles not connected to the body, such as a floor" in remarks


# ----------------------------------------------------------------------------------------------------- malformed files


def glb(tree: Any, data: bytes = b"") -> bytes:
    text = (tree if isinstance(tree, bytes) else json.dumps(tree).encode()).ljust(4)
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def ply(vertices: int, faces: int, rows: str) -> bytes:
    head = f"ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
    return (head + f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n{rows}").encode()


CORNERS = "0 0 0\n0 170 0\n10 0 0\n"
V = "v 0 0 0\nv 0 170 0\nv 10 0 0\n"
NODE = {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "accessors": [{"count": 3, "type": "VEC3"}]}
MALFORMED = {
    "far.ply": (ply(3, 1, CORNERS + "3 0 1 99\n"), "a face names vertex 99 of 3"),
    "negative.ply": (ply(3, 1, CORNERS + "3 0 1 -7\n"), "a face names vertex -7 of 3"),
    "none.ply": (ply(0, 1, "3 0 1 2\n"), ""),
    "huge.ply": (ply(10**12, 1, CORNERS), ""),
    "digits.ply": (ply(10**12, 1, CORNERS).replace(b"1000000000000", b"9" * 5000), ""),
    "words.ply": (ply(3, 1, "a b c\n" * 4), ""),
    "nan.ply": (ply(3, 1, CORNERS.replace("170", "nan") + "3 0 1 2\n"), "the position of vertex 1 is not a number"),
    "nothing.ply": (b"", ""),
    "zero.obj": (f"{V}f 0 1 2\n".encode(), "a face names vertex 0"),
    "far.obj": (f"{V}f 1 2 99\n".encode(), ""),
    "back.obj": (f"{V}f -1 -2 -9\n".encode(), "a face names vertex -9, but OBJ counts from 1"),
    "none.obj": (b"f 1 2 3\n", ""),
    "words.obj": (f"{V}f a b c\n".encode(), ""),
    "flat.obj": (f"{V}f 1 2\n".encode(), ""),
    "nothing.stl": (b"", ""),
    "short.stl": (bytes(80) + struct.pack("<I", 10**9) + bytes(50), ""),
    "words.stl": (b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 x\nendloop\nendfacet\nendsolid\n", ""),
    "normal.stl": (b"solid a\nfacet normal 0 0 x\nouter loop\nvertex 0 0 0\nvertex 0 nan 0\nvertex 9 0 0\n", ""),
    "nothing.glb": (b"", "cannot be read as GLB"),
    "empty.glb": (glb({}), ""),
    "packed.glb": (glb({"extensionsUsed": ["KHR_draco_mesh_compression"]}), "export it without compression"),
    "file.glb": (glb({**NODE, "nodes": [{"mesh": 0}], "buffers": [{"uri": "/etc/passwd", "byteLength": 36}]}), ""),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_malformed_files_give_one_line_errors(name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    content, expected = MALFORMED[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BodyError) as caught:
        read_body(tmp_path / name)
    message = str(caught.value)
    assert expected in message
    assert message.startswith(f"{tmp_path / name}: ")
    assert message.isprintable()
    assert len(message.removeprefix(str(tmp_path))) < 250
    assert "Traceback" not in caplog.text


def test_a_huge_file_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "sparse.ply").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(BodyError, match="more than 512 MB"):
        read_mesh(tmp_path / "sparse.ply")
