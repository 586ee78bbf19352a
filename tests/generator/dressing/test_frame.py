"""The frame of a pattern: garments placed elsewhere are moved to where they are worn, all others stay."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gcd_dataset.generator.body import named_body
from gcd_dataset.generator.dressing.frame import Wearer, in_body_frame, moved, placed_outline, wearer_of
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import EdgeRef, Pattern, Seam
from tests.generator.dressing.test_openings import rectangle, tube

Form = Callable[[Pattern], Pattern]
KINDS = 8  # designs: dresses, tops, hoods, skirts, trousers and jumpsuits


def shifted(pattern: Pattern, *by: float) -> Pattern:
    return replace(pattern, panels=tuple(moved(panel, np.array(by)) for panel in pattern.panels))


def bare(pattern: Pattern) -> Pattern:
    """Without labels, as in the files of other programs."""
    panels = (
        replace(panel, label="", edges=tuple(replace(edge, label="") for edge in panel.edges))
        for panel in pattern.panels
    )
    return replace(pattern, panels=tuple(panels))


def nameless(pattern: Pattern) -> Pattern:
    names = {panel.name: f"piece_{number}" for number, panel in enumerate(pattern.panels)}
    panels = tuple(replace(panel, name=names[panel.name]) for panel in bare(pattern).panels)
    seams = tuple(
        Seam(EdgeRef(names[s.left.panel], s.left.edge), EdgeRef(names[s.right.panel], s.right.edge), s.right_wrong)
        for s in pattern.seams
    )
    return replace(pattern, panels=panels, seams=seams)


@pytest.fixture(scope="module")
def worn() -> list[tuple[Pattern, Wearer]]:
    """Sampled garments on the bodies that they are drawn for, women and men, small and tall."""
    config = MakeConfig(stage="pattern", bodies="random")
    dressed = [one for number in range(KINDS) for one in prepare(3, number, config).dressed]
    return [(one.pattern, wearer_of(one.body, one.size)) for one in dressed]


@pytest.fixture(scope="module")
def wearer() -> Wearer:
    return wearer_of(*named_body("neutral")[:2])


@pytest.mark.parametrize("form", [lambda pattern: pattern, bare, nameless], ids=["labelled", "bare", "nameless"])
def test_garments_that_are_placed_on_the_body_stay(worn: list[tuple[Pattern, Wearer]], form: Form) -> None:
    for pattern, wearer in worn:
        assert in_body_frame(form(pattern), wearer) == (form(pattern), ())


@pytest.mark.parametrize("by", [(0, -85, 0), (0, 55, 0), (0, -110, -150)])
@pytest.mark.parametrize("form", [lambda pattern: pattern, bare], ids=["labelled", "bare"])
def test_a_frame_at_the_pelvis_at_the_neck_or_beside_the_body_is_recognised(
    worn: list[tuple[Pattern, Wearer]], form: Form, by: tuple[float, ...]
) -> None:
    """Each garment returns to within 10 cm of its place."""
    for pattern, wearer in worn:
        found, sentences = in_body_frame(shifted(form(pattern), *by), wearer)
        assert "moved" in sentences[0]
        for panel, placed in zip(found.panels, pattern.panels, strict=True):
            assert panel.placement.translation == pytest.approx(placed.placement.translation, abs=10.0)


def side_by_side(pattern: Pattern) -> Pattern:
    """One for each leg."""
    pair = [shifted(pattern, x, 0, 0) for x in (-10.0, 10.0)]
    panels = tuple(replace(panel, name=f"{panel.name}_{n}") for n, one in enumerate(pair) for panel in one.panels)
    seams = tuple(
        Seam(EdgeRef(f"{seam.left.panel}_{n}", seam.left.edge), EdgeRef(f"{seam.right.panel}_{n}", seam.right.edge))
        for n, one in enumerate(pair)
        for seam in one.seams
    )
    return Pattern("pair", panels, seams)


def test_garments_of_other_kinds_stay_where_they_are(wearer: Wearer) -> None:
    kinds = {
        "low skirt": tube(48.0, 25.0, y=wearer.hips - 26.0),
        "high skirt": tube(40.0, 60.0, y=wearer.waist - 46.0),
        "gown with a train": tube(46.0, 190.0, y=wearer.armpit - 190.0),
        "hat": tube(29.0, 18.0, y=wearer.nape + 8.0),
        "leg warmers": side_by_side(tube(18.0, 35.0, y=10.0)),
        "apron": Pattern("apron", (rectangle("apron", 60.0, 90.0, z=22.0, y=45.0),), ()),
    }
    assert [kind for kind, pattern in kinds.items() if in_body_frame(pattern, wearer)[1]] == []


def test_the_sentence_tells_edge_heights_and_shift(wearer: Wearer) -> None:
    skirt = tube(50.0, 40.0, y=wearer.waist - 140.0)
    found, [sentence] = in_body_frame(shifted(skirt, 0, 0, 100.0), wearer)
    top = max(float(placed_outline(panel)[:, 1].max()) for panel in found.panels)
    assert top == pytest.approx(wearer.waist)
    assert f"hung {wearer.waist - 100:.0f} cm high, and is worn at {wearer.waist:.0f} cm" in sentence
    assert "moved 100 cm up and" in sentence
