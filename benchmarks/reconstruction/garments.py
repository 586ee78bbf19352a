"""``GarmentSet``: a fixed set of garments in memory, its hashes, its splits, and where it comes from."""

import hashlib
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Any, Generic, TypeAlias, TypeVar, cast
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Float, Int

from benchmarks.reconstruction.derived import CENTRE, DERIVED, POINT_LABELS, derived_arrays, item_fields, picture_views
from gcd_dataset.devicenames import named_devices
from gcd_dataset.errors import ConfigError
from gcd_dataset.exports.published import garment_type
from gcd_dataset.files import make_folder, open_whole
from gcd_dataset.loaders import FreshGarments, GarmentDataset, GeneratedGarments, PublishedGarmentCodeData, Views
from gcd_dataset.loaders.base import Garments, Item
from gcd_dataset.loaders.scenes import BodyOf
from gcd_dataset.measurements import MEASURES
from gcd_dataset.patternhash import PatternHash
from gcd_dataset.records import Outcome, Pattern
from gcd_dataset.release.batches import PublishedBatches
from gcd_dataset.release.bodies import published_body
from gcd_dataset.scoring.inputs import SEED, moves
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards.layout import key_of
from gcd_dataset.spec import read_pattern
from gcd_dataset.tensors import (
    EDGE_LABELS,
    PANEL_LABELS,
    EdgeColumn,
    PanelColumn,
    PatternTensor,
    StitchColumn,
    decode_pattern,
    encode_pattern,
    sewn_rows,
)

Arrays: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
"""``panels``, ``edges`` and ``stitches`` of a ``PatternTensor``."""

Encoded = TypeVar("Encoded")

PATTERN = ("panels", "edges", "stitches")
FIELDS = ("meta", "design", "measures", "body", *PATTERN)
"""Item fields of every set; ``points`` and others are read where a task needs them."""
LOG_EVERY = 1000  # garments
MOST_FRESH = 1_000_000  # garments of a stream
TOGETHER = 16  # garments that a worker sends together
PORTION = 4000  # garments of a file of the cache


@dataclass(frozen=True, eq=False)
class Ragged:
    """Arrays of different lengths, one after the other."""

    rows: np.ndarray
    starts: Int[np.ndarray, "g+1"]
    """Array k is ``rows[starts[k] : starts[k + 1]]``."""

    def __len__(self) -> int:
        return len(self.starts) - 1

    def __getitem__(self, k: int) -> np.ndarray:
        return self.rows[self.starts[k] : self.starts[k + 1]]

    def select(self, chosen: Int[np.ndarray, " b"]) -> "Ragged":
        """The arrays with these numbers."""
        return Ragged.of([self[k] for k in chosen.tolist()], like=self.rows)

    @staticmethod
    def of(arrays: Sequence[np.ndarray], *, like: np.ndarray | None = None) -> "Ragged":
        """Arrays that differ in their first axis only; ``like`` gives the shape if there are none."""
        lengths = np.array([len(array) for array in arrays], dtype=np.int64)
        rows = np.concatenate(arrays) if arrays else np.zeros(0) if like is None else like[:0]
        return Ragged(rows, np.concatenate([[0], np.cumsum(lengths)]))

    @staticmethod
    def join(parts: Sequence["Ragged"]) -> "Ragged":
        """The arrays of several parts, in order."""
        lengths = np.concatenate([np.diff(part.starts) for part in parts])
        return Ragged(np.concatenate([part.rows for part in parts]), np.concatenate([[0], np.cumsum(lengths)]))


