"""Reads GarmentCodeData as published, and writes our garments in its layout."""

from typing import TYPE_CHECKING

from gcd_dataset.lazy import lazy_names

if TYPE_CHECKING:
    from gcd_dataset.release.batch_index import PublishedBatches
    from gcd_dataset.release.body_folder import PublishedPeople
    from gcd_dataset.release.garment_list import PublishedGarments
    from gcd_dataset.release.pca import PcaShapes, read_pca
    from gcd_dataset.release.read_garment import PublishedGarment

__all__ = ["PcaShapes", "PublishedBatches", "PublishedGarment", "PublishedGarments", "PublishedPeople", "read_pca"]

_NAMES_OF_MODULE = {
    "batch_index": ("PublishedBatches",),
    "body_folder": ("PublishedPeople",),
    "garment_list": ("PublishedGarments",),
    "pca": ("PcaShapes", "read_pca"),
    "read_garment": ("PublishedGarment",),
}

__getattr__, __dir__ = lazy_names(__name__, _NAMES_OF_MODULE)
