"""Notebooks run in a kernel: objects display as HTML with pictures, and progress bars as widgets."""

from pathlib import Path
from typing import Any

import pytest

from tests.shards.folders import fill

nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: make test-extras")
nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed: make test-extras")
pytest.importorskip("ipykernel", reason="ipykernel is not installed: make test-extras")
pytest.importorskip("ipywidgets", reason="ipywidgets is not installed: make test-extras")

BEGIN = """
from gcd_dataset.loaders import GarmentDataset, GarmentLoader
from gcd_dataset.loaders.fake import fake_sample
garments = GarmentDataset({folder!r})
"""
DISPLAYED = {
    "garments": 6,
    "garments[2]": 2,
    "next(iter(GarmentLoader(garments, 4)))": 4,
    "fake_sample(3, 1)": 2,
    "fake_sample(3, 1).pattern": 0,
}
"""Expression to the number of pictures that it displays."""
BAR = """
from gcd_dataset.cli.common import Bar
from gcd_dataset.making.progress import Progress
made = Bar("garment", quiet=False).run(lambda on_progress: [on_progress(Progress(8, 0, made=made)) for made in (0, 8)])
"""


def outputs_of(*cells: str) -> list[list[Any]]:
    """The outputs of each cell of a notebook, run in a kernel of this environment."""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    return [cell.outputs for cell in notebook.cells]


def test_objects_display_as_html_with_their_pictures(tmp_path: Path) -> None:
    folder = str(fill(tmp_path, range(8)))
    _, *displays = outputs_of(BEGIN.format(folder=folder), *DISPLAYED)
    for (expression, pictures), outputs in zip(DISPLAYED.items(), displays, strict=True):
        [output] = outputs
        assert output.data["text/html"].count("<img") == pictures, expression
        assert "text/plain" in output.data


def test_progress_displays_as_a_widget() -> None:
    [outputs] = outputs_of(BAR)
    [bar] = outputs  # no text on stderr beside it
    assert bar.data["application/vnd.jupyter.widget-view+json"]["model_id"]
