"""Start positions of sewing: wide skirts on a cone, wide bodices between the arms, tubes round arms and legs."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from gcd_dataset.generator.body import build_body, neutral_shape
from gcd_dataset.generator.body.limbs import Limb, leg_of, limbs_of
from gcd_dataset.generator.dressing.sewing_start import ARM_GAP, LEG_GAP, SLICE, sewing_start
from gcd_dataset.generator.dressing.skirt_on_cone import Skirt
from gcd_dataset.generator.dressing.tube_on_limb import put_on_limb, roll_round_limb
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import (
    Body,
    BodyPart,
    BoxMesh,
    Edge,
    EdgeRef,
    EdgeRole,
    Panel,
    PanelRole,
    Pattern,
    Placement,
    Seam,
)
from tests.generator.drape.garments import neutral
from tests.helpers import patch

LEVELS = {
    "meta": {"upper": None, "wb": "StraightWB", "bottom": "SkirtLevels"},
    "levels-skirt": {"base": "SkirtCircle", "level": "SkirtCircle", "num_levels": 3, "level_ruffle": 1.5},
}
CIRCLE = {"meta": {"upper": "Shirt", "bottom": "SkirtCircle"}, "flare-skirt": {"length": 0.6, "suns": 1.5}}
PENCIL = {"upper": None, "bottom": "PencilSkirt"}
TROUSERS = {"meta": {"upper": None, "bottom": "Pants"}, "pants": {"length": 0.9, "flare": 0.6}}
WIDE_SLEEVES = {
    "sleeveless": False, "length": 0.9, "connecting_width": 1.4, "end_width": 1.3, "sleeve_angle": 14,
    "connect_ruffle": 1.9, "cuff": {"type": "CuffBand", "top_ruffle": 1.7, "cuff_len": 0.1},
}  # fmt: skip
LONG_SLEEVES = {"sleeveless": False, "length": 1.15, "end_width": 0.5, "cuff": {"type": "CuffBand", "cuff_len": 0.1}}


def mesh_of(values: Mapping[str, Any]) -> BoxMesh:
    return build_box_mesh(draw_garment(neutral()[1], design_from_dict(values)), spacing=2.5)


def shirt(**sections: Mapping[str, Any]) -> BoxMesh:
    return mesh_of({"meta": {"upper": "Shirt"}, **sections})


def faces_of(mesh: BoxMesh, role: PanelRole) -> Bool[np.ndarray, " f"]:
    return np.array([str(label) == role for label in mesh.panel_labels])[mesh.panel_id]


def vertices_of(mesh: BoxMesh, role: PanelRole) -> Int[np.ndarray, " n"]:
    return np.unique(mesh.faces[faces_of(mesh, role)])


def skin_of(*parts: BodyPart) -> Float[np.ndarray, "n 3"]:
    body = neutral()[0]
    return body.vertices[np.isin(body.parts, [part.value for part in parts])]


@pytest.mark.parametrize("design", [LEVELS, CIRCLE], ids=["levels", "circle"])
def test_a_wide_skirt_lies_below_its_top_and_outside_the_body(design: Mapping[str, Any]) -> None:
    mesh = mesh_of(design)
    skirt = vertices_of(mesh, PanelRole.LEG)
    start = sewing_start(mesh, neutral()[0])[skirt]
    assert mesh.vertices[skirt, 1].max() > start[:, 1].max() + 4.0
    legs = cKDTree(skin_of(BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG, BodyPart.TRUNK)[:, [0, 2]])
    axis = np.array([0.0, skin_of(BodyPart.TRUNK)[:, 2].mean()])
    _, nearest = legs.query(start[:, [0, 2]])
    outward = start[:, [0, 2]] - axis
    assert (np.linalg.norm(outward, axis=1) > np.linalg.norm(legs.data[nearest] - axis, axis=1)).all()
    front = mesh.vertices[skirt, 2] > 5.0
    assert (start[front, 2] > axis[1] - 1.0).all()


def test_a_vertex_lies_as_far_down_the_cone_as_along_the_cloth() -> None:
    """Edges along the length of a circle skirt keep their flat length; only edges round it are compressed."""
    mesh = mesh_of(CIRCLE)
    start = sewing_start(mesh, neutral()[0])
    faces = faces_of(mesh, PanelRole.LEG)
    for k in range(3):
        ends = mesh.faces[faces][:, [k, (k + 1) % 3]]
        flat = np.linalg.norm(np.diff(mesh.uv[mesh.corners[faces][:, [k, (k + 1) % 3]]], axis=1)[:, 0], axis=1)
        length = np.linalg.norm(start[ends[:, 0]] - start[ends[:, 1]], axis=1)
        assert (length < 1.25 * flat + 0.5).mean() > 0.98


def test_a_skirt_without_a_path_down_from_its_top_starts_flat() -> None:
    # Of a predicted pattern, only a ring of a few vertices may be sewn to the waist; the rest hangs on nothing.
    mesh, body = mesh_of(CIRCLE), neutral()[0]
    skirt = Skirt.of(mesh, np.array([label == PanelRole.LEG for label in mesh.panel_labels]))
    assert skirt is not None
    placed = np.array(mesh.vertices, float)
    replace(skirt, top=skirt.cloth.vertices).place_on_cone(limbs_of(body)[BodyPart.TRUNK], placed)
    assert np.array_equal(placed, mesh.vertices)


def test_cloth_sewn_all_round_but_for_a_slit_is_no_tube() -> None:
    """No cross section of it lies at its root: the harmonic function from root to end is near 0 nearly everywhere."""
    mesh, limb = patch(30, 30), limbs_of(neutral()[0])[BodyPart.LEFT_ARM]
    middle = mesh.uv[mesh.corners].mean(axis=1)
    square = (np.abs(middle - 15.0) < 10.0).all(axis=1)
    corridor = (np.abs(middle[:, 0] - 15.5) < 1.5) & (middle[:, 1] > 15.0)
    placed = np.array(mesh.vertices, float)
    assert not put_on_limb(mesh, square | corridor, limb, placed)
    assert np.array_equal(placed, mesh.vertices)


def test_a_narrow_skirt_starts_flat_and_one_with_room_for_the_feet_where_it_is_placed() -> None:
    mesh = mesh_of({"meta": PENCIL, "pencil-skirt": {"length": 0.4}})
    assert np.array_equal(sewing_start(mesh, neutral()[0]), mesh.vertices)
    mesh = mesh_of({"meta": PENCIL, "pencil-skirt": {"length": 0.95, "flare": 1.5}})
    skirt = vertices_of(mesh, PanelRole.LEG)
    assert np.array_equal(sewing_start(mesh, neutral()[0])[skirt], mesh.vertices[skirt])


@pytest.mark.parametrize("aside", [0.0, 9.0])
def test_a_narrow_skirt_down_to_the_floor_starts_above_the_feet_and_round_both_legs(aside: float) -> None:
    """Sewn at the height of the feet, its side seams would close through them."""
    mesh = mesh_of({"meta": PENCIL, "pencil-skirt": {"length": 0.95, "flare": 0.8}})
    feet = skin_of(BodyPart.FEET)
    skirt = vertices_of(mesh, PanelRole.LEG)
    vertices = mesh.vertices + [aside, 0.0, 0.0]
    assert vertices[skirt, 1].min() < 0.5 * feet[:, 1].max()
    start = sewing_start(replace(mesh, vertices=vertices), neutral()[0])[skirt]
    assert start[:, 1].min() > feet[:, 1].max()
    legs = skin_of(BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG)
    for height in np.arange(start[:, 1].min() + 3.0, 60.0, 6.0):
        cloth, skin = (points[np.abs(points[:, 1] - height) < 3.0, 0] for points in (start, legs))
        assert cloth.min() < skin.min()
        assert cloth.max() > skin.max()


def test_a_wide_bodice_without_sleeves_starts_between_the_arms() -> None:
    mesh = shirt(shirt={"width": 1.3, "length": 1.5, "flare": 1.5})
    bodice = vertices_of(mesh, PanelRole.BODY)
    start = sewing_start(mesh, neutral()[0])
    arm = skin_of(BodyPart.LEFT_ARM)
    assert mesh.vertices[bodice, 0].max() > arm[:, 0].min() + 10.0
    height = arm[:, 1].max() - 40.0
    inside = arm[np.abs(arm[:, 1] - height) < SLICE, 0].min() - ARM_GAP
    here = bodice[np.abs(start[bodice, 1] - height) < 0.5 * SLICE]
    assert 0.0 < start[here, 0].max() <= inside + 1.5
    assert start[bodice, 1:] == pytest.approx(mesh.vertices[bodice, 1:])


@pytest.mark.parametrize("degrees", [-20.0, 25.0])
def test_a_sleeve_starts_round_an_arm_in_another_pose(degrees: float) -> None:
    """The sleeve is cut for the A-pose; the body holds its arms lower or higher."""
    mesh = shirt(sleeve={"sleeveless": False, "length": 0.8, "end_width": 0.6})
    body = build_body(replace(neutral_shape(), arm_angle=np.radians(degrees)))
    start = sewing_start(mesh, body)
    arm = limbs_of(body)[BodyPart.LEFT_ARM]
    across = np.array([-arm.axis[1], arm.axis[0]]) / np.linalg.norm(arm.axis[:2])
    sleeve = side_of(mesh, PanelRole.ARM)

    def beside(points: Float[np.ndarray, "n 3"]) -> float:
        """Distance from the middle of the sleeve's end to the arm's axis [cm]."""
        along = (points - arm.origin) @ arm.axis
        end = points[along > along.max() - 6.0, :2] - arm.origin[:2]
        offset = end @ across
        return abs(float(offset.min() + offset.max())) / 2

    assert beside(mesh.vertices[sleeve]) > 6.0
    assert beside(start[sleeve]) < 2.5


def side_of(mesh: BoxMesh, role: PanelRole) -> Int[np.ndarray, " n"]:
    """The vertices of a role on the wearer's left."""
    vertices = vertices_of(mesh, role)
    return vertices[mesh.vertices[vertices, 0] > 0.0]


