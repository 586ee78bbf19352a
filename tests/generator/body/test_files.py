"""Bodies and measures in files of every format, and bodies by name; malformed files give one-line errors."""

import codecs
import json
import logging
import struct
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml

from gcd_dataset.bodyfiles import read_body_parts
from gcd_dataset.errors import BodyError, ConfigError
from gcd_dataset.generator.body import (
    build_body,
    draw_shape,
    measure,
    named_body,
    neutral_shape,
    read_body,
    read_measurements,
    write_measurements,
)
from gcd_dataset.generator.body.mesh_bodies import measure_file, read_mesh
from gcd_dataset.records import ANGLES, MEASURES, Body, BodyPart, Measurements
from gcd_dataset.release.meshes import read_obj
from gcd_dataset.seeding import Stage, rng

SIZE = measure(build_body(neutral_shape()))


@pytest.fixture
def mannequin(tmp_path: Path) -> dict[str, Path]:
    """Files of a body: a box 1.7 m tall as mesh, one vertex for each limb, and measures."""
    trimesh.creation.box((0.5, 1.7, 0.3)).export(tmp_path / "box.obj")
    parts = {"body": [0, 1, 2, 3], "left_arm": [4], "right_arm": [5], "left_leg": [6], "right_leg": [7]}
    (tmp_path / "parts.json").write_text(json.dumps(parts))
    write_measurements(SIZE, tmp_path / "size.yaml")
    return {name: tmp_path / f for name, f in {"mesh": "box.obj", "parts": "parts.json", "size": "size.yaml"}.items()}


def test_measures_survive_a_file(tmp_path: Path) -> None:
    write_measurements(SIZE, tmp_path / "size.yaml")
    again = read_measurements(tmp_path / "size.yaml")
    assert again.to_file_values() == pytest.approx(SIZE.to_file_values(), rel=1e-15)
    assert all(getattr(again, key) == getattr(SIZE, key) for key in MEASURES if key not in ANGLES)


def test_a_measurement_file_holds_every_digit_in_degrees_with_derived_keys(tmp_path: Path) -> None:
    write_measurements(Measurements(height=171.99, shoulder_w=0.1 + 0.2, shoulder_incl=np.pi / 6), tmp_path / "a.yaml")
    body = yaml.safe_load((tmp_path / "a.yaml").read_text())["body"]
    assert body["shoulder_w"] == 0.1 + 0.2
    assert body["shoulder_incl"] == pytest.approx(30.0)
    assert body["_base_sleeve_balance"] == pytest.approx(0.3 - 2.0)
    assert "waist" not in body
    assert "_waist_level" not in body


def test_derived_keys_equal_the_references(examples: Path, tmp_path: Path) -> None:
    reference = next((examples / "patterns").glob("*/random_body/body_measurements.yaml"))
    write_measurements(read_measurements(reference), tmp_path / "again.yaml")
    theirs = yaml.safe_load(reference.read_text())["body"]
    theirs.pop("body_sample")
    assert yaml.safe_load((tmp_path / "again.yaml").read_text())["body"] == pytest.approx(theirs)


def test_a_published_mean_body(examples: Path, published: tuple[Body, Measurements]) -> None:
    folder, (body, size) = examples / "bodies", published
    table = yaml.safe_load((folder / "mean_all.yaml").read_text())["body"]
    assert size.to_file_values() == pytest.approx(table, rel=1e-14)
    assert (len(body.vertices), len(body.faces)) == (23752, 47500)
    assert np.ptp(body.vertices[:, 1]) == pytest.approx(table["height"], abs=0.01)
    assert body.vertices[:, 1].min() == 0.0
    segments = json.loads((folder / "ggg_body_segmentation.json").read_text())
    assert set(np.flatnonzero(body.parts == BodyPart.LEFT_ARM.value)) == set(segments["left_arm"])
    assert body.vertices[body.parts == BodyPart.LEFT_ARM.value, 0].mean() > 20.0


def test_inward_faces_are_flipped_and_ids_may_be_whole_floats(mannequin: dict[str, Path]) -> None:
    box = trimesh.load(mannequin["mesh"], process=False)
    trimesh.Trimesh(box.vertices, box.faces[:, ::-1], process=False).export(mannequin["mesh"])
    body, _ = read_body(mannequin["mesh"], mannequin["size"], mannequin["parts"])
    assert trimesh.Trimesh(body.vertices, body.faces, process=False).volume > 0
    assert body.parts.tolist() == [0, 0, 0, 0, 1, 2, 3, 4]
    mannequin["parts"].write_text(PARTS % '7.0], "head": null, "hands": [0.0')
    body, _ = read_body(mannequin["mesh"], mannequin["size"], mannequin["parts"])
    assert body.parts.tolist() == [BodyPart.HANDS.value, 0, 0, 0, 1, 2, 3, 4]


