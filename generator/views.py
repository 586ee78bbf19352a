"""Drawn views of a sample: rendered while garments are made, or from shards, with the same bytes.

Both use the arrays at the precision of shards: ``stored_body`` and ``stored_scene`` round to float32 first.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, UInt8

from gcd_dataset.generator.body import build_body
from gcd_dataset.generator.render.scene import HairStyle, Scene, scene_of
from gcd_dataset.records import POSITION_STEP, UV_STEP, Body, BodyShape, BoxMesh, Pattern, StoredView, as_stored
from gcd_dataset.shards.layout import recipe_hash

if TYPE_CHECKING:
    from gcd_dataset.generator.render import Camera, ClothLook, Lights, Picture, View

CONVENTION = (
    "OpenCV: camera axes x right, y down, z forward; x = K (R X + t), X in cm; the centre of the upper left pixel is "
    "(0, 0)"
)


@dataclass(frozen=True)
class ViewRequest:
    """Pictures to take of a draped sample."""

    seed: int
    """See ``picture_seed``."""
    index: int
    count: int
    size: int
    """Width and height [pixels]."""
    fabric: str | None
    body: Body
    """The wearer, see ``stored_body``."""


@dataclass(frozen=True, eq=False)
class RenderedView:
    """A picture, and the facts stored with it."""

    rgb: UInt8[np.ndarray, "h w 3"]
    facts: Mapping[str, Any]


def picture_seed(seed: int, *, data_seed: int, recipe: Mapping[str, Any]) -> int:
    """The seed of the pictures, scans and sketches of a data set: others have other looks at the same number.

    ``seed`` is that of ``Views``, ``Scan`` or ``Sketch``; ``data_seed`` and ``recipe`` are those of the garments.
    Options that change no garment (``SIDE_OPTIONS``) do not count: a data set has the same looks if it is made again
    on another device, or with captions.
    """
    garments = {name: value for name, value in recipe.items() if name not in SIDE_OPTIONS}
    identity = f"{int(seed)} {int(data_seed)} {recipe_hash(garments)}"
    return int.from_bytes(hashlib.sha256(identity.encode()).digest()[:7], "little")


SIDE_OPTIONS = ("captions", "device", "ease", "maps", "picture", "points", "view_size", "views")
"""Options of a recipe that decide what is stored beside the garments, or on which kind of device they are made."""


def stored_body(shape: BodyShape) -> Body:
    """The body that a reader of the shards builds: from shape weights in float32. Raises ``BodyError``."""
    return build_body(replace(shape, weights=np.asarray(shape.weights, np.float32).astype(float)))


def stored_scene(
    mesh: BoxMesh,
    vertices: Float[np.ndarray, "v 3"],
    body: Body,
    *,
    pattern: Pattern | None = None,
    hair: HairStyle = HairStyle.NONE,
) -> Scene:
    """The scene of a garment, as ``scene_of``, with positions and ``uv`` as shards store them."""
    mesh, vertices = replace(mesh, uv=as_stored(mesh.uv, UV_STEP)), as_stored(vertices, POSITION_STEP)
    return scene_of(mesh, vertices, body, pattern=pattern, hair=hair)


def requested_scene(request: ViewRequest, mesh: BoxMesh, vertices: Float[np.ndarray, "v 3"]) -> Scene | None:
    """The scene of a request; ``None`` for a diverged drape, which cannot be rendered."""
    if not np.isfinite(vertices).all():
        return None
    from gcd_dataset.generator.render import draw_hair

    return stored_scene(mesh, vertices, request.body, hair=draw_hair(request.seed, request.index))


def requested_views(request: ViewRequest, scene: Scene | None, *, row: int = 0) -> "list[View]":
    """The views of a request; none without a scene."""
    if scene is None:
        return []
    from gcd_dataset.generator.render import draw_views

    return draw_views(request.seed, request.index, scene, request.count, row=row, fabric=request.fabric)


def finished_view(view: "View", picture: "Picture", scene: Scene) -> RenderedView:
    """The picture of a view with its facts."""
    return RenderedView(picture.rgb, view_facts(view, picture, scene))


def view_facts(view: "View", picture: "Picture", scene: Scene) -> dict[str, Any]:
    """Camera, light, place and materials as JSON values; every view has the same keys and types."""
    look = view.appearance
    return {
        "camera": _camera_facts(view.camera, picture),
        "light": _light_facts(view.lights),
        "place": {
            "kind": view.environment.kind.name.lower(),
            "colours": _numbers(view.environment.colours),
            "light": _numbers(view.environment.light),
        },
        "appearance": {
            "cloths": [_cloth_facts(cloth) for cloth in look.cloths],
            "cloth_of_panel": list(map(int, look.cloth_of_panel)),
            "skin_tone": int(look.skin.tone),
            "skin": _numbers(look.skin.colour),
            "hair": scene.hair.name.lower(),
            "hair_colour": _numbers(look.hair.colour),
        },
    }


def _camera_facts(camera: "Camera", picture: "Picture") -> dict[str, Any]:
    return {
        "k": _numbers(picture.intrinsics),
        "rt": _numbers(picture.extrinsics),
        "focal_mm": float(camera.focal * 24.0),
        "size": len(picture.rgb),
        "convention": CONVENTION,
    }


def _light_facts(lights: "Lights") -> dict[str, Any]:
    fill = lights.fill_direction
    return {
        "key_direction": _numbers(lights.key_direction),
        "key": _numbers(lights.key),
        "key_size": float(lights.key_size),
        "fill_direction": _numbers(np.zeros(3) if fill is None else fill),
        "fill": _numbers(np.zeros(3) if fill is None else lights.fill),
        "sky": float(lights.sky),
        "exposure": float(lights.exposure),
    }


def _cloth_facts(cloth: "ClothLook") -> dict[str, Any]:
    return {
        "look": cloth.look,
        "print": cloth.print.kind.name.lower(),
        "colours": _numbers(cloth.print.colours),
        "period_cm": float(cloth.print.period),
        "weave": cloth.weave.kind.name.lower(),
        "translucency": float(cloth.translucency),
    }


def _numbers(values: Sequence[Any] | np.ndarray) -> Any:
    """Nested lists of floats."""
    return np.asarray(values, float).tolist()


NO_COLOUR = [0.0, 0.0, 0.0]
_LIGHT = dict.fromkeys(("key_direction", "key", "fill_direction", "fill"), NO_COLOUR)
_CLOTH = dict.fromkeys(("look", "print", "weave"), "") | {"colours": [NO_COLOUR], "period_cm": 0.0, "translucency": 0.0}
_K, _RT = np.zeros((3, 3)).tolist(), np.zeros((3, 4)).tolist()
MISSING_VIEW = StoredView(b"", {
    "camera": {"k": _K, "rt": _RT, "focal_mm": 0.0, "size": 0, "convention": CONVENTION},
    "light": _LIGHT | dict.fromkeys(("key_size", "sky", "exposure"), 0.0),
    "place": {"kind": "", "colours": [NO_COLOUR], "light": [NO_COLOUR]},
    "appearance": {
        "cloths": [_CLOTH], "cloth_of_panel": [0], "skin_tone": 0, "skin": NO_COLOUR, "hair": "",
        "hair_colour": NO_COLOUR,
    },
})  # fmt: skip
"""The view of a diverged drape: no picture, zeros. No list is empty: ``datasets`` infers types from first samples."""
