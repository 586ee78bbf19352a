"""``GeneratedGarments``: garments made on demand, with the indices, fields and bytes of a generated data set."""

import contextlib
import logging
import os
import zlib
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Literal, Unpack

import torch
from torch.utils.data import get_worker_info

from gcd_dataset import __version__
from gcd_dataset.devicenames import named_devices
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.files import make_folder, user_path, write_whole
from gcd_dataset.generator.drapers import DraperAddress, SharedDraper, addresses_for
from gcd_dataset.generator.garments.overlay import NO_OVERLAY, Overlay
from gcd_dataset.generator.maker import AHEAD, READY, LastDesign, produce
from gcd_dataset.generator.recipe import LastStage as Stage
from gcd_dataset.generator.recipe import MakeConfig, MakeOptions, layout_of_samples, recipe_of, versions
from gcd_dataset.loaders.base import Garments, Transform, decode_item, require_integer, tensor_of
from gcd_dataset.loaders.fields import absent_at_stage
from gcd_dataset.loaders.ranks import devices_of_process
from gcd_dataset.options import require_options
from gcd_dataset.records import Sample
from gcd_dataset.shards.access import read_file
from gcd_dataset.shards.codec import decode_sample, encode_sample, motion_arrays
from gcd_dataset.shards.layout import (
    ARRAYS,
    META,
    MOTION,
    SCHEMA,
    Bytes,
    fields_of,
    garments_layout,
    is_view_field,
    key_of,
    member_name,
    members_of,
    recipe_hash,
)
from gcd_dataset.shards.meta import read_meta
from gcd_dataset.shards.motion import decode_motion
from gcd_dataset.shards.tar import END, samples_in, tar_entry
from gcd_dataset.workers import prefetch

logger = logging.getLogger("gcd_dataset")

EACH = 1000  # cached samples of a folder