@dataclass(frozen=True, eq=False)
class GarmentSet:
    """Garments as packed arrays, one row or ragged entry for each."""

    keys: tuple[str, ...]
    """Unique names."""
    kinds: tuple[str, ...]
    """``upper_garment``, ``dress``, ``jumpsuit``, ``skirt`` or ``pants``."""
    designs: Int[np.ndarray, " g"]
    """Hash of the design: garments with the same number share it."""
    bodies: Int[np.ndarray, " g"]
    """Hash of the body's shape."""
    shapes: Float[np.ndarray, "g k"]
    """Weights of the body's shape components; k is 0 where they are unknown."""
    measures: Float[np.ndarray, "g m"]
    """The body's measures, in the order of ``MEASURES`` [cm, degrees]."""
    points: Float[np.ndarray, "g n 6"]
    """Surface points relative to ``CENTRE`` [cm] and normals, in random order, f16; n may be 0.

    Those of a scan where the set was read with ``scan``; all at ``CENTRE`` if it measured nothing.
    """
    ragged: Mapping[str, Ragged]
    """``panels``, ``edges``, ``stitches`` of a ``PatternTensor``; further fields such as ``verts`` and ``faces``."""
    recipe: Mapping[str, Any]
    """Provenance: seed and recipe, or the folder."""

    def __len__(self) -> int:
        return len(self.keys)

    def arrays(self, k: int) -> Arrays:
        """The pattern of garment k as arrays."""
        return self.ragged["panels"][k], self.ragged["edges"][k], self.ragged["stitches"][k]

    def pattern(self, k: int) -> Pattern:
        """The pattern of garment k, named by its key; its panels are named by number."""
        return replace(pattern_of(self.arrays(k)), name=self.keys[k])

    def select(self, rows: Sequence[int] | Int[np.ndarray, " b"]) -> "GarmentSet":
        """The garments with these numbers, in this order."""
        chosen = np.asarray(rows, dtype=np.int64)
        columns: dict[str, Any] = {
            name: getattr(self, name)[chosen] for name in ("designs", "bodies", "shapes", "measures", "points")
        }
        columns |= {name: tuple(getattr(self, name)[k] for k in chosen.tolist()) for name in ("keys", "kinds")}
        ragged = {name: entry.select(chosen) for name, entry in self.ragged.items()}
        return replace(self, **columns, ragged=ragged)

    def without_points(self) -> "GarmentSet":
        """The garments without surface points and their labels, which are large."""
        ragged = {name: rows for name, rows in self.ragged.items() if name not in POINT_LABELS}
        return replace(self, points=self.points[:, :0], ragged=ragged)

    @staticmethod
    def join(parts: Sequence["GarmentSet"]) -> "GarmentSet":
        """The garments of several parts, in order; they have the same fields."""
        columns: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("designs", "bodies", "shapes", "measures", "points")
        }
        columns |= {name: tuple(x for part in parts for x in getattr(part, name)) for name in ("keys", "kinds")}
        ragged = {name: Ragged.join([part.ragged[name] for part in parts]) for name in parts[0].ragged}
        return replace(parts[0], **columns, ragged=ragged)

    def pattern_hash(self, first: int = 0, step: int = 1) -> PatternHash:
        """Hash (``gcd_dataset.patternhash``) of the patterns, numbers ``first``, ``first + step`` … of a set."""
        return PatternHash.of((first + step * k, _tensor(self.arrays(k))) for k in range(len(self)))

    @cached_property
    def patterns_hash(self) -> str:
        """Hash of the patterns in their order, the same on every machine."""
        return self.pattern_hash().text

    @property
    def ids_hash(self) -> str:
        """SHA-256 of the keys in their order."""
        return hashlib.sha256("\n".join(self.keys).encode()).hexdigest()

    def save(self, path: Path) -> None:
        """Write the set as one ``.npz`` file."""
        arrays: dict[str, Any] = {
            name: np.array(value) if isinstance(value, tuple) else value
            for name, value in ((field.name, getattr(self, field.name)) for field in fields(self))
            if name not in ("ragged", "recipe")
        }
        for name, entry in self.ragged.items():
            arrays |= {f"ragged/{name}/rows": entry.rows, f"ragged/{name}/starts": entry.starts}
        with open_whole(path) as file:
            np.savez(file, **arrays, recipe=np.array(json.dumps(self.recipe)))

    @staticmethod
    def load(path: Path) -> "GarmentSet":
        """Read what ``save`` wrote. Raises ``ConfigError`` for another file."""
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files}
            ragged = {
                name.split("/")[1]: Ragged(rows, arrays[name.replace("/rows", "/starts")])
                for name, rows in arrays.items()
                if name.endswith("/rows")
            }
            columns: dict[str, Any] = {
                name: arrays[name] for name in ("designs", "bodies", "shapes", "measures", "points")
            }
            columns |= {name: tuple(arrays[name].tolist()) for name in ("keys", "kinds")}
            return GarmentSet(**columns, ragged=ragged, recipe=json.loads(str(arrays["recipe"])))
        except (OSError, EOFError, KeyError, ValueError, BadZipFile) as error:
            raise ConfigError(f"{path}: no garment set ({error}): delete the file, it is made again") from error


