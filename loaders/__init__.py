"""Garments and bodies for a ``torch.utils.data.DataLoader``: from shards, made on the spot, or as published."""

from gcd_dataset.loaders.base import Garments
from gcd_dataset.loaders.batches import PackedBatch, PaddedBatch
from gcd_dataset.loaders.body_datasets import Bodies, BodyDataset, PublishedBodies
from gcd_dataset.loaders.collate import collate_list, collate_packed, collate_padded
from gcd_dataset.loaders.fake import FakeGarments
from gcd_dataset.loaders.fresh import FreshGarments
from gcd_dataset.loaders.generated import GeneratedGarments
from gcd_dataset.loaders.graph import SeamGraph, mesh_edges, seam_graph, to_pyg
from gcd_dataset.loaders.hdf5 import Hdf5Garments
from gcd_dataset.loaders.loader import GarmentLoader
from gcd_dataset.loaders.mixed import MixedDataset
from gcd_dataset.loaders.order import ElasticSampler
from gcd_dataset.loaders.published import PublishedGarmentCodeData
from gcd_dataset.loaders.shards import GarmentDataset
from gcd_dataset.loaders.transforms import Augment, Augmented, Chain, PartialView, PointNoise, Yaw
from gcd_dataset.loaders.worker import begin_worker

__all__ = [
    "Augment",
    "Augmented",
    "Bodies",
    "BodyDataset",
    "Chain",
    "ElasticSampler",
    "FakeGarments",
    "FreshGarments",
    "GarmentDataset",
    "GarmentLoader",
    "Garments",
    "GeneratedGarments",
    "Hdf5Garments",
    "MixedDataset",
    "PackedBatch",
    "PaddedBatch",
    "PartialView",
    "PointNoise",
    "PublishedBodies",
    "PublishedGarmentCodeData",
    "SeamGraph",
    "Yaw",
    "begin_worker",
    "collate_list",
    "collate_packed",
    "collate_padded",
    "mesh_edges",
    "seam_graph",
    "to_pyg",
]
