"""The guides run as they stand, on the CPU: their commands, and their programs, which are the blocks with a file name.

A block of commands with a title is not run: its title states the cluster, server or checkout that it needs.
"""

import ast
import re
import shutil
import textwrap
from pathlib import Path

import pytest

from tests.extras.guide import ROOT, Block, blocks_of, run

DOCS = ROOT / "docs"
SMALLER = {
    "index": {
        "GeneratedGarments(16, seed=0, resolution=3.0)": "GeneratedGarments(2, seed=0, resolution=9.0, picture=32)",
        "--count 1000 --seed 7 --bodies both": "--count 8 --seed 7 --bodies both --stage mesh --resolution 8",
    },
    "pictures": {
        "--count 48 --resolution 2": "--count 2 --resolution 9 --picture 0",
        "--count 1000 --views 8 --view-size 512": "--count 1 --resolution 9 --picture 0 --views 2 --view-size 32",
        "--index 3 --png": "--index 0 --png",
        "Views(n=4, size=256": "Views(n=2, size=32",
        "size=256, maps": "size=32, maps",
        "MakeConfig(resolution=2.0)": "MakeConfig(resolution=9.0)",
    },
    "labels": {"resolution=3.0": "resolution=9.0"},
    "scans": {"points=4096": "points=512"},
    "sketches": {"size=512": "size=64"},
    "evaluate": {
        "--drape --bodies BODIES --inputs INPUTS": "--by-kind --workers 1",
        "inputs T1 t1 --mini": "inputs T3 t1 --mini --quiet",
        "python my_model.py t1/inputs answers": "cp -r t1/inputs answers",
        " --out result.json --drape": " --out result.json --quiet",
        "answers t1 --card model.toml": "answers t1 --card card.toml",
    },
    "guides/train": {"--count 1000": "--count 40", "--resolution 3": "--resolution 8", "EPOCHS = 25": "EPOCHS = 2"},
    "guides/published-data": {"--count 40 --bodies both --resolution 4": "--count 4 --bodies both --resolution 9"},
    "guides/generate": {
        "--count 10000 --seed 7 --bodies both --device cuda:0": "--count 4 --resolution 9 --device cpu --picture 64",
        "resolution = 6.0": "resolution = 9.0",
        'GeneratedGarments(6, cache_dir="kept", fields=fields, resolution=4.0)': (
            'GeneratedGarments(2, cache_dir="kept", fields=fields, resolution=9.0)'
        ),
    },
    "guides/control": {
        "--count 1000 --resolution 2": "--count 1 --resolution 9 --picture 0",
        "VIEWS, SIZE = 4, 512": "VIEWS, SIZE = 2, 64",
    },
    "guides/own-body": {"--resolution 3": "--resolution 9", "spacing=3.0": "spacing=9.0"},
    "guides/own-fabric": {"--resolution 3": "--resolution 9", "resolution=3.0": "resolution=9.0"},
    "guides/own-garment": {"--resolution 2.5": "--resolution 9"},
    "concepts/drape": {"resolution=3.0": "resolution=9.0", "pairs=16": "pairs=12"},
    "concepts/index": {"spacing=3.0": "spacing=9.0"},
    "concepts/sample": {"GeneratedGarments(4, seed=3, resolution=3.0": "GeneratedGarments(2, seed=3, resolution=9.0"},
}
"""Document to the texts of its blocks that a test replaces: fewer garments, coarser meshes, no GPU."""
DRAPED = {"scans": "garments", "sketches": "garments", "exports": "shards"}
"""Document to the name of a folder with two draped garments, which it takes for granted."""
BEFORE = {"evaluate": ["gcd generate garments --count 4 --stage pattern --seed 3 --quiet", "python specifications.py"]}
"""Document to the commands that make what else it takes for granted."""
SPECIFICATIONS = """
import json
from pathlib import Path
from gcd_dataset.loaders import GarmentDataset

Path("card.toml").write_text('name = "none"\\ngarments = 0\\nminutes = 0\\nweights = 0\\nhardware = "none"\\n')
for folder in ("ANSWERS", "TRUTH"):
    Path(folder).mkdir()
    for item in GarmentDataset("garments", fields=["spec", "meta"]):
        Path(folder, item["meta"]["key"] + "_specification.json").write_text(json.dumps(item["spec"]))
"""
GUIDES = [
    *sorted(f"guides/{path.stem}" for path in (DOCS / "guides").glob("*.md") if path.stem != "index"),
    *sorted(f"concepts/{path.stem}" for path in (DOCS / "concepts").glob("*.md")),
    *("index", "labels", "pictures", "scans", "sketches", "evaluate", "exports"),
]
NEEDS_SERVERS = {"stores"}  # its commands need buckets; tests/extras/test_storage.py runs them against an S3 API
OWN_TESTS = {"training", "viewer", "check", "reconstruction"}  # the commands of these pages are tested elsewhere


@pytest.fixture(scope="module")
def draped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("draped")
    run(folder, *["gcd", "generate", "made", "--count", "2", "--resolution", "9", "--picture", "0", "--quiet"])
    return folder / "made"


@pytest.mark.parametrize("name", GUIDES)
def test_the_guide_runs(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    (tmp_path / "specifications.py").write_text(SPECIFICATIONS)
    if name == "guides/agents":
        pytest.importorskip("mcp", reason="mcp is not installed: make test-extras")
    if name in DRAPED:
        shutil.copytree(request.getfixturevalue("draped"), tmp_path / DRAPED[name])
    for line in BEFORE.get(name, []):
        run(tmp_path, *line.split())
    ran = 0
    for block in smaller(name):
        if block.language == "sh" and not block.title:
            for command in block.commands():
                run(tmp_path, *command)
                ran += 1
        elif block.title.endswith((".py", ".toml")):
            (tmp_path / block.title).write_text(block.text)
            if block.language == "python":
                run(tmp_path, "python", block.title)
                ran += 1
    assert ran > 0, f"{name}.md has no block that runs"


@pytest.mark.parametrize("name", GUIDES)
def test_untitled_python_is_python(name: str) -> None:
    for block in blocks_of(DOCS / f"{name}.md"):
        if block.language == "python":
            assert ast.parse(textwrap.dedent(block.text)).body


def test_every_document_with_commands_is_a_guide() -> None:
    """A new page with commands is run, too."""
    found = set()
    for path in DOCS.rglob("*.md"):
        name = str(path.relative_to(DOCS).with_suffix(""))
        if any(block.language == "sh" and not block.title for block in blocks_of(path)):
            found.add(name)
    assert found <= {*GUIDES, *NEEDS_SERVERS, *OWN_TESTS}


def test_each_replaced_text_occurs() -> None:
    for name, replaced in SMALLER.items():
        blocks = "".join(block.text for block in blocks_of(DOCS / f"{name}.md"))
        assert [text for text in replaced if text not in blocks] == []


def test_blocks_that_do_not_run_say_where_they_would() -> None:
    for name in GUIDES:
        for block in blocks_of(DOCS / f"{name}.md"):
            if block.language == "sh" and block.title:
                assert re.match(r"(in|on|from|where) ", block.title), f"{name}.md: {block.title}"


def smaller(name: str) -> list[Block]:
    """The blocks of a document with smaller numbers."""
    blocks = blocks_of(DOCS / f"{name}.md")
    for before, after in SMALLER.get(name, {}).items():
        blocks = [block._replace(text=block.text.replace(before, after)) for block in blocks]
    return blocks