def pattern_of(arrays: Arrays) -> Pattern:
    """The pattern of an item's arrays; panels are named by number, labels are kept where their number is common."""
    return decode_pattern(_tensor(arrays))


def _tensor(arrays: Arrays) -> PatternTensor:
    panels, edges, stitches = arrays
    panels, edges = panels.copy(), edges.copy()
    stitches = stitches[(stitches[:, : StitchColumn.RIGHT + 1] < len(edges)).all(axis=1)]  # without those of lines
    panels[panels[:, PanelColumn.LABEL] >= len(PANEL_LABELS), PanelColumn.LABEL] = 0
    edges[edges[:, EdgeColumn.LABEL] >= len(EDGE_LABELS), EdgeColumn.LABEL] = 0
    return PatternTensor(
        panels, edges, stitches, sewn_rows(len(stitches)), tuple(str(row) for row in range(len(panels)))
    )


# ----------------------------------------------------------------------------------------------------------- the making


def generated(
    count: int,
    seed: int,
    *,
    points: int,
    extra: Sequence[str] = (),
    cache: Path | None = None,
    workers: int = 0,
    share: tuple[int, int] = (0, 1),
    **options: Any,
) -> GarmentSet:
    """Garments 0 … ``count`` - 1 of a seed, without those whose drape did not settle.

    ``share``: (r, n) keeps number r, r + n … of these alone.

    ``extra``: further item fields, and names of ``DERIVED``. ``cache``: a folder that keeps the set in files of
    ``PORTION`` garments: a stopped call continues after the last of them, and a smaller set reads the first files only.
    ``options``: of ``GeneratedGarments``. Drapes that fail are not drawn again, so the patterns are those of stage
    ``mesh``.
    """
    names, read = _names(points, extra)
    options = {"picture": 0, "points": max(points, 1), "on_fail": "keep", **options, "fields": read, "dtype": None}
    stream = _Stream(_Packed(points, tuple(extra)), _views_on_gpu(extra, options.get("device", "auto")), workers)
    whole = GeneratedGarments(count, seed, transform=stream.transform(_itself), **options)
    told = whole.recipe(0)
    recipe = {"seed": seed, "recipe": told["recipe"], "version": told["versions"]["gcd_dataset"]}
    recipe |= {"points": points, "fields": sorted(names)}
    folder = None if cache is None else make_folder(cache / f"generated-{_digest(recipe)}")

    def portions() -> Iterator[GarmentSet]:
        made = 0
        for portion in () if folder is None else _kept(folder, count):
            made = int(portion.recipe["made"])
            yield portion
        following = stream.encoded(whole.select(range(made, count)), _itself, first=made)
        for end, portion in _portions(following, made, count) if made < count else ():
            one = replace(portion, recipe={**recipe, "made": end})
            if folder is not None:
                one.save(_file_of(folder, made))
            made = end
            yield one

    parts, held = list[GarmentSet](), 0
    for portion in portions():
        wanted = np.array([int(key.rsplit("_", 1)[1]) < count for key in portion.keys])
        rows = np.flatnonzero(wanted)[(share[0] - held) % share[1] :: share[1]]
        parts.append(portion if len(rows) == len(portion) else portion.select(rows))
        held += int(wanted.sum())
    if not held:
        raise ConfigError(f"{whole!r}: no garment that settled: give another data set")
    return replace(GarmentSet.join(parts), recipe=parts[-1].recipe)


def _kept(folder: Path, count: int) -> Iterator[GarmentSet]:
    """The leading portions of a set that a folder keeps without a gap, at most up to garment ``count`` - 1."""
    made = 0
    while made < count and (path := _file_of(folder, made)).exists():
        portion = GarmentSet.load(path)
        yield portion
        made = int(portion.recipe["made"])


def _file_of(folder: Path, first: int) -> Path:
    """The file of the portion that begins with garment ``first``."""
    return folder / f"{first:09d}.npz"


