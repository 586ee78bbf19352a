"""Answers of any model as patterns, read from the files that it writes.

A file is

- a specification JSON, as this package, GarmentCode and StEm-Net write it; those of NeuralTailor, SewFormer, SewingLDM
  and AIpparel may have faults of networks, which ``AnswerReader.repair`` mends and names;
- ReWeaver's flattened panels as JSON, ``{"panels": {"0": {"edge_points": [[[x, y], ...], ...]}, ...}}`` [cm], with
  ``curves``, the curve of each edge: edges of two panels with the same curve are sewn together;
- ``design_params.yaml`` of GarmentCode, drawn for the body of its garment;
- ``panels``, ``edges`` and ``stitches`` of a ``PatternTensor`` as npz, with its ``closures`` and ``lines``, if any.

An answer that cannot be read is a failure with a reason, and stops nothing.
"""

import zipfile
import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.curves import fitted_curve, signed_area
from gcd_dataset.errors import GcdError, PatternError, SpecError, shown
from gcd_dataset.jsonfile import JsonPath, read_json
from gcd_dataset.records import Edge, EdgeRef, Measurements, Panel, Pattern, Placement, Seam
from gcd_dataset.scoring.garments import garment_name, require_size
from gcd_dataset.scoring.repair import read_prediction
from gcd_dataset.spec import pattern_from_spec
from gcd_dataset.tensors import NO_LINES, PatternTensor, decode_pattern, sewn_rows

DESIGN_FILES, ARRAYS = (".yaml", ".yml"), ".npz"
REPORT = "report.json"  # of ``gcd reconstruct``
TENSORS = ("panels", "edges", "stitches")
UNREADABLE = (
    OSError, ValueError, TypeError, EOFError, KeyError, MemoryError, RuntimeError, zipfile.BadZipFile, zlib.error
)  # fmt: skip


@dataclass(frozen=True)
class Answer:
    """An answer that was read, or the reason why it cannot be."""

    path: Path
    pattern: Pattern | None
    failure: str = ""
    remarks: tuple[str, ...] = ()
    """Repairs, a sentence each."""


@dataclass(frozen=True)
class AnswerReader:
    """How answers are read."""

    repair: bool = False
    """Mend and name the faults of networks in specifications; see ``repair.repaired``."""
    size_of: Callable[[str], Measurements] | None = None
    """The measures of a garment's wearer, for ``design_params.yaml``."""

    def read(self, folder: Path, asked: Collection[str] = ()) -> dict[str, Answer]:
        """The answers in a folder, by garment. Raises ``SpecError`` for a folder without files, or two of one name.

        ``asked``: garments whose answers may be of another kind of file than the first that the folder holds.
        """
        found: dict[str, Answer] = {}
        for path in _files(folder, asked):
            name = garment_name(path)
            if name in found:
                raise SpecError(f"{path}: {found[name].path} is named {shown(name)}, too: leave one of them")
            found[name] = self.read_file(path)
        return found

    def read_file(self, path: Path) -> Answer:
        """The answer in a file."""
        try:
            with np.errstate(all="ignore"):  # numbers without bounds overflow before they are refused
                pattern, remarks = self._pattern(path, garment_name(path))
            require_size(pattern)
            if not pattern.panels:
                raise PatternError("no panel with an edge: the model predicted nothing")
            return Answer(path, pattern, remarks=remarks)
        except GcdError as error:
            return Answer(path, None, str(error).removeprefix(f"{path}: "))

    def _pattern(self, path: Path, name: str) -> tuple[Pattern, tuple[str, ...]]:
        if path.suffix.lower() in DESIGN_FILES:
            return self._drawn(path, name), ()
        if path.suffix.lower() == ARRAYS:
            return _from_tensors(path, name), ()
        tree = read_json(path, "model's answer")
        if isinstance(tree, Mapping) and "panels" in tree and "pattern" not in tree:
            return _flattened(tree, path, name), ()
        if self.repair:
            return read_prediction(tree, name, source=str(path))
        return pattern_from_spec(tree, name, source=str(path)), ()

    def _drawn(self, path: Path, name: str) -> Pattern:
        from gcd_dataset.generator.garments import read_design
        from gcd_dataset.generator.garments.rules import DrawnGarment

        if self.size_of is None:
            raise SpecError("a design is drawn for the body of its garment: give --bodies")
        return DrawnGarment.of(self.size_of(name), read_design(path), name=name).pattern


