"""Exporting a data set to the folder layout of the published GarmentCodeData."""

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
from gcd_dataset.errors import ConfigError, ShardError, shown
from gcd_dataset.filekinds import BODY_FOLDERS
from gcd_dataset.files import safe_name, write_whole
from gcd_dataset.generator.drawing import draw_pattern, png_bytes
from gcd_dataset.generator.garments import design_from_dict
from gcd_dataset.generator.garments.design import design_tree
from gcd_dataset.generator.garments.wardrobe import Bottom, Upper
from gcd_dataset.generator.lay_plan import INK, LayPlan, cloth_colour, lay_out
from gcd_dataset.generator.svg import pattern_svg
from gcd_dataset.records import Outcome, Sample
from gcd_dataset.release.published_names import DEFAULT_BODY, SPLIT_NAMES, properties_name
from gcd_dataset.release.write import (
    FAIL_CLASSES,
    PatternDrawing,
    ReleaseDraft,
    garment_files,
    release_draft,
    yaml_bytes,
)
from gcd_dataset.shards import ShardReader
from gcd_dataset.shards.layout import garments_in
from gcd_dataset.shards.store import splits_in

logger = logging.getLogger("gcd_dataset")

BATCH = 5000  # designs in a batch
LETTERS = string.ascii_uppercase + string.digits
LETTERS_IN_NAME = 10
SPLIT_FILE = "GarmentCodeData_v2_official_train_valid_test_data_split.json"
COUNTS = ("fin_frame", "self_collisions", "body_collisions", "face_count")  # figures of a drape in the properties
TEXTURE = 15  # pixels per centimetre
LARGEST_TEXTURE = 2048  # pixels
CLOTH_OPACITY, OUTLINE = 166, 0.5  # opacity of cloth, of 255; width of outlines [cm]


@dataclass(frozen=True)
class PublishedName:
    """Batch, folder and name of a garment in the published layout."""

    batch: str
    body_folder: str
    name: str
    body_sample: str | None
    """Name of a random body; ``None`` for the default body."""

    @property
    def listed(self) -> str:
        """The garment's entry in the split file, which lists designs: always under the default body."""
        return f"{self.batch}/{BODY_FOLDERS['default']}/{self.name}"


@dataclass
class _PublishedBatch:
    """Properties of the garments of one batch and one body folder, by garment name."""

    panels: dict[str, int] = field(default_factory=dict)
    types: dict[str, dict[str, Any]] = field(default_factory=dict)
    counts: dict[str, dict[str, int]] = field(default_factory=dict)
    fails: dict[str, str] = field(default_factory=dict)


def exported_splits(folder: Path | str) -> dict[str, ShardReader]:
    """Split to reader, for the splits of the published layout; logs a warning about others.

    Raises ``ShardError`` if there is none.
    """
    splits = splits_in(folder)
    others = ", ".join(split for split in splits if split not in SPLIT_NAMES)
    if others and not set(splits) & set(SPLIT_NAMES):
        raise ShardError(
            f"{folder}: the published layout has no name for its splits ({others}): give --hdf5 FILE and --split"
        )
    if others:
        logger.warning("%s: left out: %s: the published layout has only %s", folder, others, ", ".join(SPLIT_NAMES))
    return {split: ShardReader(folder, split) for split in SPLIT_NAMES if split in (splits or ("train",))}


def export_published(readers: Mapping[str, ShardReader], out: Path | str) -> Generator[str, None, None]:
    """Write all garments, yielding the name of each; the split file and the batch properties are written last.

    Garments from a release keep their names. Generated garments are named by seed and design, 5,000 designs in a batch;
    garments on the neutral body go to ``default_body``. Garments that did not settle are written and listed as failed,
    as GarmentCode's tools do. ``out`` must be new or empty, or hold a stopped export of the same garments, which is
    resumed. Raises ``ConfigError``, ``OutputError`` and ``ShardError``.
    """
    if any(garments_in(reader.layout.members) > 1 for reader in readers.values()):
        raise ConfigError(f"{out}: the layout of GarmentCodeData has no outfits: give --plain OUT or --hdf5 FILE")
    # Only an export of the same garments by the same version is resumed.
    contents = {split: [shard.sha256 for shard in reader.record.shards] for split, reader in readers.items()}
    with release_draft(out, json.dumps({"version": __version__, "contents": contents})) as draft:
        yield from _write_garments(readers, draft)


