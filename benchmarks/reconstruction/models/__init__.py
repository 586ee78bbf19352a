"""The models: a file for each network, and ``baselines``.

The module of a network has ``build(smoke=…, options=…)``, which returns its ``Learner``, and ``USUAL`` and ``SMOKE``,
options of ``TrainConfig``. ``TASKS`` names the tasks that it answers; by default all whose answers are patterns.
"""

from importlib import import_module
from typing import Any

from gcd_dataset.errors import ConfigError

__all__ = ["MODELS", "load_model"]

NETWORKS = (
    "panel_set", "edge_tokens", "parameters", "picture_set", "picture_parameters", "stitches", "segmentation",
    "drape_surrogate", "measures",
)  # fmt: skip
BASELINES = (
    "nearest", "typical", "ceiling", "nearest_labels", "box_mesh", "coarse_drape", "solver", "mean_measures",
    "nearest_measures",
)  # fmt: skip
MODELS = (*NETWORKS, *BASELINES)


def load_model(name: str) -> Any:
    """The module of a network, or a ``Baseline``. Raises ``ConfigError`` for an unknown name."""
    if name in NETWORKS:
        return import_module(f"{__name__}.{name}")
    if name in BASELINES:
        return import_module(f"{__name__}.baselines").BASELINES[name]
    raise ConfigError(f"no model {name!r:.99}: choose one of {', '.join(MODELS)}")
