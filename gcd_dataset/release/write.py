"""Writes our garments as the files of the published layout, for code that reads GarmentCodeData.

The layout loses some information: PLY files split vertices at seams, and texture coordinates have no scale. The rest
lengths of seams are stored as a pickle, which holds plain numbers only.
"""

import io
import json
import pickle
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float
from PIL import Image

from gcd_dataset.bodyfiles import measurements_tree
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.files import make_folder, require_name, write_whole, writing_to
from gcd_dataset.records import ANGLES, BoxMesh, Drape, Measurements, Outcome, Record, Sample
from gcd_dataset.release.meshes import Ply, weld, write_ply
from gcd_dataset.release.published_names import ENDINGS
from gcd_dataset.shards.access import locked, reading
from gcd_dataset.spec import spec_from_pattern

UNFINISHED, NOTE, LOCK = ".unfinished", ".garments", ".export.lock"


class ReleaseDraft:
    """The folder of a release during export."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._unfinished = folder, folder / UNFINISHED
        self._visited: set[Path] = set()

    def begin(self, garments: str) -> None:
        """Start or continue the export. Raises ``ConfigError`` for a folder with other ``garments`` or files."""
        note = self._unfinished / NOTE
        with reading(self.folder):
            begun = note.read_text() if note.exists() else None
            others = {path.name for path in self.folder.iterdir()} - {UNFINISHED, LOCK}
        if others and begun is None:
            raise ConfigError(f"{self.folder}: not empty: choose another folder")
        if others and begun != garments:
            raise ConfigError(
                f"{self.folder}: begun with other garments, or by another version of gcd_dataset: delete it, or choose "
                "another folder"
            )
        make_folder(self._unfinished)
        write_whole(note, garments.encode())

    def holds(self, path: Path) -> bool:
        """Whether the garment at ``path``, relative to the release, is complete.

        Raises ``ShardError`` for a path that was queried before, and for an unsafe one.
        """
        for part in path.parts:
            require_name(part, f"{self.folder}: a garment's path")
        if path in self._visited:
            raise ShardError(
                f"{self.folder / path}: two garments of the data set have this name: export their splits one by one"
            )
        self._visited.add(path)
        with reading(self.folder / path):
            return (self.folder / path).exists()

    def put(self, path: Path, files: Mapping[str, bytes]) -> None:
        """Write the files of a garment, atomically. Raises ``OutputError``."""
        folder, draft = self.folder / path, self._unfinished / path.name
        with writing_to(draft):
            if draft.exists():  # left by a run that was killed
                shutil.rmtree(draft)
        make_folder(draft)
        for name, content in files.items():
            write_whole(draft / name, content)
        make_folder(folder.parent)
        with writing_to(folder):
            draft.rename(folder)

    def end(self) -> None:
        """Remove the hidden folder: the export is complete. Raises ``OutputError``."""
        with writing_to(self._unfinished):
            shutil.rmtree(self._unfinished)


@contextmanager
def release_draft(folder: Path | str, garments: str) -> Iterator[ReleaseDraft]:
    """A release in ``folder``, complete when the block ends without an error; otherwise the next call continues it.

    ``garments``: a text that identifies the exported garments. Raises ``ConfigError`` for a folder with anything else
    in it, ``OutputError`` for one that cannot be written, or is locked by another process.
    """
    draft = ReleaseDraft(make_folder(folder))
    with locked(draft.folder / LOCK, "exporting"):
        draft.begin(garments)
        yield draft
        draft.end()


DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
PICTURE = 800  # width and height of a render [pixels]
PICKLE = 4  # pickle protocol
DEGREE_DIGITS = 10

FAIL_CLASSES: Mapping[Outcome, str] = {
    Outcome.NOT_SETTLED: "static_equilibrium",
    Outcome.THROUGH_BODY: "cloth_body_intersection",
    Outcome.THROUGH_ITSELF: "cloth_self_intersection",
    Outcome.OVERSTRETCHED: "crashes",
    Outcome.SLID_OFF: "crashes",
    Outcome.FELL: "crashes",
    Outcome.OVERFULL: "crashes",
    Outcome.REFUSED: "crashes",
    Outcome.DIVERGED: "crashes",
    Outcome.CANNOT_BE_PUT_ON: "crashes",
}
"""Outcome to the failure class in the properties of a batch; ``crashes`` if no class of the layout fits."""


@dataclass(frozen=True, eq=False)
class PatternDrawing(Record):
    """The drawings of a pattern, and the positions of its panels in the texture."""

    svg: bytes
    drawing: bytes
    """PNG of the pattern."""
    texture: bytes
    """PNG of the texture."""
    shifts: Float[np.ndarray, "p 2"]
    """Translation from each panel's plane to the texture [cm]."""
    size: Float[np.ndarray, "2"]
    """Width and height of the texture [cm]."""


