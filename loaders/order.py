"""The order in which garments come: a pure function of seed, epoch and position, shared out over any number of ranks.

A position counts the garments that all ranks together have received since the first epoch began; epoch ``e`` is the
positions from ``e * n`` on. What comes at a position depends on neither ranks, workers nor batch size, so one integer
is all that has to be kept to go on later, with other ones too.
"""

import math
from collections.abc import Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np
from torch.utils.data import DistributedSampler

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Garments, natural
from gcd_dataset.loaders.ranks import present_rank, require_rank, shared_out_by
from gcd_dataset.loaders.states import named, position_of

__all__ = ["ElasticSampler", "Pad", "Permutation", "RankShare", "SampleOrder", "permutation"]

Pad = Literal["none", "repeat"]

ROUNDS = 8  # of the network: half of them change a number's left part, half its right
WORD = (1 << 64) - 1
AT_ONCE = 1024  # garments of a rank whose numbers are worked out together


class Permutation:
    """A permutation of 0 … ``length`` - 1 chosen by some numbers, without a table of it.

    >>> shuffled = Permutation(5, 0, 7)
    >>> [shuffled(place) for place in range(5)]
    [1, 0, 2, 4, 3]

    A Feistel network over the smallest grid of about √length × √length that holds all numbers, walked on from numbers
    beyond ``length`` (Black and Rogaway, Ciphers with Arbitrary Finite Domains, CT-RSA 2002). NumPy's own
    ``permutation`` may change with its releases, and a stored position must not then mean another garment.
    """

    def __init__(self, length: int, *key: int) -> None:
        self.length = length
        self._rows = math.isqrt(length - 1) + 1
        self._columns = -(-length // self._rows)
        keys = np.random.SeedSequence(key).generate_state(ROUNDS, np.uint64).tolist()
        self._rounds = tuple(zip(keys[::2], keys[1::2], strict=True))

    def __call__(self, place: int) -> int:
        while (place := self._walked(place)) >= self.length:
            pass
        return place

    def of(self, places: Sequence[int]) -> list[int]:
        """The same for several places: a thousand take little longer than twenty do one by one."""
        found = np.asarray(places, np.uint64)
        beyond = np.arange(len(found))
        while len(beyond):
            found[beyond] = self._walked(found[beyond])
            beyond = beyond[found[beyond] >= self.length]
        return found.tolist()

    def _walked(self, place: Any) -> Any:
        """A number of the grid, or each of an array of them."""
        row, column = divmod(place, self._columns)
        for first, second in self._rounds:
            row = (row + _scrambled(column + first)) % self._rows
            column = (column + _scrambled(row + second)) % self._columns
        return row * self._columns + column


permutation = lru_cache(maxsize=64)(Permutation)
"""The same, kept for the next place."""


def _scrambled(number: Any) -> Any:
    """A word in which every bit depends on every bit of ``number``: that is how SplitMix64 ends (Steele 2014)."""
    number = number & WORD  # words of an array begin again by themselves
    number = ((number ^ number >> 30) * 0xBF58476D1CE4E5B9) & WORD
    number = ((number ^ number >> 27) * 0x94D049BB133111EB) & WORD
    return number ^ number >> 31


class SampleOrder:
    """Which garment comes at which position: all of an epoch, then those of the next in another order.

    ``shuffle``: by chance, named by ``seed``; otherwise as they are numbered. A data set with an order of its own, as
    ``MixedDataset`` is one, comes in that. Raises ``ConfigError`` for a data set without garments.
    """

    def __init__(self, dataset: Sized, *, shuffle: bool, seed: int) -> None:
        self.length, self.shuffle, self.seed = len(dataset), shuffle, natural("seed", seed)
        if not self.length:
            raise ConfigError("a data set without garments has no order: give one with 1 or more")
        self._as_it_comes = isinstance(dataset, Garments) and dataset.endless
        self._dataset = named(dataset)

    def __getitem__(self, position: int) -> int:
        """The number of the garment at a position."""
        if self._as_it_comes:
            return position
        epoch, place = divmod(position, self.length)
        return permutation(self.length, self.seed, epoch)(place) if self.shuffle else place

    def numbers(self, positions: Sequence[int]) -> list[int]:
        """The numbers of the garments at some positions of one epoch."""
        if self._as_it_comes or not self.shuffle or not len(positions):
            return [self[position] for position in positions]
        epoch = positions[0] // self.length
        return permutation(self.length, self.seed, epoch).of([place - epoch * self.length for place in positions])

    def epoch(self, position: int) -> int:
        """The epoch that a position is in."""
        return position // self.length

    def end(self, position: int) -> int:
        """Where the epoch of a position ends and the next begins."""
        return (self.epoch(position) + 1) * self.length

    def anew(self, position: int) -> int:
        """Where a pass begins that goes on with nothing: the epoch after one that was broken off."""
        return self.end(position - 1)

    def state(self, position: int) -> dict[str, Any]:
        """A position, with all that says whose order it is one of."""
        return {"position": position, **self._names(), **self._dataset}

    def position_of(self, state: Mapping[str, Any]) -> int:
        """The position in a state. Raises ``ConfigError`` for the state of another order, and for none."""
        return position_of(state, self._names(), self._dataset)

    def _names(self) -> dict[str, Any]:
        return {"seed": self.seed, "shuffle": self.shuffle, "length": self.length}


@dataclass(frozen=True)
class RankShare:
    """An order shared out among ranks, and the part of one of them."""

    order: SampleOrder
    rank: int
    world_size: int
    pad: Pad
    among: int = 1
    """Ranks among which somebody else shares out what this one gets."""

    def begin(self, position: int) -> int:
        """Where to go on: the next epoch if what is left of this one is not enough for every rank."""
        return position if self.share(position) else self.order.end(position)

    def share(self, position: int) -> range:
        """The positions of this rank from there to the end of the epoch, and beyond it for those that fill up."""
        left = self.order.end(position) - position
        own = -(-left // self.world_size) if self.pad == "repeat" else left // self.world_size
        return range(position + self.rank, position + self.rank + own * self.world_size, self.world_size)

    def after(self, begun: int, received: int) -> int:
        """The position after every rank has received that many garments."""
        received *= self.among
        done = received >= len(self.share(begun))
        return self.order.end(begun) if done else begun + received * self.world_size

    def garments(self, begun: int) -> Iterator[int]:
        """The numbers of this rank's garments; behind the epoch that was begun follow its first garments."""
        length, share = self.order.length, self.share(begun)
        first = self.order.end(begun) - length
        for cut in range(0, len(share), AT_ONCE):
            yield from self.order.numbers([first + (place - first) % length for place in share[cut : cut + AT_ONCE]])


class ElasticSampler(DistributedSampler[int]):
    """This rank's garments of an epoch, for a plain ``DataLoader``; the next time those of the next epoch.

    >>> from gcd_dataset.loaders import FakeGarments
    >>> [list(ElasticSampler(FakeGarments(7), rank=rank, world_size=2)) for rank in (0, 1)]
    [[1, 0, 2], [3, 6, 4]]

    Ranks take turns, so that the first garments of all ranks together are the first of the order, whatever their
    number. ``rank`` and ``world_size``, where they are not given, are looked up by ``len()`` and ``iter()``: those of
    ``torch.distributed`` where it runs, else of the environment that ``torchrun`` sets, else 0 and 1. ``pad``: what
    happens at the end of an epoch to fewer garments than ranks: with ``none`` they are left out, so that all ranks get
    equally many, and with ``repeat`` the first garments of the epoch fill up.

    Lightning takes it for the ``DistributedSampler`` that it is and puts none of its own in its place. A loader that
    ``accelerate`` has prepared shares out garments itself: it gets all of them.

    ``iter()`` begins an epoch: the next one too after a loop that broke off, and after ``load_state_dict`` the rest of
    that of the state. ``set_epoch`` chooses the epoch that the next ``iter()`` begins.

    The state counts garments as they are handed to the ``DataLoader``; worker processes ask ahead of the training loop,
    which then has to say how many it has ``received``. Raises ``ConfigError`` for ranks that cannot be.
    """

    def __init__(
        self,
        dataset: Sized,
        *,
        shuffle: bool = True,
        seed: int = 0,
        rank: int | None = None,
        world_size: int | None = None,
        pad: Pad = "none",
    ) -> None:
        # Not that of ``DistributedSampler``, which asks for the rank at once.
        if pad not in get_args(Pad):
            raise ConfigError(f"pad={pad!r}: there is {', '.join(get_args(Pad))}")
        self.order = SampleOrder(dataset, shuffle=shuffle, seed=seed)
        self.pad, self._given = pad, require_rank(rank, world_size)
        self._division = self.division() if self._given else None
        self.position = self._begun = self._first_epoch = 0
        self._loaded = False

    @property
    def rank(self) -> int:  # type: ignore[override]
        """This rank, from 0, as things stand now."""
        return self.division().rank

    @property
    def world_size(self) -> int:
        """How many ranks there are, as things stand now."""
        return self.division().world_size

    num_replicas = world_size  # what ``DistributedSampler`` calls it

    @property
    def epoch(self) -> int:  # type: ignore[override]
        """The epoch of the next garment, from 0."""
        return self.order.epoch(self.position)

    def division(self) -> RankShare:
        """How garments are shared out among ranks as things stand now. Raises ``ConfigError`` for too few of them."""
        library = shared_out_by()
        if library is None:
            division = RankShare(self.order, *(self._given or present_rank()), self.pad)
        elif self._given not in (None, (0, 1)):
            raise ConfigError(f"world_size={self._given[1]}: {library} shares out garments too: leave it out, and rank")
        else:
            division = RankShare(self.order, 0, 1, self.pad, among=present_rank()[1])
        if not division.share(0):
            raise ConfigError(
                f"{self.order.length} garments for {division.world_size} ranks: give pad='repeat', or fewer ranks"
            )
        return division

    def __len__(self) -> int:
        """This rank's garments in a whole epoch."""
        return len(self.division().share(0))

    def __iter__(self) -> Iterator[int]:
        self._division = division = self.division()
        self._begun = begun = division.begin(self.position if self._loaded else self.order.anew(self.position))
        return self._handed_out(division, begun)

    def set_epoch(self, epoch: int) -> None:
        """Have the next ``iter()`` begin that epoch.

        After ``load_state_dict`` the first epoch set is that of the state, and the next one that after it: a framework
        may count from 0 again.
        """
        epoch = natural("epoch", epoch)
        if self._loaded:
            self._first_epoch = self.epoch - epoch
        else:
            self.position = (self._first_epoch + epoch) * self.order.length

    def state_dict(self, received: int | None = None) -> dict[str, Any]:
        """Where the training loop has come to; ``received``: this rank's garments since the last ``iter()``."""
        if received is None:
            return self.order.state(self.position)
        division = self._division or self.division()
        return self.order.state(division.after(self._begun, natural("received", received)))

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from there at the next ``iter()``. Raises ``ConfigError`` for the state of another order."""
        self.position = self._begun = self.order.position_of(state)
        self._loaded, self._division = True, None

    def _handed_out(self, division: RankShare, begun: int) -> Iterator[int]:
        for count, number in enumerate(division.garments(begun), 1):
            self.position, self._loaded = division.after(begun, -(-count // division.among)), False
            yield number