def _portions(found: Iterable[tuple[int, GarmentSet]], first: int, count: int) -> Iterator[tuple[int, GarmentSet]]:
    """Sets of ``PORTION`` garments, and how many of the ``count`` are made then; prints the progress.

    ``found``: index and garment of those from index ``first`` on that settled, in order.
    """
    parts: list[GarmentSet] = []
    made = first
    for k, one in found:
        if (k + 1) // LOG_EVERY > made // LOG_EVERY:
            print(f"{k + 1} of {count} garments", file=sys.stderr, flush=True)
        made = k + 1
        parts.append(one)
        if len(parts) == PORTION and made < count:
            yield made, GarmentSet.join(parts)
            parts = []
    if parts:
        yield count, GarmentSet.join(parts)


def _names(points: int, extra: Sequence[str]) -> tuple[list[str], list[str]]:
    """Names of the arrays of a set, and the item fields to read for them."""
    names = [*FIELDS, *(["points"] if points else []), *extra]
    return names, item_fields(names)


def read_folder(
    source: str,
    *,
    points: int,
    extra: Sequence[str] = (),
    workers: int = 0,
    stage: str = "pattern",
    split: str = "",
    most: int | None = None,
    cache: Path | None = None,
) -> GarmentSet:
    """The settled garments of a folder: patterns, GarmentCodeData as published, or a set that ``GarmentDataset`` opens.

    ``split``: of the official split of the published layout, whose garments lack ``body`` and ``pose``. ``cache``:
    folder for what it unpacks, by default that layout. ``most``: the first garments alone. Raises ``ConfigError`` for
    garments of another stage; ``pattern``: those of any.
    """
    folder, bodies = Path(source), None
    opened: Callable[..., Garments] = partial(GarmentDataset, source, dtype=None)
    if split:
        batches, extra = PublishedBatches(folder, cache_dir=cache), [name for name in extra if name != "pose"]
        opened = partial(PublishedGarmentCodeData, batches, split, dtype=None)
        bodies = partial(published_body, batches.root)
    patterns = [] if split or not folder.is_dir() else sorted(folder.rglob("*_specification.json"))
    names, read = _names(points, extra)
    fields = PATTERN if patterns else opened().fields
    held = "drape" if "verts" in fields else "mesh" if "faces" in fields else "pattern"
    if stage not in ("pattern", held):  # points of box meshes and of drapes have one name
        raise ConfigError(f"{source}: garments of stage {held}: give garments made with --stage {stage}")
    if patterns:
        return _read_patterns(source, patterns[:most])
    stream = _Stream(_Packed(points, tuple(extra), bodies), _views_on_gpu(extra, "auto", bodies), workers)
    read = [name for name in read if name != "body" or not split]
    found = opened(fields=read, transform=stream.transform(_itself))
    found = found.select(range(len(found))[:most])
    parts = [part for _, part in _portions(stream.encoded(found, _itself), 0, len(found))]
    if not parts:
        raise ConfigError(f"{found!r}: no garment that settled: give another data set")
    recipe = {"source": source, "points": points, "fields": sorted(names), **({"split": split} if split else {})}
    return replace(GarmentSet.join(parts), recipe=recipe)


def _read_patterns(source: str, paths: Sequence[Path]) -> GarmentSet:
    """Garments of specification files, without wearers and points; ``skirt_00012`` and ``skirt_7`` are of one kind.

    Raises ``PatternError`` with the file that cannot be read.
    """
    kinds = [path.stem.removesuffix("_specification").rstrip("_0123456789") for path in paths]
    found, count = [encode_pattern(read_pattern(path)) for path in paths], len(paths)
    return GarmentSet(
        keys=tuple(f"0_{k:09d}" for k in range(count)),
        kinds=tuple(kinds),
        designs=np.array([_number(kind.encode()) for kind in kinds]),
        bodies=np.array([_number(bytes(path)) for path in paths]),
        shapes=np.zeros((count, 0), np.float32),
        measures=np.full((count, len(MEASURES)), np.nan, np.float32),
        points=np.zeros((count, 0, 6), np.float16),
        ragged={name: Ragged.of([getattr(tensor, name) for tensor in found]) for name in PATTERN},
        recipe={"source": source, "files": [path.name for path in paths]},
    )


