"""Encoding and decoding of samples."""

import io
import json
import zlib
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.generator.drape import fabric_named
from gcd_dataset.generator.points import sample_surface
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import MEASURES, Grade, Measurements, NamedFabric, Outcome, Provenance, Sample, Strain, View
from gcd_dataset.shards import FIELDS, MEMBERS, ShardReader, decode_fields, decode_sample, encode_sample
from gcd_dataset.shards.codec import NO_PICTURE
from gcd_dataset.shards.layout import garments_layout
from gcd_dataset.shards.npy import read_npy, write_npy
from tests.shards.real import first_schema, patterns


@pytest.fixture
def sample() -> Sample:
    return fake_sample(seed=1, index=12)


def stages(sample: Sample) -> Iterator[Sample]:
    """The sample after ``--stage`` drape, mesh and pattern."""
    yield sample
    yield replace(sample, drape=None, front=None, back=None)
    yield replace(sample, shape=None, box_mesh=None, drape=None, points=None, front=None, back=None)


def test_equal_samples_have_equal_bytes() -> None:
    assert encode_sample(fake_sample(1, 12)) == encode_sample(fake_sample(1, 12))
    assert encode_sample(fake_sample(1, 12)) != encode_sample(fake_sample(2, 12))


def test_every_stage_has_the_same_members(sample: Sample) -> None:
    for stage in stages(sample):
        assert tuple(encode_sample(stage)) == MEMBERS


def test_decoding_gives_the_record_back_to_the_stored_precision(sample: Sample) -> None:
    assert sample.box_mesh is not None
    assert sample.drape is not None
    assert sample.points is not None
    exact = replace(
        sample,
        box_mesh=replace(
            sample.box_mesh,
            vertices=sample.box_mesh.vertices.astype(np.float32),
            uv=sample.box_mesh.uv.astype(np.float32),
        ),
        drape=replace(sample.drape, vertices=sample.drape.vertices.astype(np.float32)),
        points=decode_fields(encode_sample(sample), ["points"])["points"].astype(float),
    )
    for stage in stages(exact):
        again = decode_sample(encode_sample(stage))
        assert [f.name for f in fields(stage) if not same(getattr(stage, f.name), getattr(again, f.name))] == []


def same(a: object, b: object) -> bool:
    return np.array_equal(a, b) if isinstance(a, np.ndarray) and isinstance(b, np.ndarray) else a == b


def test_a_second_round_trip_changes_no_byte(sample: Sample) -> None:
    for stage in stages(sample):
        members = encode_sample(stage)
        assert encode_sample(decode_sample(members)) == members


def test_a_diverged_drape_is_stored(sample: Sample) -> None:
    assert sample.drape is not None
    wrecked = replace(sample.drape, vertices=np.full((3, 3), np.nan), outcome=Outcome.DIVERGED, stretch_p99=np.nan)
    again = decode_sample(encode_sample(replace(sample, drape=wrecked))).drape
    assert again is not None
    assert np.isnan(again.stretch_p99)
    assert replace(again, stretch_p99=0.0) == replace(wrecked, stretch_p99=0.0)


def test_meta_names_the_hash_of_every_other_member(sample: Sample) -> None:
    members = encode_sample(sample)
    crc = json.loads(members["meta.json"])["crc32"]
    assert crc == {name: zlib.crc32(members[name]) for name in MEMBERS[1:]}


def test_points_of_a_real_garment_are_stored_to_a_twentieth_of_a_millimetre(tmp_path: Path) -> None:
    drape = ShardReader(first_schema(tmp_path) / "drapes").sample(0)
    assert drape.box_mesh is not None
    assert drape.drape is not None
    for surface in (drape.drape.vertices, drape.box_mesh.vertices):
        points = sample_surface(surface, drape.box_mesh.faces, 4000, np.random.default_rng(0))
        members = encode_sample(replace(drape, points=points))
        read = decode_fields(members, ["points"])["points"]
        assert read.dtype == np.float32
        assert np.abs(read[:, :3] - points[:, :3]).max() < 0.005
        assert np.abs(read[:, 3:] - points[:, 3:]).max() < 1e-4
        assert np.linalg.norm(read[:, 3:], axis=1) == pytest.approx(1.0, abs=1e-4)
        assert len(np.unique(read[:, 1])) > 2000  # distinct heights; absolute 16-bit floats had 264 among 8192


@pytest.mark.parametrize("count", [1, 127, 128, 129, 400])
def test_any_number_of_points_is_decoded(sample: Sample, count: int) -> None:
    points = np.random.default_rng(count).normal(size=(count, 6)) * [30, 30, 30, 0.5, 0.5, 0.5] + [0, 90, 0, 0, 0, 0]
    read = decode_fields(encode_sample(replace(sample, points=points)), ["points"])["points"]
    assert np.abs(read[:, :3] - points[:, :3]).max() < 0.005
    assert np.allclose(read[:, 3:], np.clip(points[:, 3:], -1, 1), atol=1e-4)


def test_nan_points_stay_nan(sample: Sample) -> None:
    assert sample.points is not None
    points = sample.points.copy()
    points[3, 1], points[5, 4] = np.nan, np.inf
    read = decode_fields(encode_sample(replace(sample, points=points)), ["points"])["points"]
    assert np.flatnonzero(np.isnan(read).any(axis=1)).tolist() == [3, 5]
    whole = np.isfinite(points).all(axis=1)
    assert np.abs(read[whole, :3] - points[whole, :3]).max() < 0.005
    nothing = encode_sample(replace(sample, points=np.full((7, 6), np.nan)))
    assert np.isnan(decode_fields(nothing, ["points"])["points"]).all()


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
        views=(View(sample.front, {"camera": [0.0, 1.0]}), View(sample.front, {"light": {"from": "left"}})),
    )