def _write_garments(readers: Mapping[str, ShardReader], draft: ReleaseDraft) -> Iterator[str]:
    batches: dict[tuple[str, str], _PublishedBatch] = {}
    splits: dict[str, dict[str, None]] = {}
    first_batch = 0
    for split, reader in readers.items():
        listed = splits.setdefault(SPLIT_NAMES[split][0], {})
        last = 0
        for position in range(len(reader)):
            sample = reader.sample(position)
            published = _published_name(sample, split, first_batch)
            last = max(last, _design_number(sample))
            batch = batches.setdefault((published.batch, published.body_folder), _PublishedBatch())
            _write(sample, published, draft, batch)
            if sample.drape is not None and sample.drape.outcome is Outcome.SETTLED:
                listed[published.listed] = None
            yield published.name
        first_batch += last // BATCH + 1
    for (name, body_folder), batch in batches.items():
        properties = yaml_bytes(batch_properties(name, batch))
        write_whole(draft.folder / name / body_folder / properties_name(body_folder), properties)
    lists = {name: list(splits.get(name, {})) for name, *_ in SPLIT_NAMES.values()}
    write_whole(draft.folder / SPLIT_FILE, json.dumps(lists, indent=4).encode())


def _write(sample: Sample, published: PublishedName, draft: ReleaseDraft, batch: _PublishedBatch) -> None:
    tree, folder = _design(sample), Path(published.batch, published.body_folder, "data", published.name)
    if not draft.holds(folder):
        files = garment_files(sample, published.name, tree, _drawing(sample), body_sample=published.body_sample)
        draft.put(folder, files)
    name, drape, mesh = published.name, sample.drape, sample.box_mesh
    assert drape is not None
    assert mesh is not None
    batch.panels[name] = len(sample.pattern.panels)
    batch.types[name] = garment_type(tree)
    figures = (drape.frames, drape.self_crossings, drape.body_crossings, len(mesh.faces))
    batch.counts[name] = dict(zip(COUNTS, figures, strict=True))
    if drape.outcome is not Outcome.SETTLED:
        batch.fails[name] = FAIL_CLASSES[drape.outcome]


# --------------------------------------------------------------------------------------------------------------- names


def _published_name(sample: Sample, split: str, first_batch: int) -> PublishedName:
    provenance = sample.provenance
    if provenance.source:
        return _name_in_release(sample.key, provenance.source, provenance.body_name)
    number = _design_number(sample)
    batch, name = f"garments_{BATCH}_{first_batch + number // BATCH}", _name(f"{split}:{provenance.seed}:{number}")
    if provenance.body_name == "neutral":
        return PublishedName(batch, BODY_FOLDERS["default"], name, None)
    pose = "apart" if sample.shape is not None and sample.shape.legs_apart else "straight"
    return PublishedName(batch, BODY_FOLDERS["random"], name, f"{first_batch * BATCH + number:05d}_{pose}")


def _name_in_release(key: str, source: str, body_name: str) -> PublishedName:
    """The name that a garment had in its release, made safe as a path."""
    parts = source.rsplit("/", 3)
    if len(parts) != 4:
        raise ShardError(f"sample {key}: its meta.json has source {shown(source)}: give RELEASE/BATCH/BODIES/NAME")
    batch, body_folder, name = map(safe_name, parts[1:])
    return PublishedName(batch, body_folder, name, None if body_name == DEFAULT_BODY else body_name)


def _design_number(sample: Sample) -> int:
    """Number of the sample's design within its seed; with ``bodies="both"`` two samples share a design.

    A design on several random bodies counts as several designs: the layout has a single folder for random bodies.
    """
    provenance = sample.provenance
    if provenance.recipe.get("bodies_each", 1) > 1:
        return provenance.index
    return provenance.index // (2 if provenance.source or provenance.recipe.get("bodies") == "both" else 1)


