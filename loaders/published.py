"""GarmentCodeData as its authors have published it, with the items of every other data set."""

import io
import json
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image

from gcd_dataset import __version__
from gcd_dataset.generator.drawing import jpeg_bytes
from gcd_dataset.generator.points import sample_surface
from gcd_dataset.loaders.available import lacking_at
from gcd_dataset.loaders.base import Garments, Transform
from gcd_dataset.loaders.indexing import number_in
from gcd_dataset.records import Drape, Measurements, Outcome, Pattern, Provenance, Sample
from gcd_dataset.release.batch_index import PublishedBatches
from gcd_dataset.release.garment_list import PublishedGarments
from gcd_dataset.release.read_garment import PublishedGarment
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards.codec import encode_partial_sample, encode_sample
from gcd_dataset.shards.layout import MEMBERS, Bytes, key_of

__all__ = ["PublishedGarmentCodeData"]

LARGEST_PICTURE = 8192  # pixels a side; published ones have 800
POINTS = 8192  # of a garment's surface, as in our own data sets
META, MEASURES = "meta.json", "measures.json"
MESH = ("spec", "sim", "box", "segmentation", "vertex_labels")
DRAPE = ("sim", "segmentation")
FILES: Mapping[str, tuple[str, ...]] = {
    META: (*MESH, "measures"),
    "spec.txt": ("spec",), "panels.npy": ("spec",), "edges.npy": ("spec",), "stitches.npy": ("spec",),
    "design.txt": ("design",), "measures.json": ("measures",), "body.npy": (),
    "faces.npy": MESH, "uv.npy": MESH, "panel_id.npy": MESH, "labels.npy": MESH, "seams.npy": MESH,
    "corners.npy": MESH, "uv_vertex.npy": MESH, "box.npy": MESH,
    "verts.npy": DRAPE, "points.npy": DRAPE, "front.jpg": ("front",), "back.jpg": ("back",),
}  # fmt: skip
"""Member of a sample to the published files that it is made from."""
NEED: Mapping[str, frozenset[str]] = {
    kind: frozenset(member for member, kinds in FILES.items() if kind in kinds)
    for kind in ("spec", "measures", "design", "box", "front", "back")
}
"""Published file to the members that take it."""


