"""``Scan`` and ``Sketch``, and what they share with ``Views``: the geometry of a loaded garment and its wearer."""

import contextlib
import json
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import compress
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch.utils.data import get_worker_info

from gcd_dataset import __version__
from gcd_dataset.bodies import POSES
from gcd_dataset.errors import BodyError, ConfigError
from gcd_dataset.loaders.base import (
    GarmentItem,
    Item,
    require_callable,
    require_integer,
    require_number,
    require_ranges,
)
from gcd_dataset.loaders.body_datasets import Bodies
from gcd_dataset.loaders.ranks import device_of_process
from gcd_dataset.loaders.transforms import OutfitCloth
from gcd_dataset.loaders.worker import shared_number
from gcd_dataset.outfits import joined_pattern
from gcd_dataset.records import Body, BodyShape, BoxMesh, Outcome, Panel, Pattern, Placement
from gcd_dataset.seeding import Stage
from gcd_dataset.seeding import rng as seeded_rng
from gcd_dataset.shards.layout import split_worn, worn_name
from gcd_dataset.shards.meta import json_text, shape_of

if TYPE_CHECKING:
    from gcd_dataset.generator.render.scans import DepthNoise, PointScan, ScanRanges
    from gcd_dataset.generator.render.sketches import SketchStyle

VIEW_FIELDS: tuple[str, ...] = (
    "meta", "spec", "panels", "edges", "stitches", "body",
    "faces", "uv", "panel_id", "seams", "corners", "uv_vertex", "verts",
)  # fmt: skip
"""The fields that ``Views``, ``Scan`` and ``Sketch`` read, and those that ``collate_packed`` needs for them."""
NEEDED = ("meta", "spec", "verts", "faces", "uv", "panel_id", "seams", "corners", "uv_vertex")
LARGEST = 4096  # pixels in a row
BODIES_KEPT = 256  # bodies in memory: 150 MB

BodyOf = Callable[[str], Body]
"""The body of a wearer, by the name in ``meta["body"]``."""


