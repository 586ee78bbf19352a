"""Silhouettes of a garment in pictures, and its drape as their cameras see it."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gcd_dataset.errors import ConfigError, DrapeError, SpecError
from gcd_dataset.generator import Fitting
from gcd_dataset.generator.body import named_body
from gcd_dataset.generator.drawing import png_bytes
from gcd_dataset.generator.garments import GarmentDesign, design_from_dict
from gcd_dataset.generator.jacobian import Draped, Worn
from gcd_dataset.generator.render import Camera, look_at, scene_of
from gcd_dataset.generator.render.scans import Ranger
from gcd_dataset.generator.silhouettes import Silhouettes, write_cut_outs
from gcd_dataset.records import Body, BoxMesh

PIXELS = 200
CAMERAS = (
    look_at(np.array([30.0, 120.0, 300.0]), np.array([0.0, 70.0, 0.0]), focal=2.0, shift=(0.1, -0.05)),
    look_at(np.array([320.0, 60.0, 0.0]), np.array([0.0, 70.0, 0.0]), focal=2.0, roll=0.1),
)


def cut_out(folder: Path, mesh: BoxMesh, vertices: np.ndarray, body: Body) -> None:
    """Write pictures of a garment, cut out, and their cameras."""
    with Ranger(scene_of(mesh, vertices, body), device="cpu") as ranger:
        masks = np.stack([image.garment for image in ranger.images(CAMERAS, PIXELS)])
    pictures = np.broadcast_to(np.where(masks[..., None], 90, 200), (*masks.shape, 3)).astype(np.uint8)
    K = np.stack([camera.intrinsics(PIXELS) for camera in CAMERAS])
    write_cut_outs(folder, pictures, masks, K, np.stack([camera.extrinsics() for camera in CAMERAS]))


@pytest.fixture(scope="module")
def worn() -> Worn:
    """A skirt before its drape."""
    body, size, _ = named_body("neutral")
    found = Fitting(body, size, resolution=6.0).worn(design_from_dict({"meta": {"bottom": "PencilSkirt"}}))
    assert found is not None
    return found


@pytest.fixture
def pictures(worn: Worn, tmp_path: Path) -> Path:
    cut_out(tmp_path, worn.job.box_mesh, worn.job.box_mesh.vertices, worn.job.body)
    return tmp_path


def overlaps(folder: Path, worn: Worn, *, up: float = 0.0) -> list[float]:
    mesh, target = worn.job.box_mesh, Silhouettes.read(folder, device="cpu")
    return list(target.overlaps(mesh, mesh.vertices + [0.0, up, 0.0], worn.job.body))


def test_a_garment_covers_its_own_silhouettes(worn: Worn, pictures: Path) -> None:
    assert min(overlaps(pictures, worn)) > 0.97
    assert max(overlaps(pictures, worn, up=10.0)) < 0.85


def test_what_a_picture_does_not_show_does_not_count(worn: Worn, pictures: Path) -> None:
    """Pictures whose lower part, with the hem, is cut off: the camera's numbers stay."""
    for path in pictures.glob("*.png"):
        with Image.open(path) as image:
            image.crop((0, 0, PIXELS, PIXELS // 2)).save(path)
    assert min(overlaps(pictures, worn)) > 0.97


def test_the_camera_of_its_matrices() -> None:
    for camera in CAMERAS:
        K, rt = camera.intrinsics(PIXELS), camera.extrinsics()
        found = Camera.of(K, rt, PIXELS)
        assert np.allclose(found.intrinsics(777), camera.intrinsics(777))
        assert np.allclose(found.extrinsics(), rt)
        for k, pose in ((K * [[1], [1.1], [1]], rt), (K + np.eye(3, k=1) * 9, rt), (-K, rt), (K, -rt), (K, 100 * rt)):
            with pytest.raises(ConfigError):
                Camera.of(k, pose, PIXELS)


def test_cameras_in_metres_see_no_garment(worn: Worn, pictures: Path) -> None:
    for path in pictures.glob("*.json"):
        camera = json.loads(path.read_text())["camera"]
        rt = np.array(camera["rt"]) * [1, 1, 1, 0.01]
        path.write_text(json.dumps({"camera": {**camera, "rt": rt.tolist()}}))
    drape: Any = SimpleNamespace(vertices=worn.job.box_mesh.vertices)
    with pytest.raises(DrapeError, match="the cameras see no drape where the pictures show the garment"):
        Silhouettes.read(pictures, device="cpu").distances([Draped(GarmentDesign(), worn, drape)], lambda *_: [])


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("1.json", None, r"1\.json: missing: .* give its k and rt, in centimetres"),
        ("1.json", b'{"camera": {"k": [[1, 0, 0]], "rt": []}}', r"1\.json: k and rt must have 3 rows each"),
        ("1.json", b'{"k": 1}', r"1\.json: camera must be a JSON object"),
        ("0.png", b"no picture", r"0\.png: cannot be read"),
        ("0.png", png_bytes(np.zeros((9, 9, 3), np.uint8)), r"0\.png: no garment cut out"),
        ("*.png", None, r"no pictures: give NAME\.png"),
    ],
)
def test_pictures_without_silhouettes_or_cameras_are_refused(
    pictures: Path, name: str, content: bytes | None, told: str
) -> None:
    for path in pictures.glob(name):
        path.write_bytes(content) if content else path.unlink()
    with pytest.raises((ConfigError, SpecError), match=told):
        Silhouettes.read(pictures)