def test_a_sleeve_longer_than_the_arm_starts_on_the_arm_and_not_round_the_hand() -> None:
    mesh = shirt(sleeve=LONG_SLEEVES)
    sleeve = side_of(mesh, PanelRole.ARM)
    arm = limbs_of(neutral()[0])[BodyPart.LEFT_ARM]
    wrist = float((arm.skin @ arm.axis).max())
    assert (mesh.vertices[sleeve] @ arm.axis).max() > wrist + 3.0
    assert (sewing_start(mesh, neutral()[0])[sleeve] @ arm.axis).max() < wrist


def test_a_wide_sleeve_below_its_armhole_starts_outside_trunk_and_bodice() -> None:
    mesh = shirt(sleeve=WIDE_SLEEVES)
    start = sewing_start(mesh, neutral()[0])
    bodice, sleeve = side_of(mesh, PanelRole.BODY), side_of(mesh, PanelRole.ARM)
    armhole = np.intersect1d(bodice, sleeve)
    below = sleeve[start[sleeve, 1] < start[armhole, 1].min()]
    assert len(below) > 10
    beside = np.concatenate([start[bodice], skin_of(BodyPart.TRUNK, BodyPart.LEFT_LEG)])
    for x, y, _ in start[np.setdiff1d(below, armhole)]:
        assert x > beside[np.abs(beside[:, 1] - y) < 0.5 * SLICE, 0].max(initial=-np.inf)


