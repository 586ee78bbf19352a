"""Plain pictures, as data sets store them: front and back in flat panel colours on paper."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from jaxtyping import Float, UInt8

from gcd_dataset.generator.lay_plan import PALETTE, PAPER
from gcd_dataset.generator.render.appearance import RGB, Appearance, ClothLook, Print, Underwear
from gcd_dataset.generator.render.cameras import fixed_camera
from gcd_dataset.generator.render.casting import PendingPictures
from gcd_dataset.generator.render.environment import Environment, EnvironmentKind, Lights
from gcd_dataset.generator.render.pictures import PlainView
from gcd_dataset.generator.render.scene import Scene, figure_scene, scene_of
from gcd_dataset.records import Body, BoxMesh

SIDES = ("front", "back")
SKIN: RGB = (0.80, 0.76, 0.72)
WRONG_SIDE = 0.55  # brightness of the wrong side of cloth, relative to the right side
CLOTHS = tuple(ClothLook(Print(colours=(colour,) * 4), wrong_side=WRONG_SIDE) for colour in PALETTE)
PAGE = Environment(EnvironmentKind.PLAIN, ((PAPER[0] / 255, PAPER[1] / 255, PAPER[2] / 255),) * 3)


def garment_scene(vertices: Float[np.ndarray, "v 3"], mesh: BoxMesh, body: Body) -> Scene:
    """The scene of a garment at ``vertices`` [cm] on its body; of a diverged drape the body alone."""
    return scene_of(mesh, vertices, body) if np.isfinite(vertices).all() else figure_scene(body)


def plain_view(scene: Scene, side: str = "front", *, row: int = 0) -> PlainView:
    """A plain view of a scene, which is in ``row`` of the list to be rendered."""
    camera = fixed_camera(scene, side)
    return PlainView(row, _look(len(scene.panel_names)), camera, Lights(-camera.rotation[2]), PAGE)


def start_plain(
    scenes: Sequence[Scene], *, size: int, sides: Sequence[str] = SIDES, device: str = "auto"
) -> PendingPictures:
    """Start rendering the sides of each scene, as ``start_pictures`` does, for ``lend_rgb``."""
    views = [plain_view(scene, side, row=row) for row, scene in enumerate(scenes) for side in sides]
    return PendingPictures(scenes, views, size, (), device, rgb_only=True)


def render_view(
    scene: Scene, *, size: int = 512, view: str = "front", device: str = "auto"
) -> UInt8[np.ndarray, "h w 3"]:
    """A square picture of a scene in plain colours, framed alike from the front, from behind and from the ``side``.

    Raises ``ConfigError`` for a missing device, a size below 1, or another view.
    """
    [picture] = start_plain([scene], size=size, sides=(view,), device=device).lend_rgb()
    return picture.copy()


def render_garment(
    vertices: Float[np.ndarray, "v 3"], mesh: BoxMesh, body: Body, *, size: int = 512, device: str = "auto"
) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]:
    """Front and back of a garment at ``vertices`` [cm] on its body."""
    front, back = start_plain([garment_scene(vertices, mesh, body)], size=size, device=device).lend_rgb().copy()
    return front, back


@cache  # views of one look share its cloths on the device
def _look(panels: int) -> Appearance:
    return Appearance(CLOTHS, np.arange(panels) % len(CLOTHS), underwear=Underwear(SKIN))
