"""The recorded FreeSewing patterns of task T7."""

import json
import tarfile
from collections import Counter
from pathlib import Path

import benchmarks.run
from gcd_dataset.spec import pattern_from_spec
from gcd_dataset.validate import require_valid

RECORDED = Path(benchmarks.run.__file__).parent / "data" / "freesewing.tar.xz"


def test_ten_valid_patterns_of_each_design_are_sewn() -> None:
    """The free edges are hems, necklines and waists alone. One pattern of each design is validated."""
    designs: Counter[str] = Counter()
    with tarfile.open(RECORDED) as tar:
        for member in sorted((entry for entry in tar if entry.isfile()), key=lambda entry: entry.name):
            file, name = tar.extractfile(member), Path(member.name).name
            assert file is not None
            pattern = pattern_from_spec(json.loads(file.read()), name)
            if designs[name.split("_")[0]] == 0:
                require_valid(pattern, source=name)
            designs[name.split("_")[0]] += 1
            assert 2 * len(pattern.seams) / sum(len(panel.edges) for panel in pattern.panels) > 0.6
    assert set(designs.values()) == {10}
    assert len(designs) == 9
