"""Rendering of batches: scenes and views in, pictures and truths out; a GPU works in the background."""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any, get_args

import numpy as np
import warp as wp
from jaxtyping import Bool, Float, UInt8

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.device import keep_some_memory, launch_lock
from gcd_dataset.generator.drape import load_kernels, resolve_device
from gcd_dataset.generator.render.environment import EnvironmentKind
from gcd_dataset.generator.render.images import linear_light
from gcd_dataset.generator.render.kernels import cast, prepare, truths
from gcd_dataset.generator.render.kernels.records import ClothRow, Shot
from gcd_dataset.generator.render.packing import Materials, pack_views
from gcd_dataset.generator.render.pictures import BACKGROUND, REACH, VERTEX_MAPS, MapName, Picture, View
from gcd_dataset.generator.render.scene import Scene
from gcd_dataset.generator.render.uploading import Block, StagingBuffers, Uploaded, add_scenes, upload, wrapped

SIDE = 2  # rays along each side of a pixel
POLL = 2e-4  # s between two looks at a GPU
PIXELS = 64 * 512**2  # pixels rendered at once: 0.8 GB of hits
MAP_TYPES: dict[str, tuple[type, int, float]] = {
    "depth": (np.float32, 0, 0.0),
    "normals": (np.float32, 3, 0.0),
    "part": (np.uint8, 0, BACKGROUND),
    "panel_id": (np.int16, 0, -1),
    "seam": (np.int16, 0, -1),
    "silhouette": (np.uint8, 0, 0),
    "lit": (np.uint8, 0, 0),
}
"""Type, channels and background of each map, in the order of the kernel's arguments."""
VALUES: dict[str, tuple[int, ...]] = {"uv": (2,), "stretch": (2,), "gap": (), "pressure": ()}
"""Channels of each map that is interpolated from the corners of a face; NaN off the garment."""
WARP_TYPES: dict[type, Any] = {np.float32: wp.float32, np.uint8: wp.uint8, np.int16: wp.int16}


def render(
    scenes: Sequence[Scene],
    views: Sequence[View],
    *,
    size: int = 512,
    maps: Sequence[MapName] = (),
    device: str = "auto",
) -> list[Picture]:
    """A picture of ``size`` × ``size`` pixels for each view, in order, with the ``maps`` named.

    Views of one scene share its mesh. A picture is a function of its scene, view and size: the same bytes in any batch
    and order on one class of device. Raises ``ConfigError`` for a missing device, a size below 1, an unknown map, a
    view of a scene that is not there, or an appearance of another garment.
    """
    _check(scenes, views, size, maps)
    done: dict[int, Picture] = {}
    for rows in _batches(views, size):
        pending = start_pictures(scenes, [views[row] for row in rows], size=size, maps=maps, device=device)
        done.update(zip(rows, pending.pictures(), strict=True))
    return [done[row] for row in range(len(views))]


def empty_picture(size: int, maps: Sequence[MapName]) -> Picture:
    """A black picture of a garment that was not draped: its maps hold the background, its camera zeros."""
    found = dict[str, np.ndarray]()
    for name in maps:
        if name in VALUES:
            found[name] = np.full((size, size, *VALUES[name]), np.nan, np.float32)
            continue
        kind, channels, background = MAP_TYPES[name]
        found[name] = np.full((size, size, channels) if channels else (size, size), background, kind)
    return Picture(np.zeros((size, size, 3), np.uint8), np.zeros((3, 3)), np.zeros((3, 4)), found)


def start_pictures(
    scenes: Sequence[Scene],
    views: Sequence[View],
    *,
    size: int,
    maps: Sequence[MapName] = (),
    device: str = "auto",
) -> "PendingPictures":
    """Start ``render`` of all views at once; a GPU works in the background.

    Several threads may start renderings: they prepare scenes at the same time and launch one after the other.
    """
    return PendingPictures(scenes, views, size, maps, device)