NINE = [", ".join([f"*l{i - 1}"] * 9) for i in range(12)]
LAUGHS = "".join(f"l{i}: &l{i} [{NINE[i] if i else 'ha'}]\n" for i in range(12)) + "body: {height: *l11}"
"""Nine to the power of eleven lists, in 600 bytes."""
MERGED_LAUGHS = "".join(f"l{i}: &l{i} {{{f'<<: [{NINE[i]}]' if i else 'a: 1'}}}\n" for i in range(12)) + "body: *l11"
PARTS = '{"left_arm": [4], "right_arm": [5], "left_leg": [6], "right_leg": [%s]}'


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("parts", '{"left_arm": [4], "right_arm": [5], "left_leg": [6], "right_leg": [8]}', "right_leg names vertex 8"),
        ("parts", '{"body": [0]}', "lists the parts body: add left_arm, right_arm, left_leg and right_leg"),
        ("parts", PARTS.replace("[4]", "[]") % 7, "left_arm has no vertices: list the vertices of the limb"),
        ("parts", PARTS % -1, "right_leg is not a list of vertex ids: give whole numbers, 0 or more"),
        ("parts", '{"%s": 1}' % ("a" * 10**5), "add left_arm, right_arm"),
        ("parts", PARTS % 10**30, "right_leg names vertex 10**15 or more"),
        ("size", 100_000 * "[" + 100_000 * "]", "nested too deeply"),
        ("size", f"body: {{height: {10**400}}}", "body.height is 10**15 or more: give a positive number"),
        (
            "size",
            f"body: {{height: {[[i] for i in range(1000)]}}}",
            "body.height is [[0], [1], [2], [3], [4], [5], ...]",
        ),
        ("size", "body:\n  waist: 70\n  waist: 90\n", "line 2, column 3: a repeated key"),
        ("size", "body: {waist: 070}", "the number 070, which is not in base 10"),
        ("size", "a: &a {x: 1}\nbody:\n  <<: *a\n", "line 3, column 3: a merge key (<<): write the entries out"),
        ("size", LAUGHS, "nested too deeply"),
        ("size", MERGED_LAUGHS, "a merge key"),
        ("size", "body: {height: !!python/object:os.system 1}", "not YAML (line 1, column 16: could not determine"),
        ("size", "# much\n" * 200_000, "more than 1 MB: give the path of a measurement YAML"),
        ("size", "body: {height: 170}", "body lacks head_l, neck_w"),
        ("size", "body: {height: tall}", "body.height is 'tall': give a positive number"),
        ("size", "body: {hips: -3}", "body.hips is -3: give a positive number of centimetres"),
        ("size", "body: {shoulder_incl: steep}", "body.shoulder_incl is 'steep': give a number of degrees"),
        ("mesh", "v 0 0\nf 1 2 9\n", "box.obj"),
        ("mesh", 3 * "v 0 0 0\nv 1 0 0\nv 0 170 0\n" + "f 1 1 1\n", "box.obj"),
        ("mesh", 3 * "v 0 0 0\nv 1 0 0\nv 0 170 0\n" + "f 1 2 3\n", "not closed"),
    ],
)
def test_errors_of_broken_files_give_place_and_remedy(
    name: str, content: str, expected: str, mannequin: dict[str, Path]
) -> None:
    mannequin[name].write_text(content)
    with pytest.raises(BodyError) as caught:
        read_body(mannequin["mesh"], mannequin["size"], mannequin["parts"])
    message = str(caught.value)
    assert message.startswith(str(mannequin[name]))
    assert expected in message
    assert message.isprintable()
    assert len(message.removeprefix(str(mannequin[name]))) < 400


