"""Front and back pictures of stored garments, rendered by processes or a thread while a network is trained.

Four inputs: three to train on, and one to test on whose prints, kinds of cloth, skin tones, cameras, lights and places
none of the three shows.
"""

from collections.abc import Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import count

import numpy as np
from jaxtyping import Int, UInt8

from benchmarks.reconstruction.derived import MAPS, pixel_labels
from gcd_dataset.generator.body import neutral_shape
from gcd_dataset.generator.render import (
    Appearance,
    AppearanceRanges,
    Camera,
    CameraRanges,
    ClothLook,
    Environment,
    EnvironmentKind,
    EnvironmentRanges,
    LightRanges,
    Lights,
    PendingPictures,
    Print,
    PrintKind,
    Ranges,
    Scene,
    Skin,
    View,
    draw_appearance,
    draw_camera,
    draw_hair,
    draw_view,
    start_pictures,
)
from gcd_dataset.generator.render.pictures import Picture
from gcd_dataset.generator.render.plain import SKIN, plain_view
from gcd_dataset.generator.views import stored_body, stored_scene
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards import ShardReader
from gcd_dataset.tensors import PANEL_LABELS
from gcd_dataset.workers import prefetch, streams

SIDES = 2  # pictures of a garment: front, back


class Input(StrEnum):
    """The input of a network."""

    PLAIN = "plain"
    """The stored pictures: fixed cameras, a colour for each panel. The same pictures at every reading."""
    GREY = "grey"
    """Cameras of ``TRAINING``, drawn at every reading; grey cloth in studio light."""
    DRAWN = "drawn"
    """All of ``TRAINING``, drawn at every reading."""
    HELD_OUT = "held_out"
    """All of ``HELD_OUT``: to test on."""


P = PrintKind
TRAINING = Ranges(
    appearance=AppearanceRanges(
        prints=(P.STRIPES, P.DOTS, P.NOISE, P.GRADIENT),
        looks=(
            "poplin",
            "linen",
            "voile",
            "denim",
            "drill",
            "gabardine",
            "jersey",
            "melange",
            "rib",
            "corduroy",
            "velvet",
        ),
        tones=(1, 2, 4, 5, 7, 8, 10),
    ),
    camera=CameraRanges(yaw=(-45.0, 25.0), pitch=(-8.0, 10.0), focal=(50.0, 105.0), crop=0.0),
    lights=LightRanges(azimuth=(-75.0, 30.0), kelvin=(4500.0, 8000.0), contrast=(1.0, 3.0)),
    environment=EnvironmentRanges(weights=(0.3, 0.5, 0.0, 0.2)),
)
"""Ranges of training views of the front; cameras of the back stand opposite."""
HELD_OUT = Ranges(
    appearance=AppearanceRanges(
        prints=(P.CHECKS, P.TARTAN, P.FLORAL), plain=0.0, looks=("satin", "crepe", "flannel", "ponte"), tones=(3, 6, 9)
    ),
    camera=CameraRanges(yaw=(25.0, 45.0), pitch=(10.0, 18.0), focal=(35.0, 50.0), crop=0.0),
    lights=LightRanges(azimuth=(30.0, 75.0), kelvin=(3600.0, 4500.0), contrast=(3.0, 5.0)),
    environment=EnvironmentRanges(weights=(0.0, 0.0, 1.0, 0.0)),
)
"""Rooms, checks, tartan and flowers; cameras and lights beyond those of ``TRAINING``."""
GREY = ClothLook(print=Print(colours=((0.6, 0.6, 0.6),) * 4))
STUDIO = np.array([-0.45, -0.55, -0.70])  # towards the key light, in camera axes: from above and the left
AT_ONCE = {"cpu": 2, "cuda": 8}  # garments rendered together
AHEAD = 2  # batches of a process that wait to be used
VIEWS_PER_EPOCH = 16  # stream numbers of one reading


@dataclass(frozen=True, eq=False)
class ShownGarment:
    """A garment to render."""

    position: int
    """Position among the settled garments of the folder's split ``train``."""
    index: int
    """Index of the sample."""
    scene: Scene


@dataclass(frozen=True)
class Share:
    """The garments that one process renders."""

    folder: str
    positions: tuple[int, ...]
    inputs: tuple[Input, ...]
    seed: int
    size: int
    device: str
    readings: int
    """Readings of each garment as each input; 0: without end."""
    at_once: int
    """Garments rendered together."""


@dataclass(frozen=True, eq=False)
class Rendered:
    """Pictures of some garments."""

    what: Input
    positions: Int[np.ndarray, " b"]
    pictures: UInt8[np.ndarray, "b n h w 3"]
    labels: UInt8[np.ndarray, "b n h w"]
    """``pixel_labels`` of the pictures."""


def load_garment(reader: ShardReader, position: int) -> ShownGarment:
    """A stored garment, with the body that readers of the shards build."""
    sample = reader.sample(position)
    assert sample.box_mesh is not None
    assert sample.drape is not None
    body = stored_body(sample.shape or neutral_shape())
    return ShownGarment(
        position,
        reader.number(position),
        stored_scene(sample.box_mesh, sample.drape.vertices, body, pattern=sample.pattern),
    )


