"""Answers of any model as patterns, read from the files that it writes.

A file is

- a specification JSON as this package and GarmentCode write it; with ``form`` ``neuraltailor``, ``sewformer``,
  ``sewingldm`` or ``aipparel`` as these models write it, with their faults repaired and named;
- AIpparel's tokens as JSON, ``{"tokens": [...], "values": {"<pattern_cmd_LINE>": [[x, y], ...], ...}}``;
- ReWeaver's flattened panels as JSON, ``{"panels": {"0": {"edge_points": [[[x, y], ...], ...]}, ...}}`` [cm], with
  ``curves``, the curve of each edge: edges of two panels with the same curve are sewn together;
- ``design_params.yaml`` of GarmentCode, drawn for the body of its garment;
- arrays as npz, npy, pt: ``panels``, ``edges`` and ``stitches`` of a ``PatternTensor``, or a model's output.

An answer that cannot be read is a failure with a reason, and stops nothing.
"""

import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np

from gcd_dataset.curves import LINE, Quadratic, signed_area, to_frame
from gcd_dataset.encodings import aipparel, garmentdiffusion, neuraltailor, sewformer, sewingldm
from gcd_dataset.encodings.rows import Scaling
from gcd_dataset.encodings.specifications import read_prediction
from gcd_dataset.errors import ConfigError, GcdError, PatternError, SpecError, did_you_mean, shown
from gcd_dataset.jsonfile import JsonPath, read_json
from gcd_dataset.records import Edge, EdgeRef, Measurements, Panel, Pattern, Placement, Seam
from gcd_dataset.scoring.garments import garment_name, require_size
from gcd_dataset.spec import pattern_from_spec
from gcd_dataset.tensors import PatternTensor, decode_pattern, sewn_rows

ARRAY_FILES = (".npz", ".npy", ".pt", ".pth")
DESIGN_FILES = (".yaml", ".yml")
FILES = (".json", *DESIGN_FILES, *ARRAY_FILES)
UNREADABLE = (
    OSError, ValueError, TypeError, EOFError, KeyError, RuntimeError, MemoryError, UnpicklingError, zipfile.BadZipFile,
)  # fmt: skip
STRAIGHT = 0.01  # of the chord: rise of a control point from which an edge is curved
MOST_ROWS = 5000  # edges of a garment's arrays; their distances take 200 MB, and the largest network has 1,443
SINGLE = ""  # name of the array of a file that holds one
TENSORS = ("panels", "edges", "stitches")


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
    """How answers are read. Raises ``ConfigError`` for an unknown form."""

    form: str = ""
    """The model that wrote the files, one of ``FORMS``; empty: files that tell themselves what they are."""
    raw: bool = False
    """Whether arrays and tokens of a model are in cm, not in the network's units."""
    panels: Sequence[str] = ()
    """Names of the panels of arrays, in their order, in place of the network's own."""
    size_of: Callable[[str], Measurements] | None = None
    """The measures of a garment's wearer, for ``design_params.yaml``."""

    def __post_init__(self) -> None:
        if self.form and self.form not in FORMS:
            raise ConfigError(f"form {self.form}: give one of {', '.join(FORMS)}{did_you_mean(self.form, FORMS)}")

    def read(self, folder: Path) -> dict[str, Answer]:
        """The answers in a folder, by garment. Raises ``SpecError`` for a folder without files, or two of one name."""
        found: dict[str, Answer] = {}
        for path in _files(folder, self.form):
            for name, answer in self.read_file(path):
                if name in found:
                    raise SpecError(f"{path}: {found[name].path} is named {shown(name)}, too: leave one of them")
                found[name] = answer
        return found

    def read_file(self, path: Path) -> Iterator[tuple[str, Answer]]:
        """Garment and answer of a file; several for arrays with a first axis of garments."""
        name = garment_name(path)
        try:
            if path.suffix.lower() in ARRAY_FILES:
                for title, decode in self._arrays(path, name):
                    yield title, _attempt(lambda decode=decode: (decode(), ()), path)  # type: ignore[misc]
            else:
                yield name, _attempt(partial(self._text, path, name), path)
        except GcdError as error:
            yield name, Answer(path, None, _reason(error, path))

    def _text(self, path: Path, name: str) -> tuple[Pattern, tuple[str, ...]]:
        if path.suffix.lower() in DESIGN_FILES:
            return self._drawn(path, name), ()
        tree = read_json(path, "answer")
        if isinstance(tree, Mapping) and "pattern" not in tree:
            if "tokens" in tree:
                return aipparel.decode(_tokens(tree, path, raw=self.raw), name), ()
            if "panels" in tree:
                return _flattened(tree, path, name), ()
        if self.form:
            return read_prediction(tree, name, source=str(path))
        return pattern_from_spec(tree, name, source=str(path)), ()

    def _drawn(self, path: Path, name: str) -> Pattern:
        from gcd_dataset.generator.garments import read_design
        from gcd_dataset.generator.garments.rules import DrawnGarment

        if self.size_of is None:
            raise SpecError("a design is drawn for the body of its garment: give --bodies")
        return DrawnGarment.of(self.size_of(name), read_design(path), name=name).pattern

    def _arrays(self, path: Path, name: str) -> Iterator[tuple[str, Callable[[], Pattern]]]:
        """Name and decoder of each garment of a file of arrays. Raises ``GcdError`` for what is no such file."""
        arrays = _read_arrays(path)
        if not self.form:
            yield name, partial(_from_tensors, arrays, name)
            return
        if self.form not in ARRAYS:
            raise SpecError(f"{self.form} has no arrays: give a JSON file, or the form {', '.join(ARRAYS)}")
        reader = ARRAYS[self.form]
        names = [str(item) for item in arrays.pop("names", np.zeros(0, str)).reshape(-1).tolist()]
        for number, (title, part) in enumerate(_garments(arrays, reader, path, name)):
            title = names[number] if number < len(names) else title
            if (rows := int(np.prod(part[reader.main].shape[:-1]))) > MOST_ROWS:
                raise SpecError(
                    f"{shown(title)}: {reader.main} hold {rows} edges, more than {MOST_ROWS}: give one garment, or a "
                    "first axis of garments"
                )
            yield title, partial(reader.decode, part, title, self.raw, self.panels or reader.panels)


