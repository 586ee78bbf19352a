"""The contents of a display: meshes of samples and patterns, stretches, crossings, tables."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Body, BoxMesh, Drape, Outcome, Pattern, Sample
from gcd_dataset.viewer.content import content_of, crossing_vertices
from tests.generator.mesh.shapes import panel
from tests.helpers import body_from, joined, patch
from tests.shards.folders import fake_outfit


@pytest.fixture(scope="module")
def sample() -> Sample:
    return fake_sample(3, 1)


def draped(mesh: BoxMesh, vertices: np.ndarray, crossings: int = 0) -> Sample:
    drape = Drape(vertices, Outcome.SETTLED, 10, crossings, 0, 1.0, 1.0)
    return replace(fake_sample(3, 1), box_mesh=mesh, drape=drape, shape=None)


def test_two_sheets_that_cross_are_marked_along_the_line_where_they_meet() -> None:
    """A sheet in the plane z = 0.5 and one in the plane x = 2.5 meet where both are: all marks lie near that line."""
    flat = patch(5, 5, place=np.eye(3)[:, :2], origin=(0.0, 0.0, 0.5))
    upright = patch(5, 3, place=np.eye(3)[:, [1, 2]], origin=(2.5, 0.13, -1.07))
    cloth = joined(flat, upright)
    marked = cloth.vertices[crossing_vertices(cloth.vertices, cloth.faces)]
    assert len(marked) > 4
    assert np.abs(marked[:, 0] - 2.5).max() <= 1.0 and np.abs(marked[:, 2] - 0.5).max() <= 1.0
    away = joined(flat, replace(upright, vertices=upright.vertices + [9.0, 0.0, 0.0]))
    assert not len(crossing_vertices(away.vertices, away.faces))


def test_crossings_of_faces_of_all_sizes_are_those_of_all_pairs() -> None:
    """Triangles of 0.02 to 20 cm, against a search over all pairs with the volumes of tetrahedra."""
    random = np.random.default_rng(5)
    size = 0.02 * 1000.0 ** random.random((50, 1, 1))
    vertices = (random.uniform(0, 7, (50, 1, 3)) + size * random.normal(size=(50, 3, 3))).reshape(-1, 3)
    faces = np.arange(150).reshape(-1, 3)
    expected = set()
    for edge in faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2):
        for face in faces:
            if edge[0] in face:
                continue
            (p, q), (a, b, c) = vertices[edge], vertices[face]
            sides = [np.linalg.det([x - a, b - a, c - a]) > 0 for x in (p, q)]
            turns = {bool(np.linalg.det([q - p, x - p, y - p]) > 0) for x, y in ((a, b), (b, c), (c, a))}
            if sides[0] != sides[1] and len(turns) == 1:
                expected |= set(edge.tolist())
    assert len(expected) > 20
    assert set(crossing_vertices(vertices, faces).tolist()) == expected


def test_cloth_through_the_body_is_marked() -> None:
    cloth = patch(4, 4)
    wall = patch(4, 4, place=np.eye(3)[:, [1, 2]], origin=(1.5, 0.13, -2.07))
    body = Body(wall.vertices, wall.faces, np.zeros(len(wall.vertices), np.uint8))
    marked = cloth.vertices[crossing_vertices(cloth.vertices, cloth.faces, body)]
    assert set(marked[:, 0].tolist()) == {1.0, 2.0}


def test_cloth_drawn_to_one_and_a_half_is_stretched_by_as_much() -> None:
    mesh = patch(4, 4)
    content = content_of(draped(mesh, mesh.vertices * [1.5, 1.0, 1.0]))
    assert content.values["stretch"] == pytest.approx(1.5)
    assert content.crossed is not None and not len(content.crossed)


def test_a_drape_that_diverged_is_left_out(sample: Sample) -> None:
    assert sample.box_mesh is not None
    content = content_of(draped(sample.box_mesh, np.full_like(sample.box_mesh.vertices, np.nan)))
    assert content.mesh is not None and content.outcome is Outcome.SETTLED
    assert content.draped is None and not content.values and content.crossed is None


def test_weights_of_another_body_model_give_no_body(sample: Sample) -> None:
    assert sample.shape is not None and len(sample.shape.weights) == 8  # the body model has 20
    assert content_of(sample).body is None
    ball = body_from(trimesh.creation.icosphere(subdivisions=1, radius=5.0))
    assert content_of(sample, ball).body == ball


def test_tables_hold_the_measures_with_units(sample: Sample) -> None:
    rows = dict(content_of(sample).tables["Measures"])
    assert rows["height"] == f"{sample.measurements.height:.1f} cm"
    assert all(value.endswith((" cm", " °")) for value in rows.values())


def test_the_garments_of_an_outfit_are_one_content_with_their_layers() -> None:
    content = content_of(fake_outfit(2, 3))
    assert content.mesh is not None and content.draped is not None
    assert content.layers == (2, 2, 2)
    assert len(content.pattern.panels) == 6 and len(content.draped) == len(content.mesh.vertices)
    table = dict(content.tables["Outfit"])
    assert table["garment 0"].endswith("tucked, settled") and table["garment 1"].endswith("worn open, settled, denim")
    assert table["2 over 1"] == "9 crossings, 25.00% of 22 covered vertices in wrong order"
    assert content_of(fake_sample(3, 1)).layers == ()


def test_nested_values_have_dotted_names_and_integers_stay_integers(sample: Sample) -> None:
    design = {"collar": {"depth": {"v": 1}, "flip": True, "style": None, "angles": [95, 0.25]}}
    rows = content_of(replace(sample, design=design)).tables["Design"]
    assert rows == (
        ("collar.depth.v", "1"),
        ("collar.flip", "yes"),
        ("collar.style", "none"),
        ("collar.angles", "95, 0.25"),
    )


def test_a_pattern_is_placed_round_the_neutral_body(sample: Sample) -> None:
    content = content_of(sample.pattern)
    assert content.mesh is not None and content.body is not None
    assert content.mesh.panel_names == tuple(panel.name for panel in sample.pattern.panels)
    assert content.draped is None and content.outcome is None


def test_a_pattern_that_cannot_be_meshed_has_no_mesh() -> None:
    bow = panel("bow", [(0, 0), (40, 40), (40, 0), (0, 40)], at=(0, 100, 20))  # crosses itself
    content = content_of(Pattern("tie", (bow,), ()))
    assert content.mesh is None and content.pattern.panels[0].name == "bow"