class PendingPictures:
    """Pictures that a device is rendering. ``rgb_only``: of plain views, for ``lend_rgb`` alone."""

    def __init__(
        self,
        scenes: Sequence[Scene],
        views: Sequence[View],
        size: int,
        maps: Sequence[MapName],
        device: str,
        *,
        rgb_only: bool = False,
    ) -> None:
        _check(scenes, views, size, maps)
        device = resolve_device(device)
        load_kernels("renderer", prepare, cast, truths, device=device)
        keep_some_memory(device)
        self._views, self._size, self._maps = views, size, tuple(maps)
        self._staging = StagingBuffers(device)
        self._scenes = [scenes[view.scene] for view in views]
        self._positions = [] if rgb_only else list(map(_marked_points, self._scenes, self._views))
        self._results: dict[str, np.ndarray] = {}
        self._rendered: wp.Event | None = None
        self._kept: object = None
        if not views:
            return
        used = sorted({view.scene for view in views})
        block = Block(self._staging)
        starts = add_scenes(block, [scenes[row] for row in used], rgb_only=rgb_only)
        block.add("value", wp.float32, *(_corner_values(scenes[row], maps) for row in used))
        materials = pack_views(views, scenes, {row: k for k, row in enumerate(used)})
        self._add_views(block, materials)
        block.fill()
        with launch_lock:
            given = block.upload()
            uploaded = upload(given, *starts, device)
            self._kept = block, uploaded, self._launch(uploaded, materials, given, device)
            self._rendered = self._staging.event()

    def ready(self) -> bool:
        """Whether ``pictures`` returns without waiting."""
        with launch_lock:  # CUDA refuses event queries while another thread captures a graph
            return self._rendered is None or self._rendered.is_complete

    def pictures(self) -> list[Picture]:
        """Wait for the pictures. Call once."""
        results = self._wait()
        if self._staging.locked:
            results = {name: array.copy() for name, array in results.items()}
        return list(self._finished(results))

    def lend(self) -> list[Picture]:
        """Wait for the pictures, as ``pictures``; for a GPU their arrays are page-locked memory: drop them soon."""
        return list(self._finished(self._wait()))

    def lend_rgb(self) -> UInt8[np.ndarray, "n h w 3"]:
        """Wait for the pictures, as ``lend``, without the other fields of ``Picture``."""
        return self._wait()["rgb"]

    def _wait(self) -> dict[str, np.ndarray]:
        while not self.ready():  # other threads launch meanwhile
            time.sleep(POLL)
        with launch_lock:
            self._kept = None  # frees the meshes
        self._staging.release()
        results, self._results = self._results, {}
        if "values" in results:
            results |= _by_name(results.pop("values"), self._maps)
        return results

    def _finished(self, results: Mapping[str, np.ndarray]) -> Iterator[Picture]:
        size, begin = self._size, 0
        for row, (view, scene, positions) in enumerate(zip(self._views, self._scenes, self._positions, strict=True)):
            end, corners = begin + len(positions), len(scene.corner_rows)
            pixels = view.camera.project(positions, size)
            visible = (np.abs(pixels - 0.5 * (size - 1)) <= 0.5 * size).all(axis=1)
            visible &= results["visible"][begin:end] == 1
            begin, marks = end, corners + len(scene.landmarks)
            yield Picture(
                rgb=results["rgb"][row],
                intrinsics=view.camera.intrinsics(size),
                extrinsics=view.camera.extrinsics(),
                maps={name: results[name][row] for name in self._maps},
                panel_corners=scene.panel_corners,
                corner_pixels=pixels[:corners],
                corner_visible=visible[:corners],
                landmark_names=tuple(scene.landmarks),
                landmark_pixels=pixels[corners:marks],
                landmark_visible=visible[corners:marks],
                keypoints=_keypoints(pixels[marks:], visible[marks:], size),
            )

    def _add_views(self, block: Block, materials: Materials) -> None:
        """What the kernels read besides scenes."""
        block.add("shots", Shot, materials.shots)
        block.add("cloths", ClothRow, materials.cloths)
        block.add("cloth_of_panel", wp.int32, materials.cloth_of_panel)
        if self._positions:
            block.add("texels", wp.vec3, materials.texels)
            block.add("glow", wp.vec3, materials.glow)
            block.add("owner", wp.int32, np.repeat(np.arange(len(self._positions)), list(map(len, self._positions))))
            block.add("positions", wp.vec3, *self._positions)

    def _launch(self, up: Uploaded, materials: Materials, given: dict[str, wp.array], device: str) -> list[wp.array]:
        """Launch all passes and the copies of their results; returns the arrays that these read."""
        outputs = {"rgb": _shade(up, materials, given, self._size, device)}
        outputs |= _truths(up, given["shots"], self._maps, self._size, device)
        if self._positions:
            seen = [up.scenes, given["shots"], given["owner"], given["positions"]]
            outputs["visible"] = wp.zeros(len(given["owner"]), dtype=wp.uint8, device=device)
            wp.launch(truths.see_points, len(given["owner"]), inputs=seen, outputs=[outputs["visible"]], device=device)
        for name, array in outputs.items():
            kind = wp.dtype_to_numpy(array.dtype)
            self._results[name] = self._staging.array(array.shape, kind)
            if array.size:
                wp.copy(wrapped(self._results[name], array.dtype), array)
        return list(outputs.values())