def test_a_wide_sleeve_that_ends_below_a_torso_starts_at_finite_positions() -> None:
    body = neutral()[0]
    keep = ~np.isin(body.parts, [part.value for part in (BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG, BodyPart.FEET)])
    faces = (np.cumsum(keep) - 1)[body.faces[keep[body.faces].all(axis=1)]]
    torso = replace(body, vertices=body.vertices[keep], faces=faces, parts=body.parts[keep])
    assert np.isfinite(sewing_start(shirt(sleeve=WIDE_SLEEVES), torso)).all()


def test_the_end_of_a_moved_sleeve_is_straight() -> None:
    """Its vertices start at one distance along the arm: cuffs were sewn with the hem of one panel before the wrist."""
    mesh = shirt(sleeve=LONG_SLEEVES)
    start, arm = sewing_start(mesh, neutral()[0]), limbs_of(neutral()[0])[BodyPart.LEFT_ARM]
    cuffs = [number for number, name in enumerate(mesh.panel_names) if "left_cuff" in name]
    ends = [np.sort(start[np.unique(mesh.faces[mesh.panel_id == cuff])] @ arm.axis)[-5:].mean() for cuff in cuffs]
    assert len(ends) == 2
    assert abs(ends[0] - ends[1]) < 0.5


def test_trouser_legs_start_round_the_legs_and_end_at_the_ankles() -> None:
    body, mesh = neutral(legs_apart=True)[0], mesh_of(TROUSERS)
    start = sewing_start(mesh, body)
    leg = leg_of(body, BodyPart.LEFT_LEG)
    assert leg is not None
    own = vertices_of(mesh, PanelRole.LEG)
    low = own[(start[own, 1] < 30.0) & (start[own, 0] > 0.0)]
    assert len(low)
    assert (start[low] @ leg.axis).max() < (leg.skin @ leg.axis).max()
    calf = leg.skin[np.abs(leg.skin[:, 1] - 28.0) < 2.0, 0]
    beside = low[np.abs(start[low, 1] - 28.0) < 2.0]
    assert start[beside, 0].min() < calf.min()
    assert start[beside, 0].max() > calf.max()


