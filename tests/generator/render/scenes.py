"""Small scenes with known answers."""

import numpy as np
import trimesh

from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.render import (
    Appearance,
    Camera,
    ClothLook,
    Environment,
    EnvironmentKind,
    Lights,
    Print,
    Scene,
    Stitching,
    View,
    Weave,
    look_at,
    scene_of,
)
from gcd_dataset.records import BoxMesh
from tests.helpers import body_from, far_ball, napkins, patch

GREY = (0.5, 0.5, 0.5)
FLAT = Weave(depth=0.0, specular=0.0, sheen=0.0, mottle=0.0, wrinkles=0.0)
BARE = Stitching(hem=0.0)
DARK = Environment(EnvironmentKind.PLAIN, ((0.0, 0.0, 0.0),) * 3)
FRONT_LIGHT = Lights(np.array([0.0, 0.0, 1.0]), key=(0.8, 0.8, 0.8), sky=0.2)


def cloth_of(motif: Print, *, translucency: float = 0.0, transmission: float = 0.05) -> ClothLook:
    """Matt cloth without stitches, wrinkles and threads."""
    return ClothLook(motif, FLAT, BARE, translucency=translucency, transmission=transmission)


def plain(*colours: tuple[float, float, float]) -> Print:
    return Print(colours=(*colours, *(GREY,) * (4 - len(colours))))  # type: ignore[arg-type]


def look(scene: Scene, *cloths: ClothLook) -> Appearance:
    """Panel k of cloth k, or all of the last."""
    rows = np.minimum(np.arange(len(scene.panel_names)), len(cloths) - 1)
    return Appearance(cloths, rows, underwear=None)


def hung_patch(columns: int = 10, rows: int = 10, *, spacing: float = 2.0) -> BoxMesh:
    """A square of cloth that faces +z, its middle 100 cm above the floor."""
    return patch(columns, rows, spacing=spacing, origin=(-0.5 * columns * spacing, 100.0 - 0.5 * rows * spacing, 0.0))


def patch_scene(mesh: BoxMesh | None = None) -> Scene:
    """A cloth far in front of its body, which is out of sight."""
    mesh = hung_patch() if mesh is None else mesh
    return scene_of(mesh, mesh.vertices, far_ball())


def open_napkins() -> Scene:
    """Two napkins of 20 x 10 cm, sewn together in the middle and laid open."""
    pattern = napkins()
    mesh = build_box_mesh(pattern, spacing=2.0)
    shift = np.where(mesh.panel_id == 0, 0.0, 20.0)
    flat = np.zeros((len(mesh.vertices), 3))
    flat[mesh.uv_vertex[mesh.corners], :2] = mesh.uv[mesh.corners]
    flat[mesh.uv_vertex[mesh.corners], 0] += shift[:, None]
    return scene_of(mesh, flat + [-20.0, 95.0, 0.0], far_ball(), pattern=pattern)


def ball_scene(radius: float = 20.0) -> Scene:
    """A ball 100 cm above the floor, and cloth behind it."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    ball.apply_translation([0.0, 100.0, 0.0])
    mesh = hung_patch()
    return scene_of(mesh, mesh.vertices - [0.0, 0.0, 100.0], body_from(ball))


def ahead(distance: float = 100.0, *, focal: float = 4.0) -> Camera:
    """A camera at the level of the patch, straight before it."""
    return look_at(np.array([0.0, 100.0, distance]), np.array([0.0, 100.0, 0.0]), focal=focal)


def view_of(scene: Scene, *cloths: ClothLook, camera: Camera | None = None, lights: Lights = FRONT_LIGHT) -> View:
    cloths = cloths or (cloth_of(plain(GREY)),)
    return View(0, look(scene, *cloths), camera or ahead(), lights, DARK)
