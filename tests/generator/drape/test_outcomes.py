"""Outcomes of garments that come off the body, and counts of crossings between cloth and body."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_batch
from gcd_dataset.generator.drape.holds import fell, off_body
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Body, BodyPart, BoxMesh, Outcome
from tests.helpers import SIZE, body_from, far_ball, joined, patch, tube

LYING = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, -1.0]])
HOOD = MakeConfig(
    bodies="pooled",
    stage="mesh",
    resolution=3.0,
    design=Overlay.from_dict(
        {"meta": {"upper": {"options": ["Shirt", "FittedShirt"]}}, "collar": {"component": {"style": "Hood2Panels"}}}
    ),
)
EARS_OUT = (5, 7)  # seed and number of a design: ears pierce its hood


def table() -> Body:
    top = trimesh.creation.box(extents=[40.0, 20.0, 40.0])
    top.apply_translation([0.0, 60.0, 0.0])
    return body_from(top)


def on_a_table(mesh: BoxMesh) -> DrapeJob:
    return DrapeJob(mesh, table(), SIZE)


def beside(mesh: BoxMesh) -> BoxMesh:
    return replace(mesh, vertices=mesh.vertices + [80.0, 0.0, 0.0])


SHEET = patch(16, 16, place=LYING, origin=(-8.0, 72.0, 8.0))


def test_a_garment_beside_the_body_falls_below_the_floor() -> None:
    """Equally alone and in a batch; the drape ends as soon as every vertex is below the floor."""
    falls, stays = on_a_table(beside(SHEET)), on_a_table(SHEET)
    together = drape_batch([stays, falls], device="cpu")
    assert [drape.outcome for drape in together] == [Outcome.SETTLED, Outcome.FELL]
    assert drape_batch([falls], device="cpu") == [together[1]]
    assert -30.0 < together[1].vertices[:, 1].max() < 0.0
    assert together[1].frames < DrapeConfig().max_frames


def test_a_loose_component_falls_alone() -> None:
    scrap = patch(4, 4, place=LYING, origin=(80.0, 66.0, 1.0))
    [drape] = drape_batch([on_a_table(joined(SHEET, scrap))], DrapeConfig(max_frames=100), device="cpu")
    assert drape.outcome is Outcome.FELL
    assert drape.vertices[0, 1] > 70.0


def test_a_hem_below_the_floor_is_not_a_fall() -> None:
    mesh = patch(4, 30, origin=(0.0, -5.0, 0.0))
    assert not fell(DrapeJob(mesh, far_ball(), SIZE), mesh.vertices)
    assert fell(DrapeJob(mesh, far_ball(), SIZE), mesh.vertices - [0.0, 20.0, 0.0])


def test_cloth_below_the_floor_is_a_fall_unless_it_hangs_from_hip_height() -> None:
    heap, train = patch(4, 40, origin=(0.0, -20.0, 0.0)), patch(4, 140, origin=(0.0, -50.0, 0.0))
    said = fell(DrapeJob(heap, far_ball(), SIZE), heap.vertices)
    assert said == "51% of the cloth lies below the floor; it hangs from 20 to -20 cm"
    assert not fell(DrapeJob(train, far_ball(), SIZE), train.vertices)


def test_a_ring_round_both_ankles_has_slid_off_and_a_sock_has_not() -> None:
    """Also if the panels were placed there."""
    ring = tube(36, 3, radius=11.5, spacing=2.0, height=10.0)
    sock = replace(ring, vertices=ring.vertices * [0.4, 1.0, 0.4] + [10.0, 0.0, 0.0])
    assert (
        off_body(DrapeJob(ring, far_ball(), SIZE), ring.vertices) == "its top lies at 16 cm, below the knees at 43 cm"
    )
    assert not off_body(DrapeJob(sock, far_ball(), SIZE), sock.vertices)


def test_a_ring_at_rest_round_the_feet_has_slid_off() -> None:
    """Without labels: a wide ring drops from the waist onto the foot of a post and rests there."""
    post = trimesh.creation.cylinder(radius=6.0, height=130.0, sections=24)
    foot = trimesh.creation.cylinder(radius=40.0, height=6.0, sections=48)
    shape = trimesh.util.concatenate([post, foot])
    shape.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    shape.apply_translation([0.0, 3.0, 0.0])
    shape = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(shape.vertices, shape.faces, 8.0))
    ring = tube(36, 3, radius=11.5, spacing=2.0, height=95.0)
    [drape] = drape_batch([DrapeJob(ring, body_from(shape), SIZE)], device="cpu")
    assert np.ptp(drape.vertices[:, 1]) < 8.0
    assert 6.0 < drape.vertices[:, 1].min() < drape.vertices[:, 1].max() < 20.0
    assert drape.outcome is Outcome.SLID_OFF
    assert "below the knees" in drape.reason


def test_a_neckline_belongs_above_the_armpits() -> None:
    """At 131 cm for this size; and its mean above the waist, at 107 cm."""
    dress = patch(
        5, 5, spacing=2.0, origin=(0.0, SIZE.waist_level + 20.0, 0.0), labels={"left_collar": np.arange(30, 36)}
    )
    job = DrapeJob(dress, far_ball(), SIZE)
    assert not off_body(job, dress.vertices)
    assert (
        off_body(job, dress.vertices - [0.0, 10.0, 0.0]) == "its neckline lies at 127 cm, below the armpits at 131 cm"
    )
    assert off_body(job, dress.vertices - [0.0, 40.0, 0.0]) == "its neckline lies at 97 cm, below the waist at 107 cm"


@pytest.mark.parametrize("labels", [{}, {"left_collar": np.arange(36)}, {"lower_interface": np.arange(36)}])
def test_every_piece_of_an_outfit_belongs_on_the_body(labels: dict[str, np.ndarray]) -> None:
    """A top that stays up, and a skirt that is not sewn to it and has dropped to the ankles."""
    waist = SIZE.waist_level
    top = replace(tube(36, 3, radius=15.0, spacing=2.0, height=waist + 30.0), labels=labels)
    outfit = joined(top, tube(36, 20, radius=15.0, spacing=2.0, height=waist - 42.0))
    job, of_skirt = DrapeJob(outfit, far_ball(), SIZE), np.arange(len(outfit.vertices)) >= len(top.vertices)
    dropped = outfit.vertices - np.outer(of_skirt, [0.0, 70.0, 0.0])
    dropped[of_skirt, 1] = np.maximum(dropped[of_skirt, 1], 1.0)
    assert not off_body(job, outfit.vertices)
    assert off_body(job, dropped)
    assert not fell(job, dropped)


def test_edges_of_a_spike_through_cloth_are_counted() -> None:
    """The tip pierces the inside of a face: no cloth edge crosses, but three edges of the body do."""
    spike = trimesh.Trimesh(
        [[50.0, 105.0, -25.0], [40.0, 60.0, -20.0], [60.0, 60.0, -20.0], [50.0, 60.0, -40.0]],
        [[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]],
    )
    cloth = patch(1, 1, spacing=100.0, place=LYING, origin=(0.0, 100.0, 0.0))
    jobs = [DrapeJob(cloth, far_ball(), SIZE), DrapeJob(cloth, body_from(spike), SIZE)]
    solver = Solver(build_model(jobs, DrapeConfig(), "cpu"), DrapeConfig())
    assert solver.body_crossings().tolist() == [0, 0]
    assert solver.body_through().tolist() == [0, 3]
    assert solver.body_through(np.array([True, False])).tolist() == [0, 0]


def test_internal_parts_and_lids_do_not_count_as_skin_through_cloth() -> None:
    """The top of a ball as an eye: neither the eye nor the lid over its opening counts."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    ball.apply_translation([0.0, 100.0, 0.0])
    inside = ball.vertices[:, 1] > 106.0
    parts = np.where(inside, BodyPart.INTERNAL.value, 0).astype(np.uint8)
    body = replace(body_from(ball), parts=parts)
    sheet = patch(1, 1, spacing=100.0, place=LYING, origin=(-31.0, 106.5, 52.0))
    counts = [
        Solver(build_model([DrapeJob(sheet, one, SIZE)], DrapeConfig(), "cpu"), DrapeConfig()).body_through()[0]
        for one in (body_from(ball), body)
    ]
    above = ball.vertices[ball.edges_unique][:, :, 1] > 106.5
    assert counts == [int((above[:, 0] != above[:, 1]).sum()), 0]


