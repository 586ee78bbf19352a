"""Every reader of external files: its input, its result in comparable form, and whether checksums protect it."""

import json
import os
import shutil
import tempfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import torch
import trimesh
import yaml
import zstandard

from gcd_dataset import generate_people
from gcd_dataset.bodyfiles import measurements_text
from gcd_dataset.errors import GcdError
from gcd_dataset.exports.published import export_published, exported_splits
from gcd_dataset.faults import check_pattern, require_valid
from gcd_dataset.generator.body import named_body, read_body
from gcd_dataset.generator.body.landmarks import read_landmarks
from gcd_dataset.generator.drawing import jpeg_bytes
from gcd_dataset.generator.dressing import dress
from gcd_dataset.generator.garments.design import read_design
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.jsonfile import read_toml
from gcd_dataset.loaders import BodyDataset, GarmentDataset, GarmentLoader, Hdf5Garments, PublishedGarmentCodeData
from gcd_dataset.records import Layer, Outfit, Sample, WornGarment
from gcd_dataset.shards import ShardReader
from gcd_dataset.shards.codec import decode_field, decode_fields, decode_sample, encode_sample
from gcd_dataset.shards.hdf5 import write_hdf5
from gcd_dataset.shards.layout import FIELDS, fields_of, member_of
from gcd_dataset.spec import read_pattern, spec_from_pattern, write_pattern
from gcd_dataset.viewer.garments import spec_album
from gcd_dataset.viewer.server import Gallery
from tests.helpers import as_draped
from tests.release.published import pack
from tests.shards.folders import contents, write_samples


@dataclass(frozen=True)
class Reader:
    """A reader, and a file that it reads."""

    content: bytes
    """Content of the undamaged file."""
    read: Callable[[bytes], Any]
    """Replaces the content of the file, and reads it."""
    protected: bool
    """Whether checksums cover the file: changed content is refused, or reads as the original."""


def _file(path: Path, content: bytes, read: Callable[[], Any], *, protected: bool = False) -> Reader:
    """A reader of one file: its content is replaced by the input."""

    def replaced(data: bytes) -> Any:
        path.write_bytes(data)
        return read()

    return Reader(content, replaced, protected)


def _plain(value: Any) -> Any:
    """The value with arrays and tensors as bytes, for comparison."""
    if isinstance(value, torch.Tensor):
        value = value.numpy()
    if isinstance(value, np.ndarray):
        return (str(value.dtype), value.shape, value.tobytes())
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return [_plain(inner) for inner in value] if isinstance(value, list | tuple) else value


CONFIG = MakeConfig(stage="mesh", resolution=8.0, points=64)
COUNT = 2


@cache
def garments() -> tuple[Sample, ...]:
    """Garments of the sampler with the box mesh as drape; draping would take minutes."""
    return tuple(_with_drape(make(3, index, CONFIG)) for index in range(COUNT))


def write_shards(folder: Path, *, count: int = COUNT) -> Path:
    """The first garments as a data set of one shard."""
    recipe = recipe_of(replace(CONFIG, stage="drape", device="cpu"))
    return write_samples(folder, garments()[:count], seed=3, recipe=recipe)


def small_body() -> trimesh.Trimesh:
    """A closed shape of a person's height, of few triangles [cm]."""
    shape = trimesh.creation.capsule(height=130.0, radius=20.0, count=[8, 8])
    shape.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    shape.apply_translation([0.0, -shape.vertices[:, 1].min(), 0.0])
    return shape


def _with_drape(sample: Sample) -> Sample:
    picture = jpeg_bytes(np.full((16, 16, 3), 90 + sample.provenance.index, np.uint8))
    return replace(as_draped(sample), front=picture, back=picture)