def _files(path: Path, asked: Collection[str]) -> list[Path]:
    """The answers in a folder, at its top, else at any depth: of the first kind of file, and those asked of others.

    Of the specifications in a folder beside each other those named as predictions count, if there are any: models copy
    the true ones there. Raises ``SpecError`` for a folder without answers.
    """
    if not path.is_dir():
        raise SpecError(f"{path}: no such folder: give a folder of answers")
    for found in (path.glob("*"), path.rglob("*")):
        files = sorted(file for file in found if not file.name.endswith(".meta.json") and file.name != REPORT)
        chosen: list[Path] = []
        for kind in ((".json",), DESIGN_FILES, (ARRAYS,)):
            own = [file for file in files if file.suffix.lower() in kind]
            predicted, known = {file.parent for file in own if "pred" in file.stem}, set(map(garment_name, chosen))
            own = [file for file in own if "pred" in file.stem or file.parent not in predicted]
            chosen += [file for file in own if not known or garment_name(file) in set(asked) - known]
        if chosen:
            return chosen
    raise SpecError(f"{path}: no answers: it should hold NAME.json, NAME_design_params.yaml or NAME.npz")


def read_arrays(path: Path, names: Sequence[str], optional: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """Arrays of an npz file. Pickled objects are never loaded. Raises ``SpecError``."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: np.asarray(file[name]) for name in (*names, *(name for name in optional if name in file))}
    except UNREADABLE as cause:
        reason = shown(str(cause).partition("\n")[0])
        raise SpecError(f"{path}: cannot be read ({reason}): save {', '.join(names)} with numpy.savez") from cause


def _from_tensors(path: Path, name: str) -> Pattern:
    try:
        found = {key: rows.astype(float) for key, rows in read_arrays(path, TENSORS, ("lines", "closures")).items()}
    except UNREADABLE as cause:
        raise SpecError(f"its arrays hold no numbers: save {', '.join(TENSORS)} with numpy.savez") from cause
    panels, edges, stitches = (found[key] for key in TENSORS)
    lines, closures = found.get("lines", NO_LINES), found.get("closures", sewn_rows(len(stitches)))
    if panels.ndim != 2 or edges.ndim != 2 or stitches.ndim != 2:
        raise SpecError("panels, edges and stitches are not all tables: save those of one garment in a file")
    names = tuple(map(str, range(len(panels))))
    return decode_pattern(PatternTensor(panels, edges, stitches.astype(int), closures, names, name=name, lines=lines))


def _flattened(tree: Mapping[str, Any], path: Path, name: str) -> Pattern:
    """ReWeaver's panels: each edge by points, the edges in any order and direction, without a place in space."""
    at = JsonPath(str(path))
    panels, refs = [], dict[Any, list[EdgeRef]]()
    for key, entry in at.mapping(tree["panels"], "panels").items():
        within = at.within(f"panel {key}")
        curves = within.list_of(entry, "curves") if within.mapping(entry, "a panel").get("curves") is not None else []
        if not all(isinstance(curve, int | float | str) for curve in curves):
            raise within.error("curves must be numbers: give the number of each edge's curve")
        try:
            lines = [np.array(points, float) for points in within.list_of(entry, "edge_points")]
            panel, rows = _chained(str(key), lines)
        except (TypeError, ValueError, IndexError, OverflowError) as cause:
            raise within.error("edge_points are no lists of points [x, y]: give two points or more an edge") from cause
        panels.append(panel)
        for place, row in enumerate(rows):
            if row < len(curves):
                refs.setdefault(curves[row], []).append(EdgeRef(panel.name, place))
    return Pattern(name, tuple(panels), tuple(Seam(two[0], two[1]) for two in refs.values() if len(two) == 2))


def _chained(name: str, lines: list[np.ndarray]) -> tuple[Panel, list[int]]:
    """The panel of edges that are joined end to nearest end, counter-clockwise, and the row of each edge."""
    rows, chain, left = [0], [lines[0]], set(range(1, len(lines)))
    while left:
        end = chain[-1][-1]
        row, flip = min(
            ((row, flip) for row in left for flip in (False, True)),
            key=lambda each: float(np.hypot(*(lines[each[0]][-1 if each[1] else 0] - end))),
        )
        left.remove(row)
        rows.append(row)
        chain.append(lines[row][::-1] if flip else lines[row])
    if signed_area(np.concatenate([line[:-1] for line in chain])) < 0:
        rows, chain = rows[::-1], [line[::-1] for line in chain[::-1]]
    corners = np.array([line[0] for line in chain])
    edges = tuple(Edge(k, (k + 1) % len(chain), fitted_curve(line)) for k, line in enumerate(chain))
    return Panel(name, corners, edges, Placement(np.zeros(3), np.zeros(3))), rows
