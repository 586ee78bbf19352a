"""Data sets of garments and bodies, and a resumable loader for training.

From data set to batch:

1. A *data set* is a list of garments: ``ds[i]`` is an item, a dict of tensors. ``GarmentDataset`` and ``Hdf5Garments``
   read items from our formats, ``PublishedGarmentCodeData`` from the authors' files; ``GeneratedGarments`` makes them
   (``base.py``).
2. The *order* maps a position to an index: epoch ``e`` is the permutation of all indices keyed by ``(seed, e)``,
   computed without a table (``order.py``).
3. Each *rank* takes every ``world_size``-th position, so all ranks together always have a prefix of the order. The rank
   is looked up at each ``iter()`` (``ranks.py``).
4. The *cursor* is the position after the last batch that the training loop received, not the last one prefetched
   (``loader.py``).
5. With ``num_workers=0`` a *thread* of the training process prefetches stored garments. Generated garments and slow
   transforms need *worker processes*, those of a ``DataLoader``: a worker receives indices and epoch, and sends the
   batch, or the error as a value (``loader.py``, ``worker.py``).
6. A *transform*, then an ``augment``, changes the item; both may be users' code, and run with random streams seeded by
   seed, epoch and index (``loader.py``). *Collate* packs or pads the items (``batches.py``).
7. The *state* is the cursor, with seed, length and a hash of the data set, which must match on loading. Any number of
   ranks or workers and any batch size may resume from it (``states.py``).
8. *Views* are pictures rendered from items: in the workers on a CPU, otherwise from whole batches by threads of the
   training process, ahead of the loop (``views.py``).
9. *Pure functions*: the order depends on ``(seed, epoch)`` alone, augmentation, views, scans and sketches on
   ``(seed, epoch, index)``, a generated garment on its ``(seed, index)``. None depends on rank, worker, batch size or
   time. The same holds for ``FreshGarments``, which replays garments while new ones are made (``fresh.py``).
"""

from typing import TYPE_CHECKING

from gcd_dataset.lazy import lazy_names
from gcd_dataset.loaders.base import Garments
from gcd_dataset.loaders.batches import PackedBatch, PaddedBatch, collate_list, collate_packed, collate_padded
from gcd_dataset.loaders.fields import BodyFields, GarmentFields
from gcd_dataset.loaders.loader import GarmentLoader
from gcd_dataset.loaders.order import ElasticSampler
from gcd_dataset.loaders.shards import GarmentDataset
from gcd_dataset.loaders.worker import begin_worker

if TYPE_CHECKING:
    from gcd_dataset.loaders.body_datasets import Bodies, BodyDataset, PublishedBodies
    from gcd_dataset.loaders.fake import FakeGarments
    from gcd_dataset.loaders.fresh import FreshGarments
    from gcd_dataset.loaders.generated import GeneratedGarments
    from gcd_dataset.loaders.graph import SeamGraph, mesh_edges, seam_graph
    from gcd_dataset.loaders.hdf5 import Hdf5Garments
    from gcd_dataset.loaders.mixed import MixedDataset
    from gcd_dataset.loaders.published import PublishedGarmentCodeData
    from gcd_dataset.loaders.scenes import VIEW_FIELDS, Scan, Sketch
    from gcd_dataset.loaders.transforms import (
        Augment,
        Augmented,
        Chain,
        OutfitCloth,
        PartialView,
        PickCaption,
        PointNoise,
        Yaw,
    )
    from gcd_dataset.loaders.views import Views

__all__ = [
    "VIEW_FIELDS", "Augment", "Augmented", "Bodies", "BodyDataset", "BodyFields", "Chain", "ElasticSampler",
    "FakeGarments", "FreshGarments", "GarmentDataset", "GarmentFields", "GarmentLoader", "Garments",
    "GeneratedGarments", "Hdf5Garments", "MixedDataset", "OutfitCloth", "PackedBatch", "PaddedBatch", "PartialView",
    "PickCaption", "PointNoise", "PublishedBodies", "PublishedGarmentCodeData", "Scan", "SeamGraph", "Sketch", "Views",
    "Yaw", "begin_worker", "collate_list", "collate_packed", "collate_padded", "mesh_edges", "seam_graph",
]  # fmt: skip

__getattr__, __dir__ = lazy_names(__name__)
