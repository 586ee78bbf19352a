"""Encoding and decoding of samples."""

import io
import json
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.generator.drawing import jpeg_bytes
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import (
    MEASURES,
    BoxMesh,
    Closure,
    Grade,
    InnerLine,
    LineRole,
    Maps,
    Measurements,
    NamedFabric,
    Outcome,
    Provenance,
    Sample,
    StoredView,
    Strain,
)
from gcd_dataset.shards import FIELDS, MEMBERS, decode_fields, decode_sample, encode_sample
from gcd_dataset.shards.codec import MESH_CODINGS, patterns_of, spread
from gcd_dataset.shards.layout import garments_layout, is_picture
from gcd_dataset.shards.sections import HEAD, Coding, pack, unpack
from gcd_dataset.spec import pattern_from_spec, spec_from_pattern
from gcd_dataset.tensors import decode_pattern, encode_pattern
from tests.helpers import parts
from tests.pleats import pleated_square
from tests.shards import stranger
from tests.shards.folders import patterns, write_shard


@pytest.fixture
def sample() -> Sample:
    return fake_sample(seed=1, index=12)


def stages(sample: Sample) -> Iterator[Sample]:
    """The sample after ``--stage`` drape, mesh and pattern."""
    yield sample
    yield replace(sample, drape=None, front=None, back=None)
    yield replace(sample, shape=None, box_mesh=None, drape=None, points=None, front=None, back=None)


def test_every_stage_has_the_same_members_beside_pictures(sample: Sample) -> None:
    assert encode_sample(sample) == encode_sample(fake_sample(1, 12)) != encode_sample(fake_sample(2, 12))
    for stage in stages(sample):
        members = MEMBERS if stage.drape is not None else [m for m in MEMBERS if not is_picture(m)]
        encoded = encode_sample(stage)
        assert list(encoded) == list(members)
        meta = json.loads(encoded["meta.json"])
        assert meta["crc32"] == {name: zlib.crc32(encoded[name]) for name in members[1:]}
        assert not {"outfit", "layers"} & meta.keys()  # as before there were outfits
        assert encode_sample(decode_sample(encoded)) == encoded  # a second round trip changes no byte
    unpictured = replace(sample, front=None, back=None)
    assert tuple(encode_sample(unpictured)) == MEMBERS  # a drape that could not be rendered
    provenance = replace(sample.provenance, recipe={"picture": 0})
    assert "front.jpg" not in encode_sample(replace(unpictured, provenance=provenance))


def test_decoding_gives_the_record_back_to_the_stored_precision(sample: Sample) -> None:
    exact = decode_sample(encode_sample(sample))
    for stage in stages(exact):
        again = decode_sample(encode_sample(stage))
        assert [f.name for f in fields(stage) if not same(getattr(stage, f.name), getattr(again, f.name))] == []
    (mesh, drape), (sent_mesh, sent_drape) = parts(exact), parts(sample)
    for stored, sent in (
        (mesh.vertices, sent_mesh.vertices),
        (mesh.uv, sent_mesh.uv),
        (drape.vertices, sent_drape.vertices),
    ):
        assert np.abs(stored - sent).max() < 1e-3  # cm
    for name in ("faces", "corners", "uv_vertex", "panel_id", "seams"):
        assert np.array_equal(getattr(mesh, name), getattr(sent_mesh, name))


def same(a: object, b: object) -> bool:
    return np.array_equal(a, b) if isinstance(a, np.ndarray) and isinstance(b, np.ndarray) else a == b


def test_a_diverged_drape_is_stored(sample: Sample) -> None:
    assert sample.drape is not None
    for place, stored in ((np.nan, np.nan), (np.inf, np.inf), (1e300, np.inf), (1e30, float(np.float32(1e30)))):
        wrecked = replace(sample.drape, vertices=np.full((3, 3), place), outcome=Outcome.DIVERGED, stretch_p99=np.nan)
        again = decode_sample(encode_sample(replace(sample, drape=wrecked))).drape
        assert again is not None
        assert np.isnan(again.stretch_p99)
        wrecked = replace(wrecked, vertices=np.full((3, 3), stored), stretch_p99=0.0)
        assert replace(again, stretch_p99=0.0) == wrecked
    points = np.full((7, 6), np.nan)
    assert np.isnan(decode_fields(encode_sample(replace(sample, points=points)), ["points"])["points"]).all()


