"""Garments made when they are asked for: the same index space, fields and bytes as a published data set."""

import logging
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import torch

from gcd_dataset import __version__
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.files import make_folder
from gcd_dataset.generator.garments.overlay import NO_OVERLAY, Overlay
from gcd_dataset.generator.pipeline import make_many
from gcd_dataset.generator.recipe import MakeConfig, recipe_of, versions
from gcd_dataset.loaders.base import Garments, Transform, natural
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.codec import encode_sample
from gcd_dataset.shards.layout import Bytes, key_of, recipe_hash
from gcd_dataset.shards.single import read_single, write_single

__all__ = ["GeneratedGarments"]

logger = logging.getLogger("gcd_dataset")


class GeneratedGarments(Garments):
    """Garments 0 … ``n`` - 1 of ``seed``, made on the spot: what ``gcd generate`` would have put into shards.

    >>> ds = GeneratedGarments(1000, drape=None, fields=("panels", "box"))  # doctest: +SKIP
    >>> ds[7]["box"].shape  # doctest: +SKIP
    torch.Size([9731, 3])

    ``bodies``, ``resolution`` [cm], ``fabric``, ``device``, ``on_fail`` and ``design`` are those of ``MakeConfig``; an
    overlay for ``design`` comes from ``read_overlay``. ``drape``: ``warp``, or ``None`` to stop at the box mesh.
    ``cache_dir``: keeps every garment made there, and reads it from there the next time; each seed, recipe and version
    of this package has a folder of its own in it, and a damaged garment is made again. On a GPU a batch that a
    ``DataLoader`` asks for is draped together, on a CPU one garment after the other.

    Raises ``ConfigError`` for options that do not fit together; a GPU that is not there is told with the first garment.
    """

    def __init__(
        self,
        n: int,
        seed: int = 0,
        *,
        bodies: Literal["neutral", "random", "female", "male", "both"] = "random",
        drape: Literal["warp"] | None = "warp",
        device: str = "auto",
        resolution: float = 1.0,
        fabric: str = "default",
        cache_dir: str | Path | None = None,
        on_fail: Literal["retry", "keep"] = "retry",
        transform: Transform | None = None,
        fields: Iterable[str] | None = None,
        design: Overlay | None = None,
    ) -> None:
        super().__init__(fields, transform)
        self._n, self._seed = natural("n", n), natural("seed", seed)
        # Its form alone: to ask for the device would start CUDA here, which workers forked later do not survive.
        if not (isinstance(device, str) and re.fullmatch(r"auto|cpu|cuda(:\d+)?", device)):
            raise ConfigError(f"device={device!r}: give auto, cpu, or a GPU as cuda:0")
        if drape not in ("warp", None):
            raise ConfigError(f"drape={drape!r}: there is 'warp', and None to stop at the box mesh")
        stage: Literal["mesh", "drape"] = "mesh" if drape is None else "drape"
        self.config = MakeConfig(
            bodies=bodies,
            stage=stage,
            resolution=resolution,
            device=device,
            on_fail=on_fail,
            design=design or NO_OVERLAY,
            fabric=fabric,
        )
        self._cache_dir = None if cache_dir is None else Path(cache_dir)
        # Asked here and not in a worker: a forked one may be told that there is no GPU, and would go on without.
        self._on_gpu = drape is not None and (
            device.startswith("cuda") or (device == "auto" and torch.cuda.device_count() > 0)
        )
        self._process = os.getpid()

    def __len__(self) -> int:
        return self._n

    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions that garment ``index`` is made with. Raises ``IndexError``."""
        position = self._position(index)
        return {
            "seed": self._seed,
            "index": position,
            "recipe": recipe_of(self.config),
            "versions": versions(),
        }

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` unless garment ``index``, made anew, is the one in the cache, or the one made before."""
        position = self._position(index)
        before, now = self._read(position) or self._kept([position])[0], self._made([position])[0]
        for member, data in now.items():
            if data != before[member]:
                raise ShardError(f"{key_of(position)}, member {member}: comes out different when it is made again")

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Several garments at once; a ``DataLoader`` calls this for a batch."""
        positions = [self._position(index) for index in indices]
        there = {position: self._cached(position) for position in positions}
        missing = [position for position, members in there.items() if members is None]
        made = dict(zip(missing, self._kept(missing), strict=True))
        return [self._item(there[position] or made[position]) for position in positions]

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        return self._cached(position) or self._kept([position])[0]

    def _kept(self, positions: Sequence[int]) -> list[dict[str, bytes]]:
        """Garments made, and put into the cache if there is one."""
        made = self._made(positions)
        for position, members in zip(positions, made, strict=True):
            if self._cache_dir is not None:
                path = self._cache_path(position)
                make_folder(path.parent)
                write_single(path, position, members)
        return made

    def _made(self, positions: Sequence[int]) -> list[dict[str, bytes]]:
        return [encode_sample(sample) for sample in make_many(self._seed, positions, self.config)]

    def _cached(self, position: int) -> Mapping[str, Bytes] | None:
        """The garment in the cache, if it is there and whole."""
        try:
            return self._read(position)
        except ShardError as error:
            logger.warning("%s; it is made again", error)
            return None

    def _read(self, position: int) -> Mapping[str, Bytes] | None:
        """The garment in the cache, if it is there. Raises ``ShardError`` for a damaged one."""
        self._require_no_fork()
        if self._cache_dir is None:
            return None
        path = self._cache_path(position)
        with reading(path):
            there = path.exists()
        return read_single(path) if there else None

    def _cache_path(self, position: int) -> Path:
        assert self._cache_dir is not None
        return self._cache_dir / self._cache_name / f"{key_of(position)}.tar"

    @property
    def _cache_name(self) -> str:
        """The cache's folder for this seed, recipe and version: no garment is ever taken for one of another."""
        return f"{__version__}-seed{self._seed}-{recipe_hash(recipe_of(self.config))[:16]}"

    def _require_no_fork(self) -> None:
        """Raise ``ConfigError`` where CUDA would be used in a forked process, which CUDA does not survive."""
        if self._on_gpu and os.getpid() != self._process:
            raise ConfigError(
                f"device={self.config.device!r} in a forked worker: give the DataLoader multiprocessing_context="
                "'spawn' or num_workers=0, or make garments with device='cpu'"
            )

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._process = os.getpid()  # unpickled: spawned, not forked
