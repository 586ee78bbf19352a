"""The authors' shape space, read from a file written by the test."""

import struct
from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.bodies import BodyMesh
from gcd_dataset.errors import BodyError
from gcd_dataset.release import PcaShapes, read_pca

MEAN = np.array([[0.1, -0.02, 0.0], [-0.1, -0.02, 0.0], [0.0, 0.0, 0.1], [0.0, 1.7, 0.0], [0.0, 0.9, -0.1]])  # m
VARIANCE = np.array([0.04, 0.01, 0.0])  # m²
COMPONENTS = np.linalg.qr(np.random.default_rng(0).normal(size=(15, 3)))[0].T
"""Three orthonormal vectors."""


def write_pca(
    path: Path,
    mean: np.ndarray = MEAN,
    components: np.ndarray = COMPONENTS,
    variance: np.ndarray = VARIANCE,
    header: tuple[int, int] = (15, 3),
) -> Path:
    path.write_bytes(
        struct.pack("<II", *header) + b"".join(a.astype("<f8").tobytes() for a in (components, mean, variance))
    )
    return path


@pytest.fixture
def shapes(tmp_path: Path) -> PcaShapes:
    return read_pca(write_pca(tmp_path / "point.pca"))


def test_no_weights_give_the_mean_body_on_the_floor(shapes: PcaShapes) -> None:
    assert np.allclose(shapes.vertices(np.zeros(3)), 100.0 * (MEAN + [0.0, 0.02, 0.0]))


def test_weights_count_standard_deviations(shapes: PcaShapes) -> None:
    weights = np.array([0.5, -2.0, 3.0])
    moved = MEAN.ravel() + 0.5 * 0.2 * COMPONENTS[0] - 2.0 * 0.1 * COMPONENTS[1]
    expected = 100.0 * moved.reshape(-1, 3)
    expected[:, 1] -= expected[:, 1].min()
    assert np.allclose(shapes.vertices(weights), expected)


def test_a_batch_equals_its_bodies_one_by_one(shapes: PcaShapes) -> None:
    weights = np.random.default_rng(1).normal(size=(2, 4, 3))
    batch = shapes.vertices(weights)
    assert batch.shape == (2, 4, 5, 3)
    assert np.allclose(batch[1, 2], shapes.vertices(weights[1, 2]))


def test_a_drawn_population_has_the_variances_of_the_file(shapes: PcaShapes) -> None:
    weights = np.random.default_rng(2).normal(size=(4000, 3))
    bodies = (shapes.mean + np.einsum("nk,kvi->nvi", weights, shapes.components)).reshape(4000, -1) / 100.0
    assert ((bodies - bodies.mean(axis=0)) @ COMPONENTS.T).var(axis=0) == pytest.approx(VARIANCE, rel=0.1, abs=1e-12)


def test_a_body_is_dressed_on_the_published_mesh(shapes: PcaShapes) -> None:
    faces = np.array([[0, 1, 2], [0, 3, 4]])
    body = shapes.body(np.ones(3), BodyMesh(faces, np.zeros(5, np.uint8)))
    assert np.array_equal(body.vertices, shapes.vertices(np.ones(3)))
    with pytest.raises(BodyError, match="a mesh of 4 vertices with parts for shapes of 5"):
        shapes.body(np.ones(3), BodyMesh(faces, np.zeros(4, np.uint8)))
    with pytest.raises(BodyError, match="without parts"):
        shapes.body(np.ones(3), BodyMesh(faces))
    with pytest.raises(BodyError, match=r"weights of shape \(2,\), for 3 components"):
        shapes.vertices(np.ones(2))


def test_a_git_lfs_pointer_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "point.pca"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 10000000\n")
    with pytest.raises(BodyError, match="git lfs pull"):
        read_pca(path)


@pytest.mark.parametrize("length", [0, 7, 8, 200, 487])
def test_a_truncated_file_is_reported(tmp_path: Path, length: int) -> None:
    path = write_pca(tmp_path / "point.pca")
    whole = path.read_bytes()
    assert len(whole) == 8 + 8 * (45 + 15 + 3)
    path.write_bytes(whole[:length])
    with pytest.raises(BodyError, match=rf"point\.pca: {length} bytes.*copy it again"):
        read_pca(path)


def nan_in(array: np.ndarray) -> np.ndarray:
    broken = array.copy()
    broken.flat[1] = np.nan
    return broken


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"header": (3, 15)}, "beginning with 3 and 15: not a point"),
        ({"header": (14, 3)}, "beginning with 14 and 3"),
        ({"header": (0, 0)}, "beginning with 0 and 0"),
        ({"mean": nan_in(MEAN)}, "NaN or infinity"),
        ({"components": nan_in(COMPONENTS)}, "NaN or infinity"),
        ({"components": COMPONENTS.T.copy()}, "not orthonormal"),  # transposed in the file
        ({"components": 2 * COMPONENTS}, "not orthonormal"),
        ({"variance": VARIANCE[::-1]}, "do not fall to 0"),
        ({"variance": VARIANCE - 0.02}, "do not fall to 0"),
        ({"variance": 1e4 * VARIANCE}, "moves the skin by 894 cm"),
        ({"components": 1e200 * COMPONENTS}, "not orthonormal"),
        ({"mean": 100 * MEAN}, "172 m tall"),
        ({"mean": MEAN[:, [1, 2, 0]]}, "m tall"),
    ],
)
def test_a_file_that_is_no_shape_space_is_reported(tmp_path: Path, changed: dict[str, np.ndarray], told: str) -> None:
    with pytest.raises(BodyError, match=told):
        read_pca(write_pca(tmp_path / "point.pca", **changed))  # type: ignore[arg-type]


def test_a_missing_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(BodyError, match="no such file"):
        read_pca(tmp_path / "point.pca")
