"""``Sketch``: line drawings of garments, drawn when they are read."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Item, require_number, require_ranges
from gcd_dataset.loaders.body_datasets import Bodies
from gcd_dataset.loaders.scene_items import BodyOf, SceneTransform, StoredGarment, wearer_of
from gcd_dataset.seeding import Stage
from gcd_dataset.seeding import rng as seeded_rng

if TYPE_CHECKING:
    from gcd_dataset.generator.render.sketches import SketchStyle


class Sketch(SceneTransform):
    """Draws each garment as lines: a transform, or an augmentation.

    >>> from gcd_dataset.loaders import VIEW_FIELDS, GarmentDataset
    >>> ds = GarmentDataset("garments", fields=VIEW_FIELDS, transform=Sketch(size=512))  # doctest: +SKIP
    >>> ds[0]["sketch"].shape  # doctest: +SKIP
    torch.Size([2, 512, 512])

    An item gets ``sketch`` [n, size, size] for the n ``yaws``, ``sketch_k`` and ``sketch_rt``, described in
    ``GarmentFields``.

    Lines drawn by hand and ``turn`` are a function of ``seed``, epoch and garment, as for ``Views``; not of workers,
    order or batch. Clean lines from a fixed side are the same in every epoch. A CPU and a GPU differ in roundings. As a
    ``transform``, ``set_epoch`` sets the epoch, in running workers too; in ``Augmented`` and
    ``FreshGarments(augment=…)`` each use has a stream of its own.

    - ``yaws``: sides to draw [degrees]: 0 in front, 90 at the wearer's left, 180 behind.
    - ``turn``: largest random turn added to each of them [degrees].
    - ``style``: ``None`` is ``FLAT``, a technical flat; ``HAND`` is drawn by hand, on the wearer.
    - ``device``: ``cpu``, as workers need, or the GPU that casts the rays.
    - ``bodies``: the wearers of garments without shape weights, as for ``Views``; for a style with ``body``.

    Raises ``ConfigError`` for invalid options; and where items are drawn for a GPU in a worker, a field that is
    missing, and a wearer that is unknown.
    """

    def __init__(
        self,
        size: int = 512,
        *,
        yaws: Sequence[float] = (0.0, 180.0),
        turn: float = 0.0,
        style: "SketchStyle | None" = None,
        seed: int = 0,
        device: str = "cpu",
        bodies: Bodies | BodyOf | None = None,
    ) -> None:
        from gcd_dataset.generator.render.sketches import FLAT

        super().__init__(size, seed, device, bodies)
        if not isinstance(yaws, list | tuple | np.ndarray) or not len(yaws):
            raise ConfigError(f"yaws={yaws!r:.99}: give one angle or more in a tuple")
        self.yaws = tuple(require_number("yaws", yaw, least=-math.inf) for yaw in yaws)
        self.turn = require_number("turn", turn, most=180.0, unit=" degrees")
        self.style = require_ranges("style", style, FLAT)

    def _draw(self, items: Sequence[Item], uses: Sequence[int]) -> list[Item]:
        return [self._entries(item, use) for item, use in zip(items, uses, strict=True)]

    def _entries(self, item: Item, use: int) -> Item:
        """The new entries of an item."""
        from gcd_dataset.generator.render.sketches import NOBODY, sketch, sketch_camera
        from gcd_dataset.generator.views import stored_scene

        garment = StoredGarment.of(item, user="Sketch")
        body = wearer_of(garment, self._body_of) if self.style.body else NOBODY
        scene = stored_scene(garment.mesh, garment.vertices, body)
        stream = seeded_rng(garment.picture_seed(self.seed), garment.index, Stage.SKETCH, use)
        cameras = [sketch_camera(scene, yaw + stream.uniform(-self.turn, self.turn)) for yaw in self.yaws]
        options: dict[str, Any] = {"size": self.size, "style": self.style, "rng": stream, "device": self.device}
        entries = {
            "sketch": np.stack([sketch(scene, camera, **options) for camera in cameras]),
            "sketch_k": np.stack([camera.intrinsics(self.size) for camera in cameras]).astype(np.float32),
            "sketch_rt": np.stack([camera.extrinsics() for camera in cameras]).astype(np.float32),
        }
        return {name: torch.from_numpy(value) for name, value in entries.items()}

    def __repr__(self) -> str:
        yaws = ", ".join(f"{yaw:g}" for yaw in self.yaws)
        return f"Sketch(size={self.size}, yaws=({yaws}), seed={self.seed}, on {self.device})"
