"""The folder ``5000_body_shapes_and_measures`` as published with GarmentCodeData.

meshes/00345_straight.obj, meshes/00345_apart.obj   one person in two poses [m], all people on one mesh
measurements/00345.yaml                             the measures, the same for both poses [cm, degrees]
meta/00345_meta.json                                pca_weights [standard deviations], arm_inclination [degrees]
"""

import functools
import json
import math
import reprlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Int

from gcd_dataset.bodies import POSES, BodyMesh, Person
from gcd_dataset.bodyfiles import read_body_file, read_body_parts, read_measurements, require_same_body
from gcd_dataset.errors import BodyError, ShardError
from gcd_dataset.files import user_path
from gcd_dataset.measurements import is_adult_height
from gcd_dataset.records import Body, BodyPart, BodyShape, Measurements, Record
from gcd_dataset.release.meshes import ObjText, read_obj
from gcd_dataset.release.published_names import DEFAULT_BODY
from gcd_dataset.shards.access import reading

FOLDER = "5000_body_shapes_and_measures"
METRE = 100.0  # cm
LARGEST = 1e4  # bound of weights, and of angles in degrees
KINDS = {
    "measures": "measurements/{}.yaml",
    "meta": "meta/{}_meta.json",
    "straight": "meshes/{}_straight.obj",
    "apart": "meshes/{}_apart.obj",
}
"""Kind of file to its path for a person."""


class PublishedPeople:
    """The people in a folder of the published layout, by name (``00345``).

    ``root``: the folder, or its parent. ``names``: people to read; by default all with a measurement file. ``needed``:
    the ``KINDS`` of file that each must have. ``segmentation``: a JSON of vertex ids by body part, as GarmentCode's
    ``ggg_body_segmentation.json``. May be pickled and forked.

    Raises ``ShardError`` with the first missing file, and the number of missing files.
    """

    def __init__(
        self,
        root: Path | str,
        *,
        names: Sequence[str] | None = None,
        needed: Iterable[str] = tuple(KINDS),
        segmentation: Path | str | None = None,
    ) -> None:
        self.folder = _folder(user_path(root))
        self.names = _all_names(self.folder) if names is None else tuple(names)
        self._segmentation = segmentation
        _require(self.folder, self.names, tuple(needed))

    def person(self, name: str) -> Person:
        """One person. Raises ``BodyError`` naming an invalid file."""
        straight, apart = (self.vertices(name, pose) for pose in POSES)
        size = self.measurements(name)
        ours = Measurements(height=float(straight[:, 1].max()))
        require_same_body(size, ours, self._path(name, "measures"), self._path(name, "straight"))
        return Person(name, self.shape(name), straight, apart, size)

    def vertices(self, name: str, pose: str) -> Float32[np.ndarray, "v 3"]:
        """A person's vertex positions [cm] in one of ``POSES``, soles at y = 0. Raises ``BodyError``."""
        text = read_obj(self._path(name, pose))
        self._require_same_mesh(text)
        positions = text.positions() * METRE
        height = float(np.ptp(positions[:, 1]))
        if not is_adult_height(height):
            raise BodyError(f"{text.path}: {height / METRE:.4g} m tall: published meshes are in metres, with y up")
        return (positions - [0.0, positions[:, 1].min(), 0.0]).astype(np.float32)

    def measurements(self, name: str) -> Measurements:
        """A person's measures. Raises ``BodyError``."""
        return read_measurements(self._path(name, "measures"))

    def shape(self, name: str) -> BodyShape:
        """A person's weights in the authors' shape space, and the arm angle [rad]. Raises ``BodyError``.

        ``arm_angle`` is ``arm_inclination`` of the file, drawn from ±15 degrees. Its sign depends on the authors' rig,
        which is not published; the measure ``arm_pose_angle`` is the actual inclination.
        """
        path = self._path(name, "meta")
        try:
            meta = json.loads(read_body_file(path))
            weights, angle = meta["pca_weights"], meta["arm_inclination"]
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise BodyError(
                f"{path}: no object with pca_weights and arm_inclination ({error}): extract it again"
            ) from error
        if not (isinstance(weights, list) and weights and all(map(_is_number, weights)) and _is_number(angle)):
            found = f"pca_weights {reprlib.repr(weights)}, arm_inclination {reprlib.repr(angle)}"
            raise BodyError(f"{path}: {found}: expected a list of numbers, and degrees: extract it again")
        return BodyShape(np.array(weights, float), math.radians(angle))

    @functools.cached_property
    def mesh(self) -> BodyMesh:
        """The common mesh, from the first file. Raises ``BodyError`` for a broken file."""
        first, parts = self._first, None
        if self._segmentation is not None:
            parts = read_body_parts(user_path(self._segmentation), first.n_vertices, first.path)
        return BodyMesh(first.faces, parts)

    @functools.cached_property
    def _first(self) -> "_FirstMesh":
        """The first mesh on disk. Raises ``ShardError`` if there is none."""
        paths = (self._path(name, pose) for name in self.names for pose in POSES)
        path = next((path for path in paths if path.exists()), None)
        if path is None:
            raise ShardError(f"{self.folder / 'meshes'}: no meshes: extract {FOLDER}.tar.gz again")
        text = read_obj(path)
        return _FirstMesh(path, len(text.v), text.triangles(), text.faces_hash())

    def _require_same_mesh(self, text: ObjText) -> None:
        """Raise ``BodyError`` if a file has other triangles, or another number of vertices, than the first mesh."""
        first = self._first
        # Compare the text first: parsing the numbers takes longer than all the rest.
        same = text.faces_hash() == first.faces_hash or np.array_equal(text.triangles(), first.faces)
        if not same or len(text.v) != first.n_vertices:
            raise BodyError(f"{text.path}: its mesh differs from {first.path.name}: all people must be on one mesh")

    def _path(self, name: str, kind: str) -> Path:
        return self.folder / KINDS[kind].format(name)


