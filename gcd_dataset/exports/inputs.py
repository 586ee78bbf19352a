"""The checks shared by all exports: suffix, drape, optional libraries; the body of a sample."""

from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np

from gcd_dataset.errors import ConfigError, ExtraMissing, ShardError
from gcd_dataset.records import Body, BoxMesh, Drape, Pattern, Sample

__all__ = ["EXTRA", "body_of", "draped_mesh", "optional", "pattern_of", "require_suffix"]

EXTRA = "export"


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
        raise ConfigError(f"{path}: the file is {_format_of(suffixes)}: end its name in {' or '.join(suffixes)}")
    return path


def _format_of(suffixes: tuple[str, ...]) -> str:
    return suffixes[0].removeprefix(".").upper()


def pattern_of(garment: Sample | Pattern) -> Pattern:
    """The pattern of a sample, or the pattern itself."""
    return garment.pattern if isinstance(garment, Sample) else garment


def draped_mesh(sample: Sample) -> tuple[BoxMesh, Drape]:
    """Mesh and drape of a sample. Raises ``ShardError`` for a sample without a drape, or with one that diverged."""
    if sample.box_mesh is None or sample.drape is None:
        raise ShardError(
            f"sample {sample.key} holds no drape: make the data set with --stage drape, or export its pattern as "
            "DXF or PDF"
        )
    if not np.isfinite(sample.drape.vertices).all():
        raise ShardError(
            f"sample {sample.key}: its drape diverged ({sample.drape.outcome.name}): choose another sample"
        )
    return sample.box_mesh, sample.drape


def body_of(sample: Sample) -> Body | None:
    """The body of a sample, built from its shape; ``None`` if the sample holds no shape, as published garments."""
    if sample.shape is None:
        return None
    from gcd_dataset.generator.body import build_body

    return build_body(sample.shape, name=sample.provenance.body_name or "body")
