"""Reads GarmentCodeData as published, and writes our garments in its layout."""

from gcd_dataset.release.batch_index import PublishedBatches
from gcd_dataset.release.body_folder import PublishedPeople
from gcd_dataset.release.garment_list import PublishedGarments
from gcd_dataset.release.pca import PcaShapes, read_pca
from gcd_dataset.release.read_garment import PublishedGarment

__all__ = ["PcaShapes", "PublishedBatches", "PublishedGarment", "PublishedGarments", "PublishedPeople", "read_pca"]