def _attempt(read: Callable[[], tuple[Pattern, tuple[str, ...]]], path: Path) -> Answer:
    try:
        with np.errstate(all="ignore"):  # numbers without bounds overflow before they are refused
            pattern, remarks = read()
        require_size(pattern)
        if not pattern.panels:
            raise PatternError("no panel with an edge: the model predicted nothing")
        return Answer(path, pattern, remarks=remarks)
    except GcdError as error:
        return Answer(path, None, _reason(error, path))


def _reason(error: GcdError, path: Path) -> str:
    return str(error).removeprefix(f"{path}: ")


def _files(path: Path, form: str) -> list[Path]:
    """The answers in a folder: of the first kind of file that it holds at its top, else at any depth.

    Of the specifications in a folder beside each other those named as predictions count, if there are any: models copy
    the true ones there. Raises ``SpecError`` for a folder without answers.
    """
    if not path.is_dir():
        raise SpecError(f"{path}: no such folder: give a folder of answers")
    kinds = ((ARRAY_FILES,) if form in ARRAYS else ()) + ((".json",), DESIGN_FILES, ARRAY_FILES)
    for found in (path.glob("*"), path.rglob("*")):
        files = sorted(file for file in found if file.suffix.lower() in FILES)
        for kind in kinds:
            if chosen := [file for file in files if file.suffix.lower() in kind]:
                predicted = {file.parent for file in chosen if "pred" in file.stem}
                return [file for file in chosen if "pred" in file.stem or file.parent not in predicted]
    raise SpecError(f"{path}: no answers: it should hold NAME.json, NAME_design_params.yaml or NAME.npz")


# --------------------------------------------------------------------------------------------------------------- arrays


