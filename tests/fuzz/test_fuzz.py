"""No input makes a reader crash, hang, fill the memory, or return values that differ from the written ones.

Two inputs for each reader here; ``make fuzz N=10000`` tries more and prints a table.
"""

from pathlib import Path

import pytest

from tests.fuzz.campaign import tallies
from tests.fuzz.readers import READERS

EXAMPLES = 2


@pytest.mark.parametrize("name", READERS)
def test_damaged_inputs_read_unchanged_or_are_refused(name: str, tmp_path: Path) -> None:
    """Bytes, and branches of documents. Without a checksum, a damaged file may also read as other valid values."""
    for _, tally in tallies(name, READERS[name](tmp_path), EXAMPLES):
        assert tally.counts.total() == EXAMPLES
        assert not tally.faults, "\n".join(tally.faults[:10])
