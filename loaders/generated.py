"""Garments made when they are asked for: the same index space, fields and bytes as a published data set."""

import logging
import os
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal, Unpack

import torch
from torch.utils.data import get_worker_info

from gcd_dataset import __version__
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.files import user_path
from gcd_dataset.generator.drapers import DraperAddress, SharedDraper, addresses_for
from gcd_dataset.generator.garments.overlay import NO_OVERLAY, Overlay
from gcd_dataset.generator.maker import AHEAD, READY, LastDesign, produce
from gcd_dataset.generator.recipe import LastStage as Stage
from gcd_dataset.generator.recipe import MakeConfig, MakeOptions, devices_name, named_devices, recipe_of, versions
from gcd_dataset.loaders.available import lacking_at
from gcd_dataset.loaders.base import Garments, Transform, natural
from gcd_dataset.loaders.ranks import own_gpu, own_gpus
from gcd_dataset.loaders.waiting import tell_wait
from gcd_dataset.options import require_options
from gcd_dataset.prefetch import prefetch
from gcd_dataset.records import Sample
from gcd_dataset.shards.codec import encode_sample
from gcd_dataset.shards.layout import SCHEMA, Bytes, key_of, members_of, recipe_hash
from gcd_dataset.shards.sample_cache import SampleCache

__all__ = ["GeneratedGarments", "Stage"]

logger = logging.getLogger("gcd_dataset")


