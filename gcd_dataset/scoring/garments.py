"""Answers and true patterns, matched by the names of their files, and their scores."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from gcd_dataset.errors import GcdError, PatternError, SpecError, shown
from gcd_dataset.faults import MOST_EDGES, MOST_PANELS, Rule, Severity, check_pattern
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.metrics import PanelShape, PatternScore, failed_score, score_pattern
from gcd_dataset.records import BoxMesh, Pattern
from gcd_dataset.scoring.distances import WORST, MeshShape, distance
from gcd_dataset.spec import is_bodice, is_trouser_leg, read_pattern
from gcd_dataset.workers import parallel_map

SPACING = 2.0  # cm: edge length of the box meshes that are compared
MOST_CLOTH = 400_000.0  # cm²: forty square metres; a larger prediction is not meshed
NO_ANSWER = "no answer"
SIZES = (Rule.MANY_PANELS, Rule.MANY_EDGES)
PREDICTED = re.compile(r"_*pred(icted|iction)?(_single)?(_[0-9.e-]+)?_*$")  # …_predicted_, …_predicted_single_, …_pred
NAMELESS = frozenset({"", "NNSewingPattern", "specification", "template", "design_params", "prediction"})
"""Files with these names are named by their folder."""
MOST_NAMES = 5  # most names listed in a message


def true_files(folder: Path) -> dict[str, Path]:
    """Name of a garment to the file of its true pattern.

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
        name = garment_name(path)
        if name in files:
            raise SpecError(f"{path}: {files[name]} is named after the same garment: leave one of them")
        files[name] = path
    return files


def garment_name(path: Path) -> str:
    """The garment that a file is named after; models name some of their files by their folder.

    >>> garment_name(Path("dress_12/_predicted_specification.json")), garment_name(Path("out/dress_12.npz"))
    ('dress_12', 'dress_12')
    """
    stem = path.stem.removesuffix("specification").rstrip("_").removesuffix("_design_params")
    stem = PREDICTED.sub("", stem)
    return path.resolve().parent.name if stem in NAMELESS else stem


def remarks_of(answers: Iterable[str], garments: Iterable[str]) -> Iterator[str]:
    """One line on the garments without an answer, and one on the answers without a garment.

    Raises ``SpecError`` if no name occurs in both.
    """
    ours, true = set(answers), set(garments)
    missing, unknown = sorted(true - ours), sorted(ours - true)
    if len(missing) == len(true):
        raise SpecError(
            f"no answer is named as a garment: there are {listed(unknown)} and {listed(missing)}"
            f"{_in_capitals(unknown, missing)}: name each answer after its garment"
        )
    if missing:
        yield f"{len(missing)} of {len(true)} garments without an answer, all failures: {listed(missing)}"
    if unknown:
        named = f"{len(unknown)}: {listed(unknown)}{_in_capitals(unknown, missing)}"
        yield f"answers without a true pattern, not scored: {named}: name each answer after its garment"


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


def score_pair(pair: tuple[str, Pattern, Pattern | None, str]) -> Scored:
    """``score_garment`` of a name, a true pattern, an answer and the reason of its failure, for ``parallel_map``."""
    name, true, answer, failure = pair
    return score_garment(name, answer, true, failure=failure or NO_ANSWER)


def score_garment(
    name: str, predicted: Pattern | None, true: Pattern, *, failure: str = NO_ANSWER, spacing: float = SPACING
) -> Scored:
    """The scores of a predicted pattern; ``None`` gets the worst, for the reason ``failure``."""
    if predicted is None:
        values = asdict(failed_score(true)) | {"boxmesh_cd": WORST}
        return Scored(name, kind_of(true), true, None, values, failure)
    cd, remarks = box_mesh_distance(predicted, true, spacing=spacing)
    values = asdict(score_pattern(predicted, true)) | {"boxmesh_cd": cd}
    if not values["valid"]:
        faults = (str(fault) for fault in check_pattern(predicted) if fault.severity is Severity.ERROR)
        remarks = (*remarks, f"not valid: {next(faults, 'a panel is smaller than 1 cm²')}")
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


def require_size(pattern: Pattern) -> None:
    """Raise ``PatternError`` for more panels or edges than a garment has: matching them takes minutes and gigabytes."""
    if len(pattern.panels) > MOST_PANELS or any(len(panel.edges) > MOST_EDGES for panel in pattern.panels):
        raise PatternError(next(str(fault) for fault in check_pattern(pattern) if fault.rule in SIZES))


def read_true(path: Path) -> Pattern:
    """A true pattern. Raises ``SpecError`` or ``PatternError`` if it cannot be read or has an open outline."""
    try:
        true = read_pattern(path)
        for panel in true.panels:
            PanelShape.of(panel)
    except SpecError as error:
        raise SpecError(f"{error}; if {path.name} is no true pattern, move it elsewhere") from error
    except PatternError as error:
        raise PatternError(f"{path}: {error}") from error
    if not true.panels:
        raise PatternError(f"{path}: a true pattern without panels: leave it out")
    return true


def scores_of(predicted: Sequence[Pattern], true: Sequence[Pattern], *, workers: int = 0) -> list[PatternScore]:
    """The score of each predicted pattern, computed by ``workers`` processes."""
    return list(parallel_map(_score_two, zip(predicted, true, strict=True), workers))


def _score_two(pair: tuple[Pattern, Pattern]) -> PatternScore:
    return score_pattern(*pair)