@dataclass(frozen=True)
class ArrayReader:
    """Decoder of the arrays of a model's output."""

    main: str
    """The array that tells the number of garments; a file with one array need not name it."""
    axes: int
    """Number of axes of the array ``main`` for one garment."""
    needed: tuple[str, ...]
    optional: tuple[str, ...]
    decode: Callable[[Mapping[str, np.ndarray], str, bool, Sequence[str]], Pattern]
    """The pattern of one garment's arrays, its name, whether they are in cm, and the names of the panels."""
    panels: Sequence[str] = ()
    """Names of the panels, unless others are given."""


def _neuraltailor(arrays: Mapping[str, np.ndarray], name: str, raw: bool, panels: Sequence[str]) -> Pattern:
    outlines, rotations, translations = _placed(arrays, {} if raw else neuraltailor.SCALINGS)
    rows = outlines.shape[:-1]
    tags = arrays.get("stitch_tags", np.zeros((*rows, 3)))
    free = arrays.get("free_edges_mask", np.ones(rows))
    if tags.size != np.prod(rows) * 3 or free.size != np.prod(rows):
        raise SpecError(
            f"stitch_tags have shape {tags.shape} and free_edges_mask {free.shape} for outlines of shape "
            f"{outlines.shape}: give three numbers and one score an edge"
        )
    parts = neuraltailor.NeuralTailorArrays(
        outlines, rotations, translations, tags.reshape(*rows, 3), free.reshape(rows)
    )
    return neuraltailor.decode(parts, name, names=panels)


def _sewformer(arrays: Mapping[str, np.ndarray], name: str, raw: bool, panels: Sequence[str]) -> Pattern:
    if not raw and arrays["outlines"].ndim == 3 and arrays["outlines"].shape[2] == 7:
        raise SpecError("outlines with seven numbers an edge have no published scaling: convert them to cm, give --raw")
    outlines, rotations, translations = _placed(arrays, {} if raw else sewformer.SCALINGS)
    count = outlines.shape[0] * outlines.shape[1]
    sewn = arrays.get("edge_cls", -np.ones(count)).reshape(-1)
    similarity = arrays.get("edge_similarity", np.zeros((count, count)))
    parts = sewformer.SewFormerArrays(outlines, rotations, translations, sewn[None], similarity)
    return sewformer.decode(parts, name, names=panels)


def _placed(arrays: Mapping[str, np.ndarray], scalings: Mapping[str, Scaling]) -> list[np.ndarray]:
    """Outlines, rotations and translations in cm. SewFormer's outlines may hold all edges of a panel in one row."""
    outlines, rotations, translations = (arrays[name] for name in ("outlines", "rotations", "translations"))
    if outlines.ndim == 2 and len(rotations) and outlines.size % (4 * len(rotations)) == 0:
        outlines = outlines.reshape(len(rotations), -1, 4)
    if outlines.ndim != 3:
        raise SpecError(
            f"outlines have shape {outlines.shape}, not (panels, edges, numbers): save the network's output"
        )
    parts = {"outlines": outlines, "rotations": rotations, "translations": translations}
    for name, values in parts.items():
        if name in scalings and values.shape[-1] != len(scalings[name].shift):
            raise SpecError(
                f"{name} have shape {values.shape}: the last axis must hold {len(scalings[name].shift)} numbers; give "
                "the network's output"
            )
    return [scalings[name].undo(values) if name in scalings else values for name, values in parts.items()]


def _sewingldm(arrays: Mapping[str, np.ndarray], name: str, raw: bool, panels: Sequence[str]) -> Pattern:
    array = _edge_rows(arrays["samples"], sewingldm.SLOT_NAMES, sewingldm.WIDTH)
    if not raw:
        plain = sewingldm.SCALING.undo(array[..., : sewingldm.CONTINUOUS])
        # Their code leaves stitch tags in the network's units; only distances between them count.
        tags = slice(sewingldm.SlotColumn.TAG, sewingldm.SlotColumn.QUATERNION)
        plain[..., tags] = array[..., tags]
        array = np.concatenate([plain, array[..., sewingldm.CONTINUOUS :]], axis=-1)
    return sewingldm.decode(array, name, names=panels)