@pytest.fixture(scope="module")
def hooded() -> tuple[DrapeJob, Float[np.ndarray, "v 3"]]:
    """A draped hood, which covers the ears."""
    [worn] = prepare(*EARS_OUT, HOOD).dressed
    assert worn.box_mesh is not None
    job = DrapeJob(worn.box_mesh, worn.body, worn.size)
    [drape] = drape_batch([job], DrapeConfig(max_body_crossings=10), device="cpu")
    assert drape.body_through == len(piercing(job, drape.vertices))
    return job, drape.vertices


def test_ears_do_not_pierce_a_hood(hooded: tuple[DrapeJob, Float[np.ndarray, "v 3"]]) -> None:
    """A narrower hood they would pierce."""
    job, vertices = hooded
    assert len(piercing(job, vertices)) == 0
    ears = piercing(job, vertices * (0.9, 1.0, 1.0))
    assert (job.body.parts[ears] == BodyPart.HEAD.value).all(axis=1).sum() > 20


@pytest.mark.parametrize("shift", [(0.0, 0.0, 3.0), (2.0, 1.0, 0.0), (0.0, -12.0, 0.0)])
def test_crossings_agree_with_exact_arithmetic(
    hooded: tuple[DrapeJob, Float[np.ndarray, "v 3"]], shift: tuple[float, float, float]
) -> None:
    """A garment moved through its body: every skin edge against all near triangles, by signs of volumes."""
    job, vertices = hooded
    solver = Solver(build_model([job], DrapeConfig(), "cpu"), DrapeConfig())
    moved = (vertices + shift).astype(np.float32)
    solver.state.x.assign(moved)
    expected = len(piercing(job, moved))
    assert expected > 100
    assert solver.body_through()[0] == expected


