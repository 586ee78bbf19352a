"""What the authors of GarmentCodeData have published, read as it is; and our own data in that layout."""

from gcd_dataset.release.batches import PublishedBatches
from gcd_dataset.release.bodies import PublishedPeople
from gcd_dataset.release.garment import PublishedGarment
from gcd_dataset.release.garments import PublishedGarments
from gcd_dataset.release.pca import PcaShapes, read_pca

__all__ = ["PcaShapes", "PublishedBatches", "PublishedGarment", "PublishedGarments", "PublishedPeople", "read_pca"]
