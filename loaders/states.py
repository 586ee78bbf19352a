"""The state of a loader: a position, and entries that identify the order and data set that it belongs to."""

import hashlib
import json
import operator
import zlib
from collections.abc import Mapping, Sized
from typing import Any

import numpy as np
from torch.utils.data import ConcatDataset, Subset

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Garments

LARGEST_POSITION = 1 << 62  # Python's limit for a length
LONGEST_REPR = 60  # characters of a value in a message


def dataset_entries(dataset: object) -> dict[str, str]:
    """State entries that identify a data set: a hash as ``dataset``, and a description for messages as ``garments``.

    The hash covers garments, data sets with an ``identity()`` method, and torch's ``Subset`` and ``ConcatDataset`` of
    them; for any other data set ``dataset`` is the name of its class.
    """
    known = _identity(dataset)
    content = json.dumps(known, sort_keys=True).encode()
    exact = known if isinstance(known, str) else hashlib.sha256(content).hexdigest()[:16]
    return {"dataset": exact, "garments": _description(dataset, known)}


def position_in_state(state: Mapping[str, Any], order: Mapping[str, Any], dataset: Mapping[str, str]) -> int:
    """The position in a state. Raises ``ConfigError`` if it is not a state, or that of another order or data set.

    ``order``, ``dataset``: the entries that it must have.

    >>> position_in_state({"position": 8, "seed": 0, "dataset": "Numbers"}, {"seed": 0}, {"dataset": "Numbers"})
    8
    """
    if not isinstance(state, Mapping):
        raise ConfigError(f"state {_short_repr(state)} is not a dict: give one that state_dict() has returned")
    missing = ({"position", "dataset"} | order.keys()) - state.keys()
    if missing:
        raise ConfigError(f"the state has no {', '.join(sorted(missing))}: give one that state_dict() has returned")
    for name, value in order.items():
        if not _equals(state[name], value):
            raise _mismatch(name, _short_repr(state[name]), _short_repr(value))
    if not _equals(state["dataset"], dataset["dataset"]):
        raise _mismatch("dataset", _dataset_in_words(state), _dataset_in_words(dataset))
    number = _as_integer(state["position"])
    if number is None or not 0 <= number < LARGEST_POSITION:
        raise ConfigError(
            f"the state has position {_short_repr(state['position'])}, not a count: give one that state_dict() has "
            "returned"
        )
    return number


def _mismatch(name: str, theirs: str, ours: str) -> ConfigError:
    return ConfigError(
        f"the state of another order: its {name} is {theirs}, here it is {ours}: load it with the same data set, "
        "seed and shuffle"
    )


def _dataset_in_words(state: Mapping[str, Any]) -> str:
    """Description and hash of a state's data set, for a message."""
    exact = _short_repr(state["dataset"])
    return f"{state['garments']} ({exact})" if isinstance(state.get("garments"), str) else exact


def _equals(value: Any, ours: Any) -> bool:
    """Whether a state entry equals ours; it may be of any type, even an array."""
    if isinstance(ours, int):
        return _as_integer(value) == ours
    return isinstance(value, type(ours)) and bool(value == ours)


def _as_integer(value: Any) -> int | None:
    try:
        return operator.index(value)
    except (TypeError, ValueError, RuntimeError):  # e.g. an array or tensor of several elements
        return None


def _short_repr(value: Any) -> str:
    """The value's ``repr`` on one line, shortened."""
    text = " ".join(repr(value).split())
    return text if len(text) <= LONGEST_REPR else f"{text[:LONGEST_REPR]}…"


def _identity(dataset: object) -> Any:
    """JSON that identifies a data set, independent of its path; for an unknown class the name of the class."""
    if isinstance(dataset, Garments):
        return dataset.identity()
    kind = type(dataset).__qualname__
    if callable(identity := getattr(dataset, "identity", None)):
        return {"class": kind, "identity": identity()}
    if isinstance(dataset, Subset):
        chosen = zlib.crc32(np.asarray(dataset.indices, np.int64).tobytes())
        return {"of": _identity(dataset.dataset), "chosen": chosen}
    if isinstance(dataset, ConcatDataset):
        return {"joined": [_identity(part) for part in dataset.datasets]}
    return kind


def _description(dataset: object, known: Any) -> str:
    """A data set in words: class, length, and first and last garment."""
    try:
        count = f" of {len(dataset)}" if isinstance(dataset, Sized) else ""
    except TypeError:  # a stream without a length
        count = ""
    identity = known.get("identity", known) if isinstance(known, dict) else {}
    first, last = identity.get("ends") or (None, None)
    if isinstance(first, Mapping) and isinstance(last, Mapping):
        return f"{type(dataset).__name__}{count}, seed {first['seed']}, numbers {first['index']} to {last['index']}"
    return f"{type(dataset).__name__}{count}{'' if first is None else f', {first} to {last}'}"
