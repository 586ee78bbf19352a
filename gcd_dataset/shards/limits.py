"""What a file may make a reader allocate: more than any garment needs, less than a machine has."""

__all__ = ["LARGEST_FILE", "LARGEST_INDEX", "LARGEST_JSON", "LARGEST_MANIFEST", "LARGEST_SAMPLE", "MOST_PIXELS"]

LARGEST_JSON = 1 << 23
"""Bytes of a JSON member; parsed it takes some twenty times as many."""
LARGEST_MANIFEST = 1 << 26
"""Bytes of a manifest: that of ten million garments has 15 MB."""
LARGEST_SAMPLE = 1 << 29
"""Bytes of all members of a sample: a dress meshed at 0.2 cm takes 25 MB."""
LARGEST_FILE = 1 << 32
"""Bytes of an index: that of ten million garments has 3.3 GB."""
LARGEST_INDEX = 64
"""Bytes of the arrays in an index for each byte of its file: ours are stored as they are."""
MOST_PIXELS = 1 << 26
"""Pixels of a picture: 8192 a side."""