@dataclass(frozen=True, eq=False)
class _FirstMesh(Record):
    """The reference mesh: all others must have its triangles and number of vertices."""

    path: Path
    n_vertices: int
    faces: Int[np.ndarray, "f 3"]
    faces_hash: str


def _folder(root: Path) -> Path:
    """The folder of the bodies: ``root`` or its subfolder. Raises ``ShardError``."""
    with reading(root):
        if root.is_file():
            raise ShardError(f"{root}: a file: extract it (tar xzf) and give the folder {FOLDER}")
        for folder in (root, root / FOLDER):
            if (folder / "measurements").is_dir():
                return folder
    raise ShardError(f"{root}: neither {FOLDER} nor a folder that holds it: give the folder of the extracted archive")


def _all_names(folder: Path) -> tuple[str, ...]:
    with reading(folder):
        names = tuple(sorted(path.stem for path in (folder / "measurements").iterdir() if path.suffix == ".yaml"))
    if not names:
        raise ShardError(f"{folder / 'measurements'}: no measurement files: extract {FOLDER}.tar.gz again")
    return names


def _require(folder: Path, names: Sequence[str], kinds: Sequence[str]) -> None:
    """Raise ``ShardError`` unless all people have files of these kinds."""
    with reading(folder):
        subfolders = {KINDS[kind].partition("/")[0] for kind in kinds}
        present = {
            f"{sub}/{path.name}" for sub in subfolders if (folder / sub).is_dir() for path in (folder / sub).iterdir()
        }
    wanted = [KINDS[kind].format(name) for name in names for kind in kinds]
    missing = [file for file in wanted if file not in present]
    if missing:
        raise ShardError(
            f"{folder / missing[0]}: missing; {len(missing)} of {len(wanted)} files are missing: extract the archive "
            "again, name the people to read, or leave out the missing fields"
        )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST


NEUTRAL = "neutral_body"
KEPT = 4  # bodies: 1.4 MB each


@lru_cache(KEPT)
def published_body(root: Path, name: str) -> Body:
    """The body ``name``, such as ``mean_all`` or ``00345_apart``, of a release; ``root``: the folder of its batches.

    Soles at y = 0. All vertices count as trunk: the release has no part labels. Raises ``BodyError`` where the mesh is
    not on disk, or is damaged.
    """
    person, _, pose = name.rpartition("_")
    is_person = person.isdecimal() and pose in POSES
    if not is_person and name != DEFAULT_BODY:
        raise BodyError(f"{name!r:.80}: no body of the release: bodies are {DEFAULT_BODY}, 00345_straight, 00345_apart")
    folders = (FOLDER, "") if is_person else (NEUTRAL, "")
    paths = [root / folder / ("meshes" if is_person else "") / f"{name}.obj" for folder in folders]
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        source = f"extract {FOLDER}.tar.gz there" if is_person else f"download the folder {NEUTRAL} too"
        raise BodyError(f"{paths[0]}: missing, so the body is left out: {source}")
    text = read_obj(path)
    positions = text.positions() * METRE
    parts = np.full(len(positions), BodyPart.TRUNK.value, np.uint8)
    return Body(positions - [0.0, positions[:, 1].min(), 0.0], text.triangles(), parts, name)
