"""No input makes a reader crash, hang, fill the memory, or return values that differ from the written ones.

``FUZZ_EXAMPLES`` inputs for each reader, 200 by default; ``make fuzz N=10000`` tries more and prints a table.
"""

import os
from pathlib import Path

import pytest

from tests.fuzz.campaign import documents, try_documents, try_files
from tests.fuzz.readers import READERS

EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "200"))


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_read_unchanged_or_are_refused(name: str, tmp_path: Path) -> None:
    """Without a checksum, a damaged file may also read as other valid values."""
    tally = try_files(name, tmp_path, EXAMPLES)
    assert tally.tried == EXAMPLES
    assert not tally.faults, "\n".join(tally.faults[:10])


@pytest.mark.parametrize("name", documents())
def test_edited_documents_are_read_or_refused(name: str, tmp_path: Path) -> None:
    tally = try_documents(name, tmp_path, EXAMPLES)
    assert tally.tried >= EXAMPLES / 2  # Hypothesis may find no more distinct documents
    assert not tally.faults, "\n".join(tally.faults[:10])
