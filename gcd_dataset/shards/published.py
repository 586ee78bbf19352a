"""Recognises folders in the published layout of GarmentCodeData: ``garments_5000_0/default_body`` and so on."""

import contextlib
from collections.abc import Mapping
from pathlib import Path

__all__ = ["BODY_FOLDERS", "find_batches", "is_batch", "is_published"]

BODY_FOLDERS: Mapping[str, str] = {"default": "default_body", "random": "random_body"}
"""Choice of ``bodies`` to the folder of a batch."""


def is_published(folder: Path) -> bool:
    """Whether a folder is GarmentCodeData as published, one of its batches, or the folder that holds it."""
    if folder.name in BODY_FOLDERS.values():
        return True
    with contextlib.suppress(OSError):
        return is_batch(folder) or find_batches(folder) is not None
    return False


def find_batches(folder: Path) -> Path | None:
    """The folder of the batches: ``folder`` or one of its subfolders; ``None`` without batches. Raises ``OSError``."""
    candidates = (folder, *sorted(inner for inner in folder.iterdir() if inner.is_dir()))
    return next((path for path in candidates if any(map(is_batch, path.iterdir()))), None)


def is_batch(folder: Path) -> bool:
    """Whether a folder is a batch of garments, such as ``garments_5000_0``."""
    return folder.is_dir() and any((folder / body_folder).is_dir() for body_folder in BODY_FOLDERS.values())