def _shards(folder: Path, name: str, *, streaming: bool = False, together: bool = False, without: str = "") -> Reader:
    """A data set of one shard; file ``name`` is replaced by the input, file ``without`` is missing.

    ``together``: read as a batch, for which columns are made.
    """
    data_set, cache = write_shards(folder / "data"), folder / "cache"
    files = contents(data_set)
    content = files.pop(name)
    files.pop(without, None)

    def read(data: bytes) -> Any:
        for path in (data_set, cache):
            shutil.rmtree(path, ignore_errors=True)
        _write(data_set, {**files, name: data})
        dataset = GarmentDataset(data_set, streaming=streaming, cache_dir=cache)
        if together:
            return _plain(list(dataset.__getitems__(range(len(dataset)))))
        return [_plain(item) for item in (dataset if streaming else (dataset[i] for i in range(len(dataset))))]

    return Reader(content, read, protected=True)


SHARD, VIEWS, INDEX, MANIFEST = "train-00000.tar", "views/train-00000.tar", "train.index", "manifest.json"


def _items(dataset: Any) -> list[Any]:
    return [_plain(dataset[index]) for index in range(len(dataset))]


def _hdf5(folder: Path) -> Reader:
    """An HDF5 file, whose checksums only ``verify`` compares."""
    path = folder / "train.h5"
    list(write_hdf5(ShardReader(write_shards(folder / "shards")), path))
    return _file(path, path.read_bytes(), lambda: _items(Hdf5Garments(path)))


def _people(folder: Path) -> Reader:
    generate_people(folder, 2, workers=0)
    path = folder / SHARD
    return _file(path, path.read_bytes(), lambda: _items(BodyDataset(folder)), protected=True)


def _member(_: Path, field: str) -> Reader:
    """One member of a sample, decoded without checksums."""
    return Reader(encode_sample(garments()[0])[FIELDS[field]], partial(_decoded, field), protected=False)


@cache
def outfit() -> Mapping[str, bytes]:
    """The members of both garments as an outfit."""
    worn = [WornGarment(one.pattern, one.design, one.box_mesh, one.drape, one.fabric) for one in garments()]
    return encode_sample(replace(garments()[0], outfit=Outfit(tuple(worn), (Layer(0, 1, 2, 3, 0.5),))))


def _sample(_: Path, field: str) -> Reader:
    """A whole outfit with one member replaced."""
    member = member_of(field)

    def read(data: bytes) -> Any:
        data = _sealed_again(data) if field == "meta" else data
        return _plain(encode_sample(decode_sample({**outfit(), member: data}), garments=2))

    return Reader(outfit()[member], read, protected=False)


def _sealed_again(data: bytes) -> bytes:
    """An edited meta.json with a valid seal, so that the checks after the seal are tried."""
    head, comma, _ = data.rpartition(b',"crc32_before":')
    return head + comma + b"%d}" % zlib.crc32(head) if comma else data


def _decoded(field: str, data: bytes) -> Any:
    return _plain(decode_field(field, {FIELDS[field]: data}))


def _sections(_: Path, member: str) -> Reader:
    """The sections of a member, framed again, so that the checks after Zstandard's checksum are tried."""
    members = outfit()
    fields = [field for field, its in fields_of(members).items() if its == member]

    def read(data: bytes) -> Any:
        return _plain(decode_fields({**members, member: zstandard.compress(data)}, fields))

    return Reader(zstandard.decompress(members[member]), read, protected=False)


def _state(folder: Path) -> Reader:
    """The state of a loader, as a checkpoint holds it."""
    dataset = GarmentDataset(write_shards(folder), fields=["panels"])
    loader = GarmentLoader(dataset, batch_size=1)
    content = json.dumps(loader.state_dict()).encode()

    def read(data: bytes) -> Any:
        try:
            state = json.loads(data)
        except (ValueError, RecursionError) as error:  # users parse their checkpoints themselves
            raise GcdError("no JSON") from error
        fresh = GarmentLoader(dataset, batch_size=1)
        fresh.load_state_dict(state)
        return [len(batch) for batch in fresh]

    return Reader(content, read, protected=False)