@pytest.mark.parametrize("count", [1, 2, 127, 1000])
def test_points_are_stored_within_a_hundredth_of_a_millimetre_and_normals_within_a_quarter_of_a_degree(
    sample: Sample, count: int
) -> None:
    rng = np.random.default_rng(count)
    normals = rng.normal(size=(count, 3))
    special = np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1], [1, 1, 0], [-1, 0, -1], [1e-9, -1, -1e-9]])
    normals[:6] = special[:count]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = np.concatenate([rng.normal(size=(count, 3)) * 30 + [0, 90, 0], normals], axis=1)
    read = decode_fields(encode_sample(replace(sample, points=points)), ["points"])["points"]
    assert read.dtype == np.float32
    assert np.abs(read[:, :3] - points[:, :3]).max() < 1e-3
    cosine = np.einsum("ij,ij->i", read[:, 3:].astype(float), normals)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.23
    assert np.linalg.norm(read[:, 3:], axis=1) == pytest.approx(1.0, abs=1e-6)


def test_the_first_points_lie_all_over_the_surface() -> None:
    for count in (0, 1, 2, 1240, 6770, 8192):
        assert np.array_equal(np.sort(spread(count)), np.arange(count))
        gaps = np.diff(np.sort(spread(count)[: count // 8]))
        assert gaps.max(initial=0) < 4 * 8  # of 8 on average


def moved(mesh: BoxMesh) -> BoxMesh:
    return replace(mesh, vertices=mesh.vertices + [0.0, 0.0, 0.5])


def swapped(mesh: BoxMesh) -> BoxMesh:
    """The first and the last face change places, so that the faces of a panel are no longer together."""
    order = np.arange(len(mesh.faces))
    order[[0, -1]] = order[[-1, 0]]
    return replace(mesh, faces=mesh.faces[order], corners=mesh.corners[order], panel_id=mesh.panel_id[order])


def turned(mesh: BoxMesh) -> BoxMesh:
    """A face begins at another corner than its row of ``corners``."""
    faces = mesh.faces.copy()
    faces[3] = faces[3][[1, 2, 0]]
    return replace(mesh, faces=faces)


@pytest.mark.parametrize(
    ("change", "section"), [(None, None), (moved, "box"), (swapped, "panel_id"), (turned, "faces")]
)
def test_what_follows_is_not_stored(
    sample: Sample, change: Callable[[BoxMesh], BoxMesh] | None, section: str | None
) -> None:
    assert sample.box_mesh is not None
    mesh = sample.box_mesh if change is None else change(sample.box_mesh)
    members = encode_sample(replace(sample, box_mesh=mesh))
    stored = {"faces_of", "rows_of", "corners", "uv", "uv_vertex", "labels", "seams"}
    found = unpack(members["mesh.z"]).keys()
    assert found == stored if section is None else found > stored and section in found
    read = decode_fields(members, ["faces", "panel_id", "box"])
    assert np.array_equal(read["faces"], mesh.faces)
    assert np.array_equal(read["panel_id"], mesh.panel_id)
    assert np.abs(read["box"] - mesh.vertices).max() < 1e-3


def full(sample: Sample) -> Sample:
    """The sample with caption, views and all other optional values."""
    assert sample.drape is not None
    assert sample.front is not None
    return replace(
        sample,
        provenance=replace(sample.provenance, redraws={"too_long": 2}),
        drape=replace(sample.drape, strain=Strain((1.25, 0.9), ((1.25, 0.95), (1.1, 0.9)))),
        grade=Grade.PAPER,
        fabric=NamedFabric("denim", {"density": 0.4, "tensile": [9.0, 8.0, 3.0]}),
        gathers=(1.0, 1.5),
        tags=("skirt", "short"),
        caption="Ein kurzer Rock \u2013 zwei Bahnen",
        views=(StoredView(sample.front, {"camera": [0.0, 1.0]}), StoredView(sample.front, {"light": {"from": "left"}})),
    )


def test_optional_members_and_entries_are_decoded(sample: Sample) -> None:
    whole = full(sample)
    members = encode_sample(whole)
    assert tuple(members) == garments_layout(caption=True, views=2).members
    again = decode_sample(members)
    for name in ("provenance", "grade", "fabric", "gathers", "tags", "caption", "views"):
        assert getattr(again, name) == getattr(whole, name)
    assert again.drape is not None and whole.drape is not None
    assert again.drape.strain == whole.drape.strain
    fields = decode_fields(members)
    assert fields["caption"] == whole.caption
    assert (fields["view_0"].shape, fields["view_1_json"]) == ((3, 16, 16), {"light": {"from": "left"}})
    assert len(json.loads(members["measures.json"])) == len(MEASURES)
    assert fields["measures"] == whole.measurements.to_file_values()


def form(value: object) -> object:
    """The nested types of a value; of a list, the type of its entries."""
    if isinstance(value, dict):
        return {name: form(entry) for name, entry in value.items()}
    if isinstance(value, list):
        assert value, "a list without entries has no type"
        return [form(value[0])]
    assert value is not None
    return type(value)


def test_meta_and_measures_have_the_same_keys_and_types_in_every_sample(sample: Sample) -> None:
    everything = full(sample)
    wrecked = replace(everything, drape=replace(everything.drape, stretch_p99=np.nan))  # type: ignore[type-var]
    bare = list(stages(sample))[-1]
    unknown = replace(bare, measurements=Measurements(), provenance=Provenance(0, 3, rejects=("a",)))
    samples = [*patterns(6), bare, unknown, sample, wrecked, everything]
    for member in ("meta.json", "measures.json"):
        forms = [form(json.loads(encode_sample(one)[member])) for one in samples]
        for one in forms:
            assert isinstance(one, dict)
            one.pop("crc32", None)
        assert all(one == forms[0] for one in forms)


def test_what_the_format_cannot_hold_is_refused(sample: Sample) -> None:
    assert sample.box_mesh is not None
    for wrong in (-1, len(sample.box_mesh.vertices)):
        faces = sample.box_mesh.faces.copy()
        faces[0, 0] = wrong
        with pytest.raises(ShardError, match=f"gcd_000000012.*faces holds row {wrong} of"):
            encode_sample(replace(sample, box_mesh=replace(sample.box_mesh, faces=faces)))
    with pytest.raises(ShardError, match="gcd_000000012 cannot be stored"):
        encode_sample(replace(sample, design={"width": np.inf}))
    with pytest.raises(ConfigError, match=r"no field verst: there are meta, .*verts"):
        decode_fields(encode_sample(sample), ["verst"])


def test_pictures_are_channels_first_and_a_missing_one_is_a_valid_jpeg(sample: Sample) -> None:
    picture = jpeg_bytes(np.full((8, 24, 3), (250, 10, 10), np.uint8))
    members = encode_sample(replace(sample, front=picture, back=None))
    with Image.open(io.BytesIO(members["back.jpg"])) as image:
        assert image.size == (1, 1)
    read = decode_fields(members, ["front", "back"])
    assert (read["front"].shape, read["back"].shape) == ((3, 8, 24), (3, 0, 0))
    assert read["front"][0].mean() > 240 > 20 > read["front"][1].mean()


def section(name: str, rows: int, columns: int, kind: bytes, order: int, planes: int, body: bytes) -> bytes:
    return HEAD.pack(name.encode(), rows, columns, kind, order, planes, -9, len(body)) + body


def frame(content: bytes) -> bytes:
    return zstandard.ZstdCompressor(write_checksum=True).compress(content)


def declared(size: int) -> bytes:
    """A frame that declares a size, followed by little."""
    return b"\x28\xb5\x2f\xfd" + b"\xe0" + size.to_bytes(8, "little") + b"\x01\x00\x00"


def test_a_very_regular_mesh_is_read_again() -> None:
    """It compresses more than readers accept."""
    corners = np.arange(3, dtype=np.int32) + np.arange(500_000, dtype=np.int32)[:, None]
    packed = pack({"corners": corners, "labels": corners[:9]}, {"corners": Coding(3)})
    assert len(packed) < corners.nbytes / 100
    for name, array in (("corners", corners), ("labels", corners[:9])):
        assert np.array_equal(unpack(packed, [name])[name], array)


VERTS = section("verts", 2, 3, b"i4", 2, 1, bytes(6))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        declared(1 << 40),
        frame(bytes(1 << 24)),  # expands more than 64 times
        frame(VERTS)[:-1],
        frame(VERTS) + b"\0",
        frame(VERTS + VERTS),
        frame(section("points", 2, 3, b"i4", 2, 1, bytes(6))),
        frame(section("verts", 6, 0, b"i4", 2, 1, bytes(6))),
        frame(section("verts", 2, 3, b"i4", 0, 0, bytes(24))),
        frame(section("verts", 2, 3, b"O8", 0, 0, bytes(48))),
        frame(section("verts", 2, 3, b"i4", 7, 1, bytes(6))),
        frame(section("verts", (1 << 32) - 1, 3, b"i4", 2, 1, bytes(6))),
        frame(section("verts", (1 << 32) - 1, 65535, b"f4", 0, 0, b"")),
    ],
)
def test_damaged_and_hostile_members_are_one_sentence(sample: Sample, data: bytes) -> None:
    begin = time.process_time()
    with pytest.raises(ShardError, match=r"^member verts\.z: [^\n]*: copy its shard again") as caught:
        decode_fields({**encode_sample(sample), "verts.z": data}, ["verts"])
    assert len(str(caught.value)) < 300
    assert time.process_time() - begin < 1


@pytest.mark.parametrize("member", [member for member in MEMBERS if member.endswith(".z")])
def test_a_flipped_bit_is_found_or_changes_nothing(sample: Sample, member: str) -> None:
    members = encode_sample(sample)
    true, found = decode_fields(members), 0
    rng = np.random.default_rng(0)
    for place in rng.integers(0, len(members[member]), 60).tolist():
        damaged = bytearray(members[member])
        damaged[place] ^= 1 << int(rng.integers(8))
        try:
            read = decode_fields({**members, member: bytes(damaged)})
        except ShardError as error:
            assert str(error).startswith(f"member {member}: ")
            found += 1
        else:
            assert all(same(read[field], true[field]) for field in true)
    assert found > 50


def test_sections_that_contradict_each_other_are_one_sentence(sample: Sample) -> None:
    members = encode_sample(sample)
    mesh = dict(unpack(members["mesh.z"]))
    huge = np.full(2, 4e9, np.uint32)
    changes: list[tuple[str, dict[str, np.ndarray]]] = [
        ("faces", {"corners": mesh["corners"] + len(mesh["uv"])}),
        ("faces", {"corners": mesh["corners"] - 1}),
        ("faces", {"uv_vertex": mesh["uv_vertex"].reshape(-1, 1)}),
        ("faces", {"corners": mesh["uv"]}),
        ("panel_id", {"faces_of": huge}),
        ("panel_id", {"faces_of": mesh["uv"]}),
        ("box", {"rows_of": huge}),
        ("box", {"rows_of": mesh["rows_of"][:1]}),
        ("box", {"rows_of": np.concatenate([mesh["rows_of"], mesh["rows_of"]])}),
        ("box", {"uv_vertex": mesh["uv_vertex"][:-1]}),
        ("box", {"uv_vertex": np.where(mesh["uv_vertex"] == 5, 1 << 29, mesh["uv_vertex"])}),
    ]
    for field, change in changes:
        damaged = {**members, "mesh.z": pack({**mesh, **change}, MESH_CODINGS)}
        begin = time.process_time()
        with pytest.raises(ShardError, match=r"^member mesh\.z: [^\n]*: copy its shard again"):
            decode_fields(damaged, [field])
        assert time.process_time() - begin < 1
    later = {**members, "verts.z": pack({**unpack(members["verts.z"]), "velocity": np.zeros(3)})}  # skipped
    assert np.array_equal(decode_fields(later, ["verts"])["verts"], decode_fields(members, ["verts"])["verts"])
    pattern = dict(unpack(members["pattern.z"]))
    for place in (np.nan, np.inf, 1e300):
        panels = np.full_like(pattern["panels"], place)
        lost = decode_fields({**members, "pattern.z": pack({**pattern, "panels": panels})}, ["box"])["box"]
        assert not np.isfinite(lost).any()
    for points in ({"xyz": np.zeros((3, 2))}, {"normals": np.zeros((2, 2), np.int32)}):
        stored = dict(unpack(members["points.z"])) | points
        with pytest.raises(ShardError, match=r"^member points\.z"):
            decode_fields({**members, "points.z": pack(stored)}, ["points"])


def test_closures_and_lines_are_stored_where_there_are_any(sample: Sample) -> None:
    seams = (replace(sample.pattern.seams[0], closure=Closure.ZIP, closed=(0.3, 1.0)), sample.pattern.seams[1])
    lined = replace(sample.pattern.panels[0], lines=(InnerLine(0, 2, role=LineRole.PLACEMENT),))
    pattern = replace(sample.pattern, panels=(lined, *sample.pattern.panels[1:]), seams=seams)
    stored, plain = encode_sample(replace(sample, pattern=pattern)), encode_sample(sample)
    for read in (decode_sample(stored).pattern, decode_pattern(next(patterns_of(stored)))):
        assert (read.seams, read.panels[0].lines) == (seams, lined.lines)
    sections = unpack(stored["pattern.z"])
    assert sections["lines"].shape == (1, 16)  # as earlier versions read and wrote it
    assert "angles" not in sections
    assert not {"closures", "lines"} & unpack(plain["pattern.z"]).keys()
    fields = decode_fields(plain, ["closures", "lines"])
    assert (fields["closures"].tolist(), fields["lines"].shape) == ([[0, 0, 1], [0, 0, 1]], (0, 17))


half_degrees = st.integers(-360, 360).map(lambda number: 0.5 * number)


@given(half_degrees, half_degrees, st.sampled_from(LineRole))
def test_folds_and_the_seams_of_their_layers_survive_in_all_formats(one: float, two: float, role: LineRole) -> None:
    """Lines, rest angles, stacked seams and closures: in a specification, as tensors, and in a shard."""
    skirt, band = pleated_square().panels
    folds = (replace(line, angle=angle) for line, angle in zip(skirt.lines, (one, two), strict=True))
    skirt = replace(skirt, lines=(*folds, InnerLine(0, 5, role=role)))
    first, *others = pleated_square().seams
    seams = (replace(first, closure=Closure.ZIP, closed=(0.25, 1.0)), *others)
    pleat = replace(pleated_square(), panels=(skirt, band), seams=seams)
    *_, drawn = stages(fake_sample(1, 12))
    for read in (
        pattern_from_spec(json.loads(json.dumps(spec_from_pattern(pleat))), "pleat"),
        decode_pattern(encode_pattern(pleat)),
        decode_sample(encode_sample(replace(drawn, pattern=pleat))).pattern,
    ):
        assert read.panel("skirt").lines == skirt.lines
        assert read.seams == seams
        assert [read.layers(seam) for seam in seams] == [pleat.layers(seam) for seam in seams]


def with_maps(sample: Sample, pressure: np.ndarray) -> Sample:
    count = len(pressure)
    return replace(sample, maps=Maps(np.ones((count, 2)), np.zeros(count), pressure, softened=1.0))


def test_maps_have_a_row_for_each_vertex_and_finite_pressures(sample: Sample) -> None:
    assert sample.drape is not None
    count = len(sample.drape.vertices)
    with pytest.raises(ShardError, match=f"000012 cannot be stored: stretch has 3 rows for {count} vertices"):
        encode_sample(with_maps(sample, np.ones(3)))
    members = encode_sample(with_maps(sample, np.ones(count)))
    short = pack({**unpack(members["maps.z"]), "gap": np.zeros(3, np.float16)})
    for wanted in (["gap"], None):
        with pytest.raises(ShardError, match=rf"^member maps\.z: gap has 3 rows for {count} vertices: copy its shard"):
            decode_fields({**members, "maps.z": short}, wanted)
    pressure, stored = (np.resize([2.0, most, np.nan], count) for most in (1e6, 65504.0))
    maps = decode_sample(encode_sample(with_maps(sample, pressure))).maps
    assert maps is not None and np.array_equal(maps.pressure, stored, equal_nan=True)


def test_a_reader_after_the_documentation_finds_the_same_arrays(tmp_path: Path) -> None:
    assert len((Path(__file__).parent / "stranger.py").read_text().splitlines()) <= 100
    assert fake_sample(0, 0).box_mesh is not None
    odd = replace(fake_sample(0, 1), box_mesh=swapped(moved(turned(fake_sample(0, 1).box_mesh))))  # type: ignore[arg-type]
    samples = [fake_sample(0, 0), odd, *stages(fake_sample(0, 2)), make(0, 3, MakeConfig(stage="mesh", resolution=4.0))]
    for sample in samples:
        tar, _ = write_shard(tmp_path, [sample])
        [(key, members)] = stranger.samples(str(tar))
        ours, theirs = decode_fields(encode_sample(sample)), stranger.arrays(members)
        assert key == sample.key
        assert theirs.keys() == {field for field, member in FIELDS.items() if member.endswith(".z")}
        for name, array in theirs.items():
            assert array.dtype == ours[name].dtype, name
            assert array.shape == ours[name].shape, name
            exact = name not in ("box", "points")  # float64 there, and float32 here
            assert np.allclose(array, ours[name], rtol=0, atol=0 if exact else 2e-5), name
