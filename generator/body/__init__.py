"""Bodies: drawn from a shape space or read from files, and their tailor's measures."""

from gcd_dataset.bodyfiles import read_measurements, write_measurements
from gcd_dataset.generator.body.files import read_body
from gcd_dataset.generator.body.named import named_body
from gcd_dataset.generator.body.shape import (
    build_body,
    draw_shape,
    female_shape,
    male_shape,
    named_shape,
    neutral_shape,
)
from gcd_dataset.generator.body.tailor import measure

__all__ = [
    "build_body",
    "draw_shape",
    "female_shape",
    "male_shape",
    "measure",
    "named_body",
    "named_shape",
    "neutral_shape",
    "read_body",
    "read_measurements",
    "write_measurements",
]