def fresh_garments(
    encode: Callable[[GarmentSet], Encoded],
    seed: int,
    *,
    first: int,
    points: int,
    extra: Sequence[str] = (),
    workers: int = 0,
    **options: Any,
) -> Iterator[tuple[int, Encoded]]:
    """Index and ``encode`` of each garment of a seed from index ``first`` on, a set of one; made by ``workers``.

    Skips garments whose drape did not settle. With a GPU, this process renders the pictures on it and encodes the
    garments that have pictures; with several GPUs, it renders on one that drapes.
    """
    _, read = _names(points, extra)
    options = {"picture": 0, "points": max(points, 1), "on_fail": "keep", **options, "fields": read, "dtype": None}
    stream = _Stream(_Packed(points, tuple(extra)), _views_on_gpu(extra, options.get("device", "auto")), workers)
    endless = GeneratedGarments(first + MOST_FRESH, seed, transform=stream.transform(encode), **options)
    yield from stream.encoded(endless.select(range(first, first + MOST_FRESH)), encode, first=first)


@dataclass(frozen=True)
class _Stream:
    """Garments made ahead by ``workers``, which also pack and encode those without pictures."""

    pack: "_Packed"
    views: Views | None
    workers: int

    def transform(self, encode: Callable[[GarmentSet], Encoded]) -> "_Encoded[Encoded] | None":
        """The transform of the data set that is streamed."""
        return _Encoded(self.pack, encode) if self.views is None else None

    def encoded(
        self, garments: Garments, encode: Callable[[GarmentSet], Encoded], *, first: int = 0
    ) -> Iterator[tuple[int, Encoded]]:
        """Index and ``encode`` of each garment that settled, a set of one; the data set has the transform above.

        ``first``: index of the first garment; the others follow without gaps.
        """
        fresh = FreshGarments(garments, workers=self.workers, room=1)
        if self.views is None:
            yield from ((k, cast(Encoded, one)) for k, one in enumerate(fresh, first) if one is not None)
        else:
            settled = filter(self.pack.keeps, fresh)
            batches = iter(lambda: list(islice(settled, TOGETHER)), [])
            shown = (item for items in self.views.batches(batches) for item in items)
            yield from ((int(item["meta"]["index"]), encode(self.pack(item))) for item in shown)


def _itself(garments: GarmentSet) -> GarmentSet:
    return garments


def _views_on_gpu(extra: Sequence[str], drapes: str, bodies: BodyOf | None = None) -> Views | None:
    """Renders the pictures of a set on a GPU; ``None`` without one, or for a set without pictures.

    ``drapes``: device of its drapes. The first GPU that it names renders; if it names none, that of this process.
    """
    if "pictures" not in extra:
        return None
    gpus = [] if drapes == "auto" else [device for device in named_devices(drapes) if device != "cpu"]
    views = picture_views(next(iter(gpus), "auto"), bodies)
    return None if views.device == "cpu" else views


@dataclass(frozen=True)
class _Packed:
    """Transform of a data set: item to a ``GarmentSet`` of one garment, or of none that it does not keep."""

    points: int
    extra: tuple[str, ...]
    bodies: BodyOf | None = None
    """The wearers of garments without shape weights."""

    def __call__(self, item: Item) -> GarmentSet:
        meta, design = item["meta"], item["design"]
        measures = np.array([item["measures"].get(name, np.nan) for name in MEASURES], dtype=np.float32)
        body = item["body"].numpy().astype(np.float32) if "body" in item else np.zeros(0, np.float32)
        arrays = derived_arrays(item, (*PATTERN, *self.extra), self.bodies)
        points = self._points(arrays.pop("scan", None), item)
        ragged = {name: Ragged.of([array]) for name, array in arrays.items()}
        found = GarmentSet(
            keys=(name_of(meta["seed"], meta["index"]),),
            kinds=(garment_type(design)["main"],),
            designs=np.array([_number(json.dumps(design, sort_keys=True).encode())]),
            bodies=np.array([_number(body.tobytes() or meta["body"].encode())]),
            shapes=body[None],
            measures=measures[None],
            points=points[None],
            ragged=ragged,
            recipe={},
        )
        return found if self.keeps(item) else found.select([])

    def keeps(self, item: Item) -> bool:
        """Whether the drape settled; where the fit is asked, there is a ring with cloth; and a motion is whole."""
        if "motion" in self.extra and not moves(item):
            return False
        is_settled = (item["meta"].get("drape") or {}).get("outcome", "") in ("", Outcome.SETTLED.name)
        return is_settled and ("fit" not in self.extra or bool(np.isfinite(DERIVED["fit"].of(item)[0, 1:]).any()))

    def _points(self, scan: np.ndarray | None, item: Item) -> Float[np.ndarray, "n 6"]:
        if not self.points:
            return np.zeros((0, 6), np.float16)
        rows = item["points"].numpy() if scan is None else scan
        found = rows[: self.points].astype(float)
        found[:, :3] -= CENTRE
        return np.nan_to_num(found).astype(np.float16)


