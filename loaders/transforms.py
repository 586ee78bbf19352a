"""Random augmentations: callables ``(item, rng) -> item`` that leave the given item unchanged; joined outfits.

>>> from gcd_dataset.loaders import Augmented, FakeGarments
>>> ds = Augmented(FakeGarments(3), Chain(Yaw(), PointNoise(0.2)), seed=1)
>>> ds[0]["points"].shape
torch.Size([64, 6])

Draws depend on seed, garment index and epoch alone. A field that an item lacks is skipped.
"""

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np
import torch

from gcd_dataset.captions import LEVELS, read_captions
from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import (
    DerivedGarments,
    Garments,
    Item,
    UserCode,
    as_transform_error,
    load_items,
    require_callable,
    require_garments,
    require_integer,
    require_number,
    wrap_item,
)
from gcd_dataset.loaders.batches import RAGGED, pack_items
from gcd_dataset.loaders.worker import shared_number
from gcd_dataset.outfits import worn_panel
from gcd_dataset.seeding import Stage
from gcd_dataset.seeding import rng as seeded_rng
from gcd_dataset.shards.layout import of_garment, split_worn

Augment: TypeAlias = Callable[[Any, np.random.Generator], Any]
"""A function of an item and a random stream that returns the changed item."""

PLACED = ("box", "verts", "points", "scan")
"""Fields of positions [cm]: three columns, possibly followed by three of normals."""
CAMERAS = ("camera_rt", "scan_camera_rt", "sketch_rt")
"""Fields of extrinsics [R | t], world to camera."""
VIEW_FACTS = re.compile(r"view_\d+_json")
DIRECTIONS = ("key_direction", "fill_direction")
"""Directions in the world, in the light of a stored view's facts."""


class Chain:
    """Several augmentations, applied in order."""

    def __init__(self, *augments: Augment) -> None:
        self.augments = tuple(require_callable("augment", augment, "item, rng") for augment in augments)

    def __call__(self, item: Item, rng: np.random.Generator) -> Item:
        for augment in self.augments:
            item = augment(item, rng)
        return item


@dataclass(frozen=True)
class Yaw:
    """Rotates the figure about the vertical: ``box``, ``verts``, of all garments, ``points`` and ``scan``.

    Cameras and lights turn with it: pictures and their maps stay, and ``camera_rt``, ``sketch_rt``, ``scan_camera_rt``
    and ``view_N_json`` describe them in the new axes. The pattern stays, and so do ``front`` and ``back``. The angle is
    added to ``meta["yaw"]``: ``Views``, ``Scan`` and ``Sketch``, which find the wearer unturned, raise ``ConfigError``
    after a ``Yaw``; apply them before it.
    """

    most: float = np.pi
    """Largest angle to either side [rad], 0 or more."""

    def __post_init__(self) -> None:
        require_number("most", self.most)

    def __call__(self, item: Item, rng: np.random.Generator) -> Item:
        angle = rng.uniform(-self.most, self.most)
        cos, sin = np.cos(angle), np.sin(angle)
        rotation = torch.tensor([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]], dtype=torch.float32)
        placed = [field for field in item if split_worn(field)[1] in PLACED]
        turned: dict[str, Any] = {field: _rotated(item[field], rotation) for field in placed}
        turned |= {field: _turned_cameras(item[field], rotation) for field in CAMERAS if field in item}
        turned |= {field: _turned_facts(item[field], rotation) for field in item if VIEW_FACTS.fullmatch(field)}
        if "meta" in item and turned and angle:
            turned["meta"] = {**item["meta"], "yaw": item["meta"].get("yaw", 0.0) + float(angle)}
        return {**item, **turned}


@dataclass(frozen=True)
class PointNoise:
    """Adds Gaussian noise to each surface point, like a scanner's; normals stay."""

    sigma: float
    """Standard deviation along each axis [cm], 0 or more."""

    def __post_init__(self) -> None:
        require_number("sigma", self.sigma, unit=" cm")

    def __call__(self, item: Item, rng: np.random.Generator) -> Item:
        if "points" not in item:
            return item
        points = item["points"]
        noise = torch.from_numpy(rng.normal(0.0, self.sigma, (len(points), 3)).astype(np.float32))
        moved = (points[:, :3].float() + noise).to(points.dtype)
        return {**item, "points": torch.cat([moved, points[:, 3:]], dim=1)}


