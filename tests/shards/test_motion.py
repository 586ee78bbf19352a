"""Garments in motion: what is read is what was written, small, and damage is named."""

from collections.abc import Callable

import numpy as np
import pytest

from gcd_dataset.errors import ShardError
from gcd_dataset.records import MOTION_STEP, GarmentMotion, Pose
from gcd_dataset.shards import decode_motion, encode_motion
from gcd_dataset.shards.motion import CODINGS, NAMES
from gcd_dataset.shards.sections import pack, unpack


def flag(frames: int = 20, side: int = 40) -> GarmentMotion:
    """A square of cloth in which a wave runs."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(side), np.arange(side)))
    corner = (np.arange(side - 1) + side * np.arange(side - 1)[:, None]).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, side], corner[:, None] + [1, side + 1, side]])
    waves = [np.stack([x, y, 5.0 * np.sin(0.2 * x - 0.4 * frame)], axis=1) for frame in range(frames)]
    poses = [Pose({"left_thigh": (0.01 * frame, 0.0, -0.25)}) for frame in range(frames)]
    counts = np.arange(3 * frames).reshape(frames, 3)
    return GarmentMotion(np.array(waves, np.float32), faces, tuple(poses), 30.0, counts)


def test_a_motion_comes_back_as_it_is_stored() -> None:
    """The first frame as in ``verts.z``, the others within half a step, at a byte for each vertex or less."""
    motion = flag()
    data = encode_motion(motion)
    read = decode_motion(data)
    np.testing.assert_allclose(read.vertices[0], motion.vertices[0], atol=2.0**-10)
    np.testing.assert_allclose(read.vertices, motion.vertices, atol=MOTION_STEP / 2)
    np.testing.assert_array_equal(read.faces, motion.faces)
    np.testing.assert_array_equal(read.crossings, motion.crossings)
    assert read.poses[7].turns["left_thigh"] == pytest.approx((0.07, 0.0, -0.25))
    assert read.fps == 30.0 and not read.is_clean.any()
    assert encode_motion(read) == data
    assert len(data) / 20 < len(motion.vertices[0])
    [alone] = decode_motion(encode_motion(flag(1))).vertices
    np.testing.assert_array_equal(alone, read.vertices[0])


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: data[:-20],
        lambda data: pack({name: part for name, part in unpack(data).items() if name != "turns"}, CODINGS),
        lambda data: pack(unpack(data) | {"steps": unpack(data)["steps"][:, 1:]}, CODINGS),
        lambda data: pack(unpack(data) | {"faces": unpack(data)["faces"] + 2}, CODINGS),
    ],
)
def test_damaged_motions_are_named(spoil: Callable[[bytes], bytes]) -> None:
    assert set(unpack(encode_motion(flag(3)))) == {*NAMES, "steps"}
    with pytest.raises(ShardError, match=r"^not a whole garment in motion"):
        decode_motion(spoil(encode_motion(flag(3))))


def test_motions_without_numbers_are_refused() -> None:
    motion = flag(3)
    broken = motion.vertices.copy()
    broken[2, 5, 1] = np.nan
    with pytest.raises(ShardError, match="no number below 10000 cm"):
        encode_motion(GarmentMotion(broken, motion.faces, motion.poses, 30.0, motion.crossings))
