"""The garment that a verb is about: a sample of a data set, or the pattern in a specification file."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from gcd_dataset.cli.verb import open_source
from gcd_dataset.errors import ConfigError, ShardError, SpecError

if TYPE_CHECKING:
    from gcd_dataset.generator.garments import OutfitDesign
    from gcd_dataset.records import Pattern, Sample
    from gcd_dataset.shards import ShardReader


def names_a_file(source: str) -> bool:
    """Whether ``source`` names a file, existing or not, and no data set, which is a folder or on a server."""
    return "://" not in source and not _is_folder(Path(source)) and (source.endswith(".json") or Path(source).exists())


def design_in(path: Path | str) -> "OutfitDesign":
    """The design in a file. Raises ``SpecError``: a bad file is bad input, not wrong usage."""
    from gcd_dataset.generator.garments import read_design

    try:
        return read_design(path)
    except ConfigError as error:
        raise SpecError(str(error)) from error


def pattern_of(options: argparse.Namespace) -> "Pattern":
    """The pattern in the specification file ``what``."""
    from gcd_dataset.spec import read_pattern
    from gcd_dataset.validate import require_valid

    return require_valid(read_pattern(Path(options.what)), source=options.what)


def sample_of(options: argparse.Namespace) -> "Sample":
    """The sample at ``index`` of the data set ``what``, local or remote; of the split ``train`` without ``split``."""
    reader = reader_of(options.what, options)
    return reader.sample(position_of(options, len(reader)))


def reader_of(source: str, options: argparse.Namespace) -> "ShardReader":
    """The reader of a data set, local or remote; of the split ``train`` without ``split``."""
    from gcd_dataset.shards import ShardReader

    return ShardReader(open_source(source, options.endpoint), options.split or "train")


def position_of(options: argparse.Namespace, count: int) -> int:
    """``--index``. Raises ``ShardError`` beyond the last garment."""
    if options.index >= count:
        known = f"give one from 0 to {count - 1}" if count > 1 else "leave --index out"
        raise ShardError(f"{options.what}: garment {options.index} of {count}: {known}")
    return int(options.index)


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError as error:
        raise SpecError(f"{path}: cannot be read ({error.strerror}): choose a file that you may read") from error