class GeneratedGarments(Garments):
    """Garments 0 … ``n`` - 1 of ``seed``, made on demand, byte for byte as ``gcd generate`` writes them to shards.

    >>> ds = GeneratedGarments(1000, drape=None, fields=("panels", "box"))  # doctest: +SKIP
    >>> ds[7]["box"].shape  # doctest: +SKIP
    torch.Size([9731, 3])

    What is made:

    - ``n``, ``seed``: number of garments, and the seed that determines them.
    - ``drape``: ``warp``, or ``None`` to stop at the box mesh. ``stage="pattern"`` stops before the box mesh.
    - ``design``: restricts the designs: an overlay from ``read_overlay``, or the content of an overlay file as a dict,
      ``{"meta": {"bottom": "none"}}``.
    - ``options``: the other options of ``MakeConfig``, such as ``bodies="both"``, ``resolution=2.0`` [cm],
      ``fabric="denim"``. Fabric and arm pose change the drapes of a seed, not its patterns. ``fabric="random"`` draws a
      fabric for each sample; ``meta`` holds its parameters.
    - ``device``: the device of the drape: ``cpu``, ``cuda:0``, ``cuda:0,1``, or ``auto``: every GPU that torch sees,
      else the CPU.

    What an item holds:

    - ``fields``: names of fields; ``None`` for all fields of the stage, but for ``motion_verts`` and ``motion_pose``,
      the whole motion of garments with a gait as ``poses``: name these. Pictures are rendered only for a cache, or if
      ``fields`` include ``front``, ``back`` or ``meta``, which holds the checksums of all members.
    - ``dtype``: the type of floating fields, float32 by default; ``None`` for the type stored in shards.
    - ``transform``: called with each item.

    ``cache_dir`` stores every garment made, one file each, and later reads are from there. It has one folder per seed,
    recipe and version of this package, the attribute ``cache``. Any number of workers and processes may share it; a
    damaged garment is made again. ``gcd generate`` makes a data set that can be copied and published.

    **Processes.** On GPUs, workers of a ``DataLoader``, forked or spawned, make body, design, pattern and mesh, and two
    draping processes per GPU drape for them. Without workers this process drapes each batch at once on the first GPU,
    which is idle while the next batch is prepared. On a CPU each worker drapes its own garments. Under ``torchrun``, or
    with ``torch.distributed`` initialised, ``auto`` is this rank's own GPU, and several GPUs are divided among the
    ranks of this machine.

    Raises ``ConfigError`` for options that do not fit together, fields of a later stage, and more ranks than GPUs; a
    missing GPU raises with the first garment. Raises ``DrapeError`` if a draping process ends; the next request
    starts another.
    """

    def __init__(
        self,
        n: int,
        seed: int = 0,
        *,
        drape: Literal["warp"] | None = "warp",
        stage: Stage | None = None,
        cache_dir: str | Path | None = None,
        transform: Transform | None = None,
        fields: Iterable[str] | None = None,
        design: Overlay | Mapping[str, Any] | None = None,
        dtype: torch.dtype | None = torch.float32,
        **options: Unpack[MakeOptions],
    ) -> None:
        self._n, self._seed = require_integer("n", n), require_integer("seed", seed)
        require_options(options, MakeConfig)
        options["device"] = devices_of_process(options.get("device", "auto"))
        self.config = MakeConfig(stage=_last_stage(drape, stage), design=_overlay(design), **options)
        empty = [] if self.config.picture else ["front", "back"]
        self._layout = layout_of_samples(self.config)
        config = self.config
        full = garments_layout(
            caption=config.captions,
            maps=config.maps,
            pose=bool(config.poses),
            motion=bool(config.motion) and fields is not None,
            views=config.views,
            garments=config.most_garments,
        )
        available, absent = fields_of(full.members), absent_at_stage(self.config.stage, empty)
        super().__init__(fields, transform, available=available, absent=absent, dtype=dtype)
        self.garments_per_design = self.config.wearers
        self._recipe = recipe_of(self.config)
        # Created here, so that all workers share these draping processes, which end with this process, not with a
        # worker.
        self._addresses = addresses_for(named_devices(self.config.device) if self.config.stage == "drape" else ["cpu"])
        cache_name = f"{__version__}-{SCHEMA}-seed{self._seed}-{recipe_hash(self._recipe)[:16]}"
        self.cache = None if cache_dir is None else user_path(cache_dir) / cache_name
        """The folder of this seed, recipe and version in ``cache_dir``; ``None`` without a cache."""
        self._sample_cache = None if self.cache is None else SampleCache(self.cache)
        self._last = LastDesign()
        self._process = os.getpid()

    def __len__(self) -> int:
        return self._n

    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions of garment ``index``. Raises ``IndexError``."""
        position = self._position(index)
        return {"seed": self._seed, "index": position, "recipe": dict(self._recipe), "versions": versions()}

    def verify(self, index: int) -> None:
        """Make garment ``index`` again; raise ``ShardError`` unless it equals the cached one, or a second new one."""
        position = self._position(index)
        cached = None if self._sample_cache is None else self._sample_cache.read(position)
        before, after = cached or self._made(position), self._made(position)
        for member, data in after.items():
            if data != before[member]:
                raise ShardError(f"{key_of(position)}, member {member}: the bytes differ when it is made again")

    def sample(self, index: int | str) -> Sample:
        known = partial(self._cached, fields=fields_of(self._layout.members))
        options = {"finished": self._encoded, "known": known, "pictured": True}
        return decode_sample(next(self._make(self._drapes_elsewhere, [self._position(index)], **options)))

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """The items of a batch, draped together; a ``DataLoader`` calls this."""
        positions = [self._position(index) for index in indices]
        return [self._item(*entry) for entry in zip(self._several(positions), positions, strict=True)]

    def stream(self, indices: Iterable[int]) -> Iterator[Any]:
        """Stream items; ``indices`` may be infinite. On a GPU the next garments are made meanwhile.

        A stream is draped on one GPU: to use several GPUs, run several streams, each in a worker.
        """
        positions = (self._position(index) for index in indices)
        if self._address is None:
            return (self._item(self._several([position])[0], position) for position in positions)
        requested: deque[int] = deque()

        def recorded() -> Iterator[int]:
            for position in positions:
                requested.append(position)
                yield position

        made = self._produced(recorded(), ahead=AHEAD)
        if get_worker_info() is None:  # in a worker, FreshGarments has a thread for this
            made = prefetch(made, READY)
        return (self._item(members, requested.popleft()) for members in made)

    def _several(self, positions: Sequence[int]) -> list[Mapping[str, Bytes]]:
        return list(self._produced(positions))

    def _produced(self, positions: Iterable[int], *, ahead: int | None = None) -> Iterator[Mapping[str, Bytes]]:
        """Encoded garments, cached or made now; by a draping process if this process must not drape."""
        elsewhere = ahead is not None or self._drapes_elsewhere
        options = {
            "finished": self._encoded,
            "known": self._cached,
            "last": self._last,
            "pictured": self._needs_pictures,
        }
        return self._make(elsewhere, positions, ahead=ahead, **options)

    def _make(self, elsewhere: bool, positions: Iterable[int], **options: Any) -> Iterator[Mapping[str, Bytes]]:
        with ExitStack() as opened:
            draper = None
            if elsewhere and (address := self._address) is not None:
                draper = opened.enter_context(SharedDraper(address))
            yield from produce(self._seed, positions, self.config, draper=draper, **options)

    @property
    def _address(self) -> DraperAddress | None:
        """The draping process of this worker: workers take the addresses in turn."""
        worker = get_worker_info()
        return self._addresses[(0 if worker is None else worker.id) % len(self._addresses)]

    @property
    def _needs_pictures(self) -> bool:
        """Whether pictures, or their checksums in ``meta``, are needed: rendering takes a second on a CPU."""
        pictures = any(field in ("front", "back", "meta") or is_view_field(field) for field in self.fields)
        return self._sample_cache is not None or pictures

    @property
    def _drapes_elsewhere(self) -> bool:
        """Whether a draping process must drape: CUDA fails in a forked process, and each CUDA context takes memory."""
        in_worker = get_worker_info() is not None or os.getpid() != self._process
        return self._address is not None and in_worker

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        return self._several([position])[0]

    def _item(self, members: Mapping[str, Bytes], position: int) -> Any:
        moving = [field for field in self.fields if field in ARRAYS[MOTION]]
        item = decode_item(members, [field for field in self.fields if field not in moving], self.dtype)
        arrays = motion_arrays(decode_motion(members[MOTION])) if moving else {}
        item.update({field: tensor_of(arrays[field], self.dtype) for field in moving})
        return self._transformed(item, position)

    def _made(self, position: int) -> Mapping[str, Bytes]:
        """A garment made now, even if it is cached."""
        return next(
            self._make(
                self._drapes_elsewhere,
                [position],
                finished=partial(encode_sample, garments=self.config.most_garments),
                pictured=self._needs_pictures,
            )
        )

    def _encoded(self, sample: Sample) -> Mapping[str, Bytes]:
        members = encode_sample(sample, garments=self.config.most_garments)
        if self._sample_cache is not None:
            self._sample_cache.keep(sample.provenance.index, members)
        return members

    def _cached(self, position: int, fields: Iterable[str] | None = None) -> Mapping[str, Bytes] | None:
        """The members for ``fields``, by default those of an item, from the cache; ``None`` if missing or damaged."""
        if self._sample_cache is None:
            return None
        try:
            return self._sample_cache.read(position, members_of(fields or self.fields, fields_of(self._layout.members)))
        except ShardError as error:
            logger.warning("%s; it is made again", error)
            return None

    def _description(self) -> list[str]:
        return [f"seed {self._seed}", f"stage {self.config.stage} on {self.config.device}"]

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._process = os.getpid()  # unpickled in a spawned process, where CUDA works


class SampleCache:
    """A cache of the samples of one seed, recipe and version, which any number of processes may fill and read.

    00012/gcd_000012345.tar     all members of sample 12345, pictures included
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def keep(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Store the members of a sample, unless it is there. Raises ``OutputError``."""
        path = self._path(index)
        if not path.exists():
            entries = [tar_entry(member_name(index, member), data) for member, data in members.items()]
            write_whole(make_folder(path.parent) / path.name, b"".join([*entries, bytes(END)]))

    def read(self, index: int, members: Iterable[str] | None = None) -> dict[str, memoryview] | None:
        """The members of a sample, by default all, checked; ``None`` if it is not there.

        A damaged sample is removed; then raises ``ShardError``.
        """
        path = self._path(index)
        if not path.exists():
            return None
        try:
            [(_, found)] = samples_in(memoryview(bytearray(read_file(path))))
            crc = read_meta(found[META])["crc32"]
            wanted = list(found if members is None else members)
            if any(zlib.crc32(found[member]) != crc[member] for member in wanted if member != META):
                raise ShardError("bytes differ from the written ones")
            return {member: found[member] for member in wanted}
        except (ShardError, ValueError, KeyError) as error:
            with contextlib.suppress(OSError):
                path.unlink()
            raise ShardError(f"{path}: damaged ({error})") from error

    def _path(self, index: int) -> Path:
        return self.folder / f"{index // EACH:05d}" / f"{key_of(index)}.tar"


def _overlay(design: Overlay | Mapping[str, Any] | None) -> Overlay:
    """The overlay that restricts designs. Raises ``ConfigError`` for an unknown parameter, with similar names."""
    if design is None:
        return NO_OVERLAY
    if isinstance(design, Overlay):
        return design
    if isinstance(design, Mapping):
        return Overlay.from_dict(design)
    raise ConfigError(
        f'design={design!r:.99}: give a dict such as {{"meta": {{"bottom": "none"}}}}, or read_overlay(FILE)'
    )


def _last_stage(drape: str | None, stage: Stage | None) -> Stage:
    """The last stage to make. Raises ``ConfigError`` for an unknown value or a contradiction."""
    if drape not in ("warp", None):
        raise ConfigError(f"drape={drape!r}: give 'warp', or None to stop at the box mesh")
    if drape is None and stage == "drape":
        raise ConfigError("drape=None and stage='drape': leave one of them out")
    return stage or ("mesh" if drape is None else "drape")
