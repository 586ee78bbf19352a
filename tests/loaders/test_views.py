"""Pictures rendered when garments are read: the same for any worker, order and batch; truths follow the geometry."""

import math
import pickle
import threading
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError, TransformError
from gcd_dataset.generator.body import build_body
from gcd_dataset.generator.drawing import jpeg_bytes
from gcd_dataset.generator.render import MAPS, AppearanceRanges, PrintKind
from gcd_dataset.generator.render.pictures import VERTEX_MAPS
from gcd_dataset.loaders import (
    VIEW_FIELDS,
    Augmented,
    Chain,
    FakeGarments,
    FreshGarments,
    GarmentDataset,
    GarmentLoader,
    MixedDataset,
    PublishedGarmentCodeData,
    Scan,
    Sketch,
    Views,
    Yaw,
    collate_list,
    collate_packed,
    collate_padded,
)
from gcd_dataset.records import Sample
from gcd_dataset.shards import ShardReader
from tests.loaders.rendered import COUNT, SEED, SIZE, write_mapped
from tests.loaders.test_shards import same
from tests.release.published import RELEASE, publish


def dataset(worn_folder: Path, **options: Any) -> GarmentDataset:
    return GarmentDataset(worn_folder, fields=VIEW_FIELDS, **options)


def small(**options: Any) -> Views:
    return Views(**{"n": 1, "size": SIZE, "seed": SEED, "device": "cpu", **options})


def pictures(batches: Any) -> dict[int, torch.Tensor]:
    """Number of the garment to its pictures."""
    found: dict[int, torch.Tensor] = {}
    for batch in batches:
        metas = [item["meta"] for item in batch] if isinstance(batch, list) else batch["meta"]
        views = [item["views"] for item in batch] if isinstance(batch, list) else batch["views"]
        found |= {meta["index"]: picture for meta, picture in zip(metas, views, strict=True)}
    return found


@pytest.fixture(scope="module")
def first_epoch(worn_folder: Path) -> dict[int, torch.Tensor]:
    """The pictures of epoch 0, each garment rendered alone."""
    views = small()
    return {item["meta"]["index"]: item["views"] for item in map(views, dataset(worn_folder))}


def test_stored_views_are_those_rendered_from_the_shards(worn_folder: Path) -> None:
    reader, views = ShardReader(worn_folder), small(n=2)
    for number, item in enumerate(dataset(worn_folder)):
        rendered = views(item)
        for view, picture, k, rt in zip(
            reader.sample(number).views, rendered["views"], rendered["camera_k"], rendered["camera_rt"], strict=True
        ):
            assert view.picture == jpeg_bytes(picture.numpy())
            assert np.array_equal(np.float32(view.facts["camera"]["k"]), k)
            assert np.array_equal(np.float32(view.facts["camera"]["rt"]), rt)


@pytest.mark.parametrize(("workers", "collate", "seed"), [(0, collate_padded, 0), (2, collate_list, 1)])
def test_pictures_depend_on_epoch_and_garment_alone(
    worn_folder: Path, first_epoch: dict[int, torch.Tensor], workers: int, collate: Any, seed: int
) -> None:
    views = small()
    loader = GarmentLoader(dataset(worn_folder), 2, seed=seed, num_workers=workers, collate_fn=collate, views=views)
    assert same(pictures(loader), first_epoch)
    second = pictures(loader)
    assert not any(torch.equal(second[number], first_epoch[number]) for number in second)
    views.set_epoch(1)
    assert torch.equal(second[1], views(dataset(worn_folder)[1])["views"])


def test_other_data_sets_have_other_pictures_at_the_same_number(worn_folder: Path) -> None:
    """Data sets of another seed, or of the same seed and another recipe; not those on another device."""
    item = dataset(worn_folder)[0]
    meta, views = item["meta"], small()
    for change in ({"seed": SEED + 1}, {"recipe": {**meta["recipe"], "resolution": 3.0}}):
        assert not torch.equal(views({**item, "meta": {**meta, **change}})["views"], views(item)["views"])
    elsewhere = {**item, "meta": {**meta, "recipe": {**meta["recipe"], "device": "cuda", "captions": True, "views": 9}}}
    assert torch.equal(views(elsewhere)["views"], views(item)["views"])


