"""Predictions and true patterns as two folders of specification files, matched by file name, and their scores."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

from gcd_dataset.errors import GcdError, PatternError, SpecError, shown
from gcd_dataset.faults import MOST_EDGES, MOST_PANELS, Rule, Severity, check_pattern
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.metrics import PanelShape, failed_score, score_pattern
from gcd_dataset.records import BoxMesh, Pattern
from gcd_dataset.scoring.distances import WORST, MeshShape, distance
from gcd_dataset.spec import is_bodice, is_trouser_leg, read_pattern
from gcd_dataset.workers import parallel_map

SPACING = 2.0  # cm: edge length of the box meshes that are compared
MOST_CLOTH = 400_000.0  # cm²: forty square metres; a larger prediction is not meshed
NO_PREDICTION = "no prediction"
SIZES = (Rule.MANY_PANELS, Rule.MANY_EDGES)
ENDINGS = ("_specification", "_predicted", "_prediction")
"""Ends of file names that are not part of a garment's name."""
PLAIN = frozenset({"specification", "prediction", "predicted"})  # stems of files that are named by their folder
MOST_NAMES = 5  # most names listed in a message


@dataclass(frozen=True, slots=True)
class GarmentPair:
    """One test garment."""

    name: str
    true: Path
    predicted: Path | None
    """``None`` without a prediction."""


@dataclass(frozen=True, slots=True)
class Folders:
    """The test garments of two folders."""

    cases: tuple[GarmentPair, ...]
    """All garments of the folder of true patterns, by name."""
    unknown: tuple[str, ...]
    """Predictions without a true pattern."""

    def remarks(self) -> Iterator[str]:
        """One line on the garments without a prediction, and one on the predictions without a true pattern."""
        missing = [case.name for case in self.cases if case.predicted is None]
        if missing:
            yield f"{len(missing)} of {len(self.cases)} garments without a prediction, all failures: {listed(missing)}"
        if self.unknown:
            named = f"{len(self.unknown)}: {listed(self.unknown)}{_in_capitals(self.unknown, missing)}"
            yield f"predictions without a true pattern, not scored: {named}: name each prediction after its garment"


def match_folders(predictions: Path, truth: Path) -> Folders:
    """The garments of ``truth`` with their predictions.

    Raises ``SpecError`` for a missing or empty folder, or if no name occurs in both; see ``garment_files``.
    """
    true, predicted = garment_files(truth), garment_files(predictions)
    if not true.keys() & predicted.keys():
        raise SpecError(
            f"{predictions}: no file is named as one of {truth}: it holds {listed(list(predicted))}, the other "
            f"{listed(list(true))}{_in_capitals(predicted, true)}: name each prediction after its garment"
        )
    cases = tuple(GarmentPair(name, path, predicted.get(name)) for name, path in sorted(true.items()))
    return Folders(cases, tuple(sorted(predicted.keys() - true.keys())))


def garment_files(folder: Path) -> dict[str, Path]:
    """Name of a garment to its specification file.

    Files are ``NAME.json`` or ``NAME_specification.json`` in the folder. If it holds no JSON, they are
    ``NAME_specification.json`` at any depth, or ``NAME/specification.json``. Raises ``SpecError`` for a folder that is
    missing or holds no specification, and for two files with the same name.
    """
    if not folder.is_dir():
        raise SpecError(f"{folder}: no such folder: give a folder of specification files")
    paths = sorted(folder.glob("*.json")) or sorted(folder.rglob("*specification.json"))
    if not paths:
        raise SpecError(f"{folder}: no specification files: it should hold NAME.json or NAME_specification.json")
    files: dict[str, Path] = {}
    for path in paths:
        name = name_of(path)
        if name in files:
            raise SpecError(f"{path}: {files[name]} is named after the same garment: leave one of them")
        files[name] = path
    return files


def name_of(path: Path) -> str:
    """The garment that a file is named after.

    >>> name_of(Path("out/dress_specification.json")), name_of(Path("out/dress/specification.json"))
    ('dress', 'dress')
    """
    if path.stem.lower() in PLAIN:
        return path.parent.name
    return next((path.stem.removesuffix(end) for end in ENDINGS if path.stem.endswith(end)), path.stem)


def _in_capitals(names: Iterable[str], garments: Iterable[str]) -> str:
    """A remark if a name differs from a garment's in capital letters only; else empty."""
    known = {garment.casefold(): garment for garment in garments}
    alike = [name for name in names if name.casefold() in known]
    return f" ({shown(alike[0])} and {shown(known[alike[0].casefold()])} differ in capital letters)" if alike else ""


def listed(names: Sequence[str]) -> str:
    """The first names, for a message."""
    first = ", ".join(map(shown, names[:MOST_NAMES]))
    return first if len(names) <= MOST_NAMES else f"{first} and {len(names) - MOST_NAMES} more"


