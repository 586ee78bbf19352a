"""Read predictions of published models and write them as specification files that ``evaluate`` scores.

    python -m gcd_dataset.scoring.answers FORMAT FILE... --out DIR
    python -m gcd_dataset.scoring.evaluate DIR TRUTH

FORMAT names the model. A FILE is a specification JSON as NeuralTailor, SewFormer, SewingLDM and AIpparel write it,
AIpparel's tokens as JSON, the arrays of a model's output as npz, npy or pt, or a folder of such files. Each garment
becomes DIR/NAME_specification.json. A garment that cannot be read is named on stderr and left out: ``evaluate`` counts
it as a failure. Exit code 0; 1 if no garment could be read or the options are wrong.
"""

import argparse
import re
import sys
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np

from gcd_dataset.encodings import aipparel, garmentdiffusion, neuraltailor, sewformer, sewingldm
from gcd_dataset.encodings.rows import Scaling
from gcd_dataset.encodings.specifications import read_prediction
from gcd_dataset.errors import ConfigError, GcdError, PatternError, SpecError, shown
from gcd_dataset.files import make_folder
from gcd_dataset.jsonfile import JsonPath, read_json
from gcd_dataset.records import Pattern
from gcd_dataset.spec import write_pattern

ARRAY_FILES = (".npz", ".npy", ".pt", ".pth")
FILES = (".json", *ARRAY_FILES)
PREDICTED = re.compile(r"_*pred(icted|iction)?(_single)?(_[0-9.e-]+)?_*$")  # …_predicted_, …_predicted_single_, …_pred
UNREADABLE = (
    OSError, ValueError, TypeError, EOFError, KeyError, RuntimeError, MemoryError, UnpicklingError, zipfile.BadZipFile,
)  # fmt: skip
MOST_ROWS = 5000  # edges of a garment's arrays; their distances take 200 MB, and the largest network has 1,443
SINGLE = ""  # name of the array of a file that holds one
NAMELESS = frozenset({"", "NNSewingPattern", "specification", "template"})  # such files are named by their folder


@dataclass(frozen=True)
class Prediction:
    """A prediction that was read."""

    pattern: Pattern
    remarks: tuple[str, ...] = ()
    """Repairs, a sentence each."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code; exits 2 for wrong usage."""
    options = _parser().parse_args(arguments)
    try:
        written, failed = _import(options)
    except GcdError as error:
        print(f"importing: {error}", file=sys.stderr)
        return 1
    print(f"importing.garments {written} garments")
    print(f"importing.failed {failed} garments")
    return 0 if written else 1


def read_garments(
    form: str, path: Path, *, raw: bool = False, panels: Sequence[str] = ()
) -> Iterator[Prediction | GcdError]:
    """The garments of a file: several for arrays with a first axis of garments.

    ``raw``: arrays are in cm, not in the network's units; ``panels``: names of the panels of arrays, in their order, in
    place of the network's own. A garment that cannot be decoded gives its error; raises
    ``GcdError`` for a file that cannot be read at all.
    """
    name = garment_name(path)
    if path.suffix == ".json":
        tree = read_json(path, "prediction")
        if form == "aipparel" and isinstance(tree, Mapping) and "pattern" not in tree:
            yield _attempt(lambda: Prediction(aipparel.decode(_tokens(tree, path, raw=raw), name)), path, name)
        else:
            yield Prediction(*read_prediction(tree, name, source=str(path)))
        return
    if form not in ARRAYS:
        raise ConfigError(f"{path}: {form} has no arrays: give a JSON file, or one of {', '.join(ARRAYS)}")
    reader = ARRAYS[form]
    arrays = _read_arrays(path)
    names = [str(item) for item in arrays.pop("names", np.zeros(0, str)).reshape(-1).tolist()]
    for number, (title, part) in enumerate(_garments(arrays, reader, path, name)):
        title = names[number] if number < len(names) else title
        if (rows := int(np.prod(part[reader.main].shape[:-1]))) > MOST_ROWS:
            raise SpecError(
                f"{path}: {shown(title)}: {reader.main} hold {rows} edges, more than {MOST_ROWS}: give one garment, or "
                "a first axis of garments"
            )
        read = partial(reader.decode, part, title, raw, panels or reader.panels)
        yield _attempt(lambda read=read: Prediction(read()), path, title)  # type: ignore[misc]