def _garmentdiffusion(arrays: Mapping[str, np.ndarray], name: str, raw: bool, panels: Sequence[str]) -> Pattern:
    if not raw:
        raise SpecError("GarmentDiffusion published no scaling of its numbers: convert them to cm, and give --raw")
    array = _edge_rows(arrays["edges"], range(garmentdiffusion.MAX_PANELS), garmentdiffusion.WIDTH)
    return garmentdiffusion.decode(array, name, names=panels)


def _edge_rows(array: np.ndarray, panels: Sequence[Any], width: int) -> np.ndarray:
    """An array of (panels, edges, width), from one of (panels × edges, width) too."""
    if array.shape[-1] != width:
        raise SpecError(f"{array.shape[-1]} numbers an edge, not {width}: save the output of the network's decoder")
    if array.ndim == 2 and len(array) % len(panels) == 0:
        return array.reshape(len(panels), -1, width)
    return array


ARRAYS = {
    "neuraltailor": ArrayReader(
        main="outlines",
        axes=3,
        needed=("rotations", "translations"),
        optional=("stitch_tags", "free_edges_mask"),
        decode=_neuraltailor,
        panels=neuraltailor.PANEL_CLASSES,
    ),
    "sewformer": ArrayReader(
        main="outlines",
        axes=3,
        needed=("rotations", "translations"),
        optional=("edge_cls", "edge_similarity"),
        decode=_sewformer,
        panels=sewformer.PANEL_CLASSES,
    ),
    "sewingldm": ArrayReader("samples", 3, (), (), _sewingldm, sewingldm.SLOT_NAMES),
    "garmentdiffusion": ArrayReader("edges", 3, (), (), _garmentdiffusion),
}
FORMS = ("specification", *ARRAYS, "aipparel")
"""``specification`` repairs the faults of a specification."""


def _garments(
    arrays: Mapping[str, np.ndarray], reader: ArrayReader, path: Path, name: str
) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    """Name and arrays of each garment of a file. Raises ``SpecError`` for missing or unlike arrays."""
    if SINGLE in arrays or (len(arrays) == 1 and not reader.needed):
        arrays = {reader.main: next(iter(arrays.values()))}
    wanted = (reader.main, *reader.needed)
    missing = [key for key in wanted if key not in arrays]
    if missing:
        raise SpecError(
            f"{path}: no array {', '.join(missing)} among {', '.join(map(shown, arrays)) or 'none'}: save the "
            f"network's output with the names {', '.join((*wanted, *reader.optional))}"
        )
    used = {key: arrays[key] for key in (*wanted, *reader.optional) if key in arrays}
    if any(values.ndim == 0 for values in used.values()):
        raise SpecError(f"{path}: an array is a single number: save the network's output")
    # SewFormer's rows of all edges of a panel have one axis less: the placements tell a batch.
    lead = arrays[reader.needed[0]].ndim == 3 if reader.needed else arrays[reader.main].ndim > reader.axes
    if not lead:
        yield name, used
        return
    counts = {len(values) for values in used.values()}
    if len(counts) != 1:
        lengths = ", ".join(f"{key} {len(values)}" for key, values in used.items())
        raise SpecError(f"{path}: arrays of unequal numbers of garments ({lengths}): save one batch in a file")
    for number in range(counts.pop()):
        yield f"{name}_{number}", {key: values[number] for key, values in used.items()}


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a file by name, as float64; names of garments as strings. Pickled objects are never loaded."""
    advice = "save plain arrays with numpy.savez or tensors with torch.save"
    try:
        if not path.stat().st_size:
            raise ValueError("an empty file")
        if path.suffix in (".pt", ".pth"):
            import torch

            with warnings.catch_warnings(action="ignore"):  # torch's advice on foreign files; the error is one line
                content = torch.load(path, map_location="cpu", weights_only=True)
            parts = content if isinstance(content, dict) else {SINGLE: content}
            arrays = {
                str(key): _real((value if value.is_complex() else value.double()).numpy(force=True))
                for key, value in parts.items()
                if isinstance(value, torch.Tensor)
            }
            if isinstance(names := parts.get("names"), list | tuple):
                arrays["names"] = np.array([str(item) for item in names])
            return arrays
        with path.open("rb") as file:  # numpy leaves a broken archive open
            content = np.load(file, allow_pickle=False)
            if isinstance(content, np.ndarray):
                return {SINGLE: _real(content)}
            with content:
                plain = {key: content[key] for key in content.files}
        return {key: value if key == "names" else _real(value) for key, value in plain.items()}
    except FileNotFoundError as cause:
        raise SpecError(f"{path}: no such file: give a prediction") from cause
    except UNREADABLE as cause:
        reason = str(cause).partition("\n")[0].partition(". ")[0]
        raise SpecError(f"{path}: cannot be read ({shown(reason)}): {advice}") from cause


def _real(values: np.ndarray) -> np.ndarray:
    if np.iscomplexobj(values):
        raise ValueError("complex numbers")
    return values.astype(float)


def _from_tensors(arrays: Mapping[str, np.ndarray], name: str) -> Pattern:
    """The pattern of a ``PatternTensor``'s arrays."""
    if missing := [key for key in TENSORS if key not in arrays]:
        raise SpecError(f"no array {', '.join(missing)}: save {', '.join(TENSORS)}, or name the model with --form")
    panels, edges, stitches = (arrays[key] for key in TENSORS)
    if panels.ndim != 2 or edges.ndim != 2 or stitches.ndim != 2:
        raise SpecError("panels, edges and stitches are not all tables: save those of one garment in a file")
    return decode_pattern(
        PatternTensor(
            panels,
            edges,
            stitches.astype(int),
            sewn_rows(len(stitches)),
            tuple(map(str, range(len(panels)))),
            name=name,
        )
    )


