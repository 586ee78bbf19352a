"""Borders of panels, hair and underwear lie where the garment and the body have them."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from gcd_dataset.generator.body import build_body, draw_shape, neutral_shape
from gcd_dataset.generator.body.landmarks import model_landmarks
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.render import HairStyle, Scene, look_at, render, scene_of
from gcd_dataset.generator.render.figure import body_masks, eyeballs, hair_shell
from gcd_dataset.generator.render.geometry import HEM, PanelBorders, panel_borders
from gcd_dataset.generator.render.pictures import HAIR
from gcd_dataset.records import Body, BodyPart, BoxMesh
from tests.generator.render.scenes import view_of
from tests.helpers import body_from, far_ball, joined, napkins, patch, tube


def borders_of(mesh: BoxMesh) -> PanelBorders:
    return panel_borders(scene_of(mesh, mesh.vertices, far_ball()))


def test_the_border_of_panels_is_their_perimeter() -> None:
    """Two squares of 4 × 10 cm and 4 × 3 cm, 5 segments a side: lengths begin at each."""
    borders = borders_of(joined(patch(5, 5, spacing=2.0), patch(5, 5, spacing=0.6)))
    assert (borders.seam == HEM).all()
    assert borders.first.tolist() == [0, 20, 40]
    assert sorted(borders.along[:20].tolist()) == pytest.approx(np.arange(0.0, 40.0, 2.0).tolist())
    assert sorted(borders.along[20:].tolist()) == pytest.approx(np.arange(0.0, 12.0, 0.6).tolist())
    one = borders_of(patch(1, 1))
    assert sum(int(flag).bit_count() for flag in one.flags) == 4
    assert all(flag & 0b111 == 0 for flag in one.flags.tolist())


def test_seams_are_found_on_both_panels() -> None:
    """Napkins of 20 × 10 cm, sewn along 10 cm; a tube whose long edges share vertices has a seam of unknown row."""
    mesh = build_box_mesh(napkins(), spacing=1.0)
    borders = borders_of(mesh)
    lengths = np.linalg.norm(mesh.uv[borders.ends[:, 1]] - mesh.uv[borders.ends[:, 0]], axis=1)
    assert lengths[borders.seam == 0].sum() == pytest.approx(2 * 10.0, rel=1e-3)
    assert lengths[borders.seam == HEM].sum() == pytest.approx(2 * 50.0, rel=1e-3)
    round_tube = borders_of(tube(12, 4, radius=5.0)).seam
    assert ((round_tube == -1).sum(), (round_tube == HEM).sum()) == (2 * 4, 2 * 12)


def test_panel_corners_are_rows_of_their_own_panel() -> None:
    """The napkins lie over each other in the panel plane, beside the origin, with corners on cells of the grid."""
    pattern = napkins()
    mesh = build_box_mesh(pattern, spacing=1.0)
    for shift in (0.0, -0.5, 0.25, -123.4567):
        panels = tuple(replace(panel, vertices=panel.vertices + shift) for panel in pattern.panels)
        moved = replace(mesh, uv=mesh.uv + shift)
        scene = scene_of(moved, mesh.vertices, far_ball(), pattern=replace(pattern, panels=panels))
        assert len(scene.corner_rows) == sum(len(p.vertices) for p in pattern.panels)
        for (panel, corner), row in zip(scene.panel_corners.tolist(), scene.corner_rows.tolist(), strict=True):
            assert moved.uv[row] == pytest.approx(panels[panel].vertices[corner], abs=1e-2)
            assert scene.panel_of_row[row] == panel


@pytest.mark.parametrize("seed", range(3))
def test_underwear_and_eyes_suit_any_body(seed: int) -> None:
    """Briefs cover the hips, the top the breasts; eyes lie in their sockets."""
    body = build_body(draw_shape(np.random.default_rng(seed)))
    masks, y = body_masks(body), body.vertices[:, 1]
    trunk = body.parts == BodyPart.TRUNK.value
    assert (masks.briefs[trunk & (y < y[trunk].min() + 4.0)] > 0).all()
    limbs = np.isin(body.parts, [BodyPart.HANDS.value, BodyPart.FEET.value, BodyPart.HEAD.value])
    assert (masks.briefs[limbs] < 0).all() and (masks.top[limbs] < 0).all()
    for name in ("bust_right", "bust_left"):
        nearest = np.linalg.norm(body.vertices - model_landmarks(body.vertices).points[name], axis=1).argmin()
        assert masks.top[nearest] > 2.0
    eyes = eyeballs(body)
    (right, left), balls = eyes.centres, trimesh.Trimesh(eyes.vertices, eyes.faces, process=False)
    assert right[0] < -1.5 < 1.5 < left[0]
    assert right[1] == pytest.approx(left[1], abs=0.2)
    assert np.linalg.norm(eyes.vertices[: len(eyes.vertices) // 2] - right, axis=1) == pytest.approx(eyes.radius)
    assert balls.volume == pytest.approx(2 * 4 / 3 * np.pi * eyes.radius**3, rel=0.25)


def test_hair_lies_on_the_head_and_leaves_the_face_free() -> None:
    body = build_body(neutral_shape())
    assert len(hair_shell(bare_head(body, HairStyle.NONE)).faces) == 0
    depths = []
    for style in (HairStyle.CROPPED, HairStyle.SHORT, HairStyle.FULL):
        shell = hair_shell(bare_head(body, style))
        head = body.vertices[body.parts == BodyPart.HEAD.value]
        depths.append(shell.vertices[:, 1].max() - head[:, 1].max())
        assert np.linalg.norm(shell.vertices - head[head[:, 2].argmax()], axis=1).min() > 5.0
    assert 0.3 < depths[0] < depths[1] < depths[2] < 3.0


def test_hair_stays_under_a_hood() -> None:
    """Of a head in cloth that lies 0.6 cm off its skin, no camera sees hair; without the cloth, all do."""
    under, bare = hair_pixels(HairStyle.FULL)
    assert max(under) == 0
    assert min(bare) > 28


def hair_pixels(style: HairStyle) -> tuple[list[int], list[int]]:
    """Pixels of hair from five sides: of a head in a hood, and of a bare head."""
    body, middle = build_body(neutral_shape()), np.array([0, 155.0, 0])
    eyes = [np.array([200 * np.sin(angle), 200.0, 200 * np.cos(angle)]) for angle in (0.6, 1.8, 3.1, 4.4, 5.7)]
    scenes = [hooded(body, style), bare_head(body, style)]
    views = [
        replace(view_of(scene, camera=look_at(eye, middle, focal=6)), scene=row)
        for row, scene in enumerate(scenes)
        for eye in eyes
    ]
    pictures = render(scenes, views, size=48, maps=("part",), device="cpu")
    hair = [int((picture.maps["part"] == HAIR).sum()) for picture in pictures]
    return hair[:5], hair[5:]


def hooded(body: Body, style: HairStyle) -> Scene:
    """A body whose head and neck are in cloth."""
    skin = trimesh.Trimesh(body.vertices, body.faces, process=False)
    chin = body.vertices[body.parts == BodyPart.HEAD.value, 1].min()
    head = (body.vertices[body.faces, 1] > chin - 5.0).all(axis=1)
    rows, faces = np.unique(body.faces[head], return_inverse=True)
    faces, points = faces.reshape(-1, 3), (body.vertices + 0.6 * skin.vertex_normals)[rows]
    mesh = replace(
        patch(1, 1), vertices=points, faces=faces, corners=faces, uv=points[:, :2], uv_vertex=np.arange(len(points)),
        panel_id=np.zeros(len(faces), int),
    )  # fmt: skip
    return scene_of(mesh, points, body, hair=style)


def bare_head(body: Body, style: HairStyle) -> Scene:
    """A body and, far from its head, a patch of cloth."""
    mesh = patch(1, 1)
    return scene_of(mesh, mesh.vertices, body, hair=style)


def test_a_body_without_a_head_has_neither_hair_nor_eyes() -> None:
    ball = body_from(trimesh.creation.icosphere())
    assert len(hair_shell(bare_head(ball, HairStyle.FULL)).faces) == 0
    assert len(eyeballs(ball).faces) == 0
