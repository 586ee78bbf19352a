"""Components are moved, mirrored, placed by each other, and assembled to patterns."""

import numpy as np
import pytest

from gcd_dataset.curves import signed_area
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.pattern import Component, Outline, Piece, assemble
from gcd_dataset.records import EdgeRole, Panel, Pattern


def rectangle(name: str, width: float = 20.0, height: float = 30.0) -> Piece:
    outline = Outline.start(0, 0).line(width, 0, name="hem").line(width, height, name="left")
    return Piece(name, outline.line(0, height, name="top").close(name="right"))


def tube(name: str, y: float = 60.0) -> Component:
    front, back = rectangle(f"{name}_f").at(-10, y, 12), rectangle(f"{name}_b").at(-10, y, -12)
    return (
        Component.of(front, back)
        .sewn(front.along("left"), back.along("left"))
        .sewn(front.along("right"), back.along("right"))
        .offering(top=front.against("top") + back.along("top"), hem=front.along("hem") + back.against("hem"))
    )


def corner(panel: Panel, vertex: int) -> list[float]:
    return [round(float(x), 6) for x in panel.placement.apply(panel.vertices[vertex])]


def seam_ends(pattern: Pattern) -> list[tuple[list[float], list[float]]]:
    """The two corners that meet at the start of every seam."""
    found = []
    for seam in pattern.seams:
        left, right = pattern.panel(seam.left.panel), pattern.panel(seam.right.panel)
        a, b = left.edges[seam.left.edge], right.edges[seam.right.edge]
        mate = b.start if seam.right_wrong else b.end
        found.append((corner(left, a.start), corner(right, mate)))
    return found


def test_an_assembled_tube_is_seen_from_outside_and_stays_in_place() -> None:
    """Loops run counter-clockwise, seams join the ends that face each other, the first corner is the origin."""
    pattern = assemble(tube("tube"), "tube")
    for panel in pattern.panels:
        assert signed_area(panel.vertices) * panel.placement.translation[2] > 0
        assert panel.vertices[0].tolist() == [0.0, 0.0]
        assert corner(panel, 0)[:2] == [-10.0, 60.0]
    assert not any(seam.right_wrong for seam in pattern.seams)
    for left, right in seam_ends(pattern):
        assert left[:2] == right[:2]


def test_a_panel_sewn_inside_out_is_right_to_wrong() -> None:
    front, back = rectangle("f").at(-10, 0, 12), rectangle("b").at(-10, 0, 14)
    pattern = assemble(Component.of(front, back).sewn(front.along("left"), back.along("left")), "lapel")
    assert [seam.right_wrong for seam in pattern.seams] == [True]


def test_a_divided_edge_keeps_its_label_on_every_part() -> None:
    skirt, belt = tube("skirt"), rectangle("belt", width=40.0, height=5.0).at(-20, 95, 20)
    whole = Component.of(skirt, belt).sewn(belt.along("hem"), skirt.interface("top"))
    pattern = assemble(whole.with_edge_label(belt.along("hem"), EdgeRole.LOWER_INTERFACE), "skirt")
    labelled = [edge.name for edge in pattern.panel("belt").edges if edge.label == "lower_interface"]
    assert labelled == ["hem", "hem"]


def test_what_cannot_be_assembled_or_placed_is_an_error() -> None:
    front, back = rectangle("f").at(0, 0, 12), rectangle("b").at(0, 0, -12)
    both, whole = Component.of(front, back), Component.of(front)
    once = both.sewn(front.along("left"), back.along("left"))
    with pytest.raises(PatternError, match="edge left of panel f is sewn twice"):
        assemble(once.sewn(front.along("left"), back.along("right")), "twice")
    with pytest.raises(PatternError, match="panels tube_b, tube_f appear twice"):
        Component.of(tube("tube"), tube("tube"))
    with pytest.raises(PatternError, match="interface all lies in the middle of its component"):
        whole.offering(all=front.along("hem", "left", "top", "right")).placed_by("all", tube("tube"), "hem", gap=5.0)
    with pytest.raises(PatternError, match="no panel named b: there are f"):
        assemble(whole.sewn(front.along("left"), back.along("left")), "half")
    with pytest.raises(PatternError, match="no edge named lefft: there are hem, left, top, right"):
        assemble(both.sewn(front.along("lefft"), back.along("left")), "misspelt")


def test_placed_by_leaves_a_gap_on_the_interfaces_side() -> None:
    upper, lower = tube("upper", y=100.0), tube("lower", y=0.0)
    assert lower.placed_by("top", upper, "hem", gap=5.0).points("top")[:, 1] == pytest.approx(95.0)


def test_gathers_shift_the_break_to_the_projected_lengths() -> None:
    # The front's 20 cm count 10, the back's 20 cm count 30: a quarter of the band's 40 cm goes to the front.
    skirt, belt = tube("skirt"), rectangle("belt", width=40.0, height=5.0).at(-20, 95, 20)
    front, back = skirt.piece("skirt_f"), skirt.piece("skirt_b")
    top = front.against("top", ruffle=2.0) + back.along("top", ruffle=20 / 30)
    pattern = assemble(Component.of(skirt, belt).sewn(belt.along("hem"), top), "gathered")
    xs = sorted(corner(pattern.panel("belt"), i)[0] for i in range(5))
    assert xs == [-20.0, -20.0, -10.0, 20.0, 20.0]


def test_a_component_turns_about_the_world_origin_and_its_mirror_image_lies_on_the_other_side() -> None:
    turned = rectangle("right_sleeve").at(10, 0, 5).turned(0.5 * np.pi)
    assert turned.points("hem") == pytest.approx(np.array([[0.0, 10.0, 5.0], [0.0, 30.0, 5.0]]), abs=1e-9)
    right = Component.of(turned).moved((-3, 0, 0))
    left = right.mirrored("right", "left")
    assert left.pieces[0].name == "left_sleeve"
    assert left.points() == pytest.approx(right.points() * [-1, 1, 1])


def test_an_interface_is_as_long_as_its_edges_together() -> None:
    front, back = rectangle("f").at(-10, 0, 12), rectangle("b", width=26.0).at(-13, 0, -12)
    gathered = Component.of(front, back).offering(hem=front.along("hem", ruffle=2.0) + back.against("hem"))
    assert gathered.length("hem") == pytest.approx(46.0)
