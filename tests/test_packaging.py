"""The wheel holds all packages and data files of the tree."""

import ast
import os
import tomllib
from importlib.metadata import version
from pathlib import Path
from typing import Any

import yaml

import gcd_dataset
from gcd_dataset.generator.recipes import recipe_names

ROOT = Path(__file__).resolve().parent.parent


def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_the_package_list_is_the_folders() -> None:
    """The list for setuptools is manual: a forgotten folder would be missing from the wheel only."""
    folders = set()
    for folder, _, names in os.walk(ROOT / "gcd_dataset", followlinks=True):
        if any(name.endswith(".py") for name in names):
            folders.add(".".join(Path(folder).relative_to(ROOT).parts))
    assert folders == set(project()["tool"]["setuptools"]["packages"])


def test_the_links_lead_to_the_mapped_folders() -> None:
    for name, folder in project()["tool"]["setuptools"]["package-dir"].items():
        assert (ROOT / name.replace(".", "/")).resolve() == (ROOT / folder).resolve()


def test_data_files_are_packed() -> None:
    packed = project()["tool"]["setuptools"]["package-data"]["gcd_dataset.generator"]
    data = [path for path in (ROOT / "generator" / "data").iterdir() if not path.name.startswith((".", "__"))]
    assert data
    assert all(path.match(pattern) for path in data for pattern in packed)
    assert sum(path.stat().st_size for path in data) < 2_500_000


def test_files_of_the_page_are_packed() -> None:
    packed = project()["tool"]["setuptools"]["package-data"]["gcd_dataset.viewer"]
    files = [path for path in (ROOT / "gcd_dataset" / "viewer").iterdir() if path.suffix in (".css", ".html", ".js")]
    assert {path.suffix for path in files} == {".css", ".html", ".js"}
    assert all(any(path.match(pattern) for pattern in packed) for path in files)


def test_recipes_are_packed() -> None:
    packed = project()["tool"]["setuptools"]["package-data"]["gcd_dataset.generator.recipes"]
    names = {path.name for path in (ROOT / "generator" / "recipes").glob("*.toml")}
    assert {name.removesuffix(".toml") for name in names} == set(recipe_names())
    assert all(any(Path(name).match(pattern) for pattern in packed) for name in names)


def test_one_version() -> None:
    """A literal in ``gcd_dataset/__init__.py``: setuptools parses it, since importing would need the dependencies."""
    assert gcd_dataset.__version__ == version("gcd-dataset")
    assert "version" not in project()["project"]
    tree = ast.parse((ROOT / "gcd_dataset" / "__init__.py").read_text())
    assigned = [
        node for node in tree.body if isinstance(node, ast.Assign) and "__version__" in ast.unparse(node.targets[0])
    ]
    assert [ast.literal_eval(node.value) for node in assigned] == [gcd_dataset.__version__]


def test_python_versions_are_those_of_the_workflow() -> None:
    listed = {line.rpartition(" ")[2] for line in project()["project"]["classifiers"] if "Python :: 3." in line}
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())
    assert set(workflow["jobs"]["test"]["strategy"]["matrix"]["python"]) == listed
    assert project()["project"]["requires-python"] == f">={min(listed, key=lambda text: int(text.split('.')[1]))}"


def test_the_workflow_runs_what_make_test_runs() -> None:
    """Format, lint, types and tests, extras, and distributions."""
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())
    steps = [step.get("run", "") for job in workflow["jobs"].values() for step in job["steps"]]
    commands = "\n".join(steps)
    for command in ("ruff format --check", "ruff check", "mypy", "pytest", "make test-extras", "python -m build"):
        assert command in commands, command
    actions = [step["uses"] for job in workflow["jobs"].values() for step in job["steps"] if "uses" in step]
    assert actions
    assert all("@" in action for action in actions)


def test_the_citation_names_title_and_licence_of_the_project() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
    assert citation["license"] == project()["project"]["license"]
    assert "version" not in citation  # in one place only


def test_constraints_pin_every_dependency() -> None:
    pins = {line.split("==")[0].lower() for line in (ROOT / "constraints.txt").read_text().splitlines() if "==" in line}
    wanted = project()["project"]["dependencies"] + project()["project"]["optional-dependencies"]["dev"]
    names = {requirement.split(">")[0].split("=")[0].split("[")[0].strip().lower() for requirement in wanted}
    assert names <= pins
