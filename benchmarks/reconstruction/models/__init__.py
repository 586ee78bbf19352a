"""The models: a file for each network, and ``baselines``.

The module of a network has ``build(config)``, which takes sizes by name and returns its ``Learner``. It may have
``USUAL`` and ``SMOKE``, its usual options of a training and of the smallest, ``SMALL``, the sizes of the smallest, and
``TASKS``, the tasks that it answers; by default all whose answers are patterns.
"""

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from gcd_dataset.errors import ConfigError

__all__ = ["MODELS", "load_model"]

NETWORKS = (
    "panel_set", "edge_tokens", "parameters", "picture_parameters", "stitches", "segmentation",
    "drape_surrogate", "measures", "fit", "motion_residual",
)  # fmt: skip
BASELINES = (
    "nearest", "typical", "ceiling", "nearest_labels", "box_mesh", "coarse_drape", "solver", "mean_measures",
    "nearest_measures", "nearest_fit", "frozen", "skinned",
)  # fmt: skip
MODELS = (*NETWORKS, *BASELINES)


def load_model(name: str) -> Any:
    """The module of a network, a ``Baseline``, or a stranger's ``path/to/file.py:build``. Raises ``ConfigError``."""
    if name in NETWORKS:
        return import_module(f"{__name__}.{name}")
    if name in BASELINES:
        return import_module(f"{__name__}.baselines").BASELINES[name]
    path, _, function = name.rpartition(":")
    if not path.endswith(".py") or not Path(path).is_file():
        raise ConfigError(f"no model {name!r:.99}: give path/to/file.py:build, or one of {', '.join(MODELS)}")
    return _of_file(Path(path).resolve(), function)


def _of_file(path: Path, function: str) -> Any:
    """The names of a file, imported as other processes can import it, with the function as ``build``."""
    sys.path.insert(0, str(path.parent))
    found = import_module(path.stem)
    if not found.__file__ or Path(found.__file__).resolve() != path:
        raise ConfigError(f"{path}: Python has another module {path.stem}: rename the file")
    build: Callable[..., Any] | None = getattr(found, function, None)
    if build is None:
        raise ConfigError(f"{path} has no function {function}: give its name after the colon")
    return SimpleNamespace(**{**vars(found), "build": build})
