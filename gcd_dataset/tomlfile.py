"""TOML files: size-limited reading, with errors that name the file, the line and a remedy."""

import tomllib
from pathlib import Path
from typing import Any

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import read_whole
from gcd_dataset.jsonfile import is_flat

LARGEST_TOML = 1 << 20  # bytes, a second to parse; a config file has some kilobytes
MOST_DOTS = 1000  # in a line; for a dotted key tomllib takes time and memory that grow with the square of its parts


def read_toml(path: Path | str) -> dict[str, Any]:
    """The parsed TOML of a file. Raises ``ConfigError`` if it is missing, broken or too large."""
    content = read_whole(path, "TOML file", limit=LARGEST_TOML, error=ConfigError)
    try:
        if max(line.count(b".") for line in content.split(b"\n")) > MOST_DOTS:
            raise RecursionError
        table = tomllib.loads(content.decode("utf-8-sig"))
        if not is_flat(table):
            raise RecursionError
        return table
    except RecursionError as error:
        raise ConfigError(f"{path}: nested too deep: flatten the TOML") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: byte {error.start} is not valid UTF-8: correct the TOML") from error
    except ValueError as error:  # also raised for an integer of thousands of digits, with advice after a semicolon
        raise ConfigError(f"{path}: {str(error).partition(';')[0]}: correct the TOML") from error
