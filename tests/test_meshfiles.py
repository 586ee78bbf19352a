"""Mesh files read back by trimesh equal the meshes written."""

import io
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from gcd_dataset.meshfiles import glb_bytes, obj_bytes, ply_bytes
from gcd_dataset.records import BoxMesh
from tests.helpers import far_ball, joined, patch, tube

STEEP = np.array([[1.0, 0.0], [0.0, 0.8], [0.0, 0.6]])


def garment() -> BoxMesh:
    """A tube, whose seam vertices have two texture coordinates, and a patch."""
    sheet = patch(3, 2, spacing=2.0, place=STEEP, origin=(30.0, 100.0, 8.5))
    return replace(joined(tube(12, 4, radius=2.0, height=90.0), sheet), panel_names=("skirt", "patch pocket"))


def read(content: bytes, kind: str) -> trimesh.Trimesh:
    """The mesh as read by trimesh; an OBJ gets a vertex for every pair of position and texture coordinate."""
    mesh = trimesh.load(io.BytesIO(content), file_type=kind, process=False, force="mesh")
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def lines(content: bytes, kind: str) -> list[list[str]]:
    """The words after ``kind`` on every line that begins with it."""
    return [words[1:] for words in map(str.split, content.decode().splitlines()) if words[:1] == [kind]]


def test_an_obj_has_the_triangles_with_their_texture() -> None:
    mesh = garment()
    again = read(obj_bytes(mesh.vertices, mesh), "obj")
    assert again.triangles == pytest.approx(mesh.vertices[mesh.faces], abs=1e-3)
    uv = np.asarray(again.visual.uv)
    assert uv[again.faces] == pytest.approx(mesh.uv[mesh.corners], abs=1e-3)


def test_an_obj_keeps_the_vertices_numbers() -> None:
    mesh = garment()
    content = obj_bytes(mesh.vertices, mesh)
    assert np.array(lines(content, "v"), float) == pytest.approx(mesh.vertices, abs=1e-3)
    corners = np.array([[corner.split("/") for corner in face] for face in lines(content, "f")], int) - 1
    assert np.array_equal(corners[..., 0], mesh.faces)
    assert np.array_equal(corners[..., 1], mesh.corners)


def test_an_obj_has_a_group_a_panel() -> None:
    """OBJ reads white space in a name as several groups."""
    mesh = garment()
    content = obj_bytes(mesh.vertices, mesh)
    assert lines(content, "g") == [["skirt"], ["patch_pocket"]]
    of_groups = [part.count("\nf ") for part in content.decode().split("\ng ")[1:]]
    assert of_groups == np.bincount(mesh.panel_id).tolist()


def test_a_ply_is_the_mesh() -> None:
    mesh = garment()
    again = read(ply_bytes(mesh.vertices, mesh), "ply")
    assert again.vertices == pytest.approx(mesh.vertices, abs=1e-4)
    assert np.array_equal(again.faces, mesh.faces)


def test_a_glb_is_in_metres_with_its_body() -> None:
    mesh, body = garment(), far_ball()
    scene = trimesh.load(io.BytesIO(glb_bytes(mesh.vertices, mesh, body)), file_type="glb")
    assert isinstance(scene, trimesh.Scene)
    placed = {str(part.metadata["name"]): part for part in scene.dump()}
    assert placed.keys() == {"garment", "body"}
    for name, vertices, faces in (("garment", mesh.vertices, mesh.faces), ("body", body.vertices, body.faces)):
        part = placed[name]
        assert isinstance(part, trimesh.Trimesh)
        assert part.bounds == pytest.approx(np.array([vertices.min(axis=0), vertices.max(axis=0)]) / 100, abs=1e-5)
        assert part.area == pytest.approx(trimesh.Trimesh(vertices, faces, process=False).area / 1e4, rel=1e-4)
        assert len(part.faces) == len(faces)