def test_the_lowest_point_of_an_armhole_starts_under_the_arm() -> None:
    sleeves = {"sleeveless": True, "connecting_width": 1.0}
    mesh = shirt(shirt={"width": 1.3, "length": 1.3, "flare": 1.4}, sleeve=sleeves)
    body = build_body(replace(neutral_shape(), arm_angle=np.radians(-25.0)))
    armhole = mesh.labels[EdgeRole.LEFT_ARMHOLE]
    lowest = armhole[np.argmin(mesh.vertices[armhole, 1])]
    arm = limbs_of(body)[BodyPart.LEFT_ARM].skin
    inside = arm[np.abs(arm[:, 1] - mesh.vertices[lowest, 1]) < SLICE, 0].min()
    assert mesh.vertices[lowest, 0] > inside
    assert sewing_start(mesh, body)[lowest, 0] < inside


def test_trousers_before_a_seated_wearer_start_at_finite_positions() -> None:
    """The thighs point forward, so that the legs have no side-by-side heights."""
    standing = neutral(legs_apart=True)[0]
    forward = standing.vertices[:, [0, 2, 1]] * (1.0, 1.0, -1.0)
    assert np.isfinite(sewing_start(mesh_of(TROUSERS), replace(standing, vertices=forward))).all()


DEPTH = 0.3  # cm under the skin: rounding decides on which side of the skin a cuff lies that touches it


def starts(seed: int, number: int, *, resolution: float = 2.0) -> list[tuple[BoxMesh, Float[np.ndarray, "v 3"], Body]]:
    """The coarse mesh of a sampled garment, its start and its body, for each of the two wearers of a design."""
    dressed = prepare(seed, number, MakeConfig(bodies="both", resolution=resolution, device="cpu")).dressed
    found = [(one.coarse.mesh, one.start, one.body) for one in dressed if one.coarse and one.start is not None]
    assert len(found) == 2
    return found