def _flattened(tree: Mapping[str, Any], path: Path, name: str) -> Pattern:
    """ReWeaver's panels: each edge by points, the edges in any order and direction, without a place in space."""
    at = JsonPath(str(path))
    panels, refs = [], dict[Any, list[EdgeRef]]()
    for key, entry in at.mapping(tree["panels"], "panels").items():
        within = at.within(f"panel {key}")
        curves = list(within.mapping(entry, "").get("curves", ()))
        try:
            lines = [np.array(points, float) for points in within.list_of(entry, "edge_points")]
            panel, rows = _chained(str(key), lines)
        except (TypeError, ValueError, IndexError) as cause:
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
    edges = []
    for k, line in enumerate(chain):
        start, end = corners[k], corners[(k + 1) % len(chain)]
        middle = line[len(line) // 2] if len(line) % 2 else line[len(line) // 2 - 1 :][:2].mean(axis=0)
        x, y = (2 * middle - 0.5 * (start + end)).tolist()
        bent = to_frame((start[0], start[1]), (end[0], end[1]), (x, y))
        edges.append(Edge(k, (k + 1) % len(chain), Quadratic(bent) if abs(bent[1]) > STRAIGHT else LINE))
    return Panel(name, corners, tuple(edges), Placement(np.zeros(3), np.zeros(3))), rows


def _tokens(tree: Mapping[str, Any], path: Path, *, raw: bool) -> aipparel.AIpparelTokens:
    """AIpparel's tokens from a JSON object with ``tokens`` and ``values``."""
    at = JsonPath(str(path))
    tokens = tuple(at.text(word, "a token") for word in at.list_of(tree, "tokens"))
    values = {}
    for command, rows in at.mapping(tree.get("values"), "values").items():
        try:
            array = np.array(rows, float)
        except (TypeError, ValueError, OverflowError) as cause:
            raise at.error(f"values of {shown(command)} are no table of numbers: give one row a token") from cause
        values[command] = array if raw else _unscaled(command, array)
    return aipparel.AIpparelTokens(tokens, values)


def _unscaled(command: str, rows: np.ndarray) -> np.ndarray:
    """Rows of a command in cm; rows of a wrong width are left to ``decode``, which reports them."""
    if rows.ndim != 2 or rows.shape[1] != aipparel.NUMBERS.get(command):
        return rows
    if command == aipparel.MOVE:
        return np.concatenate([aipparel.SCALINGS["translations"].undo(rows[:, :3]), rows[:, 3:]], axis=1)
    points = rows.reshape(len(rows), -1, 2)
    return aipparel.SCALINGS["vertices"].undo(points).reshape(rows.shape)
