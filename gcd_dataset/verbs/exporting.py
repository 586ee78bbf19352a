"""Exporting a data set to other formats: HDF5, plain tars, or the published folder layout."""

from functools import partial
from pathlib import Path
from typing import Literal, get_args

from gcd_dataset.errors import ConfigError, did_you_mean
from gcd_dataset.making.progress import Progress, ProgressCallback, ignore_progress

__all__ = ["Form", "export"]

Form = Literal["hdf5", "plain", "published"]
HDF5 = (".h5", ".hdf5")


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
    export = _to_published if form == "published" else partial(_split, form)
    return export(Path(dataset), Path(out), split, on_progress)


def _split(form: Form, folder: Path, out: Path, split: str | None, on_progress: ProgressCallback) -> Progress:
    """Export a split as HDF5, or as plain tars."""
    from gcd_dataset.shards import ShardReader
    from gcd_dataset.shards.hdf5 import write_hdf5
    from gcd_dataset.shards.plain import write_plain

    is_inside = out.resolve().is_relative_to(folder.resolve()) and out.suffix not in HDF5
    if form == "hdf5" and is_inside:
        raise ConfigError(
            f"{out}: in the folder of the data set itself: end its name in {HDF5[0]}, or choose another folder"
        )
    if form == "plain" and is_inside:
        raise ConfigError(f"{out}: in the folder of the data set itself: choose another folder")
    reader = ShardReader(folder, "train" if split is None else split)
    progress = Progress(len(reader), 0, split=reader.split)
    on_progress(progress)
    for _ in write_hdf5(reader, out) if form == "hdf5" else write_plain(reader, out):
        progress = progress.with_made()
        on_progress(progress)
    return progress


def _to_published(folder: Path, out: Path, split: str | None, on_progress: ProgressCallback) -> Progress:
    from gcd_dataset.verbs.release_folders import export_published, exported_splits

    if split is not None:
        raise ConfigError(
            "split is for hdf5 and plain: the published layout takes train, validation and test, and lists them in its "
            "split file"
        )
    readers = exported_splits(folder)
    progress = Progress(sum(map(len, readers.values())), 0, split=", ".join(readers))
    on_progress(progress)
    for _ in export_published(readers, out):
        progress = progress.with_made()
        on_progress(progress)
    return progress
