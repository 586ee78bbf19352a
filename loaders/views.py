"""``Views``: pictures of garments in drawn cloth, light and places, rendered when garments are read.

Where pictures are rendered:

- With a CPU and worker processes, in the workers, item by item, before collate.
- Otherwise a thread of the training process renders the next batches during the training step (``render_ahead``). A
  GPU is never used in workers: each would open a CUDA context, and a forked one cannot.
"""

import contextlib
import threading
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import numpy as np
import torch
from torch import Tensor

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import GarmentItem, Item, require_integer, require_ranges
from gcd_dataset.loaders.batches import (
    POINTS_TO,
    RAGGED,
    PackedBatch,
    PaddedBatch,
    collate_packed,
    collate_padded,
    pin_tensor,
)
from gcd_dataset.loaders.body_datasets import Bodies
from gcd_dataset.loaders.scenes import VIEW_FIELDS, BodyOf, SceneTransform, StoredGarment, wearer_of
from gcd_dataset.shards.layout import ARRAYS, MAPS, split_worn

if TYPE_CHECKING:
    from gcd_dataset.generator.render import (
        AppearanceRanges,
        CameraRanges,
        EnvironmentRanges,
        LightRanges,
        Picture,
        Scene,
        View,
    )
    from gcd_dataset.generator.render.pictures import MapName

USED = (*VIEW_FIELDS, *ARRAYS[MAPS])  # fields that views are rendered from
MOST_VIEWS = 4096
PIXELS = 64 * 512**2  # pixels rendered at once: 0.8 GB of hits

Tag = TypeVar("Tag")


