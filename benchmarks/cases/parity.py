"""Our patterns against GarmentCode's, from the same designs and measures.

Every folder with a ``*_specification.json``, a ``design_params.yaml`` and a ``body_measurements.yaml`` is one design.
``same``: panel names and seams agree. ``outline``: every outline is within 0.2 cm of its counterpart; within 0.5 cm for
fronts of the bodice and 1 cm for sleeves, their cuffs and hoods, where the reference varies between versions of SciPy;
and each sleeve's cap, without gathers, equals its armhole to 0.1 cm. ``placement``: every panel is placed within 1 cm
of its counterpart. A design that agrees only without some mend (``garments/mends.py``) counts as agreeing; with
``--expect``, a TOML file of folder name to list of mends, only the listed mends may be left out.
"""

import argparse
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from benchmarks.cases.figures import CaseResult, Figure
from benchmarks.comparison import FigureDifference, compare
from gcd_dataset.curves import curve_length
from gcd_dataset.errors import BodyError, ConfigError, PatternError, SpecError
from gcd_dataset.generator.body import read_measurements
from gcd_dataset.generator.garments import outfit
from gcd_dataset.generator.garments.design import GarmentDesign, read_design
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.jsonfile import read_toml
from gcd_dataset.records import EdgeRef, Measurements, Pattern
from gcd_dataset.spec import read_pattern

OUTLINE, FRONT_OUTLINE, SLEEVE_OUTLINE = 0.2, 0.5, 1.0  # tolerances of outlines [cm]
CAP_LENGTH = 0.1  # cm: tolerance between the lengths of a cap and its armhole
PLACEMENT = 1.0  # cm: tolerance of a panel's position


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
    parser.add_argument("--expect", type=Path, help="TOML: folder name = list of mends that may be left out")


def run(options: argparse.Namespace) -> CaseResult:
    """Compare all designs. Raises ``ConfigError`` for a folder without designs, or an invalid ``--expect`` file."""
    folders = [path for path in _designs(options.folder) if options.only in str(path)]
    if not folders:
        raise ConfigError(f"{options.folder}: no folder in it has design, measures and specification of a pattern")
    expected = None if options.expect is None else _read_expected(options.expect)
    verdicts = [_judge(options.folder, path, expected) for path in folders]
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


def _read_expected(path: Path) -> Mapping[str, frozenset[Mend]]:
    content = read_toml(path)
    try:
        return {folder: frozenset(Mend[name] for name in mends) for folder, mends in content.items()}
    except TypeError as error:
        raise ConfigError(f"{path}: {error}: give a TOML file of folder name = list of mends") from error
    except KeyError as error:
        known = ", ".join(mend.name for mend in Mend)
        raise ConfigError(f"{path}: unknown mend {error}: choose among {known}") from error


def _judge(root: Path, folder: Path, expected: Mapping[str, frozenset[Mend]] | None) -> Verdict:
    """The verdict with all mends; if the patterns differ, with the fewest mends left out that explain it."""
    name = folder.relative_to(root).as_posix()
    may_explain = ALL_MENDS if expected is None else expected.get(name, frozenset())
    try:
        design, size = read_design(folder / "design_params.yaml"), read_measurements(folder / "body_measurements.yaml")
        theirs = read_pattern(next(folder.glob("*_specification.json")))
        best = _verdict(name, size, design, theirs, ())
        for left_out in _subsets(may_explain & design.mends()):
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
        ours = outfit(size, design, mends=ALL_MENDS - set(left_out))
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
    return curve_length(*panel.edge_ends(ref.edge), panel.edges[ref.edge].curve)
