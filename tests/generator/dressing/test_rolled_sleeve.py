"""One-panel sleeves at the start of sewing."""

import numpy as np
import pytest

from gcd_dataset.generator.body.limbs import Limb
from gcd_dataset.generator.dressing.rolled_sleeve import roll_round_limb
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.records import BoxMesh, Edge, EdgeRef, Panel, PanelRole, Pattern, Placement, Seam

WIDTH, LENGTH = 40.0, 50.0  # cm
ABOVE = 8.0  # cm between the arm's axis and the flat sleeve


def rectangle(name: str, height: float, placement: Placement, role: PanelRole) -> Panel:
    """A rectangle of ``WIDTH``, whose top and bottom have two edges each: the ends of a ring's seam must differ."""
    half = 0.5 * WIDTH
    corners = np.array([[-half, 0.0], [0.0, 0.0], [half, 0.0], [half, height], [0.0, height], [-half, height]])
    return Panel(name, corners, tuple(Edge(i, (i + 1) % 6) for i in range(6)), placement, role)


@pytest.fixture(scope="module")
def mesh() -> BoxMesh:
    """A sleeve of one panel above a horizontal arm, sewn to itself along its length and by its top to a strip."""
    flat = Placement(np.array([60.0, 100.0 + ABOVE, 0.0]), np.array([0.0, 0.0, 0.0]))
    down = np.array([-np.pi / 2, 0.0, 0.0])
    turned = Placement(flat.translation, np.array([down[0], np.pi / 2, 0.0]))
    sleeve = rectangle("sleeve", LENGTH, turned, PanelRole.ARM)
    strip = rectangle("strip", 10.0, Placement(np.array([5.0, 100.0, 0.0]), turned.rotation), PanelRole.BODY)
    pairs = [(("sleeve", 2), ("sleeve", 5)), (("strip", 2), ("strip", 5))]
    pairs += [(("sleeve", 3), ("strip", 1)), (("sleeve", 4), ("strip", 0))]
    seams = tuple(Seam(EdgeRef(*left), EdgeRef(*right)) for left, right in pairs)
    return build_box_mesh(Pattern("sleeve", (sleeve, strip), seams), spacing=2.0)


def arm(radius: float) -> Limb:
    """A cylinder along x, from x = 0 to 80, at a height of 100 cm."""
    along, turn = np.meshgrid(np.linspace(0.0, 80.0, 41), np.linspace(0.0, 2 * np.pi, 32, endpoint=False))
    skin = np.stack([along, 100.0 + radius * np.cos(turn), radius * np.sin(turn)], axis=-1).reshape(-1, 3)
    return Limb(skin, np.array([1.0, 0.0, 0.0]), np.array([40.0, 100.0, 0.0]), radius, radius)


def rolled(mesh: BoxMesh, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions about the arm's axis of the sleeve's vertices beyond 10 cm from its root, and their vertex numbers."""
    own = np.array(mesh.panel_labels)[mesh.panel_id] == PanelRole.ARM
    placed = np.array(mesh.vertices, float)
    assert roll_round_limb(mesh, own, arm(radius), placed)
    rows = np.unique(mesh.faces[own])
    beyond = rows[np.abs(placed[rows, 0] - placed[rows, 0].max()) < LENGTH - 12.0]
    return placed[beyond, 1:] - [100.0, 0.0], beyond


def test_sleeve_surrounds_the_arm_with_its_own_girth(mesh: BoxMesh) -> None:
    around, _ = rolled(mesh, 4.0)
    assert np.linalg.norm(around, axis=1) == pytest.approx(WIDTH / (2 * np.pi), rel=0.02)
    angles = np.sort(np.arctan2(around[:, 1], around[:, 0]))
    assert np.diff(angles).max() < np.radians(30)


def test_sleeve_narrower_than_the_arm_is_widened_beyond_the_skin(mesh: BoxMesh) -> None:
    around, _ = rolled(mesh, 9.0)
    assert np.linalg.norm(around, axis=1).min() > 9.0


def test_middle_stays_above_and_the_seam_comes_below(mesh: BoxMesh) -> None:
    around, rows = rolled(mesh, 4.0)
    vertex, count = np.unique(mesh.uv_vertex, return_counts=True)
    assert around[np.isin(rows, vertex[count > 1]), 0].max() < -0.9 * WIDTH / (2 * np.pi)
    assert around[:, 0].max() == pytest.approx(WIDTH / (2 * np.pi), rel=0.02)


def test_right_side_of_the_cloth_is_outside(mesh: BoxMesh) -> None:
    own = np.array(mesh.panel_labels)[mesh.panel_id] == PanelRole.ARM
    placed = np.array(mesh.vertices, float)
    roll_round_limb(mesh, own, arm(4.0), placed)
    a, b, c = placed[mesh.faces[own]].transpose(1, 0, 2)
    normals, centres = np.cross(b - a, c - a), (a + b + c) / 3
    beyond = centres[:, 0] > centres[:, 0].max() - LENGTH + 12.0
    outward = centres[beyond] - [0.0, 100.0, 0.0]
    assert (normals[beyond, 1:] * outward[:, 1:]).sum(axis=1).min() > 0.0


def test_sleeve_of_two_panels_is_left_alone(mesh: BoxMesh) -> None:
    everything = np.ones(len(mesh.faces), bool)
    placed = np.array(mesh.vertices, float)
    assert not roll_round_limb(mesh, everything, arm(4.0), placed)
    assert np.array_equal(placed, mesh.vertices)