@dataclass(frozen=True)
class _Encoded(Generic[Encoded]):
    """Transform of a data set: item to what ``encode`` returns; ``None`` if its drape did not settle."""

    pack: _Packed
    encode: Callable[[GarmentSet], Encoded]

    def __call__(self, item: Item) -> Encoded | None:
        packed = self.pack(item)
        return self.encode(packed) if len(packed) else None


def name_of(seed: int, index: int) -> str:
    """The key of a garment; test garments have the names of ``gcd bench inputs``, so that answers can be submitted."""
    return key_of(index) if seed == SEED else f"{seed}_{index:09d}"


def _number(data: bytes) -> int:
    return int.from_bytes(hashlib.sha256(data).digest()[:8], "little", signed=True)


def _digest(recipe: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()[:16]


# ----------------------------------------------------------------------------------------------------------- the splits


@dataclass(frozen=True, eq=False)
class Split:
    """Garments to train on, to watch a training with, and to test on.

    Raises ``ConfigError`` if one is empty, or if training and another share a design or a body.
    """

    train: GarmentSet
    check: GarmentSet
    test: GarmentSet
    apart: tuple[str, ...] = ("designs", "bodies")
    """What must not be shared: the official split of GarmentCodeData separates designs alone."""

    def __post_init__(self) -> None:
        for name, other in (("test", self.test), ("check", self.check)):
            for what in self.apart:
                shared = np.intersect1d(getattr(self.train, what), getattr(other, what))
                if len(shared):
                    raise ConfigError(f"{len(shared)} {what} are in train and {name}: split the garments again")
        sizes = [len(self.train), len(self.check), len(self.test)]
        if not all(sizes):
            raise ConfigError(
                f"garments to train on, to check and to test: {sizes}: give more garments, some on bodies of their own"
            )

    def without(self, kind: str) -> "Split":
        """Trained without a kind of garment, tested on that kind alone. Raises ``ConfigError``."""
        if kind not in self.test.kinds:
            raise ConfigError(f"no {kind} to test on: choose one of {', '.join(sorted(set(self.test.kinds)))}")
        return replace(
            self,
            train=self.train.select([k for k, name in enumerate(self.train.kinds) if name != kind]),
            check=self.check.select([k for k, name in enumerate(self.check.kinds) if name != kind]),
            test=self.test.select([k for k, name in enumerate(self.test.kinds) if name == kind]),
        )

    def first(self, count: int, first: int = 0, step: int = 1) -> "Split":
        """The split with the first ``count`` training garments, or numbers ``first``, ``first + step`` … of these."""
        return replace(self, train=self.train.select(range(first, min(count, len(self.train)), step)))


def split_off(garments: GarmentSet, designs: int, *, checked: int = 32, seed: int = 0) -> Split:
    """Split a set by design and by body: ``designs`` to test on and ``checked`` to check, drawn by ``seed``.

    At most half of the designs are tested on. All garments of a design are on one side. Garments of the other sides on
    bodies that training garments wear are left out. The training set is in random order. Raises ``ConfigError`` if a
    side is empty.
    """
    every = rng(seed, 0, Stage.SPLIT).permutation(np.unique(garments.designs))
    tested = min(designs, len(every) // 2)
    checked = min(checked, (len(every) - tested) // 2)
    known = ~np.isin(garments.designs, every[: tested + checked])
    own = ~np.isin(garments.bodies, garments.bodies[known])
    return Split(
        train=garments.select(rng(seed, 1, Stage.SPLIT).permutation(np.flatnonzero(known))),
        check=garments.select(np.flatnonzero(np.isin(garments.designs, every[tested : tested + checked]) & own)),
        test=garments.select(np.flatnonzero(np.isin(garments.designs, every[:tested]) & own)),
    )
