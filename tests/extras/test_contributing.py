"""The worked examples of CONTRIBUTING.md, carried out in a copy of the tree: their tests pass there."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r'^```(\w+) title="([^"]+)"\n(.*?)^```$', re.MULTILINE | re.DOTALL)
BLOCKS = BLOCK.findall((ROOT / "CONTRIBUTING.md").read_text())
COPIED = ("gcd_dataset", "generator", "loaders", "benchmarks", "tools", "tests/generator", "tests/benchmarks")
EXAMPLES = ("garment", "cape", "measure", "fabric", "rule", "model", "benchmark")
TESTS = [title for _, title, _ in BLOCKS if title.startswith("tests/")]


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the tree with the new files and added lines of the examples."""
    tree = tmp_path_factory.mktemp("tree")
    left_out = shutil.ignore_patterns("__pycache__", "reports")
    for name in COPIED:
        shutil.copytree(ROOT / name, tree / name, symlinks=True, ignore=left_out)
    for name in ("pyproject.toml", "tests/conftest.py", "tests/helpers.py"):
        shutil.copy(ROOT / name, tree / name)
    for language, title, content in BLOCKS:
        if language == "diff":
            (tree / title).write_text(with_lines(tree / title, content))
        elif language == "python":
            assert not (tree / title).exists(), f"{title} is an example, and is in the tree"
            (tree / title).write_text(content)
    return tree


def with_lines(path: Path, diff: str) -> str:
    """The text of a file with the added lines of a diff, whose hunks are separated by ``@@``."""
    text = path.read_text()
    for hunk in diff.split("@@\n"):
        lines = hunk.splitlines(keepends=True)
        before = "".join(line[1:] or "\n" for line in lines if not line.startswith("+"))
        after = "".join(line[1:] or "\n" for line in lines)
        assert text.count(before.removesuffix("\n")) == 1, f"{path.name} has not, or not only once:\n{before}"
        text = text.replace(before.removesuffix("\n"), after.removesuffix("\n"))
    return text


def run(tree: Path, *arguments: str) -> str:
    """The output of Python in the copy, which is imported in place of the tree."""
    env = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-m", *arguments], cwd=tree, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout


def test_there_is_an_example_of_each_kind() -> None:
    headings = re.findall(r"^### An? (\w+)$", (ROOT / "CONTRIBUTING.md").read_text(), re.MULTILINE)
    assert tuple(headings) == EXAMPLES
    assert len(TESTS) == len(EXAMPLES)


def test_the_tests_of_the_examples_pass(tree: Path) -> None:
    assert re.search(r"\b11 passed", run(tree, "pytest", "-q", "-p", "no:cacheprovider", *TESTS))


def test_an_example_changes_three_files_at_most() -> None:
    examples = (ROOT / "CONTRIBUTING.md").read_text().split("\n### ")[1:]
    assert len(examples) == len(EXAMPLES)
    for example in examples:
        assert len({title for language, title, _ in BLOCK.findall(example) if language != "sh"}) <= 3


def test_the_new_garments_pass_the_battery(tree: Path) -> None:
    battery = "tests/generator/garments/test_battery.py"
    names = "in_the_battery or ALineSkirt or A_LINE or PointedCape or POINTED_CAPE"
    told = run(tree, "pytest", "-q", "-p", "no:cacheprovider", battery, "-k", names)
    assert int(re.findall(r"(\d+) passed", told)[0]) == 32


def test_the_new_benchmark_prints_its_figures_and_leaves_a_report(tree: Path) -> None:
    (command,) = (content.split() for language, _, content in BLOCKS if language == "sh")
    assert command[:2] == ["python", "-m"]
    assert re.search(r"^meshing\.vertices_2cm \d+ $", run(tree, *command[2:]), re.MULTILINE)
    assert "- command: `python -m benchmarks.run meshing" in (tree / "meshing.md").read_text()


def test_the_examples_are_written_in_the_house_style(tree: Path) -> None:
    """Ruff prints nothing if it finds no fault."""
    files = [title for language, title, _ in BLOCKS if language in ("python", "diff")]
    assert run(tree, "ruff", "check", "--quiet", "--no-cache", *files) == ""
    assert run(tree, "ruff", "format", "--check", "--quiet", "--no-cache", *files) == ""
