"""``FakeGarments``: valid, distinct and reproducible."""

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError
from gcd_dataset.faults import check_pattern
from gcd_dataset.loaders import FakeGarments
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards.codec import encode_sample


def test_the_pattern_can_be_sewn() -> None:
    for index in range(5):
        assert check_pattern(fake_sample(0, index).pattern) == ()


def test_the_tube_is_open_at_two_ends_only() -> None:
    mesh = fake_sample(0, 1).box_mesh
    assert mesh is not None
    edges = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert set(count) == {1, 2}
    euler = len(mesh.vertices) - len(count) + len(mesh.faces)
    assert euler == 0  # Euler characteristic of a cylinder
    rows = len(mesh.seams) // 2
    assert (count == 1).sum() == 2 * (len(mesh.vertices) // rows)


def test_faces_look_outward_and_keep_their_area() -> None:
    sample = fake_sample(0, 2)
    assert sample.drape is not None
    assert sample.box_mesh is not None
    a, b, c = (sample.drape.vertices[sample.box_mesh.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    assert (np.einsum("fi,fi->f", normal, (a + b + c) * [1, 0, 1]) > 0).all()
    u, v, w = (sample.box_mesh.uv[sample.box_mesh.corners[:, k]] for k in range(3))
    flat = np.linalg.det(np.stack([v - u, w - u], axis=1))
    assert (flat > 0).all()
    assert np.linalg.norm(normal, axis=1).sum() < flat.sum()  # chords are shorter than arcs


def test_garments_differ_and_are_reproducible() -> None:
    ds = FakeGarments(4, seed=1)
    assert len({ds[i]["measures"]["waist"] for i in range(4)}) == 4
    assert encode_sample(fake_sample(1, 2)) == encode_sample(fake_sample(1, 2))
    ds.verify(2)


def test_arguments_are_checked_at_once() -> None:
    with pytest.raises(ConfigError, match="n=-2"):
        FakeGarments(-2)
    with pytest.raises(ConfigError, match="seed=-1"):
        FakeGarments(2, seed=-1)
    assert len(FakeGarments(int(np.int64(2)))) == 2
