"""The checks shared by all exports: suffix, drape, optional libraries; the body of a sample."""

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, TypeAlias, Union

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import ConfigError, ExtraMissing, ShardError
from gcd_dataset.outfits import joined
from gcd_dataset.records import Body, BoxMesh, Drape, GarmentMotion, Outcome, Pattern, Sample

if TYPE_CHECKING:
    from gcd_dataset.generator.fitting import Fitting

EXTRA = "export"
Graded: TypeAlias = Mapping[str, Pattern]
"""A garment in several sizes: name of each size to its pattern, in the order of the sizes."""
Draped: TypeAlias = Union[Sample, "Fitting"]
"""A garment with a drape: of a data set, or as ``drape_patterns`` makes it."""


def optional(module: str) -> ModuleType:
    """A module of the extra ``export``. Raises ``ExtraMissing`` with the command that installs it."""
    try:
        return import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise ExtraMissing(f"{package} is not installed: run pip install 'gcd-dataset[{EXTRA}]'") from error


def require_suffix(path: Path | str, *suffixes: str) -> Path:
    """The path. Raises ``ConfigError`` unless it ends in one of the suffixes."""
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        form = suffixes[0].removeprefix(".").upper()
        raise ConfigError(f"{path}: the file is {form}: end its name in {' or '.join(suffixes)}")
    return path


def patterns_of(garment: Sample | Pattern | Graded) -> Graded:
    """The pattern of each size; that of a garment or outfit in one size by the name "".

    Raises ``ConfigError`` without sizes.
    """
    if not isinstance(garment, Mapping):
        return {"": joined(garment).pattern if isinstance(garment, Sample) else garment}
    if not garment:
        raise ConfigError("a graded garment without sizes: give the pattern of one size or more")
    return garment


def key_of(garment: Draped) -> str:
    """The key of a sample; the name of another pattern."""
    return garment.key if isinstance(garment, Sample) else garment.pattern.name


def draped_mesh(garment: Draped) -> tuple[BoxMesh, Drape]:
    """Mesh and drape of a garment, or of all garments of an outfit.

    Raises ``ShardError`` for one without a drape, or with one that diverged.
    """
    garment = joined(garment) if isinstance(garment, Sample) else garment
    if garment.box_mesh is None or garment.drape is None:
        raise ShardError(
            f"sample {key_of(garment)} holds no drape: make the data set with --stage drape, or export its pattern as "
            "DXF or PDF"
        )
    if not np.isfinite(garment.drape.vertices).all():
        raise ShardError(
            f"{key_of(garment)}: its drape diverged ({garment.drape.outcome.name}): choose another garment"
        )
    if garment.drape.outcome is Outcome.CANNOT_BE_PUT_ON:
        raise ShardError(f"{key_of(garment)}: not draped, since it cannot be put on: choose another garment")
    return garment.box_mesh, garment.drape


def body_of(garment: Draped) -> Body | None:
    """The body of a garment, built from a sample's shape; ``None`` if that holds none, as published garments."""
    if not isinstance(garment, Sample):
        return garment.body
    if garment.shape is None:
        return None
    from gcd_dataset.generator.body import build_body

    return build_body(garment.shape, name=garment.provenance.body_name or "body")


def motion_of(garment: Draped) -> GarmentMotion | None:
    """The motion of a fitting."""
    return None if isinstance(garment, Sample) else garment.motion


def body_shapes(garment: Draped) -> Float[np.ndarray, "t v 3"]:
    """The vertices of a fitting's body in each frame of its motion [cm]."""
    assert not isinstance(garment, Sample) and garment.motion is not None
    return np.stack([garment.body_in(frame).vertices for frame in range(len(garment.motion.poses))])
