"""``Scan``: partial point clouds of virtual depth cameras, measured when garments are read."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from gcd_dataset.loaders.base import Item, require_integer, require_ranges
from gcd_dataset.loaders.body_datasets import Bodies
from gcd_dataset.loaders.scene_items import BodyOf, SceneTransform, StoredGarment, wearer_of
from gcd_dataset.seeding import Stage
from gcd_dataset.seeding import rng as seeded_rng

if TYPE_CHECKING:
    from gcd_dataset.generator.render.scans import DepthNoise, PointScan, ScanRanges


class Scan(SceneTransform):
    """Scans each garment with ``n`` depth cameras: a transform, or an augmentation.

    >>> from gcd_dataset.loaders import VIEW_FIELDS, GarmentDataset
    >>> ds = GarmentDataset("garments", fields=VIEW_FIELDS, transform=Scan(n=1, points=4096))  # doctest: +SKIP
    >>> ds[0]["scan"].shape  # doctest: +SKIP
    torch.Size([4096, 6])

    An item gets ``scan`` [points, 6], ``scan_panel_id``, ``scan_camera``, ``scan_camera_rt`` [n, 3, 4] and
    ``scan_camera_k``, described in ``GarmentFields``.

    Scans are a function of ``seed``, epoch and garment, as for ``Views``; not of workers, order or batch.
    A CPU and a GPU differ in roundings. As a ``transform``, ``set_epoch`` sets the epoch, in running workers too; in
    ``Augmented`` and ``FreshGarments(augment=…)`` each use has a stream of its own.

    - ``noise``: errors of the sensor; ``None``: ``KINECT``. ``NOISELESS`` has none.
    - ``cameras``: ranges to draw from; ``None``: all round. The ``n`` cameras stand evenly spaced on a circle.
    - ``body``: whether points of the skin belong to the scan; the wearer hides cloth in any case.
    - ``size``: rows and columns of the depth images [pixels].
    - ``device``: ``cpu``, as workers need, or the GPU that casts the rays.
    - ``bodies``: the wearers of garments without shape weights, as for ``Views``.

    Raises ``ConfigError`` for invalid options; and where items are scanned for a GPU in a worker, a field that is
    missing, and a wearer that is unknown.
    """

    def __init__(
        self,
        n: int = 1,
        points: int = 4096,
        *,
        noise: "DepthNoise | None" = None,
        cameras: "ScanRanges | None" = None,
        body: bool = False,
        size: int = 480,
        seed: int = 0,
        device: str = "cpu",
        bodies: Bodies | BodyOf | None = None,
    ) -> None:
        from gcd_dataset.generator.render.scans import KINECT, ScanRanges

        self.n, self.points = require_integer("n", n, least=1), require_integer("points", points, least=1)
        super().__init__(size, seed, device, bodies)
        self.body = body
        self.noise = require_ranges("noise", noise, KINECT)
        self.cameras = require_ranges("cameras", cameras, ScanRanges())

    def _draw(self, items: Sequence[Item], uses: Sequence[int]) -> list[Item]:
        return [_entries(self._scan(item, use)) for item, use in zip(items, uses, strict=True)]

    def _scan(self, item: Item, use: int) -> "PointScan":
        from gcd_dataset.generator.render.scans import draw_scan_cameras, scan
        from gcd_dataset.generator.views import stored_scene

        garment = StoredGarment.of(item, user="Scan")
        scene = stored_scene(garment.mesh, garment.vertices, wearer_of(garment, self._body_of))
        stream = seeded_rng(garment.picture_seed(self.seed), garment.index, Stage.SCAN, use)
        cameras = draw_scan_cameras(stream, scene, self.n, ranges=self.cameras, body=self.body)
        options: dict[str, Any] = {"noise": self.noise, "body": self.body, "size": self.size, "device": self.device}
        return scan(scene, cameras, stream, points=self.points, **options)

    def __repr__(self) -> str:
        return f"Scan(n={self.n}, points={self.points}, size={self.size}, seed={self.seed}, on {self.device})"


# ------------------------------------------------------------------------------------------------------------- helpers


def _entries(scan: "PointScan") -> Item:
    """The new entries of an item."""
    entries = {
        "scan": np.concatenate([scan.points, scan.normals], axis=1).astype(np.float32),
        "scan_panel_id": scan.panel_id.astype(np.int32),
        "scan_camera": scan.camera.astype(np.int32),
        "scan_camera_rt": scan.extrinsics.astype(np.float32),
        "scan_camera_k": np.repeat(scan.intrinsics[None].astype(np.float32), len(scan.extrinsics), axis=0),
    }
    return {name: torch.from_numpy(value) for name, value in entries.items()}
