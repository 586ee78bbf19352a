"""Our patterns against GarmentCode's, from the same designs and measures.

Every folder with a ``*_specification.json``, a ``design_params.yaml`` and a ``body_measurements.yaml`` is one design.
``same``: panel names and seams agree. ``outline``: every outline is within 0.2 cm of its counterpart; within 0.5 cm for
fronts of the bodice and 1 cm for sleeves, their cuffs and hoods, where the reference varies between versions of SciPy;
and each sleeve's cap, without gathers, equals its armhole to 0.1 cm. ``placement``: every panel is placed within 1 cm
of its counterpart. A design that agrees only without some mend (``garments/mends.py``) counts as agreeing.
"""

import argparse
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import shapely
from jaxtyping import Float

from benchmarks.cases import CaseResult, Figure
from gcd_dataset.curves import LINE, curve_length, sample_curve
from gcd_dataset.errors import BodyError, ConfigError, PatternError, SpecError
from gcd_dataset.generator.body import read_measurements
from gcd_dataset.generator.garments import draw_garment
from gcd_dataset.generator.garments.design import GarmentDesign, read_design
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.records import EdgeRef, Measurements, Panel, Pattern
from gcd_dataset.spec import read_pattern

OUTLINE, FRONT_OUTLINE, SLEEVE_OUTLINE = 0.2, 0.5, 1.0  # tolerances of outlines [cm]
CAP_LENGTH = 0.1  # cm: tolerance between the lengths of a cap and its armhole
PLACEMENT = 1.0  # cm: tolerance of a panel's position


STEP = 0.25  # cm between compared points of an outline
CURVE_POINTS = 65


@dataclass(frozen=True, slots=True)
class FigureDifference:
    """One difference between two patterns."""

    panel: str
    message: str

    def __str__(self) -> str:
        return f"panel {self.panel}: {self.message}" if self.panel else self.message


@dataclass(frozen=True)
class Comparison:
    """All differences between two patterns."""

    structure: tuple[FigureDifference, ...]
    """Differences in names, edge counts and seams; empty if the graphs are equal."""
    outline: Mapping[str, float]
    """Shared panel to the Hausdorff distance of its outlines [cm]."""
    worst_edge: Mapping[str, int]
    """Shared panel to the edge of ``theirs`` with that distance."""
    placement: Mapping[str, float]
    """Shared panel to the largest distance of a corner between its two placements [cm]."""


def compare(ours: Pattern, theirs: Pattern) -> Comparison:
    """Compare panels of equal name.

    Panels are aligned by their first corner and the direction of their first edge. Loops may start anywhere: our first
    corner is the one that aligns the placed loops best in space.
    """
    shared = [panel.name for panel in ours.panels if any(other.name == panel.name for other in theirs.panels)]
    names = _name_differences(ours, theirs)
    pairs = {name: (ours.panel(name), theirs.panel(name)) for name in shared}
    shifts = {name: _shift(*pair) for name, pair in pairs.items()}
    counts = [
        FigureDifference(name, f"{len(mine.edges)} edges instead of {len(other.edges)}")
        for name, (mine, other) in pairs.items()
        if len(mine.edges) != len(other.edges)
    ]
    seams = [] if names or counts else _seam_differences(ours, theirs, shifts)
    aligned = {name: _aligned(*pair, shifts[name]) for name, pair in pairs.items()}
    outlines = {name: _outline_distance(aligned[name][0], pairs[name][1]) for name in shared}
    return Comparison(
        structure=(*names, *counts, *seams),
        outline={name: distance for name, (distance, _) in outlines.items()},
        worst_edge={name: edge for name, (_, edge) in outlines.items()},
        placement={name: aligned[name][1] for name in shared},
    )


def _name_differences(ours: Pattern, theirs: Pattern) -> list[FigureDifference]:
    mine, other = ({panel.name for panel in pattern.panels} for pattern in (ours, theirs))
    missing = [FigureDifference(name, "is missing") for name in sorted(other - mine)]
    return missing + [FigureDifference(name, "is not in theirs") for name in sorted(mine - other)]


def _seam_differences(ours: Pattern, theirs: Pattern, shifts: Mapping[str, int]) -> list[FigureDifference]:
    """Seams of one pattern that the other lacks, in their edge numbers."""
    counts = {panel.name: len(panel.edges) for panel in theirs.panels}

    def renumbered(ref: EdgeRef) -> EdgeRef:
        return EdgeRef(ref.panel, (ref.edge - shifts[ref.panel]) % counts[ref.panel])

    mine = {frozenset((renumbered(seam.left), renumbered(seam.right))): seam.right_wrong for seam in ours.seams}
    other = {frozenset((seam.left, seam.right)): seam.right_wrong for seam in theirs.seams}
    found = []
    for text, only in (("is not sewn", other.keys() - mine.keys()), ("is sewn here only", mine.keys() - other.keys())):
        found += [FigureDifference("", f"seam {_text(pair)} {text}") for pair in only]
    turned = [pair for pair in mine.keys() & other.keys() if mine[pair] != other[pair]]
    return sorted(
        found + [FigureDifference("", f"seam {_text(pair)} is sewn the other way") for pair in turned], key=str
    )


