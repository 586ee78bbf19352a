"""Exporting a data set to other formats: HDF5, plain tars, or the published folder layout."""

import io
from collections.abc import Generator, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from gcd_dataset.errors import ConfigError, did_you_mean
from gcd_dataset.files import make_folder, open_whole
from gcd_dataset.making.progress import Progress, ProgressCallback, ignore_progress
from gcd_dataset.shards.codec import WIDTHS, decode_fields
from gcd_dataset.shards.layout import Bytes, fields_of, member_name
from gcd_dataset.shards.tar import END, tar_entry

if TYPE_CHECKING:
    from gcd_dataset.shards.reader import ShardReader

Form = Literal["hdf5", "plain", "published"]
HDF5 = (".h5", ".hdf5")
SAMPLES = 256  # of a plain tar


def export(
    dataset: Path | str,
    out: Path | str,
    form: Form = "hdf5",
    *,
    split: str | None = None,
    on_progress: ProgressCallback = ignore_progress,
) -> Progress:
    """Export a folder of shards to ``out``.

    ``hdf5``: one split, by default ``train``, as one file. ``plain``: one split as tars of ``.npy`` files, texts and
    pictures in the folder ``out``. ``published``: train, validation and test in the folders of GarmentCodeData; ``out``
    is created if missing, and a stopped export is resumed. Raises ``ConfigError`` for an unknown form or split,
    ``ShardError`` for a data set that cannot be read, ``OutputError`` if ``out`` cannot be written.
    """
    if form not in get_args(Form):
        known = get_args(Form)
        raise ConfigError(f"no form {form}: choose from {', '.join(known)}{did_you_mean(form, known)}")
    opened = _to_published if form == "published" else partial(_split, form)
    progress, steps = opened(Path(dataset), Path(out), split)
    on_progress(progress)
    for _ in steps:
        progress = progress.with_made()
        on_progress(progress)
    return progress


def _split(form: Form, folder: Path, out: Path, split: str | None) -> tuple[Progress, Iterator[Any]]:
    """How much there is to export of a split as HDF5 or as plain tars, and the export, which yields for each sample."""
    from gcd_dataset.shards import ShardReader
    from gcd_dataset.shards.hdf5 import write_hdf5

    is_inside = out.resolve().is_relative_to(folder.resolve()) and out.suffix not in HDF5
    if form == "hdf5" and is_inside:
        raise ConfigError(
            f"{out}: in the folder of the data set itself: end its name in {HDF5[0]}, or choose another folder"
        )
    if form == "plain" and is_inside:
        raise ConfigError(f"{out}: in the folder of the data set itself: choose another folder")
    reader = ShardReader(folder, "train" if split is None else split)
    steps = write_hdf5(reader, out) if form == "hdf5" else write_plain(reader, out)
    return Progress(len(reader), 0, split=reader.split), steps


def _to_published(folder: Path, out: Path, split: str | None) -> tuple[Progress, Iterator[Any]]:
    from gcd_dataset.exports.published import export_published, exported_splits

    if split is not None:
        raise ConfigError(
            "split is for hdf5 and plain: the published layout takes train, validation and test, and lists them in its "
            "split file"
        )
    readers = exported_splits(folder)
    total = sum(map(len, readers.values()))
    return Progress(total, 0, split=", ".join(readers)), export_published(readers, out)


def write_plain(reader: "ShardReader", folder: Path | str) -> Generator[int, None, None]:
    """Write a split as ``train-00000.tar``, …, yielding the position of each sample once it is written.

    A tar appears under its name when it is complete. Raises ``OutputError``, and ``ShardError`` for a damaged sample.
    """
    folder = make_folder(folder)
    for first in range(0, len(reader), SAMPLES):
        with open_whole(folder / f"{reader.split}-{first // SAMPLES:05d}.tar") as tar:
            for position in range(first, min(first + SAMPLES, len(reader))):
                with reader.naming(position):
                    members = _plain(reader.read(position, reader.layout.members))
                for member, data in members.items():
                    tar.write(tar_entry(member_name(reader.number(position), member), data))
                yield position
            tar.write(bytes(END))


def _plain(members: Mapping[str, Bytes]) -> dict[str, Bytes]:
    """Texts and pictures as they are, and arrays as ``FIELD.npy``."""
    arrays = decode_fields(members, [field for field in fields_of(members) if field in WIDTHS])
    others = {member: data for member, data in members.items() if not member.endswith(".z")}
    return {**others, **{f"{field}.npy": _npy(array) for field, array in arrays.items()}}


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array(file, np.ascontiguousarray(array), version=(1, 0), allow_pickle=False)
    return file.getvalue()