class SceneTransform(ABC):
    """Base of ``Views``, ``Scan`` and ``Sketch``: adds entries to an item, drawn from seed, epoch and garment."""

    on_gpu = "give device='cpu'"  # remedy for a GPU in a worker process

    def __init__(self, size: int, seed: int, device: str, bodies: Bodies | BodyOf | None) -> None:
        self.size, self.seed = require_integer("size", size, least=1, most=LARGEST), require_integer("seed", seed)
        self.device = device_of_process(device)
        if bodies is not None and not isinstance(bodies, Bodies):
            require_callable("bodies", bodies, "name")
        self._body_of = _PeopleByName(bodies) if isinstance(bodies, Bodies) else bodies
        self._epoch, self._process = shared_number(), os.getpid()

    def __call__(self, item: Item, rng: np.random.Generator | None = None) -> Item:
        """The item with its new entries: a transform; with ``rng``, an augmentation that draws the epoch from it."""
        use = int(self._epoch) if rng is None else int(rng.integers(1 << 62))
        return self.add_to_items([item], [use])[0]

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch of the items transformed from now on, in all worker processes."""
        self._epoch.fill_(require_integer("epoch", epoch))

    def add_to_items(self, items: Sequence[Item], uses: Sequence[int]) -> list[Item]:
        """The items with their new entries; ``uses``: the epoch, or number of the use, of each."""
        added = self._added(items, uses)
        return [GarmentItem({**item, **entries}) for item, entries in zip(items, added, strict=True)]

    @abstractmethod
    def _draw(self, items: Sequence[Item], uses: Sequence[int]) -> list[Item]:
        """The new entries of each item."""

    @abstractmethod
    def _empty(self) -> Item:
        """The new entries of a garment that was not draped: an empty picture, of the same shapes and types."""

    def _added(self, items: Sequence[Item], uses: Sequence[int]) -> list[Item]:
        """The new entries of each item. Raises ``ConfigError`` for a GPU in a worker process."""
        if self.device != "cpu" and (get_worker_info() is not None or os.getpid() != self._process):
            place = f"{type(self).__name__} on {self.device} in a worker process"
            raise ConfigError(f"{place}, where a GPU cannot be shared: {self.on_gpu}")
        draped = [not _cannot_be_put_on(item) for item in items]
        drawn = iter(self._draw(list(compress(items, draped)), list(compress(uses, draped))))
        return [next(drawn) if is_draped else self._empty() for is_draped in draped]

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._process = os.getpid()  # unpickled in a spawned process, where CUDA works


@dataclass(frozen=True)
class StoredGarment:
    """What an item tells of its garment."""

    index: int
    fabric: str | tuple[str | None, ...] | None
    """The name of its fabric, or that of each panel of an outfit."""
    mesh: BoxMesh
    vertices: np.ndarray
    specs: Sequence[Mapping[str, Any]]
    """The specification of each garment."""
    shape: np.ndarray | None
    """Shape weights of the wearer; ``None`` if they are unknown."""
    meta: Mapping[str, Any]
    user: str
    """Name of the transform, for errors."""
    values: Mapping[str, np.ndarray]
    """See ``Scene.values``."""

    @classmethod
    def of(cls, item: Item, *, user: str, values: Sequence[str] = ()) -> "StoredGarment":
        """For the transform ``user``, with ``values``. Raises ``ConfigError`` for a missing field, mesh or drape."""
        _require_fields(item, user, values)
        meta, worn = item["meta"], item["meta"].get("outfit", [item["meta"]])
        specs = [item[worn_name(number, "spec")] for number in range(len(worn))]
        if any(split_worn(field)[0] for field in item):
            item = OutfitCloth()(item)
        if meta.get("yaw"):
            raise ConfigError(
                f"{meta['key']} was turned by Yaw before {user}, which finds the wearer unturned: apply {user} before "
                "Yaw, or leave Yaw out; its cameras are drawn all round the figure"
            )
        arrays = {name: _array(item[name]) for name in ("faces", "corners", "uv_vertex", "panel_id", "seams")}
        vertices = _array(item["verts"]).astype(float)
        mesh = BoxMesh(
            vertices=vertices,
            uv=_array(item["uv"]).astype(float),
            panel_names=tuple(item["meta"]["panel_names"]),
            panel_labels=tuple(meta["panel_labels"]),
            labels={},
            **{name: array.astype(np.int64) for name, array in arrays.items()},
        )
        weights = _array(item["body"]).astype(float) if "body" in item else np.zeros(0)
        names = [entry["fabric"] and entry["fabric"]["name"] for entry in worn]
        panels = [name for name, entry in zip(names, worn, strict=True) for _ in entry["panel_names"]]
        fabric = names[0] if len(worn) == 1 else tuple(panels)
        shape, given = weights if len(weights) else None, {name: _array(item[name]) for name in values}
        return cls(meta["index"], fabric, mesh, vertices, specs, shape, meta, user, given)

    def picture_seed(self, seed: int) -> int:
        """The seed of its pictures, scans or sketches, from the seed of the transform."""
        from gcd_dataset.generator.views import picture_seed

        return picture_seed(seed, data_seed=self.meta["seed"], recipe=self.meta["recipe"])

    @cached_property
    def pattern(self) -> Pattern:
        """The panels of all its garments; a panel may have no edges. Raises ``SpecError``."""
        worn = zip(self.meta.get("outfit", [self.meta]), self.specs, strict=True)
        return joined_pattern([_bare_pattern({**entry, "key": self.meta["key"]}, spec) for entry, spec in worn])


def _bare_pattern(meta: Mapping[str, Any], spec: Mapping[str, Any]) -> Pattern:
    """The panels with their corners. Raises ``SpecError``.

    Items hold specifications in this package's form, read here without their edges, which takes a tenth of the time.
    """
    from gcd_dataset.spec import UNITS_IN_METER, pattern_from_spec

    form = spec.get("properties") or {}
    known = ("normalized_edge_loops", "normalize_panel_translation", "units_in_meter")
    if [form.get(name) for name in known] == [True, False, UNITS_IN_METER]:
        with contextlib.suppress(KeyError, TypeError, ValueError):
            entries = spec["pattern"]["panels"]
            corners = {name: np.array(entries[name]["vertices"], float).reshape(-1, 2) for name in meta["panel_names"]}
            return Pattern(
                meta["pattern"], tuple(Panel(name, at, (), UNPLACED, "") for name, at in corners.items()), ()
            )
    return pattern_from_spec(spec, meta["pattern"], source=meta["key"])


UNPLACED = Placement(np.zeros(3), np.zeros(3))


def _cannot_be_put_on(item: Item) -> bool:
    """Whether the vertices of a garment of an item are those before sewing."""
    meta = item.get("meta", {})
    drapes = [entry["drape"] for entry in meta.get("outfit", [meta]) if entry.get("drape") is not None]
    return any(drape["outcome"] == Outcome.CANNOT_BE_PUT_ON.name for drape in drapes)


def _require_fields(item: Item, user: str, values: Sequence[str]) -> None:
    if missing := [field for field in NEEDED if field not in item]:
        raise ConfigError(
            f"{user} needs {', '.join(missing)}, and the items hold {', '.join(item) or 'nothing'}: give the data set "
            "fields=gcd_dataset.loaders.VIEW_FIELDS, or fields=None for all"
        )
    key, count = item["meta"]["key"], len(item["meta"].get("outfit", [0]))
    of_all = [worn_name(number, name) for number in range(count) for name in NEEDED if not number or name != "meta"]
    if missing := [field for field in of_all if field not in item]:
        outfit = f"{key} is an outfit of {count} garments"
        raise ConfigError(f"{outfit}, and {user} needs {', '.join(missing)}: give the data set fields=None")
    if values and count > 1:
        raise ConfigError(f"{key} is an outfit, whose first garment alone has {values[0]}: leave it out of maps")
    if missing := [field for field in values if field not in item]:
        raise ConfigError(
            f"{key} has no {', '.join(missing)} for maps of {user}: give the data set fields=(*VIEW_FIELDS, "
            f"{', '.join(map(repr, values))}); gcd generate --maps makes one that holds them"
        )
    if empty := [
        field for field in of_all if split_worn(field)[1] in ("faces", "uv", "verts") and not len(item[field])
    ]:
        raise ConfigError(
            f"{key} has no {' and no '.join(empty)}: {user} renders draped garments: make them up to drape"
        )
    places = (torch.as_tensor(item[worn_name(number, "verts")]) for number in range(count))
    if not all(bool(torch.isfinite(verts).all()) for verts in places):
        raise ConfigError(f"{key}: its drape diverged: leave it out with settled_only=True, or quality='paper'")


def wearer_of(garment: StoredGarment, body_of: BodyOf | None) -> Body:
    """The body of a garment. Raises ``ConfigError`` if the item does not tell it, or tells another model's weights."""
    meta, name = garment.meta, str(garment.meta["body"])
    try:
        if meta["pose"] is not None:
            weights = garment.shape if garment.shape is not None else _drawn_weights(meta)
            if weights is not None and (body_of is None or _fits_model(weights)):
                return _built(weights.tobytes(), json_text(meta["pose"]))
        if body_of is not None:
            return body_of(name)
    except (BodyError, KeyError) as error:
        raise ConfigError(f"{meta['key']}, wearer {name}: {error}") from error
    raise ConfigError(
        f"{meta['key']} has no shape weights of its wearer, {name}: read the field body too, or for published garments "
        f"give {garment.user}(bodies=PublishedBodies(ROOT, segmentation=FILE))"
    )


