"""Imports are cheap, and point one way."""

import os
import re
import subprocess
import sys
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "gcd_dataset"
LIBRARIES = {
    *("torch", "warp", "h5py", "scipy", "shapely", "trimesh", "webdataset", "huggingface_hub", "aiohttp", "ray"),
    *("ezdxf", "reportlab", "pxr"),
}
SIMULATORS = {"warp", "torch"}


def loaded_by(*modules: str) -> list[set[str]]:
    """The modules that a fresh interpreter has loaded after each of these imports, one after another."""
    code = f"import sys\nfor name in {modules!r}:\n    __import__(name)\n    print(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    return [set(line.split()) for line in out.splitlines()]


def test_the_front_door_brings_numpy_alone() -> None:
    """NumPy and jaxtyping take 0.1 s of CPU time to import, which ``gcd --help`` does not need.

    The libraries of exports are imported when a file is written.
    """
    exports = [f"gcd_dataset.exports.{name}" for name in ("dxf_file", "pdf_file", "meshes")]
    modules = ("gcd_dataset", "gcd_dataset.__main__", "gcd_dataset.cli", "gcd_dataset.spec", "gcd_dataset.exports")
    loaded = loaded_by(*modules, *exports)
    assert not loaded[1] & {"numpy", "jaxtyping", "gcd_dataset.records", "tqdm", "yaml"}
    assert not loaded[len(modules) - 1] & LIBRARIES
    assert not loaded[-1] & (LIBRARIES - {"scipy", "shapely"})


def test_loaders_import_what_reading_shards_needs() -> None:
    """Generator, published files, pictures and geometry are imported by the data set or transform that uses them."""
    [loaded] = loaded_by("gcd_dataset.loaders")
    assert "torch" in loaded
    assert not loaded & (LIBRARIES - {"torch"} | {"PIL", "yaml"})
    assert not loaded & {f"gcd_dataset.{n}" for n in ("generator.garments", "generator.body", "release.read_garment")}


@pytest.mark.parametrize("name", ["gcd_dataset", "gcd_dataset.loaders", "gcd_dataset.release", "gcd_dataset.generator"])
def test_every_public_name_can_be_imported(name: str) -> None:
    package = import_module(name)
    assert set(package.__all__) <= {*dir(package), "__version__"}
    assert all(getattr(package, public) is not None for public in package.__all__)
    assert name != "gcd_dataset.generator" or set(package.__all__) == set(dir(package))
    with pytest.raises(AttributeError, match="no attribute sew"):
        package.sew  # noqa: B018


def test_patterns_are_drawn_meshed_and_dressed_without_the_simulator() -> None:
    """Patterns without trimesh too: it takes 0.4 s of CPU time to import, and only scans and posed arms need it.

    Every Ray task imports the engine; tasks that make patterns need neither Warp nor torch. Ray is optional.
    """
    steps = [
        f"gcd_dataset.generator.{name}" for name in ("pipeline", "body", "pattern", "garments", "mesh", "dressing")
    ]
    first, *_, last = loaded_by(*steps, "gcd_dataset.making.ray")
    assert "trimesh" not in first
    assert not last & {*SIMULATORS, "ray"}


@cache
def sources() -> list[Path]:
    """Every source file of the package, linked folders included."""
    folders = os.walk(PACKAGE, followlinks=True)
    return sorted(Path(folder) / name for folder, _, names in folders for name in names if name.endswith(".py"))


@cache
def imports_of(path: Path) -> set[str]:
    """Modules a file imports at any depth."""
    return set(re.findall(r"^ *(?:from|import) ([\w.]+)", path.read_text(), re.MULTILINE))


SIMULATED = ("generator/drape/", "generator/render")
USERS = {
    "warp": ("generator/device.py", "generator/mesh/filling.py", "generator/mesh/triangulate.py", *SIMULATED),
    "ray": ("making/ray.py",),
    "mcp": ("mcp/",),
    "huggingface_hub": ("hub/",),
    "aiohttp": ("hub/",),
    "s3fs": ("hub/",),
    "fsspec": ("hub/", "making/"),
}
"""Library to the only files that import it."""
LOWER = ("check", "cli", "exports", "generator", "hub", "loaders", "making", "metrics", "release", "scoring")
BELOW = {
    (*LOWER, "shards", "viewer"): ("gcd_dataset.mcp",),
    ("shards", "release", "hub", "metrics"): ("gcd_dataset.generator", "gcd_dataset.loaders"),
    ("shards",): ("gcd_dataset.release", "gcd_dataset.hub"),
    tuple(f"generator/{name}" for name in ("body", "pattern", "garments", "mesh", "dressing")): (
        "gcd_dataset.generator.drape",
    ),
}
"""Folders to the modules above them, which they do not import."""


@pytest.mark.parametrize("library", USERS)
def test_a_library_is_imported_by_its_users_alone(library: str) -> None:
    users = {str(p.relative_to(PACKAGE)) for p in sources() if any(m.split(".")[0] == library for m in imports_of(p))}
    assert all(user.startswith(USERS[library]) for user in users), users


@pytest.mark.parametrize("folders", BELOW)
def test_folders_import_nothing_above_them(folders: tuple[str, ...]) -> None:
    for path in sources():
        if str(path.relative_to(PACKAGE).parent).startswith(folders):
            assert not any(name.startswith(BELOW[folders]) for name in imports_of(path)), path


LAYERS = {
    "measurements": {"errors"},
    "records": {"errors", "curves", "measurements", "viewer.notebook"},  # the last when displayed in a notebook
    "jsonfile": {"errors", "filekinds", "files"},
    "spec": {"errors", "curves", "records", "files", "jsonfile"},
    "crossings": {"curves", "records"},
    "faults": {"errors", "curves", "records", "crossings"},
    "tensors": {"errors", "curves", "records"},
    "bodies": {"errors", "records"},
    "bodyfiles": {"errors", "files", "jsonfile", "measurements", "records", "yamlfile"},
    "seeding": set(),
    "curves": {"errors"},
}


@pytest.mark.parametrize("module", LAYERS)
def test_imports_point_one_way(module: str) -> None:
    own = {name.removeprefix("gcd_dataset.") for name in imports_of(PACKAGE / f"{module}.py") if "gcd_dataset" in name}
    assert own <= LAYERS[module]
