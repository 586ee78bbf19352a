"""Reads GarmentCodeData as published, and writes our garments in its layout."""

from typing import TYPE_CHECKING

from gcd_dataset.lazy import lazy_names

if TYPE_CHECKING:
    from gcd_dataset.release.batches import PublishedBatches
    from gcd_dataset.release.bodies import PublishedPeople
    from gcd_dataset.release.garment_list import PublishedGarments
    from gcd_dataset.release.read_garment import PublishedGarment

__all__ = ["PublishedBatches", "PublishedGarment", "PublishedGarments", "PublishedPeople"]

__getattr__, __dir__ = lazy_names(__name__)
