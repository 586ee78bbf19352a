"""Pictures per second with materials, soft shadows and truths, and their agreement with Embree.

Garments are made, then rendered in batches that are new to the renderer: preparing and uploading the meshes, building
their trees and copying the pictures back are part of the time. ``mask_agreement`` is the share of pixels whose
silhouette agrees with trimesh's caster (Embree) on the same meshes and cameras, in the worst picture;
``depth_agreement`` the share of the pixels that both hit whose depths differ by less than 0.05 cm; ``shadow_agreement``
the share of these that both find lit, or both in shadow.

``loader_images_per_s`` includes the work of loaders before rendering, which ``images_per_s`` leaves out: body, scene
and drawn views.
"""

import argparse
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from benchmarks.cases import CaseResult, Figure, jpeg_file
from gcd_dataset.errors import ConfigError
from gcd_dataset.files import write_whole
from gcd_dataset.generator.body import build_body, neutral_shape
from gcd_dataset.generator.drape import resolve_device
from gcd_dataset.generator.drawing import contact_sheet, jpeg_bytes
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.generator.render import (
    MAPS,
    Camera,
    PendingPictures,
    Scene,
    View,
    draw_hair,
    draw_views,
    render,
    scene_of_sample,
    start_pictures,
)
from gcd_dataset.generator.render.geometry import panel_borders, solid_of
from gcd_dataset.records import Sample

