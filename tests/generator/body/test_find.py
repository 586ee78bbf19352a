"""Bodies in unknown meshes: landmarks, parts and measures from the geometry alone."""

import json
import logging
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from benchmarks.broken_bodies import broken_body
from benchmarks.cases.measures import tolerance
from gcd_dataset.cli import main
from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body import (
    build_body,
    draw_shape,
    female_shape,
    measure,
    read_body,
    read_measurements,
    write_measurements,
)
from gcd_dataset.generator.body.landmarks import read_landmarks
from gcd_dataset.generator.body.measuring import FoundBody, find_body
from gcd_dataset.generator.body.mesh_bodies import measure_file
from gcd_dataset.generator.body.register import unit_of
from gcd_dataset.records import ANGLES, MEASURES, Body, BodyPart, Measurements
from gcd_dataset.seeding import Stage, rng

SAME = 0.2  # cm, degrees; tolerance for another triangulation of the same skin


def unknown(body: Body) -> Body:
    """The same skin with its faces in another order: not recognised as the model's mesh."""
    return replace(body, faces=np.roll(body.faces, 1, axis=0))


@cache
def woman() -> Body:
    return unknown(build_body(female_shape()))


@cache
def fitted_woman() -> FoundBody:
    return find_body(woman().vertices, woman().faces)


def off(found: Measurements, known: Measurements) -> dict[str, float]:
    values, expected = found.to_file_values(), known.to_file_values()
    return {key: values[key] - expected[key] for key in MEASURES}


def too_far(found: Measurements, known: Measurements) -> dict[str, float]:
    """Errors above half a centimetre (heights, girths), 1.5 cm (measures at landmarks) or 3 degrees."""
    return {key: by for key, by in off(found, known).items() if abs(by) > tolerance(key)}


@pytest.mark.parametrize("name", ["all", "female", "male"])
def test_the_published_means_have_the_published_measures(name: str, examples: Path) -> None:
    path = examples / "bodies" / f"mean_{name}.obj"
    result, remarks = measure_file(path)
    assert not too_far(result.measurements, read_measurements(path.with_suffix(".yaml")))
    assert "metres" in remarks[0]
    assert set(result.at_border) == {"bust", "waist", "hips"}  # ends of the search range, as when published


def test_found_and_known_landmarks_give_the_same_measures() -> None:
    body = build_body(draw_shape(rng(2, 3, Stage.BODY)))
    assert not too_far(measure(unknown(body)), measure(body))


def test_found_parts_equal_the_models() -> None:
    skin = woman().parts != BodyPart.INTERNAL.value
    assert (fitted_woman().parts == woman().parts)[skin].mean() > 0.99


def test_numbering_and_subdivision_do_not_change_a_body() -> None:
    vertices, faces = woman().vertices, woman().faces
    vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    order = rng(0, 0, Stage.BODY).permutation(len(vertices))
    other = find_body(vertices[order], np.argsort(order)[faces])
    assert max(map(abs, off(other.result.measurements, fitted_woman().result.measurements).values())) < SAME


def test_a_body_scaled_and_moved_has_scaled_measures() -> None:
    larger = find_body(
        1.1 * woman().vertices + [250.0, -30.0, 80.0], woman().faces
    ).result.measurements.to_file_values()
    for key, value in fitted_woman().result.measurements.to_file_values().items():
        assert larger[key] == pytest.approx(value if key in ANGLES else 1.1 * value, abs=SAME)


def test_measures_of_the_models_mesh_scale_exactly() -> None:
    body = build_body(female_shape())
    small, large = measure(body).to_file_values(), measure(replace(body, vertices=1.1 * body.vertices)).to_file_values()
    for key in MEASURES:
        assert large[key] == pytest.approx(small[key] * (1.0 if key in ANGLES else 1.1), rel=1e-6)


HARMLESS = ("some faces flipped", "facing away", "on a floor")
ERRORS = {
    "not a number": "the position of vertex 3121 is not a number",
    "collapsed": "with an area",
    "no hands": "wrist|hands",
    "twelve vertices": "20 triangles",
    "arms grown to the trunk": "is merged with the trunk",
    "empty file": "no triangles",
}


@pytest.mark.parametrize("kind", ["some faces flipped", "on a floor"])
def test_harmless_damage_does_not_change_the_measures(kind: str, tmp_path: Path) -> None:
    require_the_measures_in_spite_of(kind, tmp_path)


def require_the_measures_in_spite_of(kind: str, tmp_path: Path) -> None:
    made = broken_body(kind, rng(1, HARMLESS.index(kind), Stage.BODY))
    assert made.truth is not None
    result, remarks = measure_file(made.write(tmp_path))
    assert not too_far(result.measurements, made.truth)
    assert any("turned" in remark for remark in remarks) == (kind == "facing away")
    assert any("such as a floor" in remark for remark in remarks) == (kind == "on a floor")