def _marked_points(scene: Scene, view: View) -> Float[np.ndarray, "n 3"]:
    """Panel corners, landmarks, then key points, each ``REACH`` nearer to the camera [cm]."""
    corners = scene.vertices[scene.uv_vertex[scene.corner_rows]]
    away = scene.keypoints - view.camera.eye
    nearer = REACH[: len(away), None] * away / np.linalg.norm(away, axis=1, keepdims=True)
    marks = np.array(list(scene.landmarks.values())).reshape(-1, 3)
    return np.concatenate([corners, marks, scene.keypoints - nearer])


def _keypoints(
    pixels: Float[np.ndarray, "n 2"], visible: Bool[np.ndarray, " n"], size: int
) -> Float[np.ndarray, "17 3"]:
    """``Picture.keypoints`` from the key points of a scene, which has all or none."""
    found = np.zeros((len(REACH), 3))
    if len(pixels):
        inside = (np.abs(pixels - 0.5 * (size - 1)) <= 0.5 * size).all(axis=1)
        found[inside, :2], found[:, 2] = pixels[inside], np.where(visible, 2, inside)
    return found


def _check(scenes: Sequence[Scene], views: Sequence[View], size: int, maps: Sequence[MapName]) -> None:
    if size < 1:
        raise ConfigError(f"a picture of {size} pixels: give a size of 1 or more")
    for name in maps:
        if name not in get_args(MapName):
            raise ConfigError(f"unknown map {name!r}: choose from {', '.join(get_args(MapName))}")
    for number, view in enumerate(views):
        if not 0 <= view.scene < len(scenes):
            raise ConfigError(f"view {number} is of scene {view.scene}: there are {len(scenes)}, counted from 0")
        for name in (name for name in maps if name in VERTEX_MAPS):
            garment = scenes[view.scene]
            if np.shape(garment.values.get(name, ())) != (len(garment.vertices), *VALUES[name]):
                raise ConfigError(
                    f"scene {view.scene} has no {name} of each vertex: give it values, as of Maps.by_vertex"
                )


def _corner_values(scene: Scene, maps: Sequence[MapName]) -> Float[np.ndarray, "c n"]:
    """The channels of the maps in ``VALUES`` at each row of ``uv``, in the order of ``maps``."""
    columns = [scene.uv if name == "uv" else scene.values[name][scene.uv_vertex] for name in maps if name in VALUES]
    return np.column_stack([np.zeros((len(scene.uv), 0)), *columns])


def _by_name(values: Float[np.ndarray, "s h w n"], maps: Sequence[MapName]) -> dict[str, np.ndarray]:
    """Views of the channels of each map in ``VALUES``, in the order of ``maps``."""
    found: dict[str, np.ndarray] = {}
    begin = 0
    for name in maps:
        if name in VALUES:
            end = begin + math.prod(VALUES[name])
            found[name] = values[..., begin:end].reshape(values.shape[:-1] + VALUES[name])
            begin = end
    return found


