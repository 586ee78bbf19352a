"""Types of the benchmarks' arguments."""

import argparse
from pathlib import Path

import pytest

from benchmarks.cases.figures import jpeg_file


def test_a_jpeg_has_no_other_ending() -> None:
    assert jpeg_file("drapes.JPG") == Path("drapes.JPG")
    with pytest.raises(argparse.ArgumentTypeError, match=r"drapes.png: the picture is a JPEG"):
        jpeg_file("drapes.png")