def scene(body: Body) -> trimesh.Trimesh:
    """The body in inches with an eyeball, on a floor, leaning to front and side, turned; vertex 0 is unused."""
    eye = trimesh.creation.icosphere(radius=1.2).apply_translation([3.0, 0.93 * body.vertices[:, 1].max(), 5.0])
    floor = trimesh.creation.box((300.0, 4.0, 300.0)).apply_translation([0.0, -2.0, 0.0])
    whole = trimesh.util.concatenate([trimesh.Trimesh(body.vertices, body.faces, process=False), eye, floor])
    turn = Rotation.from_euler("YZX", [40.0, 5.0, 8.0], degrees=True).as_matrix()
    vertices = np.concatenate([[[1e6, 0.0, 0.0]], whole.vertices @ turn.T / 2.54])
    return trimesh.Trimesh(vertices, whole.faces + 1, process=False)


def test_the_body_of_a_scene_is_measured_upright_and_alone(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    body = build_body(female_shape())
    scene(unknown(body)).export(tmp_path / "scene.obj")
    with caplog.at_level(logging.INFO):
        stood, size = read_body(tmp_path / "scene.obj", height=float(np.ptp(body.vertices[:, 1])))
    for remark in ("scaled to 166.", "upright facing +z and was turned", "left out: 12 triangles not connected"):
        assert remark in caplog.text
    assert max(map(abs, off(size, fitted_woman().result.measurements).values())) < 0.7
    count = len(body.vertices)
    assert np.abs(stood.vertices[:count] - body.vertices).max() < 2.0
    assert (stood.parts[:count] == body.parts)[body.parts != BodyPart.INTERNAL.value].mean() > 0.97
    assert (stood.parts[count:] == BodyPart.INTERNAL.value).all()  # the eyeball


def test_our_mesh_is_set_upright(tmp_path: Path) -> None:
    body = build_body(female_shape())
    turn = Rotation.from_euler("x", 3.0, degrees=True).as_matrix()
    trimesh.Trimesh(body.vertices @ turn.T, body.faces, process=False).export(tmp_path / "own.ply")
    result, remarks = measure_file(tmp_path / "own.ply")
    assert max(map(abs, off(result.measurements, measure(body)).values())) < 0.5
    assert "did not stand upright facing +z and was turned" in remarks


def test_a_mirrored_body_keeps_its_left_on_the_left(tmp_path: Path) -> None:
    """Its vertices are our mesh's, its sides are not."""
    body = build_body(female_shape())
    trimesh.Trimesh(body.vertices * [-1.0, 1.0, 1.0], body.faces, process=False).export(tmp_path / "own.ply")
    mirrored, _ = read_body(tmp_path / "own.ply")
    assert mirrored.vertices[mirrored.parts == BodyPart.LEFT_ARM.value, 0].min() > 0.0


@pytest.mark.parametrize("tall", [1.0, 70.5, 61.7, 5.4, 100.0, 2400.0])
def test_a_height_of_no_adult_is_an_error(tall: float) -> None:
    with pytest.raises(BodyError, match=f"scan: {tall:g} tall, no adult's height in .* --height CM"):
        unit_of(tall, "scan")
    assert unit_of(tall, "scan", height=165.0) == pytest.approx(165.0 / tall)


@pytest.mark.parametrize("kind", ERRORS)
def test_harmful_damage_is_an_error(kind: str, tmp_path: Path) -> None:
    path = broken_body(kind, rng(1, list(ERRORS).index(kind), Stage.BODY)).write(tmp_path)
    with pytest.raises(BodyError, match=ERRORS[kind]) as caught:
        measure_file(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_body_file_needs_neither_measures_nor_parts(tmp_path: Path) -> None:
    path = tmp_path / "scan.obj"
    trimesh.Trimesh(woman().vertices * 10.0, woman().faces, process=False).export(path)
    body, size = read_body(path)
    assert np.abs(body.vertices - woman().vertices).max() < 0.01
    assert size.waist == pytest.approx(measure(build_body(female_shape())).waist, abs=0.1)
    assert set(np.unique(body.parts)) >= {part.value for part in BodyPart} - {BodyPart.INTERNAL.value}
    hands = body.vertices[body.parts == BodyPart.LEFT_ARM.value, 0]
    assert hands.min() > 8.0


def test_given_landmarks_override_found_ones(tmp_path: Path) -> None:
    nape = fitted_woman().marks.points["nape_of_neck"]
    marks = {"nape_of_neck": [0.0, float(nape[1] - 5.0), float(nape[2])], "waist": [[0.0, 100.0, 0.0]]}
    (tmp_path / "marks.json").write_text(json.dumps(marks))
    given = read_landmarks(tmp_path / "marks.json", woman().vertices)
    size = find_body(woman().vertices, woman().faces, given=given)
    assert size.result.measurements.head_l == pytest.approx(fitted_woman().result.measurements.head_l + 5.0, abs=0.01)
    assert size.result.levels["waist"] == pytest.approx(100.0, abs=2.1)
    assert size.marks.confidence["nape_of_neck"] == 1.0


def test_given_landmarks_override_those_of_the_models_mesh(tmp_path: Path) -> None:
    body = build_body(female_shape())
    trimesh.Trimesh(body.vertices, body.faces, process=False).export(tmp_path / "own.ply")
    nape = fitted_woman().marks.points["nape_of_neck"]
    marks = tmp_path / "marks.json"
    marks.write_text(json.dumps({"nape_of_neck": [0.0, float(nape[1] - 5.0), float(nape[2])]}))
    _, size = read_body(tmp_path / "own.ply", given=marks)
    assert size.head_l == pytest.approx(measure(body).head_l + 5.0, abs=0.2)
    assert size == measure_file(tmp_path / "own.ply", given=marks)[0].measurements


def test_landmarks_beside_given_measures_are_an_error(tmp_path: Path) -> None:
    """Given measures replace the measuring, which alone uses landmarks."""
    body = build_body(female_shape())
    trimesh.Trimesh(body.vertices, body.faces, process=False).export(tmp_path / "own.ply")
    write_measurements(measure(body), tmp_path / "own.yaml")
    (tmp_path / "marks.json").write_text('{"nape_of_neck": 3}')
    with pytest.raises(BodyError, match=r"marks\.json: .* leave .* out"):
        read_body(tmp_path / "own.ply", tmp_path / "own.yaml", given=tmp_path / "marks.json")


@pytest.mark.parametrize("odd", [-7, 10**6])
def test_the_error_about_a_face_names_its_invalid_vertex(odd: int) -> None:
    faces = woman().faces.copy()
    faces[5, 1] = odd
    with pytest.raises(BodyError, match=f"a face names vertex {odd} of"):
        find_body(woman().vertices, faces)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("{", "line 1, column 2"),
        ("[]", "a list: give a map"),
        ('{"elbow": 3}', "no landmark is called elbow"),
        ('{"nape_of_neck": 99999999}', "nape_of_neck is 99999999: give a vertex id under"),
        ('{"nape_of_neck": [1, 2]}', r"nape_of_neck is \[1, 2\]"),
        ('{"nape_of_neck": [1, 2, NaN]}', "NaN is not a number"),
        ('{"nape_of_neck": true}', "nape_of_neck is true"),
        ('{"nape_of_neck": [1, 2, 1e300]}', r"nape_of_neck is \[1, 2, 1e\+300\], outside the mesh"),
        ('{"nape_of_neck": [1, 2], "nape_of_neck": 3}', "occurs twice"),
        ("[" * 100_000, "64 levels deep"),
        ('{"waist": 7}', "a ring is a list"),
        ('{"neck_back": [1, 2]}', "neck_back has 2 points"),
    ],
)
def test_broken_landmark_files(content: str, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "marks.json"
    path.write_text(content)
    with pytest.raises(BodyError, match=expected) as caught:
        read_landmarks(path, np.zeros((10, 3)))
    assert str(caught.value).startswith(str(path))


def test_gcd_measure_writes_a_measurement_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measure", "--shape", "random:3", "--out", str(tmp_path / "a.yaml")]) == 0
    body = build_body(draw_shape(rng(3, 0, Stage.BODY)))
    assert read_measurements(tmp_path / "a.yaml").to_file_values() == pytest.approx(measure(body).to_file_values())
    assert main(["measure", "--shape", "male:3"]) == 0
    drawn = measure(build_body(draw_shape(rng(3, 0, Stage.BODY), group="male")))
    assert f"\n  waist: {drawn.waist}\n" in capsys.readouterr().out
    assert main(["measure", "--shape", "female"]) == 0
    assert "\n# bust: measured at height" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "code", "expected"),
    [
        ([], 2, "give a mesh file or --shape"),
        (["a.obj", "--shape", "female"], 2, "one of them"),
        (["--shape", "female", "--landmarks", "x.json"], 2, "are for a mesh file"),
        (["--shape", "female", "--height", "170"], 2, "are for a mesh file"),
        (["nowhere.obj"], 1, "nowhere.obj: no such file"),
    ],
)
def test_wrong_usage_of_gcd_measure(
    options: list[str], code: int, expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["measure", *options]) == code
    assert expected in capsys.readouterr().err


def test_an_unknown_body_is_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["measure", "--shape", "giant"])
    assert caught.value.code == 2
    assert "no body named giant" in capsys.readouterr().err
