"""The geometry of a loaded garment and its wearer, for ``Views``, ``Scan`` and ``Sketch``."""

import contextlib
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import torch
from torch.utils.data import get_worker_info

from gcd_dataset import __version__
from gcd_dataset.bodies import POSES
from gcd_dataset.errors import BodyError, ConfigError
from gcd_dataset.loaders.base import GarmentItem, Item, require_callable, require_integer
from gcd_dataset.loaders.body_datasets import Bodies
from gcd_dataset.loaders.ranks import device_of_process
from gcd_dataset.loaders.worker import shared_number
from gcd_dataset.records import Body, BodyShape, BoxMesh, Panel, Pattern, Placement
from gcd_dataset.seeding import Stage, rng

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
        self._body_of = bodies_by_name(bodies)
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

    def _added(self, items: Sequence[Item], uses: Sequence[int]) -> list[Item]:
        """The new entries of each item. Raises ``ConfigError`` for a GPU in a worker process."""
        if self.device != "cpu" and (get_worker_info() is not None or os.getpid() != self._process):
            place = f"{type(self).__name__} on {self.device} in a worker process"
            raise ConfigError(f"{place}, where a GPU cannot be shared: {self.on_gpu}")
        return self._draw(items, uses)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._process = os.getpid()  # unpickled in a spawned process, where CUDA works


@dataclass(frozen=True)
class StoredGarment:
    """What an item tells of its garment."""

    index: int
    fabric: str | None
    mesh: BoxMesh
    vertices: np.ndarray
    spec: Mapping[str, Any]
    shape: np.ndarray | None
    """Shape weights of the wearer; ``None`` if they are unknown."""
    meta: Mapping[str, Any]
    user: str
    """Name of the transform, for errors."""

    @classmethod
    def of(cls, item: Item, *, user: str) -> "StoredGarment":
        """For the transform ``user``. Raises ``ConfigError`` for a missing field, mesh or drape."""
        _require_fields(item, user)
        meta = item["meta"]
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
            panel_names=tuple(meta["panel_names"]),
            panel_labels=tuple(meta["panel_labels"]),
            labels={},
            **{name: array.astype(np.int64) for name, array in arrays.items()},
        )
        weights = _array(item["body"]).astype(float) if "body" in item else np.zeros(0)
        fabric = None if meta["fabric"] is None else meta["fabric"]["name"]
        return cls(meta["index"], fabric, mesh, vertices, item["spec"], weights if len(weights) else None, meta, user)

    def picture_seed(self, seed: int) -> int:
        """The seed of its pictures, scans or sketches, from the seed of the transform."""
        from gcd_dataset.generator.views import picture_seed

        return picture_seed(seed, data_seed=self.meta["seed"], recipe=self.meta["recipe"])

    @cached_property
    def pattern(self) -> Pattern:
        """Its panels, possibly without edges. Raises ``SpecError``."""
        return _bare_pattern(self.meta, self.spec)


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


def _require_fields(item: Item, user: str) -> None:
    if missing := [field for field in NEEDED if field not in item]:
        raise ConfigError(
            f"{user} needs {', '.join(missing)}, and the items hold {', '.join(item) or 'nothing'}: give the data set "
            "fields=gcd_dataset.loaders.VIEW_FIELDS, or fields=None for all"
        )
    key = item["meta"]["key"]
    if empty := [field for field in ("faces", "uv", "verts") if not len(item[field])]:
        raise ConfigError(
            f"{key} has no {' and no '.join(empty)}: {user} renders draped garments: make them up to drape"
        )
    if not bool(torch.isfinite(torch.as_tensor(item["verts"])).all()):
        raise ConfigError(f"{key}: its drape diverged: leave it out with settled_only=True, or quality='paper'")


def wearer_of(garment: StoredGarment, body_of: BodyOf | None) -> Body:
    """The body of a garment. Raises ``ConfigError`` if the item does not tell it, or tells another model's weights."""
    meta, name = garment.meta, str(garment.meta["body"])
    try:
        if meta["pose"] is not None:
            weights = garment.shape if garment.shape is not None else _drawn_weights(meta)
            if weights is not None and (body_of is None or _fits_model(weights)):
                return _built(weights.tobytes(), meta["pose"]["arm_angle"], meta["pose"]["legs_apart"])
        if body_of is not None:
            return body_of(name)
    except (BodyError, KeyError) as error:
        raise ConfigError(f"{meta['key']}, wearer {name}: {error}") from error
    raise ConfigError(
        f"{meta['key']} has no shape weights of its wearer, {name}: read the field body too, or for published garments "
        f"give {garment.user}(bodies=PublishedBodies(ROOT, segmentation=FILE))"
    )


def bodies_by_name(bodies: Bodies | BodyOf | None) -> BodyOf | None:
    """The bodies of a data set of people as a function of their name; a function stays. Raises ``ConfigError``."""
    if bodies is not None and not isinstance(bodies, Bodies):
        require_callable("bodies", bodies, "name")
    return _PeopleByName(bodies) if isinstance(bodies, Bodies) else bodies


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
        stream = rng(int(seed), int(number), Stage.BODY, int(drawn))
        shape: BodyShape = draw_from("random" if group == "both" else group, stream)[1]
    except (ValueError, KeyError, BodyError):
        return None
    return shape.weights.astype(np.float32).astype(float)


@lru_cache(maxsize=64)
def _built(weights: bytes, arm_angle: float, legs_apart: bool) -> Body:
    from gcd_dataset.generator.views import stored_body

    return stored_body(BodyShape(np.frombuffer(weights), arm_angle, legs_apart))


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