def _batches(views: Sequence[View], size: int) -> Iterator[list[int]]:
    """Rows of the views to render at once: whole scenes, as many as memory holds."""
    rows = sorted(range(len(views)), key=lambda row: views[row].scene)
    most = max(1, PIXELS // size**2)
    batch: list[int] = []
    for k, row in enumerate(rows):
        batch.append(row)
        last = k + 1 == len(rows) or views[rows[k + 1]].scene != views[row].scene
        if len(batch) >= most or (last and 2 * len(batch) > most):
            yield batch
            batch = []
    if batch:
        yield batch


def _shade(up: Uploaded, materials: Materials, given: dict[str, wp.array], size: int, device: str) -> wp.array:
    """The pictures (shot, h, w, 3)."""
    shots, plain = given["shots"], materials.shots["plain"] == 1
    rays = (len(shots), size, size, SIDE**2)
    hit_face, hit_uv = wp.empty(rays, dtype=int, device=device), wp.empty(rays, dtype=wp.vec2, device=device)
    sides = (2, up.first_vertex[-1])
    seen, sky = wp.full(sides, -1, dtype=int, device=device), wp.full(sides, 1.0, dtype=float, device=device)
    for number in np.unique(materials.shots["scene"][materials.shots["sheer"] == 1]).tolist():
        # What lies behind sheer cloth is not among the first hits: all of the scene counts as seen.
        for row in (seen[0], seen[1]):
            row[up.first_vertex[number] : up.first_vertex[number + 1]].fill_(number)
    picture, least = wp.empty((*rays[:3], 3), dtype=wp.uint8, device=device), _thresholds(device)
    inputs = [up.scenes, shots, SIDE]
    wp.launch(cast.cast_rays, rays, inputs=inputs, outputs=[hit_face, hit_uv, seen], device=device)
    wp.launch(prepare.sky_visibility, sides, inputs=[up.scenes, seen], outputs=[sky], device=device)
    cloths = [given["cloth_of_panel"], given["cloths"]]
    if plain.any():
        inputs = [up.scenes, shots, *cloths, sky, SIDE, hit_face, hit_uv, least]
        wp.launch(cast.shade_plain, rays[:3], inputs=inputs, outputs=[picture], device=device)
    if not plain.all():
        cells = (len(up.meshes), prepare.FLOOR_CELLS, prepare.FLOOR_CELLS)
        floor = wp.empty(cells, dtype=float, device=device)
        if np.isin(materials.shots["place"], (EnvironmentKind.SWEEP, EnvironmentKind.ROOM)).any():
            inputs = [up.scenes, given["middle"]]
            wp.launch(prepare.floor_visibility, cells, inputs=inputs, outputs=[floor], device=device)
        inputs = [up.scenes, shots, *cloths, given["texels"], given["glow"].reshape((-1, 9)), given["middle"], sky]
        inputs += [floor, SIDE, hit_face, hit_uv, least]
        wp.launch(cast.shade_pixels, rays[:3], inputs=inputs, outputs=[picture], device=device)
    return picture


@cache
def _thresholds(device: str) -> wp.array:
    """The smallest linear value of each sRGB byte from 1 to 255."""
    least = linear_light((np.arange(cast.LEVELS) + 0.5) / cast.LEVELS)
    return wp.array(least.astype(np.float32), dtype=float, device=device)


def _truths(up: Uploaded, shots: wp.array, maps: Sequence[MapName], size: int, device: str) -> dict[str, wp.array]:
    """The maps by name (shot, h, w[, channels])."""
    if not maps:
        return {}
    wanted = truths.Wanted()
    arrays: dict[str, wp.array] = {}
    for name, (kind, channels, background) in MAP_TYPES.items():
        asked = name in maps
        setattr(wanted, name, int(asked))
        pixels = (len(shots), size, size) if asked else (1, 1, 1)
        shape = (*pixels, channels) if channels else pixels
        arrays[name] = wp.full(shape, WARP_TYPES[kind](background), dtype=WARP_TYPES[kind], device=device)
    rays = (len(shots), size, size)
    wanted.channels = channels = sum(math.prod(VALUES[name]) for name in maps if name in VALUES)
    shape = (*rays, channels) if channels else (1, 1, 1, 1)
    arrays["values"] = wp.full(shape, np.nan, dtype=wp.float32, device=device)
    inputs = [up.scenes, shots, wanted, size]
    wp.launch(truths.see_centres, rays, inputs=inputs, outputs=list(arrays.values()), device=device)
    return {name: array for name, array in arrays.items() if name in maps or (name == "values" and channels)}