class Views(SceneTransform):
    """Renders ``n`` pictures of each garment: a transform, an augmentation, or the ``views`` of a ``GarmentLoader``.

    >>> from gcd_dataset.loaders import VIEW_FIELDS, GarmentDataset, GarmentLoader
    >>> ds = GarmentDataset("garments", fields=VIEW_FIELDS)  # doctest: +SKIP
    >>> loader = GarmentLoader(ds, 8, views=Views(n=4, size=256, maps=("depth",)))  # doctest: +SKIP
    >>> next(iter(loader))["views"].shape  # doctest: +SKIP
    torch.Size([8, 4, 256, 256, 3])

    An item gets ``views``, ``camera_k``, ``camera_rt``, ``panel_corners``, ``panel_corner_pixels``,
    ``panel_corner_visible``, ``landmark_pixels``, ``landmark_visible``, ``keypoints`` and, for each of ``maps``,
    ``depth_map`` and so on: ``GarmentFields`` has their shapes, units and conventions, ``generator.render.Picture``
    those of the maps. ``front`` and ``back``, the plain pictures, stay as they are. A garment that cannot be put on has
    black pictures, the background in its maps, and zeros for cameras.

    **Randomness.** Pictures are a function of ``seed``, epoch, the garment's data set (its seed and recipe) and its
    number, ``meta["index"]``; not of workers, order or batch. With the seed of the garments, those of epoch 0 are the
    ones that ``gcd generate --views`` stores. All views of a garment share cloth and figure; camera, light and place
    differ. A CPU and a GPU differ in roundings.

    **Epochs.** A ``GarmentLoader`` given ``views`` knows the epoch; for a stream and a ``MixedDataset``, whose epochs
    may repeat garments, it numbers each use. As a ``transform``, ``set_epoch`` sets the epoch, in running workers too.
    In ``Augmented`` and ``FreshGarments(augment=…)`` each use has a stream of its own.

    - ``appearance``, ``camera``, ``lights``, ``environment``: the ranges to draw from, such as
      ``AppearanceRanges(prints=…)``; ``None``: all.
    - ``maps``: names of ``Picture.maps``; ``stretch``, ``gap`` and ``pressure`` need the fields of these names.
    - ``textures``: image files by panel, in place of its print: each is laid once over the box round its panel, upright
      along the grain.
    - ``device``: ``auto`` is this rank's GPU, else the CPU; looked up when ``Views`` is made, so make it after
      ``torch.distributed`` is initialised.
    - ``bodies``: the wearers of garments without shape weights of the body model, such as published ones and
      ``FakeGarments``: ``PublishedBodies``, or a function from name to ``Body``.

    Raises ``ConfigError`` for invalid options; and where items are rendered for a GPU in a worker, a field that is
    missing, a panel of ``textures`` that a garment lacks, and a wearer that is unknown.
    """

    on_gpu = "give GarmentLoader(views=Views(…)), which renders in the training process, or Views(device='cpu')"

    def __init__(
        self,
        n: int = 4,
        size: int = 256,
        *,
        appearance: "AppearanceRanges | None" = None,
        camera: "CameraRanges | None" = None,
        lights: "LightRanges | None" = None,
        environment: "EnvironmentRanges | None" = None,
        maps: Sequence["MapName"] = ("depth", "panel_id"),
        textures: Mapping[str, Path | str] | None = None,
        seed: int = 0,
        device: str = "auto",
        bodies: Bodies | BodyOf | None = None,
    ) -> None:
        from gcd_dataset.generator.render import Ranges, read_image

        super().__init__(size, seed, device, bodies)
        self.n = require_integer("n", n, least=1, most=MOST_VIEWS)
        self.maps = _known_maps(maps)
        self.textures = {name: read_image(file) for name, file in (textures or {}).items()}
        given = {"appearance": appearance, "camera": camera, "lights": lights, "environment": environment}
        usual = Ranges()
        self.ranges = Ranges(**{name: require_ranges(name, each, getattr(usual, name)) for name, each in given.items()})

    def batches(self, batches: Iterable[Any], *, epoch: int = 0) -> Iterator[Any]:
        """The batches of a ``DataLoader`` with their pictures; the next ones are rendered during the training step.

        Batches are of ``collate_packed``, ``collate_padded`` or ``collate_list``. A ``GarmentLoader`` takes ``views``
        itself, and keeps its position exact.
        """
        entries = ((None, batch, [epoch] * garments_in(batch)) for batch in batches)
        return (batch for _, batch in render_ahead(self, entries))

    @cached_property
    def landmark_names(self) -> tuple[str, ...]:
        """Names of the landmarks, in the order of ``landmark_pixels``."""
        from gcd_dataset.generator.body.asset import landmark_table

        return tuple(landmark_table().points)

    def __repr__(self) -> str:
        maps = f", maps {', '.join(self.maps)}" if self.maps else ""
        return f"Views(n={self.n}, size={self.size}, seed={self.seed}, on {self.device}{maps})"

    # ------------------------------------------------------------------------------------------------- items, batches

    def add_to_batch(self, batch: Any, uses: Sequence[int]) -> Any:
        """A collated batch with the pictures of its garments, as if the items had had them."""
        added = self._added(_items_of(batch), uses)
        if isinstance(batch, list):
            return [GarmentItem({**item, **entries}) for item, entries in zip(batch, added, strict=True)]
        joined = (collate_packed if isinstance(batch, PackedBatch) else collate_padded)(added)
        is_pinned = torch.cuda.is_available() and "verts" in batch and batch["verts"].is_pinned()
        for name, value in joined.items():
            batch[name] = pin_tensor(value) if isinstance(value, Tensor) and is_pinned else value
        return batch

    def _draw(self, items: Sequence[Item], uses: Sequence[int]) -> list[Item]:
        at_once = max(1, PIXELS // (self.n * self.size**2))
        entries: list[Item] = []
        for first in range(0, len(items), at_once):
            chunk = slice(first, first + at_once)
            entries += self._render_chunk(items[chunk], uses[chunk])
        return entries

    def _render_chunk(self, items: Sequence[Item], uses: Sequence[int]) -> list[Item]:
        from gcd_dataset.generator.render import draw_views, with_textures

        scenes: list[Scene] = []
        views: list[View] = []
        for row, (item, use) in enumerate(zip(items, uses, strict=True)):
            garment = StoredGarment.of(item, user="Views", values=[n for n in self.maps if n in ARRAYS[MAPS]])
            seed = garment.picture_seed(self.seed)
            scenes.append(self._scene(garment, seed, use))
            options: dict[str, Any] = {"epoch": use, "row": row, "fabric": garment.fabric, "ranges": self.ranges}
            drawn = draw_views(seed, garment.index, scenes[row], self.n, **options)
            if self.textures:
                look = drawn[0].appearance
                look = with_textures(look, scenes[row], self.textures, garment=garment.meta["key"])
                drawn = [replace(view, appearance=look) for view in drawn]
            views += drawn
        pictures = self._pictures(scenes, views)
        return [self._entries(pictures[row * self.n : (row + 1) * self.n]) for row in range(len(items))]

    def _empty(self) -> Item:
        from gcd_dataset.generator.render.casting import empty_picture

        return self._entries(self.n * [empty_picture(self.size, self.maps)])

    def _pictures(self, scenes: Sequence["Scene"], views: Sequence["View"]) -> "list[Picture]":
        from gcd_dataset.generator.render import render, start_pictures

        options: dict[str, Any] = {"size": self.size, "maps": self.maps, "device": self.device}
        if len(views) * self.size**2 > PIXELS:  # one garment, whose views take several renderings
            return render(scenes, views, **options)
        with _first_use(self.device):
            pending = start_pictures(scenes, views, **options)
        return pending.lend()

    def _scene(self, garment: StoredGarment, seed: int, use: int) -> "Scene":
        from gcd_dataset.generator.render import draw_hair
        from gcd_dataset.generator.views import stored_scene

        hair = draw_hair(seed, garment.index, epoch=use)
        body = wearer_of(garment, self._body_of)
        scene = stored_scene(garment.mesh, garment.vertices, body, pattern=garment.pattern, hair=hair)
        return replace(scene, values=garment.values) if garment.values else scene

    def _entries(self, pictures: Sequence["Picture"]) -> Item:
        first = pictures[0]
        entries: dict[str, np.ndarray] = {
            "views": np.stack([picture.rgb for picture in pictures]),
            **{f"{name}_map": np.stack([picture.maps[name] for picture in pictures]) for name in self.maps},
            "camera_k": np.stack([picture.intrinsics for picture in pictures]).astype(np.float32),
            "camera_rt": np.stack([picture.extrinsics for picture in pictures]).astype(np.float32),
            "panel_corners": first.panel_corners.astype(np.int32),
            "panel_corner_pixels": np.stack([p.corner_pixels for p in pictures], axis=1).astype(np.float32),
            "panel_corner_visible": np.stack([p.corner_visible for p in pictures], axis=1),
            **self._landmarks(pictures),
            "keypoints": np.stack([picture.keypoints for picture in pictures]).astype(np.float32),
        }
        return {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in entries.items()}

    def _landmarks(self, pictures: Sequence["Picture"]) -> dict[str, np.ndarray]:
        """The landmarks in the order of ``landmark_names``, the same for every body."""
        column = {name: number for number, name in enumerate(self.landmark_names)}
        pixels = np.full((len(pictures), len(column), 2), np.nan, np.float32)
        visible = np.zeros(pixels.shape[:2], bool)
        for view, picture in enumerate(pictures):
            columns = [column[name] for name in picture.landmark_names]
            pixels[view, columns], visible[view, columns] = picture.landmark_pixels, picture.landmark_visible
        return {"landmark_pixels": pixels, "landmark_visible": visible}


# ------------------------------------------------------------------------------------------------------ in a thread


def render_ahead(views: Views, entries: Iterable[tuple[Tag, Any, Sequence[int]]]) -> Generator[tuple[Tag, Any]]:
    """``(tag, batch with pictures)`` for each ``(tag, batch, uses)``; threads render while the caller works.

    ``entries`` is advanced in the calling thread: it may run users' code. A GPU has two threads, of which one prepares
    scenes while the other waits; on a CPU one renders.
    """
    threads = 1 if views.device == "cpu" else 2
    gpu = torch.cuda.current_device() if torch.cuda.is_initialized() else None  # type: ignore[no-untyped-call]
    # A new thread's current device is GPU 0; pinning memory would open a CUDA context on another rank's GPU.
    begin = None if gpu is None else partial(torch.cuda.set_device, gpu)
    pending: deque[tuple[Tag, Future[Any]]] = deque()
    executor = ThreadPoolExecutor(threads, thread_name_prefix="gcd-views", initializer=begin)
    try:
        for tag, batch, uses in entries:
            pending.append((tag, executor.submit(views.add_to_batch, batch, uses)))
            if len(pending) > threads:
                yield _finished(pending)
        while pending:
            yield _finished(pending)
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


def _finished(pending: deque[tuple[Tag, Future[Any]]]) -> tuple[Tag, Any]:
    tag, future = pending.popleft()
    return tag, future.result()


@contextlib.contextmanager
def _first_use(device: str) -> Iterator[None]:
    """Let one thread load the kernels of a device, while others wait; later calls do not wait."""
    with contextlib.nullcontext() if device in _used else _first:
        yield
        _used.add(device)


_first, _used = threading.Lock(), set[str]()


# --------------------------------------------------------------------------------------------------------- batches


def garments_in(batch: Any) -> int:
    """Number of garments of a batch. Raises ``ConfigError`` for a batch of another collate function."""
    if isinstance(batch, list):
        return len(batch)
    if isinstance(batch, PackedBatch | PaddedBatch):
        return batch.batch_size
    raise ConfigError(
        f"views of a {type(batch).__name__}: give collate_packed, collate_padded or collate_list, or give the data set "
        "transform=Views(device='cpu')"
    )


def _items_of(batch: Any) -> list[Item]:
    """The fields of each garment that views need, as before collation."""
    count = garments_in(batch)
    if isinstance(batch, list):
        return batch
    if isinstance(batch, PaddedBatch):
        return [_unpadded(batch, number) for number in range(count)]
    targets = {target for field in USED for _, target in POINTS_TO.get(field, ())} | {"verts", "box"}
    names = {*USED, *(f"{field}_ptr" for field in {*USED, *targets}), "batch_size"}
    part = PackedBatch({name: batch[name] for name in batch if split_worn(name)[1] in names})
    return [part.garment(number) for number in range(count)]


def _unpadded(batch: PaddedBatch, number: int) -> Item:
    return {
        field: batch[field][number][batch[f"{field}_mask"][number]] if field in RAGGED else batch[field][number]
        for field in batch
        if split_worn(field)[1] in USED
    }


def _known_maps(maps: Sequence["MapName"]) -> tuple["MapName", ...]:
    from gcd_dataset.generator.render.pictures import MapName

    if isinstance(maps, str) or any(name not in get_args(MapName) for name in maps):
        raise ConfigError(f"maps={maps!r:.99}: give names in a tuple, of {', '.join(get_args(MapName))}")
    return tuple(dict.fromkeys(maps))