def test_a_resumed_loader_renders_the_rest_of_the_epoch_as_before(worn_folder: Path) -> None:
    loader = GarmentLoader(dataset(worn_folder), 1, views=small())
    list(loader)
    begun = iter(loader)
    received = pictures([next(begun)])
    state = loader.state_dict()
    assert state["position"] == COUNT + 1  # received, not rendered ahead
    rest = pictures(begun)
    other = GarmentLoader(dataset(worn_folder), 2, views=small())
    other.load_state_dict(state)
    assert same(pictures(other), rest)
    assert received.keys() | rest.keys() == set(range(COUNT))


def test_a_transform_renders_the_same_when_pickled(worn_folder: Path, first_epoch: dict[int, torch.Tensor]) -> None:
    """As for a spawned worker."""
    ds = pickle.loads(pickle.dumps(dataset(worn_folder, transform=small())))
    assert torch.equal(ds[1]["views"], first_epoch[1])


def test_batches_of_a_plain_data_loader(worn_folder: Path, first_epoch: dict[int, torch.Tensor]) -> None:
    loader = DataLoader(dataset(worn_folder), batch_size=2, collate_fn=collate_packed)
    assert same(pictures(small().batches(loader)), first_epoch)
    assert not torch.equal(pictures(small().batches(loader, epoch=1))[0], first_epoch[0])
    stacked = DataLoader(dataset(worn_folder), batch_size=1, collate_fn=tuple)
    with pytest.raises(ConfigError, match="views of a tuple: give collate_packed"):
        list(small().batches(stacked))


def test_a_packed_batch_gives_each_garment_back(worn_folder: Path) -> None:
    views, items = small(maps=("depth", "uv")), list(dataset(worn_folder))[1:]
    for added, batch in ((views, collate_packed(items)), (views, collate_packed([views(item) for item in items]))):
        batch = added.add_to_batch(batch, [0] * len(items))
        for number, item in enumerate(items):
            expected, found = views(item), batch.garment(number)
            assert found.keys() == expected.keys()
            for name, value in expected.items():
                equal = same if name != "uv_map" else partial(torch.allclose, equal_nan=True)
                assert equal(found[name], value), name


@pytest.fixture(scope="module")
def mapped(worn: list[Sample], tmp_path_factory: pytest.TempPathFactory) -> GarmentDataset:
    folder = write_mapped(tmp_path_factory.mktemp("mapped"), worn)
    return GarmentDataset(folder, fields=(*VIEW_FIELDS, "stretch", "gap", "pressure"))


def test_maps_of_vertices_are_those_of_the_point_that_a_pixel_shows(mapped: GarmentDataset) -> None:
    views, batches = small(n=2, maps=("depth", *VERTEX_MAPS)), []
    for collate in (collate_packed, collate_padded, collate_list):
        [batch] = views.batches(DataLoader(mapped, batch_size=COUNT, collate_fn=collate))
        names = ("depth_map", "gap_map", "stretch_map", "pressure_map", "camera_k", "camera_rt")
        is_list = isinstance(batch, list)
        batches.append({name: torch.stack([g[name] for g in batch]) if is_list else batch[name] for name in names})
    first = batches[0]
    for name, value in first.items():
        assert all(torch.equal(value.nan_to_num(-1.0), other[name].nan_to_num(-1.0)) for other in batches), name
    row, column = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    seen = (
        torch.stack([column, row, torch.ones_like(row)]).reshape(3, -1).float()
        * first["depth_map"].flatten(2)[:, :, None]
    )
    RT = first["camera_rt"]
    points = RT[..., :3].mT @ (first["camera_k"].inverse() @ seen - RT[..., 3:])
    height, gap = points[:, :, 1], first["gap_map"].flatten(2)
    on_cloth = ~gap.isnan()
    assert on_cloth.sum() > 1000
    assert (gap - height)[on_cloth].abs().max() < 0.1  # float16 in shards
    assert torch.equal(first["stretch_map"][..., 0].flatten(2)[on_cloth], gap[on_cloth])
    assert (first["pressure_map"].flatten(2)[on_cloth] == 0.0).all()