def _fits_model(weights: np.ndarray) -> bool:
    """Whether weights are those of the body model; ``FakeGarments`` have others."""
    from gcd_dataset.generator.body.asset import body_model

    return len(weights) == len(body_model().components)


def _drawn_weights(meta: Mapping[str, Any]) -> np.ndarray | None:
    """Shape weights of a drawn wearer, from its name, ``KIND:SEED:NUMBER``; ``None`` if this version cannot tell.

    A data set mixed with published garments has no field ``body``.
    """
    from gcd_dataset.generator.body import neutral_shape
    from gcd_dataset.generator.body.shape import draw_from

    if meta["versions"].get("gcd_dataset") != __version__:
        return None
    if meta["body"] == "neutral":
        return neutral_shape().weights.astype(np.float32).astype(float)
    try:
        _, seed, number, drawn = (f"{meta['body']}:0").split(":")[:4]
        group = meta["recipe"]["bodies"]
        stream = seeded_rng(int(seed), int(number), Stage.BODY, int(drawn))
        shape: BodyShape = draw_from("random" if group == "both" else group, stream)[1]
    except (ValueError, KeyError, BodyError):
        return None
    return shape.weights.astype(np.float32).astype(float)


@lru_cache(maxsize=64)
def _built(weights: bytes, pose: str) -> Body:
    """``pose``: ``meta["pose"]`` as JSON."""
    from gcd_dataset.generator.views import stored_body

    return stored_body(shape_of(np.frombuffer(weights), json.loads(pose)))