def _name(design: str) -> str:
    """``rand_`` and ten letters or digits, derived from a hash of ``design``."""
    number = int.from_bytes(hashlib.sha256(design.encode()).digest(), "big")
    return "rand_" + "".join(LETTERS[number // len(LETTERS) ** i % len(LETTERS)] for i in range(LETTERS_IN_NAME))


# ------------------------------------------------------------------------------------------------------------- content


def _design(sample: Sample) -> Mapping[str, Any]:
    """The tree of design parameters; a published garment's tree is unchanged."""
    return sample.design if sample.provenance.source else design_tree(design_from_dict(sample.design))


def _drawing(sample: Sample) -> PatternDrawing:
    """Pictures of the pattern, and the texture with its layout."""
    plan = lay_out(sample.pattern)
    return PatternDrawing(
        svg=pattern_svg(sample.pattern),
        drawing=png_bytes(draw_pattern(sample.pattern)),
        texture=_texture(plan),
        shifts=np.array([laid.shift for laid in plan.panels]).reshape(-1, 2),
        size=np.array([plan.width, plan.height]),
    )


def _texture(plan: LayPlan) -> bytes:
    """PNG of the laid-out panels, filled and outlined on a transparent background."""
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


UPPERS = {member.value: member.garment for member in Upper}
BOTTOMS = {member.value: member.garment for member in Bottom}
DRESS = 1.4  # least sum of the lengths of top, belt and skirt of a dress
LENGTHS = ((0.3, "mini"), (0.5, "knee_len"), (0.65, "midi"), (np.inf, "maxi"))  # upper bounds of a bottom's length
SHORT_SLEEVE = 0.5
FAILS = (
    "crashes", "cloth_body_intersection", "cloth_self_intersection", "static_equilibrium", "fast_finish",
    "pattern_loading", "multi_stitching", "gt_edges_creation",
)  # fmt: skip


def garment_type(design: Mapping[str, Any]) -> dict[str, Any]:
    """Main type and styles of a design tree, by the rules of GarmentCodeData's sampler."""

    def value(*path: str) -> Any:
        node: Any = design
        for key in path:
            node = node.get(key) if isinstance(node, Mapping) else None
        return node.get("v") if isinstance(node, Mapping) else node

    upper, bottom = UPPERS.get(value("meta", "upper")), BOTTOMS.get(value("meta", "bottom"))
    below = float(value(bottom.statistics_length_section or bottom.section, "length") or 0.0) if bottom else 0.0
    at_waist = upper is not None and upper.at_waist
    top = 1.0 if at_waist else float(value(upper.section if upper else "shirt", "length") or 0.0)
    belt = float(value("waistband", "width") or 0.0) if value("meta", "wb") else 0.0
    legs = bottom is not None and bottom.legs
    if upper:
        main = "jumpsuit" if legs else "dress" if upper.carries and top + belt + below >= DRESS else "upper_garment"
    else:
        main = "pants" if legs else "skirt"
    asymmetric = bool(upper and value("left", "enable_asym"))
    styles = ["asymmetric_top"] if asymmetric else []
    if upper and not asymmetric and "Hood" in str(value("collar", "component", "style")):
        styles.append("hoodie")
    if upper:
        branches = [("sleeve",), ("left", "sleeve")] if asymmetric else [("sleeve",)]
        lengths = [value(*at, "length") or 0.0 for at in branches if not value(*at, "sleeveless")]
        long = max(lengths, default=0.0) >= SHORT_SLEEVE
        styles += ["with_sleeves", "long_sleeve" if long else "short_sleeve"] if lengths else ["sleeveless"]
    if bottom:
        styles.append(next(name for most, name in LENGTHS if below < most))
    return {"main": main, "styles": styles}


def batch_properties(name: str, batch: "_PublishedBatch") -> dict[str, Any]:
    """The tree of the properties file: figures of each garment by name."""
    return {
        "body_default": DEFAULT_BODY,
        "body_samples": "5000_body_shapes_and_measures",
        "size": len(batch.panels),
        "name": name,
        "to_subfolders": True,
        "generator": {"stats": {"panel_count": batch.panels, "garment_types": batch.types}},
        "data_folder": name,
        "sim": {
            "stats": {
                "fails": {kind: [name for name, of in batch.fails.items() if of == kind] for kind in FAILS},
                **{key: {name: count[key] for name, count in batch.counts.items()} for key in COUNTS},
                "stop_over": [],
                "fails_count": len(batch.fails),
            }
        },
        "frozen": True,
    }
