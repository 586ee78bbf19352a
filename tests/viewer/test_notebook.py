"""Displays in notebooks: well-formed, with the garments' own pictures, and with every text of the data escaped."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from gcd_dataset.loaders import FakeGarments, GarmentDataset, collate_packed, collate_padded
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Panel, Pattern, Sample
from tests.shards.folders import fill
from tests.viewer.elements import Elements

HOSTILE = '</script><b onclick="x">&amp;'


def displayed(value: Any) -> Elements:
    return Elements(value._repr_html_())


@pytest.fixture(scope="module")
def sample() -> Sample:
    return fake_sample(3, 1)


def test_a_pattern_displays_one_group_for_each_panel(sample: Sample) -> None:
    elements = displayed(sample.pattern)
    panels = [attributes["data-panel"] for _, attributes in elements.found if "data-panel" in attributes]
    assert panels == [panel.name for panel in sample.pattern.panels]
    assert elements.count("svg") == 1


def test_a_pattern_without_panels_displays_its_name() -> None:
    elements = displayed(Pattern("nothing", (), ()))
    assert "nothing" in elements.texts and elements.count("svg") == 0


def test_a_sample_displays_its_pictures_and_its_pattern(sample: Sample) -> None:
    assert sample.front and sample.back
    elements = displayed(sample)
    assert (elements.count("img"), elements.count("svg")) == (2, 1)
    assert displayed(replace(sample, front=None, back=None)).count("img") == 0


def test_a_sample_without_a_drape_displays(sample: Sample) -> None:
    assert displayed(replace(sample, box_mesh=None, drape=None, front=None, back=None)).count("svg") == 1


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


def test_a_batch_without_pictures_displays_patterns() -> None:
    garments = FakeGarments(2, fields=["spec", "verts"])
    elements = displayed(collate_packed([garments[0], garments[1]]))
    assert (elements.count("img"), elements.count("svg")) == (0, 2)
    assert displayed(collate_packed([{"verts": torch.zeros(3, 3)}])).count("svg") == 0


def test_a_data_set_displays_its_first_garments(tmp_path: Path) -> None:
    fill(tmp_path, range(8))
    elements = displayed(GarmentDataset(tmp_path))
    assert elements.count("img") == 6
    assert displayed(GarmentDataset(tmp_path)[6:]).count("img") == 2
    assert displayed(GarmentDataset(tmp_path, fields=["verts"])).count("img") == 6


def test_garments_that_would_be_generated_are_not_displayed() -> None:
    assert displayed(FakeGarments(5)).count("img") == 0