def piercing(job: DrapeJob, vertices: Float[np.ndarray, "v 3"]) -> Int[np.ndarray, "n 2"]:
    """The edges of the skin that cross the cloth."""
    body = job.body
    points = body.vertices.astype(np.float32).astype(float)
    skin = body.faces[(body.parts[body.faces] != BodyPart.INTERNAL.value).all(axis=1)]
    edges = np.unique(np.sort(skin[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    ends, triangles = points[edges], np.asarray(vertices, float)[job.box_mesh.faces]
    tree = cKDTree(triangles.mean(axis=1))
    reach = np.linalg.norm(triangles - triangles.mean(axis=1, keepdims=True), axis=2).max()
    half = 0.5 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    near = tree.query_ball_point(ends.mean(axis=1), reach + half)
    edge = np.repeat(np.arange(len(edges)), [len(one) for one in near])
    face = np.concatenate([np.asarray(one, int) for one in near])
    hit = crosses(*ends[edge].transpose(1, 0, 2), *triangles[face].transpose(1, 0, 2))
    return edges[np.unique(edge[hit])]


def crosses(*points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Whether segments pq cross triangles abc, by the signs of five volumes."""
    p, q, a, b, c = points
    apart = volume(a, b, c, p) * volume(a, b, c, q) <= 0
    sides = np.sign([volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)])
    return apart & ((sides >= 0).all(axis=0) | (sides <= 0).all(axis=0))


def volume(*points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    a, b, c, d = points
    return (np.cross(b - a, c - a) * (d - a)).sum(axis=1)
