"""Imports are cheap, and point one way."""

import ast
import os
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


def test_the_generator_offers_its_steps() -> None:
    import gcd_dataset.generator as generator

    assert set(generator.__all__) == set(dir(generator))
    assert all(callable(getattr(generator, name)) for name in generator.__all__)
    with pytest.raises(AttributeError, match="no attribute sew"):
        generator.sew  # noqa: B018


@cache
def sources() -> list[Path]:
    """Every source file of the package, linked folders included."""
    folders = os.walk(PACKAGE, followlinks=True)
    return sorted(Path(folder) / name for folder, _, names in folders for name in names if name.endswith(".py"))


@cache
def imports_of(path: Path) -> set[str]:
    """Modules a file imports at any depth."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module}
    return found


def test_warp_is_imported_by_drape_and_render_alone() -> None:
    users = {str(p.relative_to(PACKAGE)) for p in sources() if any(m.split(".")[0] == "warp" for m in imports_of(p))}
    assert users
    assert all(user.startswith(("generator/drape/", "generator/render")) for user in users), users


def test_the_folders_before_the_drape_do_not_import_it() -> None:
    for path in sources():
        floor, folder = (*path.relative_to(PACKAGE).parts, "")[:2]
        if floor == "generator" and folder in ("body", "pattern", "garments", "mesh", "dressing"):
            assert not any(name.startswith("gcd_dataset.generator.drape") for name in imports_of(path)), path


def test_ray_is_imported_by_its_engine_alone() -> None:
    users = {str(p.relative_to(PACKAGE)) for p in sources() if any(m.split(".")[0] == "ray" for m in imports_of(p))}
    assert users == {"making/ray.py"}


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


def test_shards_published_files_and_metrics_know_nothing_of_the_generator() -> None:
    for path in sources():
        if path.relative_to(PACKAGE).parts[0] in ("shards", "release", "hub", "metrics"):
            assert not any(
                name.startswith(("gcd_dataset.generator", "gcd_dataset.loaders")) for name in imports_of(path)
            )


def test_servers_are_reached_by_the_hub_and_by_the_place_of_a_run_alone() -> None:
    for path in sources():
        part, names = path.relative_to(PACKAGE).parts[0], imports_of(path)
        clients = [name for name in names if name.startswith(("huggingface_hub", "aiohttp", "fsspec", "s3fs"))]
        assert not clients or part == "hub" or (part == "making" and clients == ["fsspec"]), path


def test_shards_import_neither_releases_nor_the_hub() -> None:
    for path in sources():
        if path.relative_to(PACKAGE).parts[0] == "shards":
            above = [name for name in imports_of(path) if name.startswith(("gcd_dataset.release", "gcd_dataset.hub"))]
            assert not above, f"{path.name} imports {above}"
