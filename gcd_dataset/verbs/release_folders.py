"""A data set of ours in the folders of the published GarmentCodeData."""

import hashlib
import io
import json
import logging
import string
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from gcd_dataset import __version__
from gcd_dataset.errors import ShardError, shown
from gcd_dataset.files import write_whole
from gcd_dataset.generator.colours import INK, cloth_colour
from gcd_dataset.generator.drawing import draw_pattern, png_bytes
from gcd_dataset.generator.garments import design_from_dict
from gcd_dataset.generator.garments.design_file import design_tree
from gcd_dataset.generator.lay_plan import LayPlan, lay_out
from gcd_dataset.generator.svg import pattern_svg
from gcd_dataset.names import safe_name
from gcd_dataset.records import Outcome, Sample
from gcd_dataset.release.draft import ReleaseDraft, release_draft
from gcd_dataset.release.published_names import BODY_FOLDERS, DEFAULT_BODY, SPLIT_NAMES, properties_name
from gcd_dataset.release.write import FAIL_CLASSES, PatternDrawing, garment_files, yaml_bytes
from gcd_dataset.shards import ShardReader
from gcd_dataset.shards.contents import splits_in
from gcd_dataset.verbs.statistics import batch_properties, garment_type

__all__ = ["export_published", "exported_splits"]

logger = logging.getLogger("gcd_dataset")

BATCH = 5000  # designs
LETTERS = string.ascii_uppercase + string.digits
LETTERS_IN_NAME = 10
SPLIT_FILE = "GarmentCodeData_v2_official_train_valid_test_data_split.json"
TEXTURE = 15  # pixels a centimetre
LARGEST_TEXTURE = 2048  # pixels
CLOTH_OPACITY, OUTLINE = 166, 0.5  # of 255; cm


@dataclass(frozen=True)
class PublishedName:
    """What a garment is called there."""

    batch: str
    body_folder: str
    name: str
    body_sample: str | None

    @property
    def listed(self) -> str:
        """The entry of a split: designs are listed under the default body, whoever wears them."""
        return f"{self.batch}/{BODY_FOLDERS['default']}/{self.name}"


@dataclass
class _Batch:
    """What has been noted about the garments of one batch on one kind of body."""

    panels: dict[str, int] = field(default_factory=dict)
    types: dict[str, dict[str, Any]] = field(default_factory=dict)
    counts: dict[str, dict[str, int]] = field(default_factory=dict)
    fails: dict[str, str] = field(default_factory=dict)


def exported_splits(folder: Path | str) -> dict[str, ShardReader]:
    """The splits of a data set that have a name in the layout; others are told. Raises ``ShardError`` without any."""
    there = splits_in(folder)
    others = ", ".join(split for split in there if split not in SPLIT_NAMES)
    if others and not set(there) & set(SPLIT_NAMES):
        raise ShardError(
            f"{folder}: no split that the published layout has a name for: there is {others}: "
            "give --hdf5 FILE and --split"
        )
    if others:
        logger.warning("%s: left out: %s: the published layout has %s alone", folder, others, ", ".join(SPLIT_NAMES))
    return {split: ShardReader(folder, split) for split in SPLIT_NAMES if split in (there or ("train",))}


def export_published(readers: Mapping[str, ShardReader], out: Path | str) -> Generator[str, None, None]:
    """Write all garments, yielding the name of each; the split and the properties of the batches come last.

    Garments that came from a release keep their names. Ours are named by seed and design, 5,000 designs a batch; those
    on the neutral body go to ``default_body``. Those that did not settle are written too, and noted as failed, as the
    authors' tools do. The folder must be new or empty, or one where an earlier run with these garments was stopped:
    it goes on there. Raises ``ConfigError``, ``OutputError`` and ``ShardError``.
    """
    with release_draft(out, _told_apart(readers)) as draft:
        yield from _written(readers, draft)


def _told_apart(readers: Mapping[str, ShardReader]) -> str:
    """What tells these garments, and how they are written, from others."""
    contents = {}
    for split, reader in readers.items():
        table = reader.index.table
        contents[split] = hashlib.sha256(table.sample.tobytes() + table.crc.tobytes()).hexdigest()
    return json.dumps({"version": __version__, "contents": contents})


def _written(readers: Mapping[str, ShardReader], draft: ReleaseDraft) -> Iterator[str]:
    batches: dict[tuple[str, str], _Batch] = {}
    splits: dict[str, dict[str, None]] = {}
    first_batch = 0
    for split, reader in readers.items():
        listed = splits.setdefault(SPLIT_NAMES[split][0], {})
        last = 0
        for position in range(len(reader)):
            sample = reader.sample(position)
            place = _place(sample, split, first_batch)
            last = max(last, _design_number(sample))
            _write(sample, place, draft, batches.setdefault((place.batch, place.body_folder), _Batch()))
            if sample.drape is not None and sample.drape.outcome is Outcome.SETTLED:
                listed[place.listed] = None
            yield place.name
        first_batch += last // BATCH + 1
    for (batch, body_folder), noted in batches.items():
        tree = batch_properties(batch, noted.panels, noted.types, noted.counts, noted.fails)
        write_whole(draft.folder / batch / body_folder / properties_name(body_folder), yaml_bytes(tree))
    lists = {name: list(splits.get(name, {})) for name, *_ in SPLIT_NAMES.values()}
    write_whole(draft.folder / SPLIT_FILE, json.dumps(lists, indent=4).encode())


