"""Data sets on disk: tars of compact members, JSON and pictures, with an index for random access.

The same tars are read by ``webdataset`` and by ``datasets.load_dataset("webdataset", …)``.
"""

from typing import TYPE_CHECKING

from gcd_dataset.lazy import lazy_names
from gcd_dataset.shards.codec import decode_fields, decode_sample, encode_sample
from gcd_dataset.shards.index import SplitIndex
from gcd_dataset.shards.layout import BODIES, FIELDS, GARMENTS, MEMBERS, SCHEMA, Layout
from gcd_dataset.shards.manifest import Manifest, Plan, ShardRecord, SplitRecord, read_manifest
from gcd_dataset.shards.motion import decode_motion, encode_motion

if TYPE_CHECKING:
    from gcd_dataset.shards.reader import ShardReader
    from gcd_dataset.shards.writer import ShardWriter

__all__ = [
    "BODIES", "FIELDS", "GARMENTS", "MEMBERS", "SCHEMA", "Layout", "Manifest", "Plan", "ShardReader", "ShardRecord",
    "ShardWriter", "SplitIndex", "SplitRecord", "decode_fields", "decode_motion", "decode_sample", "encode_motion",
    "encode_sample", "read_manifest",
]  # fmt: skip

__getattr__, __dir__ = lazy_names(__name__)
