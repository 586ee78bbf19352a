"""``PublishedGarmentCodeData``: GarmentCodeData in its published files, with the items of the other data sets."""

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
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.drawing import jpeg_bytes
from gcd_dataset.generator.quality import sample_surface
from gcd_dataset.loaders.base import Garments, Transform, index_from_key
from gcd_dataset.loaders.fields import absent_at_stage
from gcd_dataset.records import Body, Drape, Measurements, Outcome, Pattern, Provenance, Sample
from gcd_dataset.release.batches import PublishedBatches
from gcd_dataset.release.bodies import published_body
from gcd_dataset.release.garment_list import PublishedGarments
from gcd_dataset.release.read_garment import PublishedGarment
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards.codec import encode_partial_sample, encode_sample
from gcd_dataset.shards.layout import MEMBERS, Bytes, key_of

LARGEST_PICTURE = 8192  # pixels per side; published pictures have 800
POINTS = 8192  # sampled points per garment, as in generated data sets
META, MEASURES = "meta.json", "measures.json"
MESH = ("spec", "sim", "box", "segmentation", "vertex_labels")
DRAPE = ("sim", "segmentation")
FILES: Mapping[str, tuple[str, ...]] = {
    META: (*MESH, "measures"),
    "spec.txt": ("spec",), "pattern.z": ("spec",), "design.txt": ("design",), "measures.json": ("measures",),
    "mesh.z": MESH, "verts.z": DRAPE, "points.z": DRAPE, "front.jpg": ("front",), "back.jpg": ("back",),
}  # fmt: skip
"""Member to the published files that it is made from."""
MEMBERS_FROM: Mapping[str, frozenset[str]] = {
    kind: frozenset(member for member, kinds in FILES.items() if kind in kinds)
    for kind in ("spec", "measures", "design", "box", "front", "back")
}
"""Published file to the members made from it."""