def _text(pair: frozenset[EdgeRef]) -> str:
    return " with ".join(sorted(f"{ref.panel} edge {ref.edge}" for ref in pair))


def _loop(panel: Panel) -> Float[np.ndarray, "e 2"]:
    """The corners in loop order [cm]."""
    return panel.vertices[[edge.start for edge in panel.edges]]


def _shift(ours: Panel, theirs: Panel) -> int:
    """The number of our edge that corresponds to their first edge."""
    mine, other = ours.placement.apply(_loop(ours)), theirs.placement.apply(_loop(theirs))
    if len(mine) != len(other):
        return int(np.argmin(np.linalg.norm(mine - other[0], axis=1)))
    distances = [np.linalg.norm(np.roll(mine, -shift, axis=0) - other, axis=1).sum() for shift in range(len(mine))]
    return int(np.argmin(distances))


def _aligned(ours: Panel, theirs: Panel, shift: int) -> tuple[Float[np.ndarray, "n 2"], float]:
    """Our outline in their panel's plane [cm], and the largest distance of a corner between the placements [cm]."""
    mine, other = np.roll(_loop(ours), -shift, axis=0), _loop(theirs)
    turn = _direction(other) @ _direction(mine).T

    def to_theirs(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        return (points - mine[0]) @ turn.T + other[0]

    in_ours = (other - other[0]) @ turn + mine[0]  # their corners in the plane of our panel
    distances = np.linalg.norm(ours.placement.apply(in_ours) - theirs.placement.apply(other), axis=1)
    return to_theirs(np.concatenate([_edge_points(ours, edge) for edge in range(len(ours.edges))])), float(
        distances.max()
    )


def _direction(loop: Float[np.ndarray, "e 2"]) -> Float[np.ndarray, "2 2"]:
    """The rotation from the x axis to the chord of the first edge."""
    x, y = (loop[1] - loop[0]) / np.linalg.norm(loop[1] - loop[0])
    return np.array([[x, -y], [y, x]])


def _outline_distance(ours: Float[np.ndarray, "n 2"], theirs: Panel) -> tuple[float, int]:
    """Hausdorff distance of the outlines [cm], and the edge of theirs that has it."""
    edges = [_edge_points(theirs, edge) for edge in range(len(theirs.edges))]
    points, edge_of = np.concatenate(edges), np.repeat(np.arange(len(edges)), [len(points) for points in edges])
    to_ours = shapely.distance(shapely.points(points), _ring(ours))
    to_theirs = shapely.distance(shapely.points(ours), _ring(points))
    if to_ours.max() >= to_theirs.max():
        return float(to_ours.max()), int(edge_of[np.argmax(to_ours)])
    nearest = np.linalg.norm(points - ours[np.argmax(to_theirs)], axis=1)
    return float(to_theirs.max()), int(edge_of[np.argmin(nearest)])


def _ring(points: Float[np.ndarray, "n 2"]) -> shapely.LineString:
    return shapely.LineString(np.concatenate([points, points[:1]]))


def _edge_points(panel: Panel, index: int) -> Float[np.ndarray, "n 2"]:
    """Points along an edge, without the last."""
    edge, (start, end) = panel.edges[index], panel.edge_ends(index)
    count = 2 + int(curve_length(start, end, edge.curve) / STEP) if edge.curve == LINE else CURVE_POINTS
    return sample_curve(start, end, edge.curve, count)[:-1]


# -------------------------------------------------------------------------------------------------------- the case


@dataclass(frozen=True)
class Verdict:
    """The differences between our pattern and the reference for one design."""

    name: str
    structure: tuple[str, ...]
    outline: tuple[str, ...]
    placement: tuple[str, ...]
    worst_outline: float = float("nan")
    worst_placement: float = float("nan")
    explained_by: tuple[Mend, ...] = ()
    """Mends left out to make the patterns agree."""

    @property
    def agrees(self) -> bool:
        """Whether the patterns agree."""
        return not (self.structure or self.outline or self.placement)

    @property
    def faults(self) -> int:
        """Number of the three criteria by which the patterns differ."""
        return sum(map(bool, (self.structure, self.outline, self.placement)))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, help="folder of designs, searched recursively")
    parser.add_argument("--only", default="", help="only designs whose path contains this text")


def run(options: argparse.Namespace) -> CaseResult:
    """Compare all designs. Raises ``ConfigError`` for a folder without designs."""
    folders = [path for path in _designs(options.folder) if options.only in str(path)]
    if not folders:
        raise ConfigError(f"{options.folder}: no folder in it has design, measures and specification of a pattern")
    verdicts = [_judge(options.folder, path) for path in folders]
    for verdict in verdicts:
        for text in (*verdict.structure, *verdict.outline, *verdict.placement):
            print(f"{verdict.name}: {text}")
    share = 1 / len(verdicts)
    figures = (
        Figure("same", share * sum(not v.structure for v in verdicts), "of designs"),
        Figure("outline", share * sum(not v.structure and not v.outline for v in verdicts), "of designs"),
        Figure("placement", share * sum(not v.structure and not v.placement for v in verdicts), "of designs"),
        Figure("with_all_mends", share * sum(v.agrees and not v.explained_by for v in verdicts), "of designs"),
        Figure("designs", len(verdicts), ""),
    )
    return CaseResult(figures, [_row(verdict) for verdict in verdicts])


