"""Predictions and true patterns as two folders of specification files, matched by file name."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gcd_dataset.errors import SpecError, shown

ENDINGS = ("_specification", "_predicted", "_prediction")
"""Ends of file names that are not part of a garment's name."""
PLAIN = frozenset({"specification", "prediction", "predicted"})  # stems of files that are named by their folder
MOST_NAMES = 5  # most names listed in a message


@dataclass(frozen=True, slots=True)
class Case:
    """One test garment."""

    name: str
    true: Path
    predicted: Path | None
    """``None`` without a prediction."""


@dataclass(frozen=True, slots=True)
class Folders:
    """The test garments of two folders."""

    cases: tuple[Case, ...]
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
    cases = tuple(Case(name, path, predicted.get(name)) for name, path in sorted(true.items()))
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
    """A remark if a name and that of a garment differ in capital letters only; else empty."""
    known = {garment.casefold(): garment for garment in garments}
    alike = [name for name in names if name.casefold() in known]
    return f" ({shown(alike[0])} and {shown(known[alike[0].casefold()])} differ in capital letters)" if alike else ""


def listed(names: Sequence[str]) -> str:
    """The first names, for a message."""
    first = ", ".join(map(shown, names[:MOST_NAMES]))
    return first if len(names) <= MOST_NAMES else f"{first} and {len(names) - MOST_NAMES} more"