class GeneratedGarments(Garments):
    """Garments 0 … ``n`` - 1 of ``seed``, made on the spot: what ``gcd generate`` would have put into shards.

    >>> ds = GeneratedGarments(1000, drape=None, fields=("panels", "box"))  # doctest: +SKIP
    >>> ds[7]["box"].shape  # doctest: +SKIP
    torch.Size([9731, 3])

    ``options`` are those of ``MakeConfig``: ``bodies="both"``, ``resolution=2.0`` [cm], ``fabric="denim"`` and so on;
    ``design`` is an overlay by ``read_overlay``, or what such a file holds as a dict:
    ``{"meta": {"bottom": "none"}}``. With the same ``seed`` and another fabric, or arms held otherwise, come the
    same patterns, draped otherwise. ``drape``: ``warp``, or ``None`` to stop at the box mesh; ``stage="pattern"`` stops
    before that. ``fields``: ``None`` for all that garments of the stage hold; ``dtype``: of the floating ones, float32
    by default, ``None`` for what a shard would store. Pictures are taken for a cache, or where ``fields`` have
    ``front``, ``back`` or, with checksums of all, ``meta``.

    ``device``: where cloth is draped: ``cpu``, ``cuda:0``, ``cuda:0,1``; ``auto`` is every GPU that torch sees, or the
    CPU. Under ``torchrun``, or where ``torch.distributed`` runs, ``auto`` is this rank's own GPU, and several GPUs are
    shared out among the ranks of this machine. On GPUs, workers of a ``DataLoader``, forked or spawned, make body,
    design, pattern and mesh, and two processes for each GPU drape for them; without workers a batch is draped together
    in this process, on the first GPU: one process prepares fewer garments than a GPU drapes. On a CPU each worker
    drapes its own.

    ``cache_dir``: keeps every garment made there, and reads it from there the next time. Each seed, recipe and version
    of this package has a folder of its own in it, ``cache``, which is a data set for ``GarmentDataset``, ``gcd verify``
    or ``gcd publish``. Any number of workers and processes may share it; a damaged garment is made again.

    Where a garment takes seconds, as a drape does on a CPU, a line of the logger ``gcd_dataset`` says so once.

    Raises ``ConfigError`` for options that do not fit together, fields that come with a later stage, and more ranks
    than GPUs; a GPU that is not there is told with the first garment. ``DrapeError`` where a draping process ends: the
    garments asked for next start another.
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
        self._n, self._seed = natural("n", n), natural("seed", seed)
        require_options(options, MakeConfig)
        options["device"] = _named(options.get("device", "auto"))
        self.config = MakeConfig(stage=_last_stage(drape, stage), design=_overlay(design), **options)
        empty = [] if self.config.picture else ["front", "back"]
        super().__init__(fields, transform, lacking=lacking_at(self.config.stage, empty), dtype=dtype)
        self.together = self.config.wearers
        self._recipe = recipe_of(self.config)
        # Named here, so that all workers meet in these places, which end with this process, not with one of them.
        self._places = addresses_for(named_devices(self.config.device) if self.config.stage == "drape" else ["cpu"])
        self.cache = None if cache_dir is None else user_path(cache_dir) / self._cache_name
        """The folder of this seed, recipe and version in ``cache_dir``."""
        self._kept = (
            None if self.cache is None else SampleCache(self.cache, self._n, seed=self._seed, recipe=self._recipe)
        )
        self._last = LastDesign()
        self._process = os.getpid()
        self._wait_told = False

    def __len__(self) -> int:
        return self._n

    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions that garment ``index`` is made with. Raises ``IndexError``."""
        position = self._position(index)
        return {"seed": self._seed, "index": position, "recipe": dict(self._recipe), "versions": versions()}

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` unless garment ``index``, made anew, is the one in the cache, or the one made before."""
        position = self._position(index)
        before = None if self._kept is None else self._kept.read(position)
        before, now = before or self._made(position), self._made(position)
        for member, data in now.items():
            if data != before[member]:
                raise ShardError(f"{key_of(position)}, member {member}: comes out different when it is made again")

    def pack(self) -> None:
        """Write garments of the cache that wait for others of their shard into shards all the same.

        With every garment made this has been done; before, ``cache`` is a data set of whole shards alone.
        """
        if self._kept is None:
            raise ConfigError("nothing is kept: give cache_dir")
        self._kept.pack()

    def tell_wait(self) -> None:
        """Log, once, how long a garment takes to make here, unless some may lie in the cache."""
        if self.cache is None or not self.cache.exists():
            self._tell_wait()

    def _tell_wait(self) -> None:
        worker = get_worker_info()
        if not self._wait_told and (worker is None or worker.id == 0):
            self._wait_told = True
            tell_wait(self.config)

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Several garments at once; a ``DataLoader`` calls this for a batch."""
        positions = [self._position(index) for index in indices]
        return [self._item(*entry) for entry in zip(self._several(positions), positions, strict=True)]

    def stream(self, indices: Iterable[int]) -> Iterator[Any]:
        """Stream garments; ``indices`` may be infinite. On a GPU the next are made while one is handed out.

        Several GPUs are kept busy by several streams, each in a worker: a stream is draped on one of them.
        """
        positions = (self._position(index) for index in indices)
        if self._place is None:
            return (self._item(self._several([position])[0], position) for position in positions)
        begun: deque[int] = deque()

        def noted() -> Iterator[int]:
            for position in positions:
                begun.append(position)
                yield position

        made = self._produced(noted(), ahead=AHEAD)
        if get_worker_info() is None:  # the thread of a worker is that of ``FreshGarments``
            made = prefetch(made, READY)
        return (self._item(members, begun.popleft()) for members in made)

    def _several(self, positions: Sequence[int]) -> list[Mapping[str, Bytes]]:
        return list(self._produced(positions))

    def _produced(self, positions: Iterable[int], *, ahead: int | None = None) -> Iterator[Mapping[str, Bytes]]:
        """Garments of the cache or made now; by the draper of the device where this process must not drape."""
        apart = ahead is not None or self._apart
        options = {"finished": self._encoded, "known": self._known, "last": self._last, "pictured": self._pictured}
        return self._by(apart, positions, ahead=ahead, **options)

    def _by(self, apart: bool, positions: Iterable[int], **options: Any) -> Iterator[Mapping[str, Bytes]]:
        with ExitStack() as opened:
            draper = None
            if apart and (place := self._place) is not None:
                draper = opened.enter_context(SharedDraper(place))
            yield from produce(self._seed, positions, self.config, draper=draper, **options)

    @property
    def _place(self) -> DraperAddress | None:
        """Where garments that another process drapes are draped: workers have the places by turns."""
        worker = get_worker_info()
        return self._places[(0 if worker is None else worker.id) % len(self._places)]

    @property
    def _pictured(self) -> bool:
        """Whether anybody sees the pictures, or their checksums in ``meta``: on a CPU they take a second."""
        return self._kept is not None or not {"front", "back", "meta"}.isdisjoint(self.fields)

    @property
    def _apart(self) -> bool:
        """Whether another process has to drape: CUDA does not survive a fork, and each context of it takes memory."""
        elsewhere = get_worker_info() is not None or os.getpid() != self._process
        return self._place is not None and elsewhere

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        return self._several([position])[0]

    def _made(self, position: int) -> Mapping[str, Bytes]:
        """A garment made anew, whatever is in the cache."""
        self._tell_wait()
        return next(self._by(self._apart, [position], finished=encode_sample, pictured=self._pictured))

    def _encoded(self, sample: Sample) -> Mapping[str, Bytes]:
        return self._keep(sample.provenance.index, encode_sample(sample))

    def _keep(self, position: int, members: Mapping[str, Bytes]) -> Mapping[str, Bytes]:
        if self._kept is not None:
            self._kept.keep(position, members)
        return members

    def _known(self, position: int) -> Mapping[str, Bytes] | None:
        """What an item needs of the garment in the cache, if it is there and whole."""
        members = None
        try:
            if self._kept is not None:
                members = self._kept.read(position, members_of(self.fields))
        except ShardError as error:
            logger.warning("%s; it is made again", error)
        if members is None:
            self._tell_wait()
        return members

    def _described(self) -> list[str]:
        return [f"seed {self._seed}", f"stage {self.config.stage} on {self.config.device}"]

    @property
    def _cache_name(self) -> str:
        """The cache's folder for this seed, recipe, version and schema: no garment is ever taken for one of another."""
        return f"{__version__}-{SCHEMA}-seed{self._seed}-{recipe_hash(self._recipe)[:16]}"

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._process = os.getpid()  # unpickled: spawned, not forked


def _overlay(design: Overlay | Mapping[str, Any] | None) -> Overlay:
    """What designs are narrowed to. Raises ``ConfigError`` with the name that no parameter has, and one like it."""
    if design is None:
        return NO_OVERLAY
    if isinstance(design, Overlay):
        return design
    if isinstance(design, Mapping):
        return Overlay.from_dict(design)
    raise ConfigError(
        f'design={design!r:.99}: give a dict such as {{"meta": {{"bottom": "none"}}}}, or read_overlay(FILE)'
    )


def _named(device: str) -> str:
    """The devices by name, without ``auto``: those of this rank, if it is one of several. Raises ``ConfigError``."""
    if not isinstance(device, str):
        raise ConfigError(f"device={device!r:.99}: give a name, such as auto, cpu or cuda:0")
    # Only what torch can tell without CUDA: to start that here would end it in workers forked later.
    count = torch.cuda.device_count()
    own = own_gpu(count) if count and device in ("auto", "cuda") else None
    if own is not None:
        return f"cuda:{own}"
    if device != "auto":
        return devices_name(own_gpus(named_devices(device)))
    return devices_name([f"cuda:{number}" for number in range(count)] or ["cpu"])


def _last_stage(drape: str | None, stage: Stage | None) -> Stage:
    """The last step taken. Raises ``ConfigError`` for what is not there, or contradicts itself."""
    if drape not in ("warp", None):
        raise ConfigError(f"drape={drape!r}: there is 'warp', and None to stop at the box mesh")
    if drape is None and stage == "drape":
        raise ConfigError("drape=None and stage='drape': leave one of them out")
    return stage or ("mesh" if drape is None else "drape")