def test_maps_of_a_data_set_without_maps_are_refused(worn_folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"gcd_000000000 has no gap for maps of Views: .*gcd generate --maps"):
        small(maps=("gap",))(dataset(worn_folder)[0])
    with pytest.raises(ConfigError, match=r"no field gap: .*; gcd generate --maps"):
        GarmentDataset(worn_folder, fields=(*VIEW_FIELDS, "gap"))


def test_padding_of_invisible_corners_is_invisible(worn_folder: Path) -> None:
    batch = small().add_to_batch(collate_padded(list(dataset(worn_folder))), [0] * COUNT)
    mask = batch["panel_corner_visible_mask"]
    assert not mask.all()
    assert not batch.panel_corner_visible[~mask].any()
    assert (batch.panel_corners[~mask] == -1).all()


def test_visible_corners_lie_where_the_cameras_project_them(worn_folder: Path) -> None:
    views = small(n=3, size=128, maps=("depth", "panel_id"))
    item = views(dataset(worn_folder)[0])
    K, RT = item["camera_k"].double(), item["camera_rt"].double()
    panels = item["spec"]["pattern"]["panels"]
    names = item["meta"]["panel_names"]
    uv, vertices, gaps = item["uv"], item["verts"].double(), []
    for row, (panel, corner) in enumerate(item["panel_corners"].tolist()):
        flat = torch.tensor(panels[names[panel]]["vertices"][corner])
        of_panel = item["corners"][item["panel_id"] == panel].unique()
        at = of_panel[(uv[of_panel] - flat).norm(dim=1).argmin()]
        point = vertices[item["uv_vertex"][at]]
        for view in range(views.n):
            x = K[view] @ (RT[view, :, :3] @ point + RT[view, :, 3])
            assert torch.allclose(item["panel_corner_pixels"][row, view].double(), x[:2] / x[2], atol=1e-3)
            if item["panel_corner_visible"][row, view]:
                column, line = (x[:2] / x[2]).round().long().tolist()
                near = item["depth_map"][view, max(line - 1, 0) : line + 2, max(column - 1, 0) : column + 2]
                gaps.append((near - x[2]).abs().min())
    assert len(gaps) > 3
    assert np.median(gaps) < 0.5
    assert np.mean(np.array(gaps) < 2.0) > 0.9  # at a silhouette no centre of a pixel may lie on the cloth
    assert set(item["panel_id_map"].unique().tolist()) <= {-1, *range(len(names))}


def test_landmarks_have_one_order_for_all_bodies(worn_folder: Path) -> None:
    views = small()
    item = views(dataset(worn_folder)[1])
    assert item["landmark_pixels"].shape == (1, len(views.landmark_names), 2)
    assert item["landmark_visible"].any()
    assert item["keypoints"].shape == (1, 17, 3)
    assert item["keypoints"].any()


def test_a_wearer_without_weights_is_drawn_again_or_given(worn_folder: Path, worn: list[Sample]) -> None:
    item = dataset(worn_folder)[1]
    shown = small()(item)["views"]
    without = {name: value for name, value in item.items() if name != "body"}
    assert torch.equal(small()(without)["views"], shown)
    published = {**without, "meta": {**item["meta"], "pose": None, "body": "00345_straight"}}
    with pytest.raises(ConfigError, match="no shape weights of its wearer, 00345_straight: read the field body too"):
        small()(published)
    asked = []

    def body_of(name: str) -> Any:
        asked.append(name)
        body = build_body(worn[1].shape)  # type: ignore[arg-type]
        return replace(body, vertices=np.concatenate([body.vertices, np.zeros((1, 3))]), parts=np.append(body.parts, 0))

    given = small(bodies=body_of)(published)
    assert asked == ["00345_straight"]
    assert given["views"].shape == shown.shape
    assert given["landmark_pixels"].isnan().all()
    assert not given["landmark_visible"].any()
    assert not given["keypoints"].any()