def garment_name(path: Path) -> str:
    """The garment that a file is named after; models name some of their files by their folder.

    >>> garment_name(Path("dress_12/_predicted_specification.json")), garment_name(Path("out/dress_12.npz"))
    ('dress_12', 'dress_12')
    """
    stem = PREDICTED.sub("", path.stem.removesuffix("specification").rstrip("_"))
    return path.resolve().parent.name if stem in NAMELESS else stem


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
FORMATS = ("specification", *ARRAYS, "aipparel")


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


# -------------------------------------------------------------------------------------------------------------- command


def _parser() -> argparse.ArgumentParser:
    title, _, rest = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(
        prog="gcd_dataset.scoring.answers",
        description=f"{title}\n{rest}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("format", choices=FORMATS, metavar="FORMAT", help=", ".join(FORMATS))
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="predictions, or folders of them")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the specification files")
    parser.add_argument("--raw", action="store_true", help="arrays and tokens hold cm, not the network's units")
    parser.add_argument(
        "--panels",
        type=Path,
        metavar="FILE",
        help="JSON list of the names of the panels of arrays, in their order; presets that match panels by name need "
        "the names of the true patterns",
    )
    parser.add_argument("--quiet", action="store_true", help="no line for each repair")
    return parser


def _import(options: argparse.Namespace) -> tuple[int, int]:
    """Numbers of garments written and failed. Raises ``GcdError`` for wrong options."""
    paths = [file for path in options.files for file in _files(path, options.format)]
    panels = _names(options.panels) if options.panels is not None else ()
    make_folder(options.out)
    origin: dict[str, Path] = {}
    failed = 0
    for path in paths:
        try:
            for garment in read_garments(options.format, path, raw=options.raw, panels=panels):
                if isinstance(garment, GcdError):
                    failed += 1
                    print(f"importing: {garment}", file=sys.stderr)
                else:
                    _write(garment, path, options.out, origin, quiet=options.quiet)
        except (SpecError, PatternError) as error:
            failed += 1
            print(f"importing: {error}", file=sys.stderr)
    written = {f"{name}_specification.json" for name in origin}
    others = sorted(path.name for path in options.out.glob("*_specification.json") if path.name not in written)
    if others:
        text = f"{len(others)} files that this import did not write, such as {others[0]}"
        print(f"importing: {options.out} holds {text}: evaluate scores them, too", file=sys.stderr)
    return len(origin), failed


def _write(garment: Prediction, path: Path, out: Path, origin: dict[str, Path], *, quiet: bool) -> None:
    name = garment.pattern.name
    if name in origin:
        raise ConfigError(f"{path}: {origin[name]} is named {shown(name)}, too: rename one, or import it elsewhere")
    if name in (".", "..") or "/" in name or not name.isprintable():
        raise ConfigError(f"{path}: {shown(name)} is no name for a file: rename the garment")
    origin[name] = path
    write_pattern(garment.pattern, out / f"{name}_specification.json")
    if not quiet:
        for remark in garment.remarks:
            print(f"importing: {path}: {remark}", file=sys.stderr)


def _files(path: Path, form: str) -> list[Path]:
    """The predictions of a folder; a file as it is.

    Of the specifications in a folder beside each other those named as predictions count, if there are any: the models
    copy the true ones there.
    """
    if not path.is_dir():
        return [path]
    if arrays := sorted(file for file in path.rglob("*") if file.suffix in ARRAY_FILES) if form in ARRAYS else []:
        return arrays
    found = sorted(path.rglob("*.json"))
    specifications = [file for file in found if file.stem.endswith("specification")] or found
    predicted = {file.parent for file in specifications if "pred" in file.stem}
    kept = [file for file in specifications if "pred" in file.stem or file.parent not in predicted]
    if not kept:
        raise SpecError(f"{path}: no prediction: it should hold files that end in {', '.join(FILES)}")
    return kept


def _names(path: Path) -> list[str]:
    """The names in a JSON list. Raises ``ConfigError``."""
    names = read_json(path, "JSON list of panel names", error=ConfigError)
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names) and len(set(names)) == len(names)):
        raise ConfigError(f"{path}: no list of names, each once: give one name for each panel of the arrays")
    return names


def _attempt(read: Callable[[], Prediction], path: Path, name: str) -> Prediction | GcdError:
    """The garment, or its error with the file and the garment in front."""
    try:
        with np.errstate(all="ignore"):  # numbers without bounds overflow before they are refused
            garment = read()
        if not garment.pattern.panels:
            raise PatternError("no panel with an edge: the model predicted nothing; leave it out")
        return garment
    except GcdError as error:
        text = str(error)
        return type(error)(text if text.startswith(str(path)) else f"{path}: {shown(name)}: {text}")


if __name__ == "__main__":
    sys.exit(main())