class OutfitCloth:
    """A transform that joins the garments of an outfit to one mesh and one pattern, as a batch joins its garments.

    ``verts``, ``faces``, ``panels``, ``edges``, ``stitches``, … have the rows of all garments, from the skin outwards;
    row numbers refer to the joined rows, and those in columns ``LABEL`` to the garment's own names in
    ``meta["outfit"]``. ``garment_id`` is the garment of each vertex, ``panel_garment`` that of each panel, int32. The
    panels of garment 1 are named ``g1_front``, … in ``meta["panel_names"]``. Fields that only the first garment has,
    such as ``points``, stay. Raises ``ConfigError`` for row numbers without the field that they refer to.
    """

    def __call__(self, item: Item) -> Item:
        garments = [of_garment(number, item) for number in range(1 + max(split_worn(field)[0] for field in item))]
        shared = [field for field in garments[-1] if field in RAGGED]
        joined = pack_items([{field: one[field] for field in shared if field in one} for one in garments])
        owners = {"garment_id": "verts" if len(joined.get("verts", ())) else "box", "panel_garment": "panels"}
        changed = {field: joined[field] for field in shared}
        changed |= {name: joined.owners(field).int() for name, field in owners.items() if field in joined}
        if "outfit" in item.get("meta", {}):
            worn = enumerate(garment["panel_names"] for garment in item["meta"]["outfit"])
            names = [worn_panel(number, name) for number, own in worn for name in own]
            changed["meta"] = {**item["meta"], "panel_names": names}
        return {**garments[0], **changed}


class PickCaption:
    """Replaces ``caption``, the captions of all levels, by one of them: a string without line breaks.

    >>> PickCaption("short")({"caption": "short: A skirt.\\nmedium: A long skirt.\\nfull: A long plain skirt."})
    {'caption': 'A skirt.'}

    ``levels``: the level, or several, of which each use draws one; default: all. With one level it may serve as a
    ``transform`` too. Raises ``ConfigError`` for an unknown level.
    """

    def __init__(self, *levels: str) -> None:
        if unknown := [level for level in levels if level not in LEVELS]:
            raise ConfigError(f"no caption level {unknown[0]!r:.99}: there are {', '.join(LEVELS)}")
        self.levels = levels or LEVELS
        if len(self.levels) > 1:  # a use draws a level: no transform, which is called without a random stream
            self.__signature__ = inspect.signature(Chain().__call__)

    def __call__(self, item: Item, rng: np.random.Generator | None = None) -> Item:
        if "caption" not in item:
            return item
        if rng is None and len(self.levels) > 1:
            raise ConfigError("PickCaption of several levels draws one: give it as augment=, or name one level")
        number = 0 if rng is None or len(self.levels) == 1 else int(rng.integers(len(self.levels)))
        return {**item, "caption": read_captions(item["caption"])[self.levels[number]]}


@dataclass(frozen=True)
class PartialView:
    """Keeps the surface points that one camera sees: at the height of their centroid, from a random side.

    Visible points are repeated at random until there are as many as before, so that items still stack to one tensor.

    Visibility as in Katz, Tal and Basri (Direct visibility of point sets, ACM Trans. Graph. 26(3), 2007): points are
    reflected over a sphere around the camera, and those on the convex hull are visible.
    """

    distance: float = 300.0
    """From the camera to the centroid of the points [cm]."""
    reach: float = 3.0
    """log10 of the sphere's radius over the distance of the farthest point; larger values hide fewer points."""

    def __post_init__(self) -> None:
        require_number("distance", self.distance, least=1.0, unit=" cm")
        require_number("reach", self.reach, most=12.0)  # beyond, reflected points have no digits left

    def __call__(self, item: Item, rng: np.random.Generator) -> Item:
        if "points" not in item or len(item["points"]) < 4:
            return item
        angle = rng.uniform(-np.pi, np.pi)
        positions = item["points"][:, :3].double().numpy()
        camera = positions.mean(axis=0) + self.distance * np.array([np.sin(angle), 0.0, np.cos(angle)])
        visible = self._visible(positions - camera)
        repeated = rng.choice(visible, len(positions) - len(visible))
        return {**item, "points": item["points"][torch.from_numpy(np.concatenate([visible, repeated]))]}

    def _visible(self, rays: np.ndarray) -> np.ndarray:
        """Rows of the points visible from the origin, ascending."""
        distance = np.linalg.norm(rays, axis=1, keepdims=True)
        flipped = rays + 2 * (distance.max() * 10**self.reach - distance) * rays / distance
        from scipy.spatial import ConvexHull

        hull = ConvexHull(np.concatenate([flipped, np.zeros((1, 3))])).vertices
        return np.sort(hull[hull < len(rays)])