def test_every_use_of_a_fresh_garment_has_its_own_pictures(worn_folder: Path) -> None:
    def loader() -> GarmentLoader:
        fresh = FreshGarments(dataset(worn_folder), replay=2, room=2)
        return GarmentLoader(fresh, 2, shuffle=False, views=small())

    batches = list(loader())
    shown = [picture for batch in batches for picture in batch["views"]]
    assert len(shown) == 2 * COUNT
    assert len({picture.numpy().tobytes() for picture in shown}) == 2 * COUNT
    first = loader()
    begun = iter(first)
    next(begun)
    again = loader()
    again.load_state_dict(first.state_dict())
    for batch, other in zip(again, batches[1:], strict=True):
        assert torch.equal(batch["views"], other["views"])


def test_garments_that_a_mixture_repeats_look_different_each_time(worn_folder: Path) -> None:
    mixed = MixedDataset([dataset(worn_folder), dataset(worn_folder)[:1]], [1, 1])
    shown = []
    for workers in (0, 1):
        loader = GarmentLoader(mixed, 2, num_workers=workers, views=small(size=32))
        shown.append([(m["index"], p) for batch in loader for m, p in zip(batch["meta"], batch["views"], strict=True)])
    here, there = shown
    assert len({number for number, _ in here}) < len(here) == len({p.numpy().tobytes() for _, p in here})
    assert all(torch.equal(p, q) for (_, p), (_, q) in zip(here, there, strict=True))


def test_a_turned_figure_is_not_rendered_beside_its_wearer(worn_folder: Path) -> None:
    """``Yaw`` turns the cloth; the wearer, built from shape weights, would stay."""
    for user in (small(size=16), Scan(size=16, points=4), Sketch(size=16)):
        name = type(user).__name__
        with pytest.raises(TransformError, match=f"turned by Yaw before {name}, .*: apply {name} before Yaw"):
            Augmented(dataset(worn_folder), Chain(Yaw(), user))[0]
    item = Augmented(dataset(worn_folder), Chain(small(size=16), Yaw()))[0]
    plain = Augmented(dataset(worn_folder), small(size=16))[0]
    assert not torch.allclose(item["camera_rt"], plain["camera_rt"])


def test_appearances_keep_to_their_ranges(worn_folder: Path) -> None:
    plain = small(appearance=AppearanceRanges(prints=(), plain=1.0, tones=(2,)))
    striped = small(appearance=AppearanceRanges(prints=(PrintKind.STRIPES,), plain=0.0, tones=(2,)))
    pairs = [(plain(item), striped(item)) for item in dataset(worn_folder)]
    assert any(not torch.equal(one["views"], other["views"]) for one, other in pairs)  # some cloth takes no print
    assert all(torch.equal(one["camera_rt"], other["camera_rt"]) for one, other in pairs)


def test_an_image_on_a_panel_changes_that_panel_alone(worn_folder: Path, tmp_path: Path) -> None:
    item = dataset(worn_folder)[0]
    plain = small(n=4)(item)
    panel = plain["panel_id_map"].max()
    Image.new("RGB", (4, 4), (0, 255, 0)).save(tmp_path / "green.png")
    shown = small(n=4, textures={item["meta"]["panel_names"][int(panel)]: tmp_path / "green.png"})(item)
    is_changed = (shown["views"] != plain["views"]).any(dim=-1)
    assert is_changed[plain["panel_id_map"] == panel].float().mean() > 0.9
    assert is_changed[plain["panel_id_map"] != panel].float().mean() < 0.1  # pixels on its border
    with pytest.raises(TransformError, match="gcd_000000000 has no panel nothing for a texture: it has"):
        dataset(worn_folder, transform=small(textures={"nothing": tmp_path / "green.png"}))[0]