class _PeopleByName:
    """The bodies of a data set of people by name, such as ``00345_straight``, or ``00345``; some are kept in memory."""

    def __init__(self, people: Bodies) -> None:
        self._people = people
        self._kept: dict[str, Body] = {}

    def __call__(self, name: str) -> Body:
        """Raises ``KeyError`` for an unknown name, ``BodyError`` for a mesh without labels of its parts."""
        body = self._kept.get(name) or self._body(name)
        if len(self._kept) < BODIES_KEPT:
            self._kept[name] = body
        return body

    def _body(self, name: str) -> Body:
        person, _, pose = name.rpartition("_")
        is_posed = pose in POSES
        position = self._people._position(person if is_posed else name)
        return self._people.person(position).body(self._people.mesh, legs_apart=is_posed and pose == "apart")

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": {}}


def _array(value: Any) -> np.ndarray:
    """A tensor of any device and type as an array."""
    tensor = torch.as_tensor(value).detach().cpu()
    array: np.ndarray = (tensor.float() if tensor.is_floating_point() else tensor).numpy()
    return array


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

    def _empty(self) -> Item:
        from gcd_dataset.generator.render.scans import PointScan

        lost, none = np.full((self.points, 3), np.nan), np.full(self.points, -1)
        return _entries(PointScan(lost, lost, none, none, np.zeros((self.n, 3, 4)), np.zeros((3, 3)), measured=0))

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


def _entries(scan: "PointScan") -> Item:
    entries = {
        "scan": np.concatenate([scan.points, scan.normals], axis=1).astype(np.float32),
        "scan_panel_id": scan.panel_id.astype(np.int32),
        "scan_camera": scan.camera.astype(np.int32),
        "scan_camera_rt": scan.extrinsics.astype(np.float32),
        "scan_camera_k": np.repeat(scan.intrinsics[None].astype(np.float32), len(scan.extrinsics), axis=0),
    }
    return {name: torch.from_numpy(value) for name, value in entries.items()}


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

    def _empty(self) -> Item:
        count = len(self.yaws)
        return {
            "sketch": torch.full((count, self.size, self.size), 255, dtype=torch.uint8),
            "sketch_k": torch.zeros(count, 3, 3),
            "sketch_rt": torch.zeros(count, 3, 4),
        }

    def _entries(self, item: Item, use: int) -> Item:
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
