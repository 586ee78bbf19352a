"""The dataset card (``README.md``) and the Croissant description of a published data set."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any

from gcd_dataset.shards.layout import FAILED, fields_of, is_picture, split_worn
from gcd_dataset.shards.manifest import MANIFEST, Manifest, SplitRecord

TEXTS = resources.files(__package__)

BYTES = "application/octet-stream"
FORMATS = {"tar": "application/x-tar", "json": "application/json"}
SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
TAGS = ["webdataset", "garments", "sewing-patterns", "cloth-simulation", "synthetic", "3d"]

LICENSES = frozenset((TEXTS / "licenses.txt").read_text("utf-8").split())
"""License identifiers, from huggingface.co/docs/hub/repositories-licenses; the Hub refuses a card with another one."""

FIELD_DESCRIPTIONS: Mapping[str, str] = {
    "meta": "seed, index, versions, recipe; names that the arrays refer to; outcome and figures of the drape; hashes",
    "spec": "the sewing pattern as a GarmentCode specification [cm]; JSON",
    "design": "the design's parameters; JSON",
    "caption": "the garment in English, three lines: short, medium and full caption",
    "measures": "the wearer's tailor's measures [cm, degrees]",
    "panels": "the pattern as arrays: one row per panel",
    "edges": "one row per edge",
    "stitches": "one row per seam",
    "closures": "one row per seam: sewn, open, zip or buttons, and the part of its length that is joined",
    "lines": "one row per line inside a panel, such as the centre front of a buttoned shirt",
    "body": "weights of the body's shape components [standard deviations]",
    "faces": "triangles, rows of verts and box",
    "uv": "panel-plane coordinates of the seam-split vertices [cm]",
    "panel_id": "the panel of each face",
    "labels": "vertices that have a label",
    "seams": "vertices on seams",
    "corners": "rows of uv at each face's corners",
    "uv_vertex": "the vertex of each row of uv",
    "box": "vertex positions before sewing [cm]",
    "verts": "vertex positions at rest on the body [cm]",
    "points": "surface points [cm] and unit normals",
    "stretch": "largest and smallest principal stretch at each vertex",
    "gap": "signed distance of each vertex from the skin [cm]",
    "pressure": "pressure of each vertex on the skin [kPa]",
    "pose": "bend, spread and twist of each bone off the A-pose [rad]",
    "motion_verts": "vertex positions of all frames, one frame after the other [cm]",
    "motion_pose": "the same of the pose in each frame [rad]",
    "front": "picture from the front",
    "back": "picture from behind",
}

PICTURES = "Pictures are in `views/`, under the same keys; configuration `views`. "


@dataclass(frozen=True)
class Release:
    """A published data set, as described by its card and its Croissant file."""

    repo: str
    manifest: Manifest
    settled: Mapping[str, int]
    """Split to its number of settled drapes."""
    members: tuple[str, ...]
    """Members of each garment."""
    license: str
    divided: bool
    """Whether the splits share neither designs nor bodies: true for parts of one split, and for splits of a recipe."""
    endpoint: str

    @property
    def total(self) -> int:
        """Number of garments."""
        return sum(self.manifest.counts.values())

    @property
    def splits(self) -> dict[str, SplitRecord]:
        """The splits, in the order of a training."""
        known = ("train", "validation", "test")
        names = sorted(self.manifest.splits, key=lambda name: (known.index(name) if name in known else 3, name))
        return {name: self.manifest.splits[name] for name in names}

    @property
    def has_views(self) -> bool:
        """Whether there are tars of pictures."""
        return any(map(is_picture, self.members))


def card(release: Release) -> str:
    """``README.md``: YAML metadata for the Hub, then text."""
    from huggingface_hub import DatasetCardData

    title = release.repo.rpartition("/")[2].replace("-", " ").replace("_", " ")
    metadata = DatasetCardData(
        license=release.license,
        pretty_name=title,
        task_categories=["image-to-3d", "other"],
        tags=TAGS,
        size_categories=[next((text for limit, text in SIZES if release.total < limit), "n>1M")],
        configs=_configs(release),
    )
    text = (
        (TEXTS / "card.md")
        .read_text("utf-8")
        .format(
            title=title,
            repo=release.repo,
            total=release.total,
            generator=release.manifest.generator,
            manifest=MANIFEST,
            splits="\n".join(_split_row(release, name, split) for name, split in release.splits.items()),
            promise=_separation(release),
            bare=" --no-views" if release.has_views else "",
            pictures=PICTURES if release.has_views else "",
            fields="\n".join(
                f"| {field} | `{member}` | {_describe(field)} |" for field, member in fields_of(release.members).items()
            ),
            made=_origin(release.manifest),
        )
    )
    return f"---\n{metadata.to_yaml()}\n---\n{text}"


def _configs(release: Release) -> list[dict[str, Any]]:
    """The configurations of the card: tars, and tars of the pictures. ``datasets`` reads all with one builder."""
    folders = {"default": "", **({"views": "views/"} if release.has_views else {})}
    return [
        {
            "config_name": name,
            "data_files": [{"split": split, "path": f"{folder}{split}-*.tar"} for split in release.splits],
            "default": name == "default",
        }
        for name, folder in folders.items()
    ]


def _describe(field: str) -> str:
    if field.startswith("view_"):
        return "camera, light, place and materials of that view" if field.endswith("_json") else "picture from any side"
    number, plain = split_worn(field)
    return f"of garment {number} of an outfit: {FIELD_DESCRIPTIONS[plain]}" if number else FIELD_DESCRIPTIONS[plain]


def _split_row(release: Release, name: str, split: SplitRecord) -> str:
    size = sum(shard.size + shard.views_size for shard in split.shards) / 1e6
    return f"| {name} | {split.count} | {release.settled[name]} | {len(split.shards)} | {size:.1f} MB |"


def _separation(release: Release) -> str:
    """A sentence about the designs and bodies that splits have in common."""
    if len(release.splits) < 2:
        return "There is one split."
    separated = "No design, and no body but the neutral one," if release.divided else "No design"
    failed = f"; `{FAILED}` holds failed drapes of designs of any split" if FAILED in release.splits else ""
    return f"{separated} is in two splits{failed}."


def _origin(manifest: Manifest) -> str:
    """Seed and recipe, and the published recipe if the data set follows one."""
    plan, named = next(iter(manifest.splits.values())).plan, manifest.recipe
    options = json.dumps({name: value for name, value in plan.recipe.items() if name != "part"}, sort_keys=True)
    lines = [f"- seed {plan.seed}, recipe `{options}`"]
    if named is not None:
        hashes = f"- recipe `{named.name}` of sha256 `{named.sha256}`, patterns `{named.patterns}`"
        lines.append(f"{hashes}: `gcd check FOLDER --recipe {named.name}` compares")
    return "\n".join(lines)


def croissant(release: Release, files: Mapping[str, tuple[int, str]]) -> dict[str, Any]:
    """The description in Croissant 1.0 (MLCommons); ``files``: path to size [bytes] and SHA-256."""
    url = f"{release.endpoint}/datasets/{release.repo}"
    objects = [
        _thing("cr:FileObject", name, contentUrl=f"{url}/resolve/main/{name}", contentSize=f"{size} B", sha256=digest)
        | {"encodingFormat": FORMATS.get(name.rpartition(".")[2], BYTES)}
        for name, (size, digest) in files.items()
    ]
    return {
        **json.loads((TEXTS / "croissant.json").read_text("utf-8")),  # the context of its specification
        "name": release.repo.rpartition("/")[2],
        "description": f"{release.total} garments with their sewing patterns, on bodies, at rest.",
        "url": url,
        "license": release.license,
        "creator": {"@type": "sc:Organization", "name": release.repo.partition("/")[0]},
        "distribution": objects + [_file_set(name, split) for name, split in release.splits.items()],
        "recordSet": [_records(name, release) for name in release.splits],
    }


def _thing(kind: str, name: str, **properties: Any) -> dict[str, Any]:
    return {"@type": kind, "@id": name, "name": name, **properties}


def _file_set(split: str, record: SplitRecord) -> dict[str, Any]:
    tars = [{"@id": shard.name(split)} for shard in record.shards]
    # Not "*": mlcroissant would take the folder of an extracted shard for a file.
    return _thing("cr:FileSet", f"{split}-files", containedIn=tars, encodingFormat=BYTES, includes="*.*")


def _records(split: str, release: Release) -> dict[str, Any]:
    """The ``RecordSet`` of a split: one record per file; the description lists the members."""
    members = "; ".join(f"{member}: {_describe(field)}" for field, member in fields_of(release.members).items())
    fields = (("file", "Key and member.", "filename"), ("content", "The file's bytes.", "content"))
    return _thing(
        "cr:RecordSet",
        split,
        description=f"The files of each garment, KEY.MEMBER. {members}",
        field=[
            _thing("cr:Field", f"{split}/{name}", description=text, dataType="sc:Text")
            | {"source": {"fileSet": {"@id": f"{split}-files"}, "extract": {"fileProperty": file_property}}}
            for name, text, file_property in fields
        ],
    )