class PublishedGarmentCodeData(Garments):
    """GarmentCodeData, version 1 or 2, in its published folders and archives, unconverted.

    >>> ds = PublishedGarmentCodeData("GarmentCodeData_v2", "train", fields=("verts", "faces"))  # doctest: +SKIP
    >>> ds[0]["verts"].shape, ds.names[0]  # doctest: +SKIP
    (torch.Size([3549, 3]), 'garments_5000_0/default_body/rand_K3V9QX7T1B')

    ``root``: the folder that holds ``garments_5000_0`` and the other batches, or its parent; missing batches are left
    out. Or a ``PublishedBatches``, opened once for several splits; then ``bodies`` and ``cache_dir`` are its own.
    ``split``: ``train``, ``validation`` or ``test`` of the official split, or ``all`` garments on disk.
    ``bodies``: ``default``, ``random``, or ``both``: then a design's two garments are adjacent.
    ``fields``: the fields to read; other files are not opened.
    ``cache_dir``: folder for unpacked archives, by default beside them.

    An archive of 5 GB is scanned once, in a minute or two; from then on a garment in it is found in about 50 ms. For
    long trainings, extract the archives or convert them with ``gcd convert``.

    Items are those of ``GarmentDataset``, except:

    - failed garments, listed in the batch's ``dataset_properties``, are left out;
    - vertices are numbered as in segmentation and labels, not as in the ply files, which split them at seams;
    - ``uv`` is in the panels' planes [cm], not in the files' texture coordinates, whose scale is stored nowhere;
    - ``measures`` and ``design`` are as in the files, ``measures`` with GarmentCode's derived values, such as
      ``_leg_length``: data made with the authors' tools after the release has lost decimals there (171.99 became
      171.0); ``design`` keeps range and type of every parameter beside ``v``;
    - rotations are Rz Ry Rx, as in the authors' mesh generation;
    - there is no ``body``: ``meta["body"]`` is the wearer's name in ``PublishedBodies``. The authors lifted some bodies
      to stand on y = 0 before draping, and their garments with them;
    - ``front`` and ``back`` are composed on white and encoded as JPEG, like generated ones; ``meta["source"]`` holds
      batch and name;
    - counts in ``meta["drape"]`` are -1 if the properties lack them.

    Raises ``ConfigError`` for invalid options, ``ShardError`` for a folder without the layout or garments of the split,
    ``OutputError`` if an index cannot be written; items raise ``ShardError`` with the missing or invalid file.
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
        super().__init__(fields, transform, absent=absent_at_stage("drape", ["body"]), dtype=dtype)
        if not isinstance(root, PublishedBatches):
            root = PublishedBatches(root, bodies=bodies, cache_dir=cache_dir)
        self._garments = PublishedGarments(root, split)
        self._garments.require_any()

    @property
    def names(self) -> tuple[str, ...]:
        """Batch, body folder and name of all garments."""
        return tuple(map(str, self._garments.entries))

    def name(self, index: int) -> str:
        """Batch, body folder and name of garment ``index``. Raises ``IndexError``."""
        return str(self._garments.entries[self._position(index)])

    def number(self, index: int) -> int:
        """The number of garment ``index`` in converted shards, independent of other files. Raises ``IndexError``."""
        return self._garments.entries[self._position(index)].index

    @property
    def origin(self) -> dict[str, Any]:
        """Release and split that the garments are numbered by: the recipe of converted shards."""
        return {"published": self._garments.batches.release, "split_sha256": self._garments.split_sha256}

    def __len__(self) -> int:
        return len(self._garments)

    def recipe(self, index: int) -> dict[str, Any]:
        """Release and split of garment ``index``; it cannot be made again. Raises ``IndexError``."""
        made = self._provenance(self._position(index))
        return {"seed": made.seed, "index": made.index, "recipe": dict(made.recipe), "versions": dict(made.versions)}

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` unless all files of garment ``index`` exist and agree.

        The release has no checksums, so a plausible change of a number is not detected.
        """
        encode_sample(self.sample(index))

    def sample(self, index: int | str) -> Sample:
        """Garment ``index`` with everything published. Raises ``ShardError``, ``IndexError``."""
        position = self._position(index)
        return self._sample_of(self._garments.garment(position), position, MEMBERS)

    def body(self, index: int) -> Body:
        """The body that garment ``index`` was draped on. Raises ``BodyError`` where its mesh is not on disk.

        Of random bodies the release has the meshes in an archive of their own. The authors lifted some bodies, and
        their garments with them; here soles are at y = 0.
        """
        garment = self._garments.garment(self._position(index))
        return published_body(self._garments.batches.root, garment.body_name)

    def _description(self) -> list[str]:
        return [str(self._garments.batches.release)]

    def _find_key(self, key: str) -> int | None:
        number, entries = index_from_key(key), self._garments.entries
        return next((row for row, entry in enumerate(entries) if entry.index == number or str(entry) == key), None)

    def _key(self, position: int) -> str:
        return key_of(self._garments.entries[position].index)

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        garment = self._garments.garment(position)
        encoded = encode_partial_sample(self._sample_of(garment, position, members))
        # The file's own measures: the record would have fewer names, and angles in radians.
        return encoded | {MEASURES: json.dumps(garment.measures).encode()} if MEASURES in members else encoded

    def _sample_of(self, garment: PublishedGarment, position: int, members: Iterable[str]) -> Sample:
        """A garment; only the files for ``members`` are read."""
        wanted = set(members)
        garment.fetch({kind for member in wanted for kind in FILES[member]})
        provenance, with_meta, drape = self._provenance(position), META in wanted, None
        if with_meta:
            drape = garment.drape
        elif "verts.z" in wanted:  # the figures are in meta.json, which is not requested
            drape = Drape(garment.vertices, Outcome.SETTLED, 0, 0, 0, 1.0, 1.0)
        return Sample(
            key=key_of(provenance.index),
            provenance=replace(provenance, body_name=garment.body_name) if with_meta else provenance,
            pattern=garment.pattern if wanted & MEMBERS_FROM["spec"] else Pattern(garment.name, (), ()),
            measurements=garment.measurements if wanted & MEMBERS_FROM["measures"] else Measurements(),
            design=garment.design if wanted & MEMBERS_FROM["design"] else {},
            box_mesh=garment.box_mesh if wanted & MEMBERS_FROM["box"] else None,
            drape=drape,
            points=_points(garment, provenance.source) if wanted & {"points.z"} else None,
            gathers=_gathers(garment.pattern) if with_meta else (),
            front=_jpeg_on_white(garment, "front") if wanted & MEMBERS_FROM["front"] else None,
            back=_jpeg_on_white(garment, "back") if wanted & MEMBERS_FROM["back"] else None,
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


def _gathers(pattern: Pattern) -> tuple[float, ...]:
    """The gathers of each seam; empty for a pattern with an edge that cannot be drawn."""
    try:
        return pattern.gather_ratios()
    except PatternError:
        return ()


def _points(garment: PublishedGarment, source: str) -> Float[np.ndarray, "n 6"]:
    """Random points of the draped surface, seeded by release and name of the garment, so equal in every split."""
    random = rng(zlib.crc32(source.encode()), 0, Stage.POINTS)
    return sample_surface(garment.vertices, garment.faces, POINTS, random)


def _jpeg_on_white(garment: PublishedGarment, side: str) -> bytes:
    """A picture as JPEG, composed on white. Raises ``ShardError``."""
    try:
        with Image.open(io.BytesIO(garment.picture(side)), formats=["PNG"]) as image:
            if max(image.size) > LARGEST_PICTURE:
                raise ValueError(f"{image.width} by {image.height} pixels, more than {LARGEST_PICTURE}")
            picture = image.convert("RGBA")
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:  # SyntaxError: a broken PNG chunk
        raise garment.broken(side, f"not a picture ({error})") from error
    return jpeg_bytes(
        np.asarray(Image.alpha_composite(Image.new("RGBA", picture.size, "white"), picture).convert("RGB"))
    )
