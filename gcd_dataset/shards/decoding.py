"""``decode``: samples of our tars as arrays, for ``webdataset`` and for ``datasets`` of Hugging Face."""

from collections.abc import Mapping
from typing import Any, overload

from gcd_dataset.errors import ShardError
from gcd_dataset.shards.codec import REMEDY, decode_fields
from gcd_dataset.shards.layout import ARRAYS, CAPTION, MEMBERS, Bytes, fields_of
from gcd_dataset.shards.sections import unpack

TEXTS = {*(member for member in MEMBERS if member.endswith((".json", ".txt"))), CAPTION}


@overload
def decode(sample: Mapping[str, Any], /) -> dict[str, Any]: ...
@overload
def decode(member: str, data: Bytes, /) -> Any: ...
def decode(sample: Any, data: Bytes | None = None, /) -> Any:
    """Decode a sample of our tars, or a member of it.

    >>> webdataset.WebDataset(tars).decode(decode)  # doctest: +SKIP
    >>> webdataset.WebDataset(tars).map(decode)  # doctest: +SKIP
    >>> datasets.load_dataset("webdataset", data_files=tars, streaming=True)["train"].map(decode)  # doctest: +SKIP

    A sample, member to bytes: returns its fields, see ``GarmentFields``: arrays, parsed JSON, text; ``faces``,
    ``panel_id`` and ``box`` included. Entries of the same names that are no bytes were decoded by the caller, and stay
    as they are. Other entries, such as pictures, are left out.

    A member, such as ``".verts.z"``, and its bytes: returns the fields in it as a dict; for JSON the parsed value, for
    a caption the text. For other members it returns ``None``, and webdataset asks the next handler: pictures are
    decoded by ``.decode(decode, "torchrgb")``. ``box`` needs two members, and is left out.

    Raises ``ShardError`` with the member's name for damaged content.
    """
    if data is None:
        return _decode_sample(sample)
    member = sample.removeprefix(".")
    if member in TEXTS:
        return next(iter(decode_fields({member: data}).values()))
    return _arrays({member: data}) if member.endswith(".z") else None


def _decode_sample(sample: Mapping[str, Any]) -> dict[str, Any]:
    values, encoded = dict[str, Any](), dict[str, Bytes]()
    for name in sample:
        if name not in TEXTS and not name.endswith(".z"):
            continue  # not even looked up: ``datasets`` would decode a picture
        value = sample[name]
        if isinstance(value, Bytes):
            encoded[name] = value
        elif name in TEXTS:
            values[fields_of([name]).popitem()[0]] = value
        else:
            values |= value or {}
    texts = {name: encoded.pop(name) for name in [*encoded] if name in TEXTS}
    return values | decode_fields(texts) | _arrays(encoded)


def _arrays(members: Mapping[str, Bytes]) -> dict[str, Any]:
    """The fields in ``.z`` members; the arrays of an unknown member, or one of a person, as they are stored."""
    garment = {member: data for member, data in members.items() if member in ARRAYS}
    fields = [field for field in fields_of(garment) if field != "box" or "pattern.z" in garment]
    values = decode_fields(garment, fields)
    for member in members.keys() - garment.keys():
        try:
            values |= unpack(members[member])
        except ShardError as error:
            raise ShardError(f"member {member}: {error}: {REMEDY}") from error
    return values
