"""The models: one file each.

A module of a network has ``build(smoke=…, options=…)``, which returns its ``Learner``, and ``USUAL`` and ``SMOKE``,
options of ``TrainConfig``. A module of a reference has ``answers``, a ``Reference``. ``TASKS`` names the tasks that a
module answers; by default all whose answers are patterns.
"""

from importlib import import_module
from types import ModuleType

from gcd_dataset.errors import ConfigError

__all__ = ["MODELS", "load_model"]

MODELS = {
    name: f"benchmarks.reconstruction.models.{name}"
    for name in (
        "panel_set",
        "edge_tokens",
        "parameters",
        "picture_set",
        "picture_parameters",
        "stitches",
        "nearest",
        "typical",
        "ceiling",
        "segmentation",
        "nearest_labels",
        "drape_surrogate",
        "box_mesh",
        "coarse_drape",
        "solver",
        "measures",
        "mean_measures",
        "nearest_measures",
    )
}


def load_model(name: str) -> ModuleType:
    """The module of a model. Raises ``ConfigError`` for an unknown name."""
    if name not in MODELS:
        raise ConfigError(f"no model {name!r:.99}: choose one of {', '.join(MODELS)}")
    return import_module(MODELS[name])
