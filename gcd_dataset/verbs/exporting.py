"""Exporting a data set to other formats: HDF5, or the published folder layout."""

from collections.abc import Callable
from pathlib import Path
from typing import Literal, get_args

from gcd_dataset.errors import ConfigError, did_you_mean
from gcd_dataset.making.progress import Progress, ProgressCallback, ignore_progress

__all__ = ["Form", "export"]

Form = Literal["hdf5", "published"]
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

    ``hdf5``: one split, by default ``train``, as one file. ``published``: train, validation and test in the folders of
    GarmentCodeData; ``out`` is created if missing, and a stopped export is resumed. Raises ``ConfigError`` for an
    unknown form or split, ``ShardError`` for a data set that cannot be read, ``OutputError`` if ``out`` cannot be
    written.
    """
    if form not in get_args(Form):
        known = get_args(Form)
        raise ConfigError(f"no form {form}: choose from {', '.join(known)}{did_you_mean(form, known)}")
    exporters: dict[Form, Callable[[Path, Path, str | None, ProgressCallback], Progress]] = {
        "hdf5": _to_hdf5,
        "published": _to_published,
    }
    return exporters[form](Path(dataset), Path(out), split, on_progress)


def _to_hdf5(folder: Path, out: Path, split: str | None, on_progress: ProgressCallback) -> Progress:
    from gcd_dataset.shards import ShardReader
    from gcd_dataset.shards.hdf5 import write_hdf5

    if out.resolve().is_relative_to(folder.resolve()) and out.suffix not in HDF5:
        raise ConfigError(
            f"{out}: in the folder of the data set itself: end its name in {HDF5[0]}, or choose another folder"
        )
    reader = ShardReader(folder, "train" if split is None else split)
    progress = Progress(len(reader), 0, split=reader.split)
    on_progress(progress)
    for _ in write_hdf5(reader, out):
        progress = progress.with_made()
        on_progress(progress)
    return progress


def _to_published(folder: Path, out: Path, split: str | None, on_progress: ProgressCallback) -> Progress:
    from gcd_dataset.verbs.release_folders import export_published, exported_splits

    if split is not None:
        raise ConfigError(
            "split is for hdf5: the published layout takes train, validation and test, and lists them in its split file"
        )
    readers = exported_splits(folder)
    progress = Progress(sum(map(len, readers.values())), 0, split=", ".join(readers))
    on_progress(progress)
    for _ in export_published(readers, out):
        progress = progress.with_made()
        on_progress(progress)
    return progress
