"""What the authors of GarmentCodeData have published, read as it is."""

from gcd_dataset.release.bodies import PublishedPeople
from gcd_dataset.release.pca import PcaShapes, read_pca

__all__ = ["PcaShapes", "PublishedPeople", "read_pca"]