def test_meshes_that_are_no_body_are_refused(mannequin: dict[str, Path]) -> None:
    with pytest.raises(BodyError, match=r"box\.obj: 12 triangles with an area, a body needs at least 500"):
        read_body(mannequin["mesh"], mannequin["size"])
    flat = trimesh.creation.annulus(20.0, 80.0, 1e-9, sections=200)
    flat.vertices[:, 2] = 0.0
    corners = np.repeat(np.arange(600.0), 3)[:, None] * [0.0, 0.3, 0.0] + np.tile(np.eye(3), (600, 1))
    loose = trimesh.Trimesh(corners, np.arange(1800).reshape(-1, 3), process=False)
    for mesh, message in ((flat, "flat"), (loose, "do not touch each other")):
        mesh.export(mannequin["mesh"])
        with pytest.raises(BodyError, match=message):
            read_body(mannequin["mesh"])
    trimesh.creation.box((1.0, 20.0, 1.0)).export(mannequin["mesh"])
    with pytest.raises(BodyError, match="20 tall, no adult's height in centimetres, metres"):
        read_body(mannequin["mesh"], mannequin["size"], mannequin["parts"])


def test_smpls_part_names_are_read(tmp_path: Path) -> None:
    arm, leg = ["Shoulder", "Arm", "ForeArm", "Hand", "HandIndex1"], ["UpLeg", "Leg", "Foot", "ToeBase"]
    names = ["hips", "head", "eyeballs", *(side + name for side in ("left", "right") for name in arm + leg)]
    (tmp_path / "smpl.json").write_text(json.dumps({name: [row] for row, name in enumerate(names)}))
    parts = [BodyPart(part).name for part in read_body_parts(tmp_path / "smpl.json", 22, tmp_path / "a.obj")]
    assert parts[:3] == ["TRUNK", "HEAD", "INTERNAL"]
    assert parts[3:12] == 3 * ["LEFT_ARM"] + 2 * ["HANDS"] + 2 * ["LEFT_LEG"] + 2 * ["FEET"]
    assert parts[12:21] == 3 * ["RIGHT_ARM"] + 2 * ["HANDS"] + 2 * ["RIGHT_LEG"] + 2 * ["FEET"]


def test_measures_of_another_body_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Each that is over 3 cm and 5 % off; angles are not compared."""
    other = replace(SIZE, waist=SIZE.waist + 4.5, height=SIZE.height + 5.0, wrist=SIZE.wrist + 2.0, shoulder_incl=0.9)
    write_measurements(other, tmp_path / "other.yaml")
    _, size, _ = named_body("neutral", measurements=tmp_path / "other.yaml")
    assert size == other
    [record] = caplog.records
    named = record.getMessage()
    assert f"differs from neutral (its measures in brackets): waist {other.waist:.1f} ({SIZE.waist:.1f}) [cm]" in named
    caplog.clear()
    write_measurements(SIZE, tmp_path / "same.yaml")
    named_body("neutral", measurements=tmp_path / "same.yaml")
    assert not caplog.records


@pytest.mark.parametrize(("unit", "factor"), [("inches", 2.54), ("metres", 100.0), ("millimetres", 0.1)])
def test_measures_in_another_unit_are_refused(unit: str, factor: float, tmp_path: Path) -> None:
    lengths = {key: getattr(SIZE, key) / factor for key in MEASURES if key not in ANGLES and key != "wrist"}
    write_measurements(replace(SIZE, **lengths), tmp_path / "size.yaml")
    with pytest.raises(BodyError, match=rf"size\.yaml: most measures are those of male in {unit}"):
        named_body("male", measurements=tmp_path / "size.yaml")


def test_a_mesh_without_a_body_is_taken_as_it_stands(
    mannequin: dict[str, Path], caplog: pytest.LogCaptureFixture
) -> None:
    """With measures and parts, as for a dress form; the heights are compared."""
    write_measurements(replace(SIZE, height=190.0), mannequin["size"])
    read_body(mannequin["mesh"], mannequin["size"], mannequin["parts"])
    found, height = (record.getMessage() for record in caplog.records if record.levelno == logging.WARNING)
    assert "taken as it stands, y up and facing +z" in found
    assert "height 190.0 (170.0)" in height


def test_bodies_by_name() -> None:
    """One with its legs apart is measured with them straight."""
    body, size, shape = named_body("neutral")
    apart, measured, spread = named_body("neutral", legs_apart=True)
    assert (shape, spread) == (neutral_shape(), neutral_shape(legs_apart=True))
    assert size == measured == SIZE
    assert body.name == "neutral"
    assert not np.array_equal(apart.vertices, body.vertices)
    for group in ("random", "female", "male", "pooled"):
        assert named_body(f"{group}:7")[2] == draw_shape(rng(7, 0, Stage.BODY), group=group)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("giant", "no body named giant"),
        ("random:", "the seed is ''"),
        ("random:-1", "the seed is '-1'"),
        ("female:", "female:: the seed is ''.* such as female:7"),
        ("male:x", "the seed is 'x'"),
        ("neutral:7", "no body named neutral:7: there are .* female:SEED, male:SEED"),
        ("nowhere.obj", "nowhere.obj: no such file: give the path of a mesh"),
        (__file__, r"not a readable mesh format: convert it to \.obj, \.ply, \.stl, \.glb"),
    ],
)
def test_unknown_names_are_errors(name: str, expected: str) -> None:
    with pytest.raises(BodyError, match=expected):
        named_body(name)


def test_a_height_must_be_an_adults_and_is_for_a_mesh(mannequin: dict[str, Path]) -> None:
    with pytest.raises(ConfigError, match=r"height 1\.7: no adult's: give it in centimetres, 120 to 230"):
        named_body(mannequin["mesh"], measurements=mannequin["size"], segmentation=mannequin["parts"], height=1.7)
    with pytest.raises(BodyError, match="neutral: a named body has known parts and height: leave"):
        named_body("neutral", height=170.0)


@cache
def person() -> Body:
    return build_body(draw_shape(rng(5, 1, Stage.BODY)))


def mesh_of(*, ours: bool, metres: bool) -> trimesh.Trimesh:
    """The person's mesh; with its faces in another order it is not recognised as the model's."""
    faces = person().faces if ours else np.roll(person().faces, 1, axis=0)
    return trimesh.Trimesh(person().vertices * (0.01 if metres else 1.0), faces, process=False)


def test_every_kind_of_file_gives_the_measures_of_the_body_which_can_be_dressed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Of a file with the model's numbers of vertices also its parts."""
    caplog.set_level(logging.INFO)
    truth = measure(person()).to_file_values()
    for kind, off in (("stl", 1.5), ("glb", 0.05), ("ply", 0.05)):  # cm: in an STL landmarks are found
        mesh_of(ours=True, metres=kind != "stl").export(tmp_path / f"me.{kind}")
        caplog.clear()
        body, size, shape = named_body(tmp_path / f"me.{kind}")
        assert (shape, body.name) == (None, "me")
        assert size.to_file_values() == pytest.approx(truth, abs=off)
        if kind != "stl":
            assert "taken to be in metres" in caplog.text
            assert np.array_equal(body.faces, person().faces) and np.array_equal(body.parts, person().parts)
            assert body.vertices == pytest.approx(person().vertices, abs=1e-3)


