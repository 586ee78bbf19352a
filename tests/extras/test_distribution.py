"""Wheel and source distribution: the same package, and it works where no checkout is."""

import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

import gcd_dataset
from tools import release

ROOT = Path(__file__).resolve().parents[2]
UNTRACKED = (
    *(".git", ".venv*", ".*_cache", ".hypothesis", "__pycache__", "*.egg-info"),
    *("build", "dist", "demo", "node_modules"),
)
BUILD = "import sys; from setuptools import build_meta; print(getattr(build_meta, sys.argv[1])(sys.argv[2]))"
"""Builds without build isolation, which would download setuptools."""
PATTERN = """
import pathlib
import gcd_dataset
from gcd_dataset.generator import build_body, build_pattern, measure
from gcd_dataset.generator.body import neutral_shape
from gcd_dataset.generator.drawing import draw_pattern
from gcd_dataset.generator.garments import design_from_dict
pattern = build_pattern(measure(build_body(neutral_shape())), design_from_dict({"meta": {"upper": "Shirt"}}))
print(pathlib.Path(gcd_dataset.__file__).parent, len(pattern.panels), draw_pattern(pattern).shape[0])
"""


def built(kind: str, source: Path, out: Path) -> Path:
    """The wheel or source distribution of the project in ``source``."""
    command = [sys.executable, "-c", BUILD, f"build_{kind}", str(out)]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return out / done.stdout.splitlines()[-1]


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the checkout: building writes into it."""
    copy = tmp_path_factory.mktemp("copy") / "tree"
    return shutil.copytree(ROOT, copy, symlinks=True, ignore=shutil.ignore_patterns(*UNTRACKED))


@pytest.fixture(scope="module")
def sdist(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built("sdist", tree, tmp_path_factory.mktemp("sdist"))


@pytest.fixture(scope="module")
def wheel(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built("wheel", tree, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def wheel_of_sdist(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("unpacked")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    (source,) = folder.iterdir()
    return built("wheel", source, tmp_path_factory.mktemp("second"))


def contents(wheel: Path) -> dict[str, bytes]:
    """Path to content of the files of a wheel, without its metadata."""
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist() if ".dist-info/" not in name}


def test_the_wheel_holds_the_package_and_nothing_else(wheel: Path) -> None:
    files = contents(wheel)
    assert {name.partition("/")[0] for name in files} == {"gcd_dataset"}
    here = {
        str(path.relative_to(ROOT))
        for top in ("gcd_dataset", "gcd_dataset/generator", "gcd_dataset/loaders")
        for path in (ROOT / top).rglob("*.py")
    }
    assert {name for name in files if name.endswith(".py")} == here
    assert "gcd_dataset/py.typed" in files
    tables = {path.name for path in (ROOT / "generator").rglob("*.toml")}
    assert {name.rpartition("/")[2] for name in files if name.endswith(".toml")} == tables
    data = {path.name for path in (ROOT / "generator" / "data").iterdir() if path.is_file()}
    assert {name.rpartition("/")[2] for name in files if "/generator/data/" in name} == data
    assert not any("tests" in name.split("/") or "benchmarks" in name.split("/") for name in files)


def test_the_wheel_of_the_source_distribution_is_the_same(wheel: Path, wheel_of_sdist: Path) -> None:
    assert wheel.name == wheel_of_sdist.name
    assert contents(wheel) == contents(wheel_of_sdist)


def test_the_source_distribution_holds_the_documents_of_a_release_and_no_tests(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"pyproject.toml", "README.md", "LICENSE", "NOTICE", "CHANGELOG.md", "CITATION.cff", "SECURITY.md"} <= names
    assert {name.partition("/")[0] for name in names}.isdisjoint({"tests", "benchmarks", "docs", ".github"})


def test_the_metadata_hold_version_licence_and_pythons(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        metadata = Parser().parsestr(archive.read(name).decode())
        files = {name.rpartition("/")[2] for name in archive.namelist() if ".dist-info/" in name}
    assert (metadata["Name"], metadata["Version"]) == ("gcd-dataset", gcd_dataset.__version__)
    assert (metadata["License-Expression"], metadata["Requires-Python"]) == ("Apache-2.0", ">=3.11")
    assert {"LICENSE", "NOTICE", "entry_points.txt"} <= files
    classifiers = metadata.get_all("Classifier") or []
    assert {"3.11", "3.12", "3.13"} <= {line.rpartition(":: ")[2] for line in classifiers}


@pytest.fixture(scope="module")
def clean(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ``bin`` folder of an environment with the wheel.

    Its dependencies are those of the test environment, which holds this package as a link to the checkout: the link is
    not followed, since ``.pth`` files are read in an environment's own folder only.
    """
    folder = tmp_path_factory.mktemp("clean") / "venv"
    venv.create(folder, with_pip=False)
    (site,) = folder.glob("lib/python*/site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = [sys.executable, "-m", "pip", "--python", str(folder / "bin" / "python"), "install", "--quiet"]
    subprocess.run([*pip, "--no-deps", "--no-index", "--force-reinstall", str(wheel)], check=True)
    return folder / "bin"


def run(*command: str | Path, cwd: Path) -> str:
    """The output of a command that runs outside of the checkout."""
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(cwd), "OMP_NUM_THREADS": "1"}
    done = subprocess.run([str(word) for word in command], cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_the_installed_command_prints_help_and_version(clean: Path, tmp_path: Path) -> None:
    assert "generate" in run(clean / "gcd", "--help", cwd=tmp_path)
    assert run(clean / "gcd", "--version", cwd=tmp_path) == f"gcd_dataset {gcd_dataset.__version__}\n"


def test_the_installed_package_draws_a_pattern(clean: Path, tmp_path: Path) -> None:
    folder, panels, pixels = run(clean / "python", "-c", PATTERN, cwd=tmp_path).split()
    assert Path(folder).is_relative_to(clean.parent)
    assert (int(panels) > 2, int(pixels)) == (True, 800)


def test_the_readme_can_be_followed(clean: Path, tmp_path: Path) -> None:
    release.follow_readme(clean.parent, tmp_path / "empty")


def test_the_installed_command_makes_and_examines_garments(clean: Path, tmp_path: Path) -> None:
    run(clean / "gcd", "generate", "shards", "--count", "3", "--stage", "mesh", "--resolution", "4", cwd=tmp_path)
    assert "3 samples" in run(clean / "gcd", "info", "shards", cwd=tmp_path)
    assert "nothing harmful" in run(clean / "gcd", "check", "shards", cwd=tmp_path)
