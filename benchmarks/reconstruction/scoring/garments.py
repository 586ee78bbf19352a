"""The scores of one test garment: of its pattern, and of its box mesh."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial

from benchmarks.reconstruction.scoring.distances import WORST, Surface, distance
from benchmarks.reconstruction.scoring.files import Case
from gcd_dataset.errors import GcdError, PatternError, SpecError
from gcd_dataset.faults import MOST_EDGES, MOST_PANELS, Rule, Severity, check_pattern
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.metrics import PanelShape, failed_score, score_pattern
from gcd_dataset.records import BoxMesh, Pattern
from gcd_dataset.spec import is_bodice, is_trouser_leg, read_pattern
from gcd_dataset.workers import parallel_map

SPACING = 2.0  # cm: edge length of the box meshes that are compared
MOST_CLOTH = 400_000.0  # cm²: forty square metres; a larger prediction is not meshed
NO_PREDICTION = "no prediction"
SIZES = (Rule.MANY_PANELS, Rule.MANY_EDGES)


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
    """What could not be measured, and why."""


def score_cases(cases: Iterable[Case], *, workers: int = 1, spacing: float = SPACING) -> Iterator[Scored]:
    """The scores of test garments, in order, computed by ``workers`` processes; see ``score_case``."""
    return parallel_map(partial(score_case, spacing=spacing), cases, workers)


def score_case(case: Case, *, spacing: float = SPACING) -> Scored:
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
            surfaces.append(Surface.of(mesh.vertices, mesh.faces))
    return (WORST if remarks else distance(*surfaces)), tuple(remarks)


def mesh_of(pattern: Pattern, spacing: float) -> BoxMesh:
    """The box mesh of any prediction. Raises ``PatternError`` or ``MeshError`` if it has none."""
    area = sum(PanelShape.of(panel).polygon.area for panel in pattern.panels)
    if area > MOST_CLOTH:
        raise PatternError(f"{area / 1e4:.0f} m² of cloth, more than {MOST_CLOTH / 1e4:.0f}: check its unit")
    return build_box_mesh(pattern, spacing=spacing)


def kind_of(pattern: Pattern) -> str:
    """The kind of a garment: ``properties.kind`` of its file, or told by the names of its panels."""
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


def _read_true(case: Case) -> Pattern:
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
