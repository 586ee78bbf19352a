"""Types of command line arguments."""

import argparse
from pathlib import Path


def jpeg_file(text: str) -> Path:
    """The path of a JPEG file. Raises ``ArgumentTypeError`` for the name of another format."""
    path = Path(text)
    if path.suffix.lower() not in (".jpg", ".jpeg"):
        raise argparse.ArgumentTypeError(f"{text}: the picture is a JPEG, so end the name in .jpg")
    return path