class PublishedGarmentCodeData(Garments):
    """GarmentCodeData, version 1 or 2, in the folders and archives in which it was published; nothing is converted.

    >>> ds = PublishedGarmentCodeData("GarmentCodeData_v2", "train", fields=("verts", "faces"))  # doctest: +SKIP
    >>> ds[0]["verts"].shape, ds.names[0]  # doctest: +SKIP
    (torch.Size([3549, 3]), 'garments_5000_0/default_body/rand_K3V9QX7T1B')

    ``root``: the folder with ``garments_5000_0`` and its like, or the one that holds it; batches that are not there are
    left out. Or ``PublishedBatches``, opened once for several splits, with ``bodies`` and ``cache_dir`` of their own.
    ``split``: ``train``, ``validation`` or ``test`` of the official split, or ``all`` of what is on disk. ``bodies``:
    ``default``, ``random``, or ``both``, where a design's two garments follow each other. ``fields``: what to read;
    nothing else is touched. ``cache_dir``: where the indices of archives are kept, by default beside them.

    An archive of 5 GB is read through once, in a minute or two; from then on a garment in it takes some 50 ms to reach.
    To train for long, extract the archives or ``gcd convert`` them.

    Items are those of ``GarmentDataset``, except:

    - failed garments, as ``dataset_properties`` of the batch names them, are left out;
    - vertices are numbered as in segmentation and labels, not as in the ply files, which split them at seams;
    - ``uv`` is in the panels' planes [cm], not in the files' texture coordinates, whose scale is stored nowhere;
    - ``measures`` and ``design`` are as they stand in the files, ``measures`` with what GarmentCode derives from them,
      such as ``_leg_length``: data made with the authors' tools after the release
      has lost decimals there (171.99 became 171.0); ``design`` keeps range and type of every parameter beside ``v``;
    - rotations are Rz Ry Rx, as they were meshed with;
    - there is no ``body``: ``meta["body"]`` says who wears the garment, and ``PublishedBodies`` knows them. Some bodies
      of the release were lifted to stand on y = 0 before draping, and their garments with them;
    - ``front`` and ``back`` are put on white and stored as JPEG, as ours are; ``meta["source"]`` tells batch and name;
    - counts in ``meta["drape"]`` are -1 where the properties do not tell them.

    Raises ``ConfigError`` for options that there are not, ``ShardError`` for a folder without the layout or garments of
    the split, ``OutputError`` where an index cannot be kept; items raise ``ShardError`` with the file that is missing
    or not as it should be.
    """

    reads_only = True

    def __init__(
        self,
        root: str | Path | PublishedBatches,
        split: str = "train",
        *,
        bodies: str = "both",
        fields: Iterable[str] | None = None,
        cache_dir: str | Path | None = None,
        transform: Transform | None = None,
        dtype: torch.dtype | None = torch.float32,
    ) -> None:
        super().__init__(fields, transform, lacking=lacking_at("drape", ["body"]), dtype=dtype)
        if not isinstance(root, PublishedBatches):
            root = PublishedBatches(root, bodies=bodies, cache_dir=cache_dir)
        self._garments = PublishedGarments(root, split)
        self._garments.require_any()

    @property
    def names(self) -> tuple[str, ...]:
        """Of all garments: batch, body folder and name."""
        return tuple(map(str, self._garments.entries))

    def name(self, index: int) -> str:
        """Of garment ``index``: batch, body folder and name. Raises ``IndexError``."""
        return str(self._garments.entries[self._position(index)])

    def number(self, index: int) -> int:
        """The number of garment ``index`` in shards: the same whatever else is on disk. Raises ``IndexError``."""
        return self._garments.entries[self._position(index)].index

    @property
    def origin(self) -> dict[str, Any]:
        """Which release and which split numbers the garments: the recipe of their shards."""
        return {"published": self._garments.batches.release, "split_sha256": self._garments.split_sha256}

    def __len__(self) -> int:
        return len(self._garments)

    def recipe(self, index: int) -> dict[str, Any]:
        """Release and split that garment ``index`` is from; nothing makes it again. Raises ``IndexError``."""
        made = self._provenance(self._position(index))
        return {"seed": made.seed, "index": made.index, "recipe": dict(made.recipe), "versions": dict(made.versions)}

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` unless all files of garment ``index`` are there and fit each other.

        The release holds no checksums, so that a number which was changed within reason is not found.
        """
        encode_sample(self.sample(index))

    def sample(self, index: int) -> Sample:
        """Garment ``index`` with everything that is published of it. Raises ``ShardError``, ``IndexError``."""
        return self._sample(self._position(index), MEMBERS)

    def _described(self) -> list[str]:
        return [str(self._garments.batches.release)]

    def _of_key(self, key: str) -> int | None:
        number, entries = number_in(key), self._garments.entries
        return next((row for row, entry in enumerate(entries) if entry.index == number or str(entry) == key), None)

    def _key(self, position: int) -> str:
        return key_of(self._garments.entries[position].index)

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        garment = self._garments.garment(position)
        encoded = encode_partial_sample(self._sample_of(garment, position, members))
        # Not those of the sample: a record holds the measures by name, angles in radians.
        return encoded | {MEASURES: json.dumps(garment.measures).encode()} if MEASURES in members else encoded

    def _sample(self, position: int, members: Iterable[str]) -> Sample:
        """A garment of which no more is read than ``members`` take."""
        return self._sample_of(self._garments.garment(position), position, members)

    def _sample_of(self, garment: PublishedGarment, position: int, members: Iterable[str]) -> Sample:
        wanted = set(members)
        garment.fetch({kind for member in wanted for kind in FILES[member]})
        provenance, told = self._provenance(position), META in wanted
        return Sample(
            key=key_of(provenance.index),
            provenance=replace(provenance, body_name=garment.body_name) if told else provenance,
            pattern=garment.pattern if wanted & NEED["spec"] else Pattern(garment.name, (), ()),
            measurements=garment.measurements if wanted & NEED["measures"] else Measurements(),
            design=garment.design if wanted & NEED["design"] else {},
            box_mesh=garment.box_mesh if wanted & NEED["box"] else None,
            drape=garment.drape if told else _at_rest(garment) if wanted & {"verts.npy"} else None,
            points=_points(garment, provenance.source) if wanted & {"points.npy"} else None,
            front=_on_white(garment, "front") if wanted & NEED["front"] else None,
            back=_on_white(garment, "back") if wanted & NEED["back"] else None,
        )

    def _provenance(self, position: int) -> Provenance:
        entry = self._garments.entries[position]
        return Provenance(
            seed=0,
            index=entry.index,
            versions={"gcd_dataset": __version__},
            recipe=self.origin,
            source=f"{self._garments.batches.release}/{entry}",
        )


def _at_rest(garment: PublishedGarment) -> Drape:
    """The vertices, with figures that nobody has asked for."""
    return Drape(garment.vertices, Outcome.SETTLED, 0, 0, 0, 1.0, 1.0)


def _points(garment: PublishedGarment, source: str) -> Float[np.ndarray, "n 6"]:
    """Points of the draped surface: the same for a garment of that name, whatever the split."""
    random = rng(zlib.crc32(source.encode()), 0, Stage.POINTS)
    return sample_surface(garment.vertices, garment.faces, POINTS, random)


def _on_white(garment: PublishedGarment, side: str) -> bytes:
    """A picture as JPEG, its background white where it had none. Raises ``ShardError``."""
    try:
        with Image.open(io.BytesIO(garment.picture(side)), formats=["PNG"]) as image:
            if max(image.size) > LARGEST_PICTURE:
                raise ValueError(f"{image.width} by {image.height} pixels, where {LARGEST_PICTURE} are read")
            cut_out = image.convert("RGBA")
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:  # the second for a broken chunk
        raise garment.broken(side, f"not a picture ({error})") from error
    return jpeg_bytes(
        np.asarray(Image.alpha_composite(Image.new("RGBA", cut_out.size, "white"), cut_out).convert("RGB"))
    )
