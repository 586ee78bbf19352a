"""Changes of an item by chance: small callables of an item and a generator, which leave the item as it was.

>>> from gcd_dataset.loaders import Augmented, FakeGarments
>>> ds = Augmented(FakeGarments(3), Chain(Yaw(), PointNoise(0.2)), seed=1)
>>> ds[0]["points"].shape
torch.Size([64, 6])

What is drawn depends on seed, number of the garment and epoch alone. Fields that an item does not hold are passed over.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import torch
from scipy.spatial import ConvexHull

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Garments, Item, changing, function, items_of, kept_item, natural
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards.layout import Bytes

__all__ = ["Augment", "Augmented", "Chain", "PartialView", "PointNoise", "Yaw"]

Augment: TypeAlias = Callable[[Item, np.random.Generator], Item]

PLACED = ("box", "verts", "points")
"""Fields of positions [cm]: three columns of them, then perhaps three of normals."""


class Chain:
    """Several changes, one after the other."""

    def __init__(self, *augments: Augment) -> None:
        self.augments = tuple(function("augment", augment) for augment in augments)

    def __call__(self, item: Item, chance: np.random.Generator) -> Item:
        for augment in self.augments:
            item = augment(item, chance)
        return item


@dataclass(frozen=True)
class Yaw:
    """Turns the garment about the vertical: ``box``, ``verts`` and ``points``; pattern and pictures stay."""

    most: float = np.pi
    """Greatest turn to either side [rad]."""

    def __call__(self, item: Item, chance: np.random.Generator) -> Item:
        angle = chance.uniform(-self.most, self.most)
        cos, sin = np.cos(angle), np.sin(angle)
        turn = torch.tensor([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]], dtype=torch.float32)
        return {**item, **{field: _turned(item[field], turn) for field in PLACED if field in item}}


@dataclass(frozen=True)
class PointNoise:
    """Moves each surface point by normal noise, as a scanner does; normals stay."""

    sigma: float
    """Standard deviation along each axis [cm]."""

    def __call__(self, item: Item, chance: np.random.Generator) -> Item:
        if "points" not in item:
            return item
        points = item["points"]
        noise = torch.from_numpy(chance.normal(0.0, self.sigma, (len(points), 3)).astype(np.float32))
        moved = (points[:, :3].float() + noise).to(points.dtype)
        return {**item, "points": torch.cat([moved, points[:, 3:]], dim=1)}


@dataclass(frozen=True)
class PartialView:
    """Surface points that one camera sees, at the height of their middle and from any side; as many as there were.

    Some stand there several times in the place of those that are hidden, so that items still go into one batch.

    What is seen is found as by Katz, Tal and Basri (Direct visibility of point sets, ACM Trans. Graph. 26(3), 2007):
    points are flipped outward over a sphere about the camera, and those on the convex hull are seen.
    """

    distance: float = 300.0
    """From the camera to the middle of the points [cm]."""
    reach: float = 3.0
    """Logarithm of the sphere's radius over that of the farthest point; with more of it less counts as hidden."""

    def __call__(self, item: Item, chance: np.random.Generator) -> Item:
        if "points" not in item or len(item["points"]) < 4:
            return item
        angle = chance.uniform(-np.pi, np.pi)
        places = item["points"][:, :3].double().numpy()
        camera = places.mean(axis=0) + self.distance * np.array([np.sin(angle), 0.0, np.cos(angle)])
        seen = self._seen(places - camera)
        again = chance.choice(seen, len(places) - len(seen))
        return {**item, "points": item["points"][torch.from_numpy(np.concatenate([seen, again]))]}

    def _seen(self, rays: np.ndarray) -> np.ndarray:
        """Rows of the points that are seen from the origin, ascending."""
        far = np.linalg.norm(rays, axis=1, keepdims=True)
        flipped = rays + 2 * (far.max() * 10**self.reach - far) * rays / far
        hull = ConvexHull(np.concatenate([flipped, np.zeros((1, 3))])).vertices
        return np.sort(hull[hull < len(rays)])


class Augmented(Garments):
    """Garments of a data set, changed each epoch in another way; ``set_epoch`` reaches workers that are at work too.

    ``augment`` comes after the data set's own ``transform``.
    """

    def __init__(self, whole: Garments, augment: Augment, *, seed: int = 0) -> None:
        super().__init__(whole.fields, None, there=whole.fields, dtype=whole.dtype)
        self.whole, self.augment, self.seed = whole, function("augment", augment), natural("seed", seed)
        self.reads_only = whole.reads_only
        if whole.endless:
            raise ConfigError("Augmented takes no MixedDataset: give it the parts, and mix those")
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()  # type: ignore[no-untyped-call]

    def set_epoch(self, epoch: int) -> None:
        """Have the garments of batches that are begun from here on changed as in that epoch."""
        self._epoch.fill_(natural("epoch", epoch))

    def __len__(self) -> int:
        return len(self.whole)

    def recipe(self, index: int) -> dict[str, Any]:
        return self.whole.recipe(index)

    def verify(self, index: int) -> None:
        self.whole.verify(index)

    def identity(self) -> dict[str, Any]:
        return self.whole.identity()

    def tell_wait(self) -> None:
        self.whole.tell_wait()

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Several garments, at once where the data set can do that."""
        positions = [self._position(index) for index in indices]
        return [self._changed(*entry) for entry in zip(items_of(self.whole, positions), positions, strict=True)]

    def stream(self, indices: Iterable[int]) -> Any:
        """Garments one after the other, changed."""
        positions: list[int] = []

        def noted() -> Iterable[int]:
            for index in indices:
                positions.append(self._position(index))
                yield index

        return (self._changed(item, positions.pop(0)) for item in self.whole.stream(noted()))

    def _one(self, position: int) -> Any:
        return self._changed(self.whole[position], position)

    def _described(self) -> list[str]:
        return [f"of {type(self.whole).__name__}", *self.whole._described()]

    def _of_key(self, key: str) -> int | None:
        return self.whole._of_key(key)

    def _key(self, position: int) -> str:
        return self.whole._key(position)

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        return self.whole._members(position, members)

    def _changed(self, item: Item, position: int) -> Item:
        with changing(self, position):
            return kept_item(self.augment(item, rng(self.seed, position, Stage.AUGMENT, int(self._epoch))))


def _turned(rows: torch.Tensor, turn: torch.Tensor) -> torch.Tensor:
    """Positions, and normals beside them, times ``turn``."""
    columns = rows.float().reshape(len(rows), -1, 3)
    return (columns @ turn).reshape(rows.shape).to(rows.dtype)