def faces_through_limbs(mesh: BoxMesh, vertices: np.ndarray, body: Body, depth: float) -> dict[str, int]:
    """The number of edges of the body, ``depth`` under its skin [cm], that pass through each panel."""
    cloth = trimesh.Trimesh(vertices, mesh.faces, process=False)
    skin = trimesh.Trimesh(body.vertices, body.faces, process=False)
    under, edges = body.vertices - depth * skin.vertex_normals, skin.edges_unique
    start = under[edges[:, 0]]
    along = under[edges[:, 1]] - start
    length = np.linalg.norm(along, axis=1)
    hits, ray, face = cloth.ray.intersects_location(start, along / length[:, None], multiple_hits=False)
    pierced = mesh.panel_id[face[np.linalg.norm(hits - start[ray], axis=1) < length[ray]]]
    return {name: int((pierced == number).sum()) for number, name in enumerate(mesh.panel_names)}


@pytest.mark.parametrize(
    ("index", "cuff"),
    [
        (320, "sl_left_cuff_"),  # a wide sleeve gathered into a narrow cuff
        (742, "sl_left_cuff_"),
        (254, "pant_l_cuff_"),  # flared cuffs that reach past the other leg
        (255, "pant_l_cuff_"),
    ],
)
def test_cuffs_start_round_their_limbs(index: int, cuff: str) -> None:
    depth = -LEG_GAP if cuff.startswith("pant") else DEPTH
    through = faces_through_limbs(*starts(90125, index // 2)[index % 2], depth)
    assert any(name.startswith(cuff) for name in through)
    assert not {name: count for name, count in through.items() if name.startswith(cuff) and count}


def test_narrow_rings_of_a_skirt_start_round_the_legs() -> None:
    """Rings of over half a turn below a tube: the ends of their upper edge point up, within the thighs."""
    for each in starts(51128464, 1402, resolution=1.0):
        through = faces_through_limbs(*each, DEPTH)
        assert "skirt_back_4" in through
        assert not any(through.values())


def test_a_cuff_that_reaches_past_the_middle_starts_on_its_own_side() -> None:
    mesh, start, _ = starts(51128464, 693)[1]
    cuff = mesh.faces[mesh.panel_id == mesh.panel_names.index("sl_right_cuff_skirt_b")]
    assert mesh.vertices[cuff, 0].max() > 5.0
    assert start[cuff, 0].max() < -10.0


def test_trousers_with_a_narrow_cuff_end_before_the_foot() -> None:
    """The flare below the cuff is loose, but the cuff would not slip off the foot."""
    mesh, start, _ = starts(31415, 126)[1]
    flare = [number for number, name in enumerate(mesh.panel_names) if name.startswith("pant_l_cuff_skirt")]
    cloth = np.unique(mesh.faces[np.isin(mesh.panel_id, flare)])
    assert start[cloth, 1].min() > 0.0


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
    own, placed = faces_of(mesh, PanelRole.ARM), np.array(mesh.vertices, float)
    assert roll_round_limb(mesh, own, arm(radius), placed)
    rows = np.unique(mesh.faces[own])
    beyond = rows[np.abs(placed[rows, 0] - placed[rows, 0].max()) < LENGTH - 12.0]
    return placed[beyond, 1:] - [100.0, 0.0], beyond


def test_sleeve_surrounds_the_arm_with_its_own_girth_its_middle_above_and_its_seam_below(mesh: BoxMesh) -> None:
    around, rows = rolled(mesh, 4.0)
    assert np.linalg.norm(around, axis=1) == pytest.approx(WIDTH / (2 * np.pi), rel=0.02)
    assert np.diff(np.sort(np.arctan2(around[:, 1], around[:, 0]))).max() < np.radians(30)
    vertex, count = np.unique(mesh.uv_vertex, return_counts=True)
    assert around[np.isin(rows, vertex[count > 1]), 0].max() < -0.9 * WIDTH / (2 * np.pi)
    assert around[:, 0].max() == pytest.approx(WIDTH / (2 * np.pi), rel=0.02)


def test_sleeve_narrower_than_the_arm_is_widened_beyond_the_skin(mesh: BoxMesh) -> None:
    around, _ = rolled(mesh, 9.0)
    assert np.linalg.norm(around, axis=1).min() > 9.0


def test_right_side_of_the_cloth_is_outside(mesh: BoxMesh) -> None:
    own, placed = faces_of(mesh, PanelRole.ARM), np.array(mesh.vertices, float)
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
