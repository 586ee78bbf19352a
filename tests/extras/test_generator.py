"""The generator in processes of its own, and more samples than the quick tests draw."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gcd_dataset.errors import PatternError
from gcd_dataset.generator import MakeConfig, produce
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.recipes import find_recipe
from gcd_dataset.generator.recipes.hashing import made_patterns
from gcd_dataset.patternhash import PatternHash

SCRIPT = """
from gcd_dataset.generator import MakeConfig, produce
print([sample.key for sample in produce(5, range(2), MakeConfig(stage="pattern"), workers=2)])
"""


def test_the_error_of_a_script_without_main_guard_names_the_remedy(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    command = [sys.executable, str(tmp_path / "script.py")]
    finished = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert finished.returncode == 1
    assert "must start them under if __name__" in finished.stderr


PROGRAM = """
import sys
from gcd_dataset.generator.recipes import find_recipe
from gcd_dataset.generator.recipes.hashing import made_patterns
from gcd_dataset.patternhash import PatternHash
print(PatternHash.of(made_patterns(find_recipe(sys.argv[1]), map(int, sys.argv[2:]))).text)
"""
OLD = {
    "OPENBLAS_CORETYPE": "Prescott",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4",
}


@pytest.mark.parametrize(("name", "designs"), [("smoke-64", [0, 1]), ("poses", [914])])
def test_other_instructions_give_the_same_hash(name: str, designs: list[int]) -> None:
    """With libraries restricted to old instructions the last digits may differ, the hash does not.

    Design 914 once drew parameters again after the panel that rounding chose among two mirrored ones.
    """
    command = [sys.executable, "-c", PROGRAM, name, *map(str, designs)]
    there = subprocess.run(command, capture_output=True, text=True, check=True, env={**os.environ, **OLD}).stdout
    assert PatternHash.of(made_patterns(find_recipe(name), designs)).agrees(there.strip())


def test_a_failure_in_a_worker_is_raised_here() -> None:
    heavy = Overlay.from_dict({"meta": {"upper": "none", "bottom": "SkirtCircle"}, "flare-skirt": {"length": 0.9}})
    with pytest.raises(PatternError, match="2 designs were rejected, the last for: too_heavy"):
        list(produce(5, range(4), MakeConfig(stage="pattern", design=heavy, max_attempts=2), workers=2))


@pytest.mark.parametrize("name", ["smoke-64", "poses"])
def test_a_recipe_has_the_cited_hash(name: str) -> None:
    """After a change of the sampler, ``python -m gcd_dataset.generator.recipes.hashing NAME`` prints the new hash."""
    recipe = find_recipe(name)
    assert PatternHash.of(made_patterns(recipe, range(recipe.designs))).agrees(recipe.patterns)