def _write(sample: Sample, place: PublishedName, draft: ReleaseDraft, noted: _Batch) -> None:
    tree, folder = _tree(sample), Path(place.batch, place.body_folder, "data", place.name)
    if not draft.holds(folder):
        files = garment_files(sample, place.name, tree, _drawn(sample), body_sample=place.body_sample)
        draft.put(folder, files)
    _note(sample, place.name, tree, noted)


def _note(sample: Sample, name: str, tree: Mapping[str, Any], noted: _Batch) -> None:
    drape, mesh = sample.drape, sample.box_mesh
    assert drape is not None
    assert mesh is not None
    noted.panels[name] = len(sample.pattern.panels)
    noted.types[name] = garment_type(tree)
    noted.counts[name] = {
        "fin_frame": drape.frames,
        "self_collisions": drape.self_crossings,
        "body_collisions": drape.body_crossings,
        "face_count": len(mesh.faces),
    }
    if drape.outcome is not Outcome.SETTLED:
        noted.fails[name] = FAIL_CLASSES[drape.outcome]


# --------------------------------------------------------------------------------------------------------------- names


def _place(sample: Sample, split: str, first_batch: int) -> PublishedName:
    made = sample.provenance
    if made.source:
        return _place_in_release(sample.key, made.source, made.body_name)
    number = _design_number(sample)
    batch, name = f"garments_{BATCH}_{first_batch + number // BATCH}", _name(f"{split}:{made.seed}:{number}")
    if made.body_name == "neutral":
        return PublishedName(batch, BODY_FOLDERS["default"], name, None)
    pose = "apart" if sample.shape is not None and sample.shape.legs_apart else "straight"
    return PublishedName(batch, BODY_FOLDERS["random"], name, f"{first_batch * BATCH + number:05d}_{pose}")


def _place_in_release(key: str, source: str, body_name: str) -> PublishedName:
    """The place that a garment had in its release, under names that lead nowhere else."""
    parts = source.rsplit("/", 3)
    if len(parts) != 4:
        raise ShardError(f"sample {key}: its meta.json has source {shown(source)}: give RELEASE/BATCH/BODIES/NAME")
    batch, body_folder, name = map(safe_name, parts[1:])
    return PublishedName(batch, body_folder, name, None if body_name == DEFAULT_BODY else body_name)


def _design_number(sample: Sample) -> int:
    """Of a design among those of its seed: with ``bodies="both"`` two samples are of one design.

    A design that several random bodies wear counts as several: the layout has one folder for random bodies.
    """
    made = sample.provenance
    if made.recipe.get("bodies_each", 1) > 1:
        return made.index
    return made.index // (2 if made.source or made.recipe.get("bodies") == "both" else 1)


def _name(design: str) -> str:
    """``rand_`` and ten letters, always the same for a design."""
    number = int.from_bytes(hashlib.sha256(design.encode()).digest(), "big")
    return "rand_" + "".join(LETTERS[number // len(LETTERS) ** i % len(LETTERS)] for i in range(LETTERS_IN_NAME))


# ------------------------------------------------------------------------------------------------------------- content


def _tree(sample: Sample) -> Mapping[str, Any]:
    """The tree of design parameters; that of a release is kept as it is."""
    return sample.design if sample.provenance.source else design_tree(design_from_dict(sample.design))


def _drawn(sample: Sample) -> PatternDrawing:
    """The pattern drawn, and its panels laid out for the texture."""
    plan = lay_out(sample.pattern)
    return PatternDrawing(
        svg=pattern_svg(sample.pattern),
        drawing=png_bytes(draw_pattern(sample.pattern)),
        texture=_texture(plan),
        shifts=np.array([laid.shift for laid in plan.panels]).reshape(-1, 2),
        size=np.array([plan.width, plan.height]),
    )


def _texture(plan: LayPlan) -> bytes:
    """The panels in their places, outlined; clear elsewhere."""
    scale = min(TEXTURE, LARGEST_TEXTURE / max(plan.width, plan.height))
    height = scale * plan.height
    image = Image.new("RGBA", (round(scale * plan.width), round(height)))
    canvas = ImageDraw.Draw(image)
    for laid in plan.panels:
        x, y = (scale * (laid.outline + laid.shift)).T
        corners = list(zip(x.tolist(), (height - y).tolist(), strict=True))
        width = max(round(scale * OUTLINE), 1)
        canvas.polygon(corners, fill=(*cloth_colour(laid.number), CLOTH_OPACITY), outline=(*INK, 255), width=width)
    file = io.BytesIO()
    image.save(file, "PNG")
    return file.getvalue()