def _published(folder: Path, ending: str, *, packed: bool = False) -> Reader:
    """A release with one file replaced, extracted or ``packed``."""
    root = pack(_release(folder)) if packed else _release(folder)
    path = next(path for path in sorted(root.rglob("*")) if path.name.endswith(ending))

    def read() -> Any:
        shutil.rmtree(folder / "kept", ignore_errors=True)
        return _items(PublishedGarmentCodeData(root, cache_dir=folder / "kept"))

    return _file(path, path.read_bytes(), read)


def _release(folder: Path) -> Path:
    return _write(folder / "release", _release_files())


def _write(folder: Path, files: Mapping[str, bytes]) -> Path:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


@cache
def _release_files() -> Mapping[str, bytes]:
    """Path in the release to content, of one garment."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder, "release")
        list(export_published(exported_splits(write_shards(Path(folder, "shards"), count=1)), root))
        return contents(root)


def _specification(folder: Path) -> Reader:
    path = folder / "garment_specification.json"
    content = json.dumps(spec_from_pattern(garments()[0].pattern)).encode()
    return _file(path, content, lambda: [str(fault) for fault in check_pattern(read_pattern(path))])


def _mesh(folder: Path) -> Reader:
    """A specification that is draped: checked, placed on a body and triangulated."""
    path, (body, size, _) = folder / "garment_specification.json", named_body("neutral")

    def read() -> Any:
        pattern = dress(require_valid(read_pattern(path)), body, size).pattern
        return len(build_box_mesh(pattern, spacing=1.0).vertices)

    return _file(path, _specification(folder).content, read)


def _design(folder: Path) -> Reader:
    path = folder / "design_params.yaml"
    return _file(path, yaml.safe_dump({"design": garments()[0].design}).encode(), lambda: str(read_design(path)))


def _query(folder: Path) -> Reader:
    """The address of a request to the gallery."""
    write_pattern(garments()[0].pattern, folder / "a.json")
    album = spec_album(folder, None)
    galleries: dict[int, Gallery] = {}

    def read(data: bytes) -> Any:
        url = urlsplit(data.decode("latin-1"))
        query = {name: values[-1] for name, values in parse_qs(url.query).items()}
        if os.getpid() not in galleries:  # its threads do not survive a fork
            galleries[os.getpid()] = Gallery(album)
        return galleries[os.getpid()].get(url.path, query)[0]

    return Reader(b"/find?position=0&kind=&grade=clean&outcome=&text=a&side=0&rank=0", read, protected=False)


def _config(folder: Path) -> Reader:
    path = folder / "config.toml"
    content = (
        'bodies = "both"\npoints = 64\nresolution = 2.0\n'
        '[design.meta]\nupper = { options = ["Shirt", "FittedShirt"] }\n'
        '[design.sleeve]\nlength = { range = [0.7, 1.1], keep = 0.5 }\n[design.collar.component]\nstyle = "Turtle"\n'
    )

    return _file(path, content.encode(), lambda: Overlay.from_dict(read_toml(path).get("design", {})).to_dict())


def _body(folder: Path, changed: str) -> Reader:
    """A body of three files, one of them replaced."""
    shape = small_body()
    count = len(shape.vertices)
    parts = {
        name: list(range(k, count, 9)) for k, name in enumerate(("left_arm", "right_arm", "left_leg", "right_leg"))
    }
    files = {
        "body.obj": shape.export(file_type="obj").encode(),
        "body.ply": shape.export(file_type="ply"),
        "body.stl": shape.export(file_type="stl"),
        "body.glb": shape.export(file_type="glb"),
        "measures.yaml": measurements_text(garments()[0].measurements).encode(),
        "parts.json": json.dumps(parts).encode(),
    }
    _write(folder, files)
    mesh = folder / (changed if changed.startswith("body") else "body.obj")

    def read() -> Any:
        body, size = read_body(mesh, folder / "measures.yaml", folder / "parts.json")
        if not (np.isfinite(body.vertices).all() and 0 <= body.faces.min() <= body.faces.max() < len(body.vertices)):
            raise ValueError("a body with vertex ids out of range, or positions that are not finite")
        return size.to_file_values()

    return _file(folder / changed, files[changed], read)


def _landmarks(folder: Path) -> Reader:
    path, vertices = folder / "marks.json", np.asarray(small_body().vertices)
    content = {"shoulder_right": 5, "waist": [7, [0.0, 90.0, 20.0]], "bust": [1, 2, 3]}

    return _file(path, json.dumps(content).encode(), lambda: _plain(read_landmarks(path, vertices).rings))


READERS: dict[str, Callable[[Path], Reader]] = {
    "shard-indexed": partial(_shards, name=SHARD),
    "shard-scanned": partial(_shards, name=SHARD, without=INDEX),
    "shard-streamed": partial(_shards, name=SHARD, streaming=True),
    "shard-columns": partial(_shards, name=SHARD, together=True),
    "shard-views": partial(_shards, name=VIEWS, streaming=True),
    "index": partial(_shards, name=INDEX),
    "manifest": partial(_shards, name=MANIFEST),
    "hdf5": _hdf5,
    "body-set": _people,
    "member-meta": partial(_member, field="meta"),
    "member-array": partial(_member, field="edges"),
    "member-ids": partial(_member, field="faces"),
    "sections-pattern": partial(_sections, member="pattern.z"),
    "sections-outer-pattern": partial(_sections, member="g1.pattern.z"),
    "sections-outer-mesh": partial(_sections, member="g1.mesh.z"),
    "sections-mesh": partial(_sections, member="mesh.z"),
    "sections-verts": partial(_sections, member="verts.z"),
    "sections-points": partial(_sections, member="points.z"),
    "member-picture": partial(_member, field="front"),
    "sample-meta": partial(_sample, field="meta"),
    "sample-measures": partial(_sample, field="measures"),
    "sample-spec": partial(_sample, field="spec"),
    "sample-outer-spec": partial(_sample, field="g1_spec"),
    "sample-outer-design": partial(_sample, field="g1_design"),
    "sample-outer-verts": partial(_sample, field="g1_verts"),
    "sample-faces": partial(_sample, field="faces"),
    "loader-state": _state,
    "release-archive": partial(_published, ending="data.tar.gz", packed=True),
    "release-specification": partial(_published, ending="_specification.json"),
    "release-measures": partial(_published, ending="_body_measurements.yaml"),
    "release-design": partial(_published, ending="_design_params.yaml"),
    "release-drape": partial(_published, ending="_sim.ply"),
    "release-box-mesh": partial(_published, ending="_boxmesh.ply"),
    "release-segmentation": partial(_published, ending="_sim_segmentation.txt"),
    "release-labels": partial(_published, ending="_vertex_labels.yaml"),
    "release-properties": partial(_published, ending="_body.yaml"),
    "release-split": partial(_published, ending="split.json"),
    "specification": _specification,
    "config": _config,
    "body-obj": partial(_body, changed="body.obj"),
    "body-ply": partial(_body, changed="body.ply"),
    "body-stl": partial(_body, changed="body.stl"),
    "body-glb": partial(_body, changed="body.glb"),
    "measurements": partial(_body, changed="measures.yaml"),
    "body-parts": partial(_body, changed="parts.json"),
    "landmarks": _landmarks,
    "specification-mesh": _mesh,
    "design": _design,
    "viewer-query": _query,
}
"""Name to a function that makes the reader, with its files in a given folder."""


DOCUMENTS: dict[str, Callable[[bytes], Any]] = {
    name: yaml.safe_load if name in ("measurements", "design", "release-design", "release-labels") else json.loads
    for name in (
        *("specification", "manifest", "loader-state", "body-parts", "release-split", "member-meta", "sample-meta"),
        *("sample-outer-spec", "sample-outer-design", "sample-measures", "landmarks"),
        *("measurements", "design", "release-design", "release-labels"),
    )
}
"""Readers of documents, with the parser of each document: its tree is edited in addition to its bytes."""
