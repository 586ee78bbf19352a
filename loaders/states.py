"""The state of a loader: a position, and the names by which that of another loader is found out."""

import hashlib
import json
import operator
import zlib
from collections.abc import Mapping, Sequence, Sized
from typing import Any

import numpy as np
from torch.utils.data import ConcatDataset, Subset

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Garments

__all__ = ["named", "position_of", "require_whole"]

MOST = 1 << 62  # garments since the first epoch: no length in Python is greater
LONGEST = 60  # characters of a value in a message


def named(dataset: object) -> dict[str, str]:
    """Entries of a state that name a data set: ``dataset`` for a comparison, and ``garments`` for people.

    Known are garments, data sets with ``identity()`` as theirs, and torch's ``Subset`` and ``ConcatDataset`` of them;
    of others the name of the class.
    """
    known = _identity(dataset)
    return {"dataset": known if isinstance(known, str) else _hash(known), "garments": _described(dataset, known)}


def position_of(state: Mapping[str, Any], names: Mapping[str, Any], dataset: Mapping[str, str]) -> int:
    """The position in a state of the same names and data set. Raises ``ConfigError`` for another state, and for none.

    >>> position_of({"position": 8, "seed": 0, "dataset": "Numbers"}, {"seed": 0}, {"dataset": "Numbers"})
    8
    """
    if not isinstance(state, Mapping):
        raise ConfigError(f"a state that is no dict but {_shown(state)}: give one that state_dict() has returned")
    missing = ({"position", "dataset"} | names.keys()) - state.keys()
    if missing:
        raise ConfigError(f"a state without {', '.join(sorted(missing))}: give one that state_dict() has returned")
    for name, value in names.items():
        if not _same(state[name], value):
            raise _foreign(name, _shown(state[name]), _shown(value))
    if not _same(state["dataset"], dataset["dataset"]):
        raise _foreign("dataset", _both(state), _both(dataset))
    return require_whole("position", state["position"])


def require_whole(name: str, value: Any) -> int:
    """An entry of a state that counts something. Raises ``ConfigError`` for one that does not."""
    number = _whole(value)
    if number is None or not 0 <= number < MOST:
        raise ConfigError(f"a state whose {name} is {_shown(value)}: give one that state_dict() has returned")
    return number


def _foreign(name: str, theirs: str, ours: str) -> ConfigError:
    return ConfigError(
        f"the state of another order: its {name} is {theirs}, and here it is {ours}: load it with the same data set, "
        "seed and shuffle"
    )


def _both(state: Mapping[str, Any]) -> str:
    """The data set of a state, for people and exactly."""
    exact = _shown(state["dataset"])
    return f"{state['garments']} ({exact})" if isinstance(state.get("garments"), str) else exact


def _same(value: Any, ours: Any) -> bool:
    """Whether an entry of a state is ours; it may be anything, an array too."""
    if isinstance(ours, int):
        return _whole(value) == ours
    return isinstance(value, type(ours)) and bool(value == ours)


def _whole(value: Any) -> int | None:
    try:
        return operator.index(value)
    except (TypeError, ValueError, RuntimeError):  # an array, a tensor of several
        return None


def _shown(value: Any) -> str:
    """A value on one line, not too long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}…"


def _hash(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def _identity(dataset: object) -> Any:
    """What tells a data set from another: of garments how they were made, wherever they lie."""
    if isinstance(dataset, Garments):
        return dataset.identity()
    kind = type(dataset).__qualname__
    if callable(told := getattr(dataset, "identity", None)):
        return {"class": kind, "identity": told()}
    if isinstance(dataset, Subset):
        return {"of": _identity(dataset.dataset), "chosen": _checksum(dataset.indices)}
    if isinstance(dataset, ConcatDataset):
        return {"joined": [_identity(part) for part in dataset.datasets]}
    return kind


def _checksum(indices: Sequence[int]) -> int:
    return zlib.crc32(np.asarray(indices, np.int64).tobytes())


def _described(dataset: object, known: Any) -> str:
    """A data set for people: its class, how many it holds, and from which garment to which."""
    try:
        count = f" of {len(dataset)}" if isinstance(dataset, Sized) else ""
    except TypeError:  # a stream that has no length
        count = ""
    told = known.get("identity", known) if isinstance(known, dict) else {}
    first, last = told.get("ends") or (None, None)
    if isinstance(first, Mapping) and isinstance(last, Mapping):
        return f"{type(dataset).__name__}{count}, seed {first['seed']}, numbers {first['index']} to {last['index']}"
    return f"{type(dataset).__name__}{count}{'' if first is None else f', {first} to {last}'}"