def _row(verdict: Verdict) -> dict[str, object]:
    found = [text for texts in (verdict.structure, verdict.outline, verdict.placement) for text in texts]
    return {
        "design": verdict.name,
        "outline [cm]": verdict.worst_outline,
        "placement [cm]": verdict.worst_placement,
        "explained by": ", ".join(mend.name for mend in verdict.explained_by),
        "differs": "; ".join(found[:3]) + (f"; {len(found) - 3} more" if len(found) > 3 else ""),
    }


def _designs(folder: Path) -> list[Path]:
    needed = ("design_params.yaml", "body_measurements.yaml", "*_specification.json")
    return sorted(
        path.parent for path in folder.rglob(needed[0]) if all(any(path.parent.glob(name)) for name in needed)
    )


def _judge(root: Path, folder: Path) -> Verdict:
    """The verdict with all mends; if the patterns differ, with the fewest mends left out that explain it."""
    name = folder.relative_to(root).as_posix()
    try:
        design, size = read_design(folder / "design_params.yaml"), read_measurements(folder / "body_measurements.yaml")
        theirs = read_pattern(next(folder.glob("*_specification.json")))
        best = _verdict(name, size, design, theirs, ())
        for left_out in _subsets(design.mends()):
            if best.agrees:
                break
            other = _verdict(name, size, design, theirs, left_out)
            best = min(best, other, key=lambda verdict: verdict.faults)
        return best
    except (ConfigError, BodyError, SpecError) as error:
        return Verdict(name, (str(error),), (), ())


def _subsets(mends: Iterable[Mend]) -> list[tuple[Mend, ...]]:
    """All non-empty subsets of the mends, smallest first."""
    ordered = sorted(mends, key=lambda mend: mend.name)
    return [chosen for count in range(1, len(ordered) + 1) for chosen in combinations(ordered, count)]


def _verdict(
    name: str, size: Measurements, design: GarmentDesign, theirs: Pattern, left_out: tuple[Mend, ...]
) -> Verdict:
    try:
        ours = draw_garment(size, design, mends=ALL_MENDS - set(left_out))
    except PatternError as error:
        return Verdict(name, (f"cannot be drawn: {error}",), (), ())
    found = compare(ours, theirs)
    outline = [
        FigureDifference(panel, f"outline {distance:.2f} cm off at edge {found.worst_edge[panel]}")
        for panel, distance in found.outline.items()
        if distance > _tolerance(panel)
    ]
    placement = [
        FigureDifference(panel, f"hangs {distance:.2f} cm off")
        for panel, distance in found.placement.items()
        if distance > PLACEMENT
    ]
    caps = _cap_differences(ours, design)
    return Verdict(
        name,
        tuple(map(str, found.structure)),
        tuple(map(str, (*outline, *caps))),
        tuple(map(str, placement)),
        max(found.outline.values(), default=0.0),
        max(found.placement.values(), default=0.0),
        left_out,
    )


def _tolerance(panel: str) -> float:
    """Tolerance of a panel's outline [cm]."""
    if "sleeve" in panel or panel.startswith("sl_") or "hood" in panel:
        return SLEEVE_OUTLINE
    return FRONT_OUTLINE if panel.endswith("ftorso") else OUTLINE


def _cap_differences(pattern: Pattern, design: GarmentDesign) -> list[FigureDifference]:
    """Sleeves whose cap, without gathers, differs in length from the armhole."""
    found = []
    for side, arm in (("right", design.sleeve), ("left", design.left.sleeve)):
        if side == "left" and not design.left.enable_asym:
            arm = design.sleeve
        cap, armhole = _cap_and_armhole(pattern, side)
        excess = cap / arm.connect_ruffle - armhole
        if abs(excess) > CAP_LENGTH:
            found.append(FigureDifference(f"{side}_sleeve_f", f"cap {excess:+.2f} cm longer than its armhole"))
    return found


def _cap_and_armhole(pattern: Pattern, side: str) -> tuple[float, float]:
    """Lengths of a sleeve's cap and of its armhole [cm]; 0 without a sleeve."""
    caps, armholes = 0.0, 0.0
    for seam in pattern.seams:
        ends = sorted((seam.left, seam.right), key=lambda ref: "sleeve" not in ref.panel)
        if ends[0].panel.startswith(f"{side}_sleeve") and ends[1].panel.endswith("torso"):
            caps, armholes = caps + _length(pattern, ends[0]), armholes + _length(pattern, ends[1])
    return caps, armholes


def _length(pattern: Pattern, ref: EdgeRef) -> float:
    panel = pattern.panel(ref.panel)
    return curve_length(*panel.edge_ends(ref.edge), panel.edge(ref.edge).curve)
