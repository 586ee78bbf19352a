"""The bodies on which test garments are draped: a folder of body files, or a named body for all."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.bodyfiles import read_measurements, require_same_body
from gcd_dataset.errors import BodyError, shown
from gcd_dataset.files import open_regular
from gcd_dataset.generator.body import build_body, measure, named_body, read_body
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.jsonfile import read_json
from gcd_dataset.records import Body, BodyShape, Measurements

NEUTRAL = "neutral"
DEFAULT = "default"  # stem of the body of garments without a body of their own
TABLE = "bodies.json"
MESHES = (".obj", ".ply", ".stl", ".glb")
SHAPES = (".body.npy", ".npy")
APART = "_apart"  # ending of the file of the same body with the legs apart
MEASURES = (".yaml", "_measurements.yaml", "_body_measurements.yaml")
LARGEST = 100.0  # standard deviations: no person's shape weights
SEGMENTATION = "_segmentation.json"


@dataclass(frozen=True)
class Wearers:
    """Bodies by garment."""

    folder: Path | None
    """``None``: all garments are draped on the body ``name``."""
    name: str
    """Body of garments without a body of their own; empty if each must have one."""
    table: dict[str, str]
    """Garment to body, of ``bodies.json``."""

    def require(self, garments: Iterable[str]) -> None:
        """Raise ``BodyError`` for the first garment without a body; bodies are not read."""
        for garment in garments:
            self._file(garment)

    def wearer(self, garment: str, *, legs_apart: bool) -> tuple[Body, Measurements]:
        """The body of a garment and its measures. Raises ``BodyError`` with the file and a remedy."""
        path = self._file(garment)
        if path is not None:
            return _read(path, legs_apart)
        return _named(self.table.get(garment, self.name), legs_apart)

    def body_of(self, garment: str) -> str:
        """File or name of a garment's body. Raises ``BodyError`` if there is neither."""
        return str(self._file(garment) or self.table.get(garment, self.name))

    def _file(self, garment: str) -> Path | None:
        """The file of a garment's body; ``None`` for a named body. Raises ``BodyError`` if there is neither."""
        if self.folder is None:
            return None
        for stem in (self.table.get(garment, garment), *(() if garment in self.table else (DEFAULT,))):
            if (path := _body_file(self.folder, stem)) is not None:
                return path
        if garment in self.table or self.name:
            return None
        raise BodyError(
            f"{self.folder}: no body for {shown(garment)}: add {garment}.obj, {garment}.npy, {DEFAULT}.obj, or a "
            f"{TABLE} that maps garments to bodies"
        )


def wearers_of(bodies: str) -> Wearers:
    """The bodies in a folder, or the body of a name or mesh file for all garments. Raises ``BodyError``.

    A folder holds for each garment ``NAME.obj`` (or ``.ply``, ``.stl``, ``.glb``), measured unless there is
    ``NAME.yaml``, its parts found unless there is ``NAME_segmentation.json``; or ``NAME.npy``, the weights of our shape
    space, with the pose in ``NAME.meta.json``. ``NAME_apart`` is the body with its legs apart, for garments with legs;
    ``default`` is the body of all other garments. ``bodies.json`` maps garments to the stems of such files, or to names
    such as ``neutral`` and ``random:7``.
    """
    path = Path(bodies)
    if not path.is_dir():
        try:
            named_body(bodies)
        except BodyError as error:
            if path.exists() or path.suffix in MESHES or ":" in bodies:
                raise
            raise BodyError(f"{bodies}: no such folder, and {error}") from error
        return Wearers(None, bodies, {})
    table = read_json(path / TABLE, "map from garments to bodies", error=BodyError) if (path / TABLE).exists() else {}
    if not isinstance(table, dict) or not all(isinstance(body, str) for body in table.values()):
        raise BodyError(f"{path / TABLE}: give a map from names of garments to names of bodies")
    return Wearers(path, "", table)


def _body_file(folder: Path, stem: str) -> Path | None:
    paths = (folder / f"{stem}{ending}" for ending in (*SHAPES, *MESHES))  # NAME.obj beside an answer may be its drape
    return next((path for path in paths if path.is_file()), None)


@cache
def _named(name: str, legs_apart: bool) -> tuple[Body, Measurements]:
    body, measurements, _ = named_body(name, legs_apart=legs_apart)
    return body, measurements


@cache
def _read(path: Path, legs_apart: bool) -> tuple[Body, Measurements]:
    if path.suffix == ".npy":
        return _from_shape(path, legs_apart)
    stem = path.with_suffix("")
    body, size = _read_mesh(path, stem, stem)
    apart = stem.with_name(f"{stem.name}{APART}{path.suffix}")
    if legs_apart and apart.is_file():
        return _read_mesh(apart, stem, stem)[0], size
    return body, size


def _read_mesh(path: Path, measured: Path, segmented: Path) -> tuple[Body, Measurements]:
    measures = _beside(measured, MEASURES)
    segmentation = _beside(segmented, (SEGMENTATION,)) or _beside(path.parent / DEFAULT, (SEGMENTATION,))
    return read_body(path, measures, segmentation)


def _beside(stem: Path, endings: tuple[str, ...]) -> Path | None:
    paths = (stem.with_name(f"{stem.name}{ending}") for ending in endings)
    return next((path for path in paths if path.is_file()), None)


def _from_shape(path: Path, legs_apart: bool) -> tuple[Body, Measurements]:
    """The body of shape weights, measured with its legs straight unless its measures are given."""
    weights = read_weights(path)
    known = len(body_model().components)
    if weights.shape != (known,) or not (np.abs(weights) < LARGEST).all():
        raise BodyError(f"{path}: shape weights of shape {weights.shape}: give {known} numbers below {LARGEST:g}")
    stem = path.with_name(path.name.removesuffix(".npy").removesuffix(".body"))
    shape = BodyShape(weights, _arm_angle(stem.with_name(f"{stem.name}.meta.json")))
    straight = build_body(shape, name=stem.name)
    given = _beside(stem, MEASURES)
    size = measure(straight)
    if given is not None:
        ours, size = size, read_measurements(given)
        require_same_body(size, ours, given, path)
    return build_body(replace(shape, legs_apart=True), name=stem.name) if legs_apart else straight, size


def read_weights(path: Path) -> np.ndarray:
    """The shape weights in a ``.npy`` file. Raises ``BodyError`` for any other file."""
    try:
        with open_regular(path) as file:
            return np.asarray(np.lib.format.read_array(file, allow_pickle=False), float)
    except (OSError, ValueError, TypeError, MemoryError) as error:
        raise BodyError(f"{path}: not an array of shape weights ({error}): save it with numpy.save") from error


def _arm_angle(path: Path) -> float:
    """The angle in the metadata of a sample [rad]; 0 without the file."""
    if not path.is_file():
        return 0.0
    meta: Any = read_json(path, "metadata of a sample", error=BodyError)
    pose = meta.get("pose") if isinstance(meta, dict) else None
    angle = pose.get("arm_angle", 0.0) if isinstance(pose, dict) else 0.0
    if not isinstance(angle, int | float):
        raise BodyError(f"{path}: pose.arm_angle is {angle!r}: give a number of radians")
    return float(angle)