def test_corners_of_stl_are_merged_in_order_of_appearance(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=80.0)
    ball.export(tmp_path / "ball.stl")
    vertices, faces = read_mesh(tmp_path / "ball.stl")
    assert len(vertices) == len(ball.vertices)
    assert vertices[faces] == pytest.approx(ball.triangles, abs=1e-4)
    assert (np.diff(np.unique(faces.ravel(), return_index=True)[1]) > 0).all()


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
    trimesh.Scene({"body": body, "shirt": body.copy().apply_scale(1.02)}).export(tmp_path / "both.glb")
    message = r"both\.glb: holds 2 meshes \(body, shirt\), none .* the body: export it alone"
    with pytest.raises(BodyError, match=message):
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
    "huge.ply": (ply(10**12, 1, CORNERS), ""),
    "nan.ply": (ply(3, 1, CORNERS.replace("170", "nan") + "3 0 1 2\n"), "the position of vertex 1 is not a number"),
    "zero.obj": (f"{V}f 0 1 2\n".encode(), "a face names vertex 0"),
    "back.obj": (f"{V}f -1 -2 -9\n".encode(), "a face names vertex -9, but OBJ counts from 1"),
    "short.stl": (bytes(80) + struct.pack("<I", 10**9) + bytes(50), ""),
    "normal.stl": (b"solid a\nfacet normal 0 0 x\nouter loop\nvertex 0 0 0\nvertex 0 nan 0\nvertex 9 0 0\n", ""),
    "nothing.glb": (b"", "cannot be read as GLB"),
    "deep.glb": (glb(b"[" * 100_000), ""),
    "huge.glb": (glb({"accessors": [{"count": 10**12, "componentType": 5126, "type": "VEC3"}]}), ""),
    "loop.glb": (glb({"nodes": [{"children": [1]}, {"children": [0]}]}), ""),
    "packed.glb": (glb({"extensionsUsed": ["KHR_draco_mesh_compression"]}), "export it without compression"),
    "many.glb": (glb({**NODE, "nodes": [{"mesh": 0}] * 9000}, bytes(36)), ""),
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