@contextmanager
def rendering(
    folder: str,
    positions: Sequence[int],
    inputs: Sequence[Input],
    *,
    seed: int,
    size: int,
    device: str,
    processes: int,
    readings: int = 0,
) -> Iterator[Iterator[Rendered]]:
    """Pictures of the garments at ``positions``, rendered by processes; fewer than 2: by a thread of this one.

    The pictures depend neither on the number of processes nor on their speed, their order not on the speed.
    """
    processes = max(1, min(processes, len(positions)))
    at_once = AT_ONCE["cpu" if device == "cpu" else "cuda"]
    shares = [
        Share(folder, tuple(positions[k::processes]), tuple(inputs), seed, size, device, readings, at_once)
        for k in range(processes)
    ]
    if processes == 1:
        with closing(prefetch(rendered(shares[0]), AHEAD)) as batches:
            yield batches
        return
    with streams(rendered, shares) as results, closing(prefetch(_in_turn(results), AHEAD * processes)) as batches:
        yield batches


def rendered(share: Share) -> Generator[Rendered]:
    """The pictures of a share, every garment once before any is repeated; one batch is rendered ahead."""
    reader = ShardReader(share.folder, settled_only=True)
    garments = [load_garment(reader, position) for position in share.positions]
    waiting: _Started | None = None
    for epoch in count() if share.readings == 0 else range(share.readings):
        order = rng(share.seed, epoch, Stage.VIEW).permutation(len(garments))
        for first in range(0, len(order), share.at_once):
            chosen = [garments[k] for k in order[first : first + share.at_once]]
            for what in share.inputs:
                started = _start(share, what, chosen, epoch)
                if waiting is not None:
                    yield _finished(waiting)
                waiting = started
    if waiting is not None:
        yield _finished(waiting)


def views_of(what: Input, seed: int, garment: ShownGarment, row: int, epoch: int) -> tuple[Scene, list[View]]:
    """The scene of a garment and its front and back view, a function of input, seed, garment and epoch."""
    ranges = HELD_OUT if what is Input.HELD_OUT else TRAINING
    streams = [rng(seed, garment.index, Stage.VIEW, epoch * VIEWS_PER_EPOCH + side) for side in range(SIDES)]
    of_sides = [replace(ranges, camera=_turned(ranges.camera, 180.0 * side)) for side in range(SIDES)]
    scene = garment.scene
    if what is Input.PLAIN:
        return scene, [plain_view(scene, side, row=row) for side in ("front", "back")]
    if what is Input.GREY:
        cameras = [draw_camera(stream, scene, ranges=r.camera) for stream, r in zip(streams, of_sides, strict=True)]
        return scene, [_grey_view(scene, camera, row) for camera in cameras]
    scene = replace(scene, hair=draw_hair(seed, garment.index, epoch=epoch))
    look = draw_appearance(rng(seed, garment.index, Stage.APPEARANCE, epoch), scene, ranges=ranges.appearance)
    views = [draw_view(stream, scene, look, row=row, ranges=r) for stream, r in zip(streams, of_sides, strict=True)]
    return scene, views


# ------------------------------------------------------------------------------------------------------------- helpers


@dataclass(frozen=True, eq=False)
class _Started:
    """Pictures that the device is rendering."""

    what: Input
    positions: Int[np.ndarray, " b"]
    scenes: list[Scene]
    pictures: PendingPictures


def _start(share: Share, what: Input, garments: Sequence[ShownGarment], epoch: int) -> _Started:
    positions = np.array([garment.position for garment in garments])
    pairs = [views_of(what, share.seed, garment, row, epoch) for row, garment in enumerate(garments)]
    scenes, views = [scene for scene, _ in pairs], [view for _, both in pairs for view in both]
    pending = start_pictures(scenes, views, maps=MAPS, size=share.size, device=share.device)
    return _Started(what, positions, scenes, pending)


def _finished(started: _Started) -> Rendered:
    found = started.pictures.pictures()
    scenes = [scene for scene in started.scenes for _ in range(SIDES)]
    labels = [_labels(picture, scene) for picture, scene in zip(found, scenes, strict=True)]
    pictures = [picture.rgb for picture in found]
    shape = (len(started.positions), SIDES)
    return Rendered(
        started.what,
        started.positions,
        np.stack(pictures).reshape(*shape, *pictures[0].shape),
        np.stack(labels).reshape(*shape, *labels[0].shape),
    )


def _labels(picture: Picture, scene: Scene) -> UInt8[np.ndarray, "h w"]:
    """``pixel_labels`` of a picture."""
    rows = [PANEL_LABELS.index(name) if name in PANEL_LABELS else 0 for name in scene.panel_labels]
    return pixel_labels(picture.maps, rows)


def _grey_view(scene: Scene, camera: Camera, row: int) -> View:
    look = Appearance((GREY,), np.zeros(len(scene.panel_names), int), skin=Skin(SKIN, tone=0), underwear=None)
    key = STUDIO @ camera.rotation / np.linalg.norm(STUDIO)
    return View(row, look, camera, Lights(key, (0.9, 0.9, 0.9), sky=0.6), Environment(EnvironmentKind.PLAIN))


def _turned(camera: CameraRanges, degrees: float) -> CameraRanges:
    low, high = camera.yaw
    return replace(camera, yaw=(low + degrees, high + degrees))


def _in_turn(results: Sequence[Iterator[Rendered]]) -> Iterator[Rendered]:
    """One batch of each process after the other, until all have ended."""
    left = list(results)
    while left:
        for one in list(left):
            batch = next(one, None)
            if batch is None:
                left.remove(one)
            else:
                yield batch