def test_optional_members_and_entries_are_decoded(sample: Sample) -> None:
    members = encode_sample(full(sample))
    assert tuple(members) == garments_layout(caption=True, views=2).members
    again = decode_sample(members)
    for name in ("provenance", "drape", "grade", "fabric", "gathers", "tags", "caption", "views"):
        if name == "drape":
            assert again.drape is not None
            assert again.drape.strain == full(sample).drape.strain  # type: ignore[union-attr]
        else:
            assert getattr(again, name) == getattr(full(sample), name)
    fields = decode_fields(members)
    assert fields["caption"] == full(sample).caption
    assert (fields["view_0"].shape, fields["view_1_json"]) == ((3, 16, 16), {"light": {"from": "left"}})


def test_a_sample_with_an_older_wording_of_a_source_is_read_unchanged(sample: Sample) -> None:
    """Samples store the text of their fabric's source; the text of a release need not be the present one."""
    old = replace(fabric_named("interlock"), source="thickness: not published, left at what the solver keeps")
    stored = replace(sample, fabric=NamedFabric("interlock", {"source": old.source, "thickness": old.thickness}))
    assert old.source != fabric_named("interlock").source
    assert decode_sample(encode_sample(stored)).fabric == stored.fabric


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


def test_all_measures_are_stored_in_the_units_of_files(sample: Sample) -> None:
    members = encode_sample(sample)
    assert len(json.loads(members["measures.json"])) == len(MEASURES)
    assert decode_fields(members, ["measures"])["measures"] == sample.measurements.to_file_values()


def test_numpy_reads_the_arrays(sample: Sample) -> None:
    members = encode_sample(sample)
    loaded = decode_fields(members)
    for field, member in FIELDS.items():
        if member.endswith(".npy"):
            array = np.load(io.BytesIO(members[member]), allow_pickle=False)
            frame = loaded["meta"]["points"]
            if field == "points":
                array = array * np.repeat([frame["scale"], frame["normal_scale"]], 3)
                array = array + np.array([*frame["centre"], 0, 0, 0])
            assert np.allclose(array, loaded[field], rtol=0, atol=1e-4 if field == "points" else 0)


def test_faces_take_two_bytes_below_65536_vertices() -> None:
    for count, dtype in ((65_536, np.uint16), (65_537, np.uint32)):
        sample = fake_sample(0, 0)
        assert sample.box_mesh is not None
        padding = np.zeros((count - len(sample.box_mesh.vertices), 3))
        mesh = replace(sample.box_mesh, vertices=np.concatenate([sample.box_mesh.vertices, padding]))
        assert read_npy(encode_sample(replace(sample, box_mesh=mesh))["faces.npy"]).dtype == dtype


def test_a_face_without_its_vertex_is_refused(sample: Sample) -> None:
    assert sample.box_mesh is not None
    for wrong in (-1, len(sample.box_mesh.vertices)):
        faces = sample.box_mesh.faces.copy()
        faces[0, 0] = wrong
        with pytest.raises(ShardError, match=f"gcd_000000012.*faces holds row {wrong} of"):
            encode_sample(replace(sample, box_mesh=replace(sample.box_mesh, faces=faces)))


def test_numbers_that_json_cannot_hold_are_refused(sample: Sample) -> None:
    with pytest.raises(ShardError, match="gcd_000000012 cannot be stored"):
        encode_sample(replace(sample, design={"width": np.inf}))


def test_a_missing_picture_is_stored_as_a_valid_jpeg(sample: Sample) -> None:
    members = encode_sample(replace(sample, front=None))
    with Image.open(io.BytesIO(members["front.jpg"])) as image:
        assert image.size == (1, 1)
    assert members["front.jpg"] == NO_PICTURE
    assert decode_fields(members, ["front"])["front"].shape == (3, 0, 0)


def test_pictures_are_channels_first(sample: Sample) -> None:
    picture = Image.new("RGB", (24, 8), (250, 10, 10))
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=95)
    front = decode_fields(encode_sample(replace(sample, front=file.getvalue())), ["front"])["front"]
    assert front.shape == (3, 8, 24)
    assert front[0].mean() > 240 > 20 > front[1].mean()


def test_an_unknown_field_is_reported_with_the_known_ones(sample: Sample) -> None:
    with pytest.raises(ConfigError, match=r"no field verst: there are meta, .*verts"):
        decode_fields(encode_sample(sample), ["verst"])


@pytest.mark.parametrize("dtype", ["u1", "<u2", ">f4", "f8", "?", "f2", "i8"])
@pytest.mark.parametrize("shape", [(), (0,), (5,), (2, 3), (0, 3), (2, 3, 4), 30 * (1,)])
def test_npy_round_trip(dtype: str, shape: tuple[int, ...]) -> None:
    array = (np.arange(np.prod(shape)).reshape(shape) % 2).astype(dtype)
    file = write_npy(array)
    assert np.array_equal(read_npy(file), array)
    assert np.array_equal(np.load(io.BytesIO(file), allow_pickle=False), array)
    assert (len(file) - array.nbytes) % 64 == 0


def test_npy_refuses_object_arrays_and_truncated_files() -> None:
    with pytest.raises(ShardError, match="only numbers"):
        write_npy(np.array([{}]))
    with pytest.raises(ShardError, match="bytes for float64 of shape"):
        read_npy(write_npy(np.zeros(4))[:-1])
    pickled = io.BytesIO()
    np.save(pickled, np.array([{}]), allow_pickle=True)
    with pytest.raises(ShardError, match="another writer"):
        read_npy(pickled.getvalue())
