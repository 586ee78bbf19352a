"""The documents agree with the code, with the reports and with each other; the wheel holds the tree."""

import ast
import doctest
import io
import os
import re
import tomllib
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
import yaml
from PIL import Image

import gcd_dataset
from docs.tools import figures, marked, tables
from docs.tools.figures import FIGURES, StaleError, read_report
from gcd_dataset.generator.garments import GarmentDesign
from gcd_dataset.generator.garments.space import DesignSpace
from gcd_dataset.generator.recipes import recipe_names
from gcd_dataset.shards.layout import FIELDS
from gcd_dataset.shards.meta import GARMENT, SOMETIMES
from gcd_dataset.shards.sections import unpack
from tests.shards.folders import fill
from tools import release

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md")]
PAGES += sorted(DOCS.rglob("*.md"))
LINK = re.compile(r"\]\(([^)\s]+)\)")
LARGEST_PICTURE = 250_000  # bytes


@pytest.mark.parametrize("name", tables.DOCUMENTS)
def test_generated_parts_are_up_to_date(name: str) -> None:
    text = (ROOT / name).read_text()
    assert tables.updated(text) == text, f"{name} is stale: python -m docs.tools.tables"


def test_every_document_with_generated_parts_is_listed_and_every_part_is_shown() -> None:
    found = {str(page.relative_to(ROOT)): marked.marked_names(page.read_text()) for page in PAGES}
    assert {name for name, shown in found.items() if shown} == set(tables.DOCUMENTS)
    assert {part for shown in found.values() for part in shown} == set(tables.TABLES)