@dataclass(frozen=True)
class Scored:
    """A test garment with its scores."""

    name: str
    kind: str
    true: Pattern
    predicted: Pattern | None
    """``None`` for a failure."""
    values: Mapping[str, float]
    """Score by name."""
    failure: str = ""
    """Why there is no prediction; empty if there is one."""
    remarks: tuple[str, ...] = field(default=())
    """Parts that could not be measured, with the reason."""


def score_cases(cases: Iterable[GarmentPair], *, workers: int = 1, spacing: float = SPACING) -> Iterator[Scored]:
    """The scores of test garments, in order, computed by ``workers`` processes; see ``score_case``."""
    return parallel_map(partial(score_case, spacing=spacing), cases, workers)


def score_case(case: GarmentPair, *, spacing: float = SPACING) -> Scored:
    """The scores of a test garment; a prediction that is missing or cannot be read gets the worst.

    Raises ``SpecError`` or ``PatternError`` for a true pattern that cannot be read or has an open outline.
    """
    true = _read_true(case)
    if case.predicted is None:
        return score_garment(case.name, None, true, failure=NO_PREDICTION, spacing=spacing)
    try:
        predicted = read_pattern(case.predicted)
        _require_size(predicted)
    except GcdError as error:
        return score_garment(
            case.name, None, true, failure=str(error).removeprefix(f"{case.predicted}: "), spacing=spacing
        )
    return score_garment(case.name, predicted, true, spacing=spacing)


def score_garment(
    name: str, predicted: Pattern | None, true: Pattern, *, failure: str = NO_PREDICTION, spacing: float = SPACING
) -> Scored:
    """The scores of a predicted pattern; ``None`` gets the worst, for the reason ``failure``."""
    if predicted is None:
        values = asdict(failed_score(true)) | {"boxmesh_cd": WORST}
        return Scored(name, kind_of(true), true, None, values, failure)
    cd, remarks = box_mesh_distance(predicted, true, spacing=spacing)
    values = asdict(score_pattern(predicted, true)) | {"boxmesh_cd": cd}
    if not values["valid"]:
        remarks = (*remarks, f"not valid: {first_fault(predicted)}")
    return Scored(name, kind_of(true), true, predicted, values, remarks=remarks)


def box_mesh_distance(predicted: Pattern, true: Pattern, *, spacing: float = SPACING) -> tuple[float, tuple[str, ...]]:
    """The distance of the two box meshes [cm], and remarks; ``WORST`` if one of them cannot be meshed."""
    surfaces, remarks = [], []
    for title, pattern in (("prediction", predicted), ("true pattern", true)):
        try:
            mesh = mesh_of(pattern, spacing)
        except GcdError as error:
            remarks.append(f"{title} has no box mesh: {error}")
        else:
            surfaces.append(MeshShape.of(mesh.vertices, mesh.faces))
    return (WORST if remarks else distance(*surfaces)), tuple(remarks)


def mesh_of(pattern: Pattern, spacing: float) -> BoxMesh:
    """The box mesh of any prediction. Raises ``PatternError`` or ``MeshError`` if it has none."""
    area = sum(PanelShape.of(panel).polygon.area for panel in pattern.panels)
    if area > MOST_CLOTH:
        raise PatternError(f"{area / 1e4:.0f} m² of cloth, more than {MOST_CLOTH / 1e4:.0f}: check its unit")
    return build_box_mesh(pattern, spacing=spacing)


def kind_of(pattern: Pattern) -> str:
    """The kind of a garment: ``properties.kind`` of its file, else inferred from the names of its panels."""
    given = pattern.extra.get("properties", {}).get("kind")
    if isinstance(given, str) and given:
        return given
    names = [panel.name.lower() for panel in pattern.panels]
    upper = any(is_bodice(name) for name in names)
    if any(is_trouser_leg(name) for name in names):
        return "jumpsuit" if upper else "trousers"
    if any("skirt" in name and "cuff" not in name for name in names):
        return "dress" if upper else "skirt"
    return "top" if upper else "other"


def first_fault(pattern: Pattern) -> str:
    """The first reason why a pattern cannot be sewn."""
    faults = (str(fault) for fault in check_pattern(pattern) if fault.severity is Severity.ERROR)
    return next(faults, "a panel is smaller than 1 cm²")


def _require_size(pattern: Pattern) -> None:
    """Raise ``PatternError`` for more panels or edges than a garment has: matching them takes minutes and gigabytes."""
    if len(pattern.panels) > MOST_PANELS or any(len(panel.edges) > MOST_EDGES for panel in pattern.panels):
        raise PatternError(next(str(fault) for fault in check_pattern(pattern) if fault.rule in SIZES))


def _read_true(case: GarmentPair) -> Pattern:
    try:
        true = read_pattern(case.true)
        for panel in true.panels:
            PanelShape.of(panel)
    except SpecError as error:
        raise SpecError(f"{error}; if {case.true.name} is no true pattern, move it elsewhere") from error
    except PatternError as error:
        raise PatternError(f"{case.true}: {error}") from error
    if not true.panels:
        raise PatternError(f"{case.true}: a true pattern without panels: leave it out")
    return true
