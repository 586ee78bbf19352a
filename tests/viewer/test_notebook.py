"""Displays in notebooks: well-formed, with the garments' own pictures, and with every text of the data escaped."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

from gcd_dataset import generate_people
from gcd_dataset.generator.drawing import SKIN, draw_body
from gcd_dataset.loaders import BodyDataset, FakeGarments, GarmentDataset, collate_packed, collate_padded
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Panel, Pattern, Sample, StoredView
from gcd_dataset.viewer.notebook import item_html
from tests.shards.folders import fill
from tests.viewer.elements import Elements

HOSTILE = '</script><b onclick="x">&amp;'


def displayed(value: Any) -> Elements:
    return Elements(value._repr_html_())


@pytest.fixture(scope="module")
def sample() -> Sample:
    return fake_sample(3, 1)


@pytest.fixture(scope="module")
def bodies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two generated people in shards."""
    folder = tmp_path_factory.mktemp("bodies")
    generate_people(folder, 2, seed=1, workers=0)
    return folder


def test_a_pattern_displays_one_group_for_each_panel(sample: Sample) -> None:
    elements = displayed(sample.pattern)
    panels = [attributes["data-panel"] for _, attributes in elements.found if "data-panel" in attributes]
    assert panels == [panel.name for panel in sample.pattern.panels]
    assert elements.count("svg") == 1


def test_a_sample_displays_its_pictures_and_its_pattern(sample: Sample) -> None:
    assert sample.front and sample.back
    elements = displayed(sample)
    assert (elements.count("img"), elements.count("svg")) == (2, 1)
    assert displayed(replace(sample, front=None, back=None)).count("img") == 0


def test_texts_of_the_data_are_escaped(sample: Sample) -> None:
    first = sample.pattern.panels[0]
    renamed: Panel = replace(first, name=HOSTILE)
    pattern = Pattern(HOSTILE, (renamed, *sample.pattern.panels[1:]), ())
    hostile = replace(sample, key=HOSTILE, pattern=pattern, caption=HOSTILE, tags=(HOSTILE,))
    for shown in (displayed(pattern), displayed(hostile)):
        assert shown.count("b") == 1  # the heading's own
        assert shown.count("script") == 0
        assert HOSTILE in shown.texts


def test_an_item_displays_pictures_pattern_and_fields() -> None:
    item = FakeGarments(2)[1]
    elements = displayed(item)
    assert (elements.count("img"), elements.count("svg")) == (2, 1)
    assert set(item) <= set(elements.texts)


@pytest.mark.parametrize("collate", [collate_packed, collate_padded])
def test_a_batch_displays_the_fronts_of_its_garments(collate: Any) -> None:
    batch = collate([FakeGarments(3)[i] for i in range(3)])
    assert displayed(batch).count("img") == 3
    assert displayed(batch.to(torch.float64)).count("img") == 3


def test_drawn_pictures_are_displayed(sample: Sample) -> None:
    garments = FakeGarments(2, fields=["spec"])
    views, sketches = torch.zeros(3, 8, 8, 3, dtype=torch.uint8), torch.zeros(2, 8, 8, dtype=torch.uint8)
    items = [{**garments[i], "views": views, "sketch": sketches} for i in range(2)]
    assert item_html(items[0]).count("<img") == 5
    batch = displayed(collate_packed(items))
    assert (batch.count("img"), batch.count("svg")) == (2, 0)  # one of each garment
    assert item_html({**garments[0], "views": torch.zeros(3)}).count("<img") == 0  # of another origin
    assert sample.front
    stored = replace(sample, views=(StoredView(sample.front),) * 2, caption="short\nlong")
    assert displayed(stored).count("img") == 4
    assert "pre-line" in stored._repr_html_()


def test_a_data_set_displays_its_first_garments(tmp_path: Path) -> None:
    fill(tmp_path, range(8))
    assert displayed(GarmentDataset(tmp_path)).count("img") == 6
    assert displayed(GarmentDataset(tmp_path)[6:]).count("img") == 2
    assert displayed(GarmentDataset(tmp_path, fields=["verts"])).count("img") == 6


def test_garments_that_would_be_generated_are_not_displayed() -> None:
    assert displayed(FakeGarments(5)).count("img") == 0


def test_a_person_displays_its_name_and_fields(bodies: Path) -> None:
    person = BodyDataset(bodies, fields=("name", "measures"))[0]
    assert {person["name"], "measures"} <= set(displayed(person).texts)


def test_a_body_is_drawn_from_the_front_in_proportion() -> None:
    """A box of 20 by 40 by 10 cm: twice as high as wide, its front lit, its back unseen."""
    box = trimesh.creation.box((20.0, 40.0, 10.0))
    drawn = draw_body(np.asarray(box.vertices), np.asarray(box.faces), height=200)
    front = np.abs(drawn.astype(int) - SKIN).max(axis=2) < 8
    rows, columns = front.any(axis=1).nonzero()[0], front.any(axis=0).nonzero()[0]
    assert np.ptp(rows) / np.ptp(columns) == pytest.approx(2.0, abs=0.05)