def test_what_an_item_lacks_is_named_at_once(worn_folder: Path) -> None:
    flat = {**dataset(worn_folder)[0], "verts": torch.zeros(0, 3)}
    with pytest.raises(ConfigError, match="gcd_000000000 has no verts: Views renders draped garments"):
        small()(flat)
    lost = {**dataset(worn_folder)[0], "verts": torch.full((5, 3), torch.nan)}
    with pytest.raises(ConfigError, match="its drape diverged"):
        small()(lost)
    with pytest.raises(ConfigError, match="8 shape weights, the body model takes"):
        small()(FakeGarments(1)[0])


@pytest.mark.parametrize(
    ("transform", "field", "empty"),
    [(small(maps=MAPS), "views", 0), (Scan(points=9, size=32), "scan", math.nan), (Sketch(size=32), "sketch", 255)],
)
def test_a_garment_that_was_not_draped_has_an_empty_picture(
    worn_folder: Path, transform: Any, field: str, empty: float
) -> None:
    """The flat panels are not shown as if they were worn; a batch has the same fields and types as any other."""
    item = dataset(worn_folder)[0]
    drape = {**item["meta"]["drape"], "outcome": "CANNOT_BE_PUT_ON"}
    drawn, undraped = transform(item), transform({**item, "meta": {**item["meta"], "drape": drape}})
    assert torch.equal(undraped[field], torch.full_like(drawn[field], empty)) or undraped[field].isnan().all()
    batch = collate_packed([drawn, undraped])
    assert all(isinstance(batch[name], torch.Tensor) for name in drawn.keys() - item.keys())


def test_fake_garments_are_rendered_on_a_given_body(worn: list[Sample]) -> None:
    wearer = build_body(worn[0].shape)  # type: ignore[arg-type]
    [batch] = GarmentLoader(FakeGarments(2), 2, views=small(bodies=lambda name: wearer))
    assert batch["views"].shape == (2, 1, SIZE, SIZE, 3)


def test_views_beyond_the_memory_of_one_rendering_are_the_same(
    worn_folder: Path, first_epoch: dict[int, torch.Tensor], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("gcd_dataset.loaders.views", "gcd_dataset.generator.render.casting"):
        monkeypatch.setattr(f"{module}.PIXELS", SIZE**2)
    assert torch.equal(small()(dataset(worn_folder)[0])["views"], first_epoch[0])


def test_a_gpu_is_refused_in_a_worker(worn_folder: Path) -> None:
    views = small()
    views.device = "cuda:0"
    loader = DataLoader(dataset(worn_folder, transform=views), batch_size=1, num_workers=1, collate_fn=collate_list)
    with pytest.raises(TransformError, match=r"Views on cuda:0 in a worker process.*GarmentLoader\(views=Views"):
        next(iter(loader))


def test_a_loop_that_ends_early_leaves_no_thread(worn_folder: Path) -> None:
    begun = iter(GarmentLoader(dataset(worn_folder), 1, views=small()))
    assert len(list(islice(begun, 1))) == 1
    begun.close()  # type: ignore[attr-defined]
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("gcd-views")]


def test_published_garments_are_rendered_on_given_bodies_also_in_a_mixture(
    worn_folder: Path, worn: list[Sample], tmp_path: Path
) -> None:
    fields = [field for field in VIEW_FIELDS if field != "body"]
    published = PublishedGarmentCodeData(publish(tmp_path), fields=fields)
    with pytest.raises(TransformError, match=r"wearer, mean_all: read the field body too, or for published"):
        PublishedGarmentCodeData(tmp_path / RELEASE, fields=fields, transform=small())[0]
    wearer = build_body(worn[0].shape)  # type: ignore[arg-type]
    views = small(size=24, bodies=lambda name: wearer)
    mixed = MixedDataset([published[:2], GarmentDataset(worn_folder, fields=fields)[:1]], [1, 1])
    [batch] = GarmentLoader(mixed, len(mixed), views=views)
    assert batch["views"].shape == (len(mixed), 1, 24, 24, 3)
    own = {meta["index"]: use for use, meta in enumerate(batch["meta"]) if meta["pose"] is not None}
    assert own
    for number, use in own.items():
        expected = views.add_to_items([dataset(worn_folder)[number]], [use])[0]["views"]
        assert torch.equal(batch["views"][use], expected)
