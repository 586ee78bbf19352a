"""Garments for a ``torch.utils.data.DataLoader``: from shards, made on the spot, or made up."""

from gcd_dataset.loaders.base import Garments
from gcd_dataset.loaders.collate import collate_list, collate_packed
from gcd_dataset.loaders.fake import FakeGarments
from gcd_dataset.loaders.generated import GeneratedGarments
from gcd_dataset.loaders.shards import GarmentDataset

__all__ = ["FakeGarments", "GarmentDataset", "Garments", "GeneratedGarments", "collate_list", "collate_packed"]