def test_a_changed_report_makes_the_table_stale(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for path in figures.REPORTS.glob("*.md"):
        (tmp_path / path.name).write_text(
            re.sub(r"(?m)^\| drape\.clean \| \S+ ", "| drape.clean | 0.5 ", path.read_text())
        )
    before = figures.figures_table()
    monkeypatch.setattr(figures, "REPORTS", tmp_path)
    read_report.cache_clear()
    try:
        assert "50.0 % of " in figures.figures_table()
        assert figures.figures_table() != before
        (tmp_path / "scale.md").write_text("# scale\n")
        read_report.cache_clear()
        with pytest.raises(StaleError, match=r"scale\.md has no figure"):
            figures.figures_table()
    finally:
        read_report.cache_clear()


def test_every_figure_has_a_command_and_hardware() -> None:
    for figure in FIGURES:
        report = read_report(figure.report)
        assert (figure.command or report.fact("command")).strip("`").startswith("python -m benchmarks."), figure.what
        assert figure.on or report.fact("hardware"), figure.what


def test_the_readme_is_short_and_names_its_limits() -> None:
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 90
    assert len(text.split()) < 1200
    assert "make demo" in text
    assert "make test" in text
    assert "docs/limits.md" in text


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_to_files_lead_to_files(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    files = [target.partition("#")[0] for target in LINK.findall(text) if "://" not in target]
    assert [file for file in files if file and not (page.parent / file).exists()] == []


def test_the_notes_of_a_release_are_the_newest_section_of_the_changelog() -> None:
    text = (ROOT / "CHANGELOG.md").read_text()
    first, _, rest = release.notes().partition("\n")
    assert first == re.findall(r"^## .*", text, re.MULTILINE)[0]
    assert rest.strip() in text
    assert "\n## " not in rest


def test_links_to_headings_of_the_readme_lead_to_headings() -> None:
    """The site's own links are checked when it is built; the README is not on the site."""
    for target in LINK.findall((ROOT / "README.md").read_text()):
        file, _, anchor = target.partition("#")
        if anchor and "://" not in target:
            headings = re.findall(r"^#+ (.*)$", (ROOT / file).read_text(), re.MULTILINE)
            assert anchor in {re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-") for heading in headings}


def test_the_index_table_lists_the_sections_of_an_index(tmp_path: Path) -> None:
    fill(tmp_path, range(2))
    text = (DOCS / "format.md").read_text()
    section = text[text.index("## `SPLIT.index`") : text.index("## Bodies")]
    told = dict(re.findall(r"^\| `(\w+)` \| (\w+) \|", section, re.MULTILINE))
    assert told == {
        name: array.dtype.str[1:] for name, array in unpack((tmp_path / "train.index").read_bytes()).items()
    }


def test_the_meta_table_lists_the_keys_of_a_meta_file() -> None:
    text = (DOCS / "format.md").read_text()
    section = text[text.index("## `meta.json`") : text.index("## `rejects.jsonl`")]
    told = set(re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE))
    assert told == {*GARMENT, *SOMETIMES, "holds", "recipe_sha256", "crc32", "crc32_before"}


def test_every_rule_of_rejects_and_redraws_is_described() -> None:
    told = (DOCS / "limits.md").read_text().split("## Rules of the sampler")[1]
    pattern = re.compile(r'(?:(?:Reject|Redraw|SewingFault)\(|\.(?:within|again)\(\w+, |rule=)"(\w+)"')
    rules = {rule for path in (ROOT / "generator").rglob("*.py") for rule in pattern.findall(path.read_text())}
    assert len(rules) > 20
    assert not {rule for rule in rules if f"`{rule}`" not in told}


def test_every_field_has_a_unit_and_arrays_an_axis() -> None:
    assert set(tables.UNITS) == set(FIELDS)
    assert set(tables.ROWS) == {field for field, member in FIELDS.items() if member.endswith(".z")}


def test_pictures_are_small_and_shown() -> None:
    pages = "".join(page.read_text() for page in PAGES)
    pictures = sorted((DOCS / "images").rglob("*.jpg"))
    assert len(pictures) >= 8
    for picture in pictures:
        content = picture.read_bytes()
        assert len(content) <= LARGEST_PICTURE, picture.name
        assert Image.open(io.BytesIO(content)).width >= 600
        assert picture.name in pages, f"{picture.name} is on no page"


def test_the_script_draws_the_pictures_that_are_there() -> None:
    names = re.findall(r'^    "(\w+)": \1,$', (DOCS / "tools" / "pictures.py").read_text(), re.MULTILINE)
    assert {f"{name}.jpg" for name in names} == {path.name for path in (DOCS / "images").glob("*.jpg")}
    sections = {entry.key for entry in DesignSpace.declared(GarmentDesign).entries}
    assert sections == {path.stem for path in (DOCS / "images" / "parameters").iterdir()}


@pytest.mark.parametrize("module", [figures, marked, tables], ids=lambda module: str(module.__name__))
def test_examples_in_the_tools(module: object) -> None:
    assert doctest.testmod(module).failed == 0  # type: ignore[arg-type]


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


@pytest.mark.parametrize(
    ("package", "folder", "endings"),
    [
        ("gcd_dataset.generator", "generator/data", ()),
        ("gcd_dataset.viewer", "gcd_dataset/viewer", (".css", ".html", ".js")),
        ("gcd_dataset.generator.recipes", "generator/recipes", (".toml",)),
    ],
)
def test_data_files_are_packed(package: str, folder: str, endings: tuple[str, ...]) -> None:
    packed = project()["tool"]["setuptools"]["package-data"][package]
    files = [path for path in (ROOT / folder).iterdir() if not path.name.startswith((".", "__"))]
    files = [path for path in files if not endings or path.suffix in endings]
    assert files
    assert {path.suffix for path in files} >= set(endings)
    assert all(any(path.match(pattern.removeprefix("data/")) for pattern in packed) for path in files)
    if package.endswith("recipes"):
        assert {path.stem for path in files} == set(recipe_names())
    assert sum(path.stat().st_size for path in files) < 2_500_000


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


def test_the_container_recipes_have_the_same_steps_and_copy_what_is_there() -> None:
    docker, apptainer = ((ROOT / name).read_text() for name in ("Dockerfile", "apptainer.def"))
    copied = [word for line in re.findall(r"^COPY (.*) \S+$", docker, re.MULTILINE) for word in line.split()]
    assert [name for name in copied if not (ROOT / name).exists()] == []
    assert re.findall(r"^    (\S+) /opt/gcd_dataset/\1$", apptainer, re.MULTILINE) == copied
    assert {*project()["project"]["license-files"], project()["project"]["readme"]} <= {*copied}
    assert {Path(folder).parts[0] for folder in project()["tool"]["setuptools"]["package-dir"].values()} <= {*copied}
    steps = re.findall(r"^RUN (.*)", docker, re.MULTILINE)
    assert steps == re.findall(r"^    (pip .*)", apptainer, re.MULTILINE)
    extras = steps[-1].partition("[")[2].partition("]")[0].split(",")
    assert {*extras} <= {*project()["project"]["optional-dependencies"]}
    assert re.findall(r"^(?:FROM|From:) (.*)", docker + apptainer, re.MULTILINE) == ["python:3.12-slim"] * 2
