"""Bodies, drawn from the body model or read from mesh files, and their measures."""

from typing import TYPE_CHECKING

from gcd_dataset.bodyfiles import read_measurements, write_measurements
from gcd_dataset.lazy import lazy_names

if TYPE_CHECKING:
    from gcd_dataset.generator.body.by_name import named_body
    from gcd_dataset.generator.body.measuring import measure
    from gcd_dataset.generator.body.mesh_bodies import read_body
    from gcd_dataset.generator.body.motion import GAITS, Gait, named_motion, read_motion, walk
    from gcd_dataset.generator.body.pose import named_pose, pose_body
    from gcd_dataset.generator.body.shape import build_body, draw_shape, named_shape, neutral_shape
    from gcd_dataset.generator.body.shape_fit import FittedShape, fit_shape

__all__ = [
    "GAITS", "FittedShape", "Gait", "build_body", "draw_shape", "fit_shape", "measure", "named_body", "named_motion",
    "named_pose", "named_shape", "neutral_shape", "pose_body", "read_body", "read_measurements", "read_motion", "walk",
    "write_measurements",
]  # fmt: skip

__getattr__, __dir__ = lazy_names(__name__)
