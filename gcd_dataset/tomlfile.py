"""TOML files by people: read with errors that name the file, the line and what to do."""

import tomllib
from pathlib import Path
from typing import Any

from gcd_dataset.errors import ConfigError

__all__ = ["read_toml"]


def read_toml(path: Path | str) -> dict[str, Any]:
    """What is in the file. Raises ``ConfigError`` where it is missing or broken."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}): give a TOML file that you may read") from error
    except RecursionError as error:
        raise ConfigError(f"{path}: nested too deep: flatten the TOML") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: {error}: mend the TOML") from error