SIZES = (256, 512)  # pixels
DEPTH = 0.05  # cm
LIFT = 0.25  # cm from a surface to the start of a shadow ray, as in the renderer
CHECKED = 256  # pixels of the pictures that are compared with Embree
TILE = 320  # pixels of a picture of the sheet


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the case."""
    parser.add_argument("--count", type=int, default=64, help="garments (default: 64)")
    parser.add_argument("--views", type=int, default=4, help="pictures of each garment (default: 4)")
    parser.add_argument("--batch", type=int, default=0, help="garments at once (default: 16 on a GPU, 1 on a CPU)")
    parser.add_argument("--seed", type=int, default=18)
    parser.add_argument("--resolution", type=float, default=2.0, help="edge length of the meshes [cm] (default: 2)")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--checked", type=int, default=8, help="garments compared with Embree (default: 8; 0: none)")
    parser.add_argument("--preparers", type=int, default=2, help="threads that prepare batches (default: 2)")
    parser.add_argument("--sheet", type=jpeg_file, metavar="FILE", help="write a JPEG of 64 pictures")


def run(options: argparse.Namespace) -> CaseResult:
    """Make the garments, render them at both sizes, compare some with Embree."""
    if options.count < 2:
        raise ConfigError(f"--count {options.count}: give 2 or more, since the first batch warms up")
    if options.preparers < 1:
        raise ConfigError(f"--preparers {options.preparers}: give 1 or more")
    device = resolve_device(options.device)
    samples = list(_samples(options, device))
    scenes, views = zip(*(_made(options, index, sample) for index, sample in enumerate(samples)), strict=True)
    figures: list[Figure] = []
    batch = min(options.batch or (1 if device == "cpu" else 16), max(1, len(scenes) // 2))
    for size in SIZES:
        runner = Runner(lambda row: (_fresh(scenes[row]), views[row]), len(scenes), size, device, options.preparers)
        rate = runner.rate(batch)
        figures.append(Figure("images_per_s" if size == SIZES[0] else f"images_per_s_{size}", rate, f"of {size}²"))
    loader = Runner(lambda row: _made(options, row, samples[row]), len(scenes), SIZES[0], device, options.preparers)
    figures.append(Figure("loader_images_per_s", loader.rate(batch), f"of {SIZES[0]}², body, scene and views made too"))
    figures.append(Figure("prepare_ms", _prepare_ms(scenes), "CPU-ms a garment"))
    rows = [
        _compared(scene, own[0], number, device)
        for number, (scene, own) in enumerate(zip(scenes[: options.checked], views, strict=False))
    ]
    if rows:
        worst = {key: min(row[key] for row in rows) for key in ("mask", "lit", "depth")}
        figures.append(Figure("mask_agreement", worst["mask"], "of pixels, worst picture"))
        figures.append(Figure("shadow_agreement", worst["lit"], "of pixels, worst picture"))
        figures.append(Figure("depth_agreement", worst["depth"], f"within {DEPTH} cm, worst picture"))
    if options.sheet is not None:
        write_whole(options.sheet, jpeg_bytes(_sheet(scenes, options.seed, device)))
    return CaseResult(figures, rows)


# ------------------------------------------------------------------------------------------------------------- helpers


def _samples(options: argparse.Namespace, device: str) -> Iterator[Sample]:
    config = MakeConfig(resolution=options.resolution, device=device, picture=0, points=0)
    yield from produce(options.seed, range(options.count), config)


@dataclass(frozen=True)
class Runner:
    """Renders all garments, batch by batch."""

    garment: Callable[[int], tuple[Scene, Sequence[View]]]
    """Scene and views of each garment, by its number."""
    count: int
    size: int
    device: str
    preparers: int
    """Threads that prepare and start batches; on a CPU, where rendering needs the core, one."""

    def rate(self, batch: int) -> float:
        """Pictures per second; on a GPU, once the device and its buffers are warm.

        As many batches as there are preparers are begun while the device renders, and copied back in order.
        """
        if self.device == "cpu":
            self._started(range(1), size=SIZES[0] // 4).pictures()
        else:
            list(self._batches(batch))  # each buffer is page-locked once
        begun, pictures = time.perf_counter(), 0
        for finished in self._batches(batch):
            pictures += finished
        return pictures / (time.perf_counter() - begun)

    def _batches(self, batch: int) -> Iterator[int]:
        """Render all batches; the number of pictures of each."""
        preparers = 1 if self.device == "cpu" else self.preparers
        ahead = 0 if self.device == "cpu" else preparers
        starts = [range(first, min(first + batch, self.count)) for first in range(0, self.count, batch)]
        waiting: deque[Future[PendingPictures]] = deque()
        with ThreadPoolExecutor(preparers) as executor:
            for rows in starts:
                waiting.append(executor.submit(self._started, rows))
                if len(waiting) > ahead:
                    yield len(waiting.popleft().result().pictures())
            while waiting:
                yield len(waiting.popleft().result().pictures())

    def _started(self, rows: Sequence[int], *, size: int | None = None) -> PendingPictures:
        scenes, views = zip(*map(self.garment, rows), strict=True)
        placed = [_at(view, k) for k, own in enumerate(views) for view in own]
        return start_pictures(scenes, placed, size=size or self.size, maps=MAPS, device=self.device)


def _fresh(scene: Scene) -> Scene:
    """The scene without the arrays that it keeps once they are computed."""
    return replace(scene)


def _made(options: argparse.Namespace, index: int, sample: Sample) -> tuple[Scene, list[View]]:
    """The work of loaders before rendering: body, scene and drawn views."""
    body = build_body(sample.shape if sample.shape is not None else neutral_shape())
    scene = scene_of_sample(sample, body, hair=draw_hair(options.seed, index))
    return scene, draw_views(options.seed, index, scene, options.views)


def _at(view: View, row: int) -> View:
    return View(row, view.appearance, view.camera, view.lights, view.environment, view.seed)


def _prepare_ms(scenes: Sequence[Scene]) -> float:
    begun = time.process_time()
    for scene in map(_fresh, scenes):
        solid_of(scene)
        panel_borders(scene)
    return 1e3 * (time.process_time() - begun) / len(scenes)


def _compared(scene: Scene, view: View, number: int, device: str) -> dict[str, float]:
    """Agreement of one picture with Embree: shares of its pixels."""
    [picture] = render([scene], [_at(view, 0)], size=CHECKED, maps=("depth", "silhouette", "lit"), device=device)
    solid = solid_of(scene)
    expected, light = embree_maps(solid.position, solid.faces, view.camera, view.lights.key_direction, CHECKED)
    ours, seen = picture.maps["silhouette"] > 0, np.isfinite(expected)
    both = ours & seen
    apart = np.abs(picture.maps["depth"][both] - expected[both])
    return {
        "garment": number,
        "covered": float(ours.mean()),
        "mask": float((ours == seen).mean()),
        "depth": float((apart < DEPTH).mean()),
        "lit": float(((picture.maps["lit"] > 0) == light)[both].mean()),
        "depth_p99_cm": float(np.percentile(apart, 99)),
    }


def embree_maps(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    camera: Camera,
    light: Float[np.ndarray, "3"],
    size: int,
) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Depth along the optical axis [cm], infinite for the background, and whether a light far away is seen: by Embree.

    Raises ``ConfigError`` where Embree is not installed.
    """
    import trimesh

    if not trimesh.ray.has_embree:
        raise ConfigError("the comparison needs Embree: pip install 'gcd-dataset[bench]'")
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    column, row = np.meshgrid(np.arange(size), np.arange(size))
    seen = np.stack([column.ravel(), row.ravel(), np.ones(size * size)], axis=1)
    inverse = np.linalg.inv(camera.intrinsics(size))
    directions = seen @ inverse.T @ camera.rotation  # of unit depth
    origins = np.broadcast_to(camera.eye, directions.shape)
    face = np.asarray(mesh.ray.intersects_first(origins, directions))
    hit = face >= 0
    depth, lit = np.full(size * size, np.inf), np.zeros(size * size, bool)
    corner, normal = mesh.triangles[face[hit], 0], np.cross(*np.diff(mesh.triangles[face[hit]], axis=1).swapaxes(0, 1))
    depth[hit] = ((corner - origins[hit]) * normal).sum(axis=1) / (directions[hit] * normal).sum(axis=1)
    normal *= -np.sign((normal * directions[hit]).sum(axis=1, keepdims=True))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    start = camera.eye + depth[hit, None] * directions[hit] + LIFT * normal
    hidden = mesh.ray.intersects_any(start, np.broadcast_to(light, start.shape))
    lit[hit] = ~hidden & (normal @ light > 0.0)
    return depth.reshape(size, size), lit.reshape(size, size)


def _sheet(scenes: Sequence[Scene], seed: int, device: str) -> np.ndarray:
    """64 pictures of the garments in turn."""
    rows = [k % len(scenes) for k in range(64)]
    views = [draw_views(seed, 1000 + k, scenes[row], 1, row=row)[0] for k, row in enumerate(rows)]
    pictures = render(scenes, views, size=TILE, device=device)
    return contact_sheet([picture.rgb for picture in pictures], columns=8)
