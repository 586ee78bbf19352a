"""Limits on the memory that reading a file may allocate: above any garment's need, below a machine's memory."""

LARGEST_JSON = 1 << 23
"""Bytes of a JSON member; the parsed value takes about twenty times as many."""
LARGEST_MANIFEST = 1 << 26
"""Bytes of a manifest; for ten million garments it has 15 MB."""
LARGEST_SAMPLE = 1 << 29
"""Bytes of all members of a sample; a dress meshed at 0.2 cm takes 25 MB."""
LARGEST_FILE = 1 << 32
"""Bytes of an index; for ten million garments it has 3.3 GB."""
MOST_PIXELS = 1 << 26
"""Pixels of a picture: 8192 × 8192."""
