"""Data sets on disk: tars of plain arrays, JSON and pictures, with an index for random access.

The same tars are read by ``webdataset`` and by ``datasets.load_dataset("webdataset", …)``.
"""

from typing import TYPE_CHECKING

from gcd_dataset.lazy import lazy_names
from gcd_dataset.shards.codec import decode_fields, decode_sample, encode_sample
from gcd_dataset.shards.contents import read_index, rebuild_index
from gcd_dataset.shards.index import ShardIndex
from gcd_dataset.shards.layout import BODIES, FIELDS, GARMENTS, MEMBERS, SCHEMA, Layout
from gcd_dataset.shards.manifest import Manifest, ShardRecord, SplitRecord, read_manifest
from gcd_dataset.shards.reader import ShardReader

if TYPE_CHECKING:
    from gcd_dataset.shards.body_set import BodyWriter
    from gcd_dataset.shards.writer import ShardWriter

__all__ = [
    "BODIES",
    "FIELDS",
    "GARMENTS",
    "MEMBERS",
    "SCHEMA",
    "BodyWriter",
    "Layout",
    "Manifest",
    "ShardIndex",
    "ShardReader",
    "ShardRecord",
    "ShardWriter",
    "SplitRecord",
    "decode_fields",
    "decode_sample",
    "encode_sample",
    "read_index",
    "read_manifest",
    "rebuild_index",
]

_NAMES_OF_MODULE = {"body_set": ("BodyWriter",), "writer": ("ShardWriter",)}

__getattr__, __dir__ = lazy_names(__name__, _NAMES_OF_MODULE)