class Augmented(DerivedGarments):
    """Garments with an augmentation that differs each epoch; ``set_epoch`` reaches running workers too.

    ``augment`` is applied after the data set's own ``transform``. Raises ``ConfigError`` for anything but a data set of
    garments and a function of an item and a random stream.
    """

    def __init__(self, whole: Garments, augment: Augment, *, seed: int = 0) -> None:
        require_garments("whole", whole)
        super().__init__(whole, None)
        self.augment, self.seed = require_callable("augment", augment, "item, rng"), require_integer("seed", seed)
        self.garments_per_design = whole.garments_per_design
        if whole.endless:
            raise ConfigError("Augmented takes no MixedDataset: give it the parts, and mix those")
        self._epoch = shared_number()

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch of the garments loaded from now on, in all worker processes."""
        self._epoch.fill_(require_integer("epoch", epoch))

    def __len__(self) -> int:
        return len(self.whole)

    def identity(self) -> dict[str, Any]:
        return self.whole.identity()

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        positions = [self._position(index) for index in indices]
        return [self._augmented(*entry) for entry in zip(load_items(self.whole, positions), positions, strict=True)]

    def stream(self, indices: Iterable[int]) -> Any:
        positions: list[int] = []

        def recorded() -> Iterable[int]:
            for index in indices:
                positions.append(self._position(index))
                yield index

        return (self._augmented(item, positions.pop(0)) for item in self.whole.stream(recorded()))

    def _load(self, position: int) -> Any:
        return self._augmented(self.whole[position], position)

    def _separated(self) -> tuple[Garments, UserCode | None]:
        whole, code = self.whole._separated()
        return whole, self._augmented if code is None else partial(self._augmented_after, code)

    def _augmented_after(self, code: UserCode, item: Item, position: int) -> Item:
        return self._augmented(code(item, position), position)

    def _find_key(self, key: str) -> int | None:
        return self.whole._find_key(key)

    def _augmented(self, item: Item, position: int) -> Item:
        with as_transform_error(self, position):
            return wrap_item(self.augment(item, seeded_rng(self.seed, position, Stage.AUGMENT, int(self._epoch))))


def _rotated(rows: torch.Tensor, rotation: torch.Tensor) -> torch.Tensor:
    """Positions, and normals if present, times the rotation matrix."""
    columns = rows.float().reshape(len(rows), rows.shape[1] // 3, 3)
    return (columns @ rotation).reshape(rows.shape).to(rows.dtype)


def _turned_cameras(extrinsics: torch.Tensor, rotation: torch.Tensor) -> torch.Tensor:
    """[R | t] of cameras that turn with the figure; positions are rows times the rotation matrix."""
    axes, position = extrinsics[..., :3].float() @ rotation, extrinsics[..., 3:].float()
    turned = torch.cat([axes, position], dim=-1)
    return turned.to(extrinsics.dtype)


def _turned_facts(facts: Mapping[str, Any], rotation: torch.Tensor) -> dict[str, Any]:
    """The facts of a stored view whose camera and lights turn with the figure."""
    rt = _turned_cameras(torch.tensor(facts["camera"]["rt"]), rotation).tolist()
    directions = {name: (torch.tensor(facts["light"][name]) @ rotation).tolist() for name in DIRECTIONS}
    return {**facts, "camera": {**facts["camera"], "rt": rt}, "light": {**facts["light"], **directions}}