def garment_files(
    sample: Sample, name: str, design: Mapping[str, Any], drawn: PatternDrawing, *, body_sample: str | None
) -> dict[str, bytes]:
    """File name to content of the 13 files of a draped garment.

    ``design``: the tree of its parameters. ``body_sample``: name of the wearer; ``None`` for the default body. Raises
    ``ShardError`` for a garment without a drape, and for one that the layout cannot hold.
    """
    mesh, drape = sample.box_mesh, sample.drape
    if mesh is None or drape is None:
        raise ShardError(f"sample {sample.key} is not draped, but the published layout needs drapes: drape it")
    content = {
        "spec": json.dumps(spec_from_pattern(sample.pattern), indent=2).encode(),
        "svg": drawn.svg,
        "drawing": drawn.drawing,
        "design": yaml_bytes({"design": design}),
        "measures": yaml_bytes({"body": _measures(sample.measurements, body_sample)}),
        **_meshes(sample.key, mesh, drape, drawn),
        "segmentation": "".join(f"{line}\n" for line in _segments(mesh)).encode(),
        "vertex_labels": yaml_bytes({str(label): ids.tolist() for label, ids in mesh.labels.items()}),
        "rest_lengths": pickle.dumps(_rest_lengths(mesh), protocol=PICKLE),
        "texture": drawn.texture,
        "front": _render(sample.front),
        "back": _render(sample.back),
    }
    return {f"{name}{ending}": content[kind] for kind, ending in ENDINGS.items()}


def yaml_bytes(tree: Mapping[str, Any]) -> bytes:
    """A tree as YAML, with all digits, in the order of its keys."""
    return yaml.dump(tree, Dumper=DUMPER, sort_keys=False, default_flow_style=False).encode()


def _measures(measurements: Measurements, body_sample: str | None) -> dict[str, float | str]:
    """The measures; angles are rounded to remove the errors of the conversion from radians."""
    tree: dict[str, float | str] = {
        key: round(value, DEGREE_DIGITS) if key.removeprefix("_") in ANGLES else value
        for key, value in measurements_tree(measurements).items()
    }
    return dict(sorted((tree if body_sample is None else tree | {"body_sample": body_sample}).items()))


def _meshes(key: str, mesh: BoxMesh, drape: Drape, drawn: PatternDrawing) -> dict[str, bytes]:
    """Both PLY files: a split vertex for each row of ``uv``, sorted by welded vertex. Raises ``ShardError``."""
    texture = (mesh.uv + drawn.shifts[mesh.panel_of_row]) / drawn.size
    rows = np.argsort(mesh.uv_vertex, kind="stable")
    number = np.empty_like(rows)
    number[rows] = np.arange(len(rows))
    faces = number[mesh.corners]
    positions = {
        kind: np.asarray(vertices, np.float32)[mesh.uv_vertex[rows]]
        for kind, vertices in (("box", mesh.vertices), ("sim", drape.vertices))
    }
    # Readers weld vertices by position.
    if not np.array_equal(weld(positions["sim"])[1], mesh.uv_vertex[rows]):
        raise ShardError(f"sample {key}: two vertices of its drape coincide, or one has no face: leave it out")
    return {kind: write_ply(Ply(vertices, texture[rows], faces)) for kind, vertices in positions.items()}


def _segments(mesh: BoxMesh) -> list[str]:
    """For each vertex the name of its panel, or the comma-separated seams on which it lies."""
    segments = [""] * len(mesh.vertices)
    for face, panel in zip(mesh.faces.tolist(), mesh.panel_id.tolist(), strict=True):
        for vertex in face:
            segments[vertex] = mesh.panel_names[panel]
    seams: dict[int, list[str]] = {}
    for vertex, seam in mesh.seams.tolist():
        seams.setdefault(vertex, []).append(f"stitch_{seam}")
    for vertex, names in seams.items():
        segments[vertex] = ",".join(dict.fromkeys(names))
    return segments


def _rest_lengths(mesh: BoxMesh) -> dict[tuple[int, int], float]:
    """Flat length [cm] of every edge of the triangles at seams; for an edge on a seam, the shorter of both sides."""
    on_seam = np.zeros(len(mesh.vertices), bool)
    on_seam[mesh.seams[:, 0]] = True
    touching = on_seam[mesh.faces].any(axis=1)
    lengths: dict[tuple[int, int], float] = {}
    for face, corner in zip(mesh.faces[touching].tolist(), mesh.corners[touching].tolist(), strict=True):
        for i, j in ((0, 1), (1, 2), (0, 2)):
            edge = min(face[i], face[j]), max(face[i], face[j])
            flat = float(np.hypot(*(mesh.uv[corner[i]] - mesh.uv[corner[j]])))
            lengths[edge] = min(flat, lengths.get(edge, flat))
    return lengths


def _render(picture: bytes | None) -> bytes:
    """A picture as a square PNG of ``PICTURE`` pixels; transparent for ``None``."""
    file = io.BytesIO()
    if picture is None:
        image = Image.new("RGBA", (PICTURE, PICTURE))
    else:
        image = Image.open(io.BytesIO(picture)).convert("RGBA")
    if image.size != (PICTURE, PICTURE):
        image = image.resize((PICTURE, PICTURE), Image.Resampling.LANCZOS)
    image.save(file, "PNG")
    return file.getvalue()
