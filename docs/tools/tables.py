"""Writes the generated tables of the documents, from the code and from the reports of the benchmarks.

python -m docs.tools.tables           # after a change of a format, a list or a report
python -m docs.tools.tables --check   # names stale documents; exit 1 if there are any
"""

import argparse
import inspect
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from docs.tools.figures import figures_table, read_report, report_list, short_figures
from docs.tools.marked import marked_names, with_parts
from gcd_dataset.files import write_whole
from gcd_dataset.generator.drape import FABRICS
from gcd_dataset.generator.garments import GarmentDesign
from gcd_dataset.generator.garments.mends import Mend
from gcd_dataset.generator.garments.parameter import Choice, Integer, plain
from gcd_dataset.generator.garments.rules import RULES
from gcd_dataset.generator.garments.space import DesignSpace, Leaf, field_docs, meanings
from gcd_dataset.generator.recipes import find_recipe, recipe_names
from gcd_dataset.hub.card import FIELD_DESCRIPTIONS
from gcd_dataset.loaders.fake import FakeGarments, fake_sample
from gcd_dataset.loaders.fields import ADDED
from gcd_dataset.measurements import MEASURE, Measurements
from gcd_dataset.records import POSITION_STEP, UV_STEP, BodyPart, EdgeRole, Grade, Outcome
from gcd_dataset.shards import encode_sample, meta, notes
from gcd_dataset.shards.codec import WIDTHS
from gcd_dataset.shards.layout import FIELDS
from gcd_dataset.shards.sections import unpack
from gcd_dataset.tensors import CLOSURES, COLUMNS, LINE_ROLES, CurveKind

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = (
    "README.md",
    "docs/concepts/drape.md",
    "docs/concepts/measures.md",
    "docs/data-card.md",
    "docs/figures.md",
    "docs/format.md",
    "docs/guides/own-fabric.md",
    "docs/limits.md",
    "docs/mends.md",
    "docs/parameters.md",
)
"""Documents with generated parts."""

ROWS: Mapping[str, str] = {
    "panels": "p", "edges": "e", "stitches": "s", "closures": "s", "lines": "n", "body": "k", "faces": "f", "uv": "c",
    "panel_id": "f", "labels": "l", "seams": "m", "corners": "f", "uv_vertex": "c", "box": "v", "verts": "v",
    "points": "n",
}  # fmt: skip
"""Field to the letter of its first axis."""
UNITS: Mapping[str, str] = {
    "meta": "", "spec": "cm, degrees", "design": "1", "measures": "cm, degrees", "panels": "cm, rad, rows",
    "edges": "cm, rows", "stitches": "rows", "closures": "1", "lines": "cm, degrees, rows",
    "body": "standard deviations",
    "faces": "rows", "uv": "cm", "panel_id": "rows", "labels": "rows", "seams": "rows", "corners": "rows",
    "uv_vertex": "rows", "box": "cm", "verts": "cm", "points": "cm, 1", "front": "sRGB", "back": "sRGB",
}  # fmt: skip
"""Field to the unit of an item's values."""


SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def members_table() -> str:
    """The members of a sample: type and shape in the shard and in an item."""
    item = dict(FakeGarments(1)[0])
    rows = [
        (
            f"`{member}`",
            f"`{field}`",
            *_stored(field, member),
            _loaded(item[field]),
            UNITS[field],
            FIELD_DESCRIPTIONS[field],
        )
        for field, member in FIELDS.items()
    ]
    return table(("member", "field", "stored as", "shape", "in an item", "unit", "content"), rows)


def _stored(field: str, member: str) -> tuple[str, str]:
    """How a field is stored, and its shape."""
    if field not in WIDTHS:
        return {"json": "JSON", "txt": "JSON text", "jpg": "JPEG"}[member.rpartition(".")[2]], ""
    sections = unpack(encode_sample(fake_sample(0, 0))[member])
    shape = ", ".join([ROWS[field], *map(str, WIDTHS[field])])
    if field not in sections:
        return "derived", f"({shape})"
    dtype = sections[field].dtype
    if field in ("uv", "verts"):
        step = round(float(np.log2(POSITION_STEP if field == "verts" else UV_STEP)))
        return f"multiples of 2{str(step).translate(SUPERSCRIPTS)} cm", f"({shape})"
    return f"{dtype.kind}{8 * dtype.itemsize}", f"({shape})"


def _loaded(value: Any) -> str:
    """The type of an item's value."""
    if hasattr(value, "dtype"):
        name = str(value.dtype).removeprefix("torch.")
        return f"{name} (3, h, w)" if value.ndim == 3 else name
    return type(value).__name__


def stages_table() -> str:
    """The fields that each stage adds."""
    first = [name for name in FIELDS if all(name not in added for added in ADDED.values())]
    rows = [(f"`{stage}`", ", ".join(f"`{name}`" for name in added)) for stage, added in ADDED.items()]
    return table(("stage", "adds"), [("`pattern`", ", ".join(f"`{name}`" for name in first)), *rows])


def meta_table() -> str:
    """The keys of ``meta.json``."""
    head, *rows = rst_rows(meta.__doc__ or "")
    return table((head[0].replace("garments", "key"), *head[1:]), [_ticked(row) for row in rows])


def rejects_table() -> str:
    """The keys of a line of ``rejects.jsonl``."""
    return table(("key", "holds"), [_ticked(row) for row in rst_rows(notes.__doc__ or "")])


def columns_table() -> str:
    """The columns of the pattern arrays."""
    parts = []
    for name, columns in COLUMNS.items():
        docs = field_docs(columns)
        rows = [(str(column.value), f"`{column.name}`", docs.get(column.name, "")) for column in columns]
        parts += [f"**`{name}`** (`{columns.__name__}`)", table(("column", "name", "holds"), rows)]
    kinds = ", ".join(f"{kind.value} {_words(kind)}" for kind in CurveKind)
    closures, roles = (", ".join(f"{i} {word}" for i, word in enumerate(words)) for words in (CLOSURES, LINE_ROLES))
    kinds = (
        f"`EdgeColumn.KIND` is one of `CurveKind`: {kinds}. `ClosureColumn.KIND` is one of `CLOSURES`: {closures}. "
        f"`LineColumn.ROLE` is one of `LINE_ROLES`: {roles}."
    )
    return "\n\n".join([*parts, kinds])


def parts_table() -> str:
    """The parts of the body, and the labels of edges."""
    parts = ", ".join(f"{part.value} {_words(part)}" for part in BodyPart)
    labels = ", ".join(f"`{role.value}`" for role in EdgeRole)
    return (
        f"- `BodyPart`: {parts}.\n- Labels of edges (`EdgeRole`): {labels}. `meta.edge_labels` is the list that "
        'numbers refer to, `""` first; it may hold labels that a garment does not use. `meta.vertex_labels` names '
        "those that vertices of the mesh have."
    )


def measures_table() -> str:
    """The measures with unit and meaning."""
    docs = field_docs(Measurements)
    rows = [
        (
            f"`{name}`",
            known.unit,
            docs[name].removesuffix(".").replace(" [rad]", "") + (" (optional)" if known.optional else ""),
        )
        for name, known in MEASURE.items()
    ]
    return table(("measure", "in files", "taken"), rows)


def outcomes_table() -> str:
    """Outcomes with their remedies, and the grades."""
    grades = field_docs(Grade)
    outcomes = table(("outcome", "meaning, and remedy"), [(f"`{o.name}`", o.value) for o in Outcome])
    rows = [(f"`{grade.value}`", grades.get(grade.name, "any other outcome")) for grade in Grade]
    return f"{outcomes}\n\n{table(('grade', 'meaning'), rows)}"


def mends_table() -> str:
    """The faults of GarmentCode's drawing that have a switch."""
    rows = []
    for mend in Mend:
        here, there = re.split("; GarmentCode(?:'s)? ", mend.value)
        rows.append((f"`{mend.name}`", here, there))
    return table(("mend", "here", "GarmentCode"), rows)


def rules_table() -> str:
    """The rules that reject designs."""
    return table(("rule", "rejects"), [(f"`{rule.__name__}`", _summary(rule)) for rule in RULES])


def parameters_table() -> str:
    """The design parameters, a table and a picture for each section."""
    space, parts = DesignSpace.declared(GarmentDesign), []
    documented = list(meanings(space))
    for section in space.entries:
        rows = [_parameter(leaf, text) for leaf, text in documented if leaf.path.startswith(f"{section.key}.")]
        picture = f"![Patterns at both ends of `{section.key}`](images/parameters/{section.key}.jpg){{ .wide }}"
        head = ("parameter", "range", "unit", "default", "probability", "meaning")
        parts += [f"## {section.key}", _summary(section.space.kind), picture, table(head, rows)]
    return "\n\n".join(parts)


def _parameter(leaf: Leaf, meaning: str) -> tuple[str, ...]:
    """A row; the unit is the docstring's, 1 for other numbers. An option that is never sampled has a star."""
    space, named = leaf.space, re.search(r" \[(\w+)\]", meaning)
    default, keep = plain(space.default), "" if space.keep is None else f"{space.keep:g}"
    unit = named[1] if named else "" if isinstance(default, str | bool | None) else "1"
    if isinstance(space, Choice):
        values = ", ".join(f"{value}" if value in space.range else f"{value}\\*" for value in map(plain, space.options))
    else:
        values = "{:g} to {:g}".format(*space.range) + ", whole" * isinstance(space, Integer)
    return f"`{leaf.path.partition('.')[2]}`", values, unit, f"{default}", keep, meaning.replace(f" [{unit}]", "")


def fabrics_table() -> str:
    """The fabrics with their figures."""
    rows = []
    for name, fabric in FABRICS.items():
        pull, bend = fabric.pull, fabric.bend
        rows.append(
            (
                f"`{name}`",
                f"{fabric.density:g}",
                f"{pull.warp:g}, {pull.weft:g}, {pull.bias:g}",
                f"{1e6 * bend.warp:.3g}, {1e6 * bend.weft:.3g}",
                f"{fabric.thickness:g}",
                (fabric.source or "the default").partition(": ")[0],
            )
        )
    head = ("fabric", "kg/m²", "warp, weft, bias [N/m]", "bending [µN·m]", "thickness [cm]", "source")
    return table(head, rows)


def recipes_table() -> str:
    """The recipes: content, hash of the patterns, and time and energy to make them on the machines of the reports."""
    scale, fits = read_report("scale"), read_report("fits")
    rows = []
    for recipe in map(find_recipe, recipe_names()):
        minutes = recipe.count / scale.value("scale.garments_per_s") / 60
        cost = f"{minutes:.1f} min, {scale.value('scale.joules') * recipe.count / 3.6e6:.2g} kWh"
        if recipe.name == "fits":
            cost = f"{60 * fits.value('fits.recipe_hours'):.0f} min, {fits.value('fits.recipe_kwh'):.2g} kWh"
        elif recipe.config.bodies != "both" or recipe.config.resolution != 1.0:
            cost = "not measured"
        known = f"`{recipe.patterns[:16]}…`" if recipe.patterns else f"first ten: `{recipe.first_ten[:16]}…`"
        rows.append((f"`{recipe.name}`", recipe.about, f"{recipe.count:,}", known, cost))
    return table(("recipe", "holds", "samples", "hash of the patterns", "to make it, computed"), rows)


def grades_table() -> str:
    """Shares of the grades of sampled garments. The grade ``failed`` lists its outcomes."""
    report = read_report("drape_sampled")
    count, clean = report.value("drape.garments"), report.value("drape.grade_clean")
    settled = report.value("drape.settled") / count
    failed = {
        outcome.name: number
        for outcome in Outcome
        if outcome is not Outcome.SETTLED and (number := report.value(f"drape.{outcome.name.lower()}"))
    }
    shares = {Grade.CLEAN: clean, Grade.PAPER: settled - clean, Grade.FAILED: 1 - settled}
    why = ", ".join(f"{number:.0f} `{name}`" for name, number in failed.items())
    rows = [
        (f"`{grade.value}`", f"{100 * share:.1f} %", why * (grade is Grade.FAILED)) for grade, share in shares.items()
    ]
    return table(("grade", f"share of {count:.0f} sampled garments", "of these"), rows)


TABLES: Mapping[str, Callable[[], str]] = {
    "members": members_table,
    "stages": stages_table,
    "meta": meta_table,
    "rejects": rejects_table,
    "columns": columns_table,
    "parts": parts_table,
    "measures": measures_table,
    "outcomes": outcomes_table,
    "mends": mends_table,
    "rules": rules_table,
    "fabrics": fabrics_table,
    "parameters": parameters_table,
    "figures": figures_table,
    "short-figures": short_figures,
    "reports": report_list,
    "recipes": recipes_table,
    "grades": grades_table,
}
"""Name of a generated part to the function that writes it."""


def updated(document: str) -> str:
    """The text of a document with its generated parts written anew."""
    return with_parts(document, {name: TABLES[name]() for name in marked_names(document)})


# ------------------------------------------------------------------------------------------------------------- helpers


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table.

    >>> print(table(("a", "b"), [("1", "x | y")]))
    | a | b |
    |---|---|
    | 1 | x \\| y |
    """
    lines = [head, *rows]
    text = [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines]
    return "\n".join([text[0], "|" + "---|" * len(head), *text[1:]])


def rst_rows(docstring: str) -> list[tuple[str, ...]]:
    """The rows of the first table in a docstring; lines without a first cell continue the row above.

    >>> rst_rows("==  ==\\nab  cd\\n    ef\\n==  ==")
    [('ab', 'cd ef')]
    """
    lines = docstring.splitlines()
    rules = [number for number, line in enumerate(lines) if line.startswith("==")]
    ends = np.cumsum([len(part) + 2 for part in lines[rules[0]].split("  ")]).tolist()
    rows: list[tuple[str, ...]] = []
    for line in lines[rules[0] + 1 : rules[-1]]:
        if line.startswith("=="):
            continue
        starts = [0, *ends[:-1]]
        stops = [*ends[:-1], None]
        cells = tuple(line[start:stop].strip() for start, stop in zip(starts, stops, strict=True))
        if cells[0]:
            rows.append(cells)
        else:
            rows[-1] = tuple(f"{above} {cell}".strip() for above, cell in zip(rows[-1], cells, strict=True))
    return rows


def _summary(owner: object) -> str:
    return " ".join((inspect.getdoc(owner) or "").split("\n\n")[0].split()).replace("``", "`")


def _ticked(row: Sequence[str]) -> tuple[str, ...]:
    return tuple(cell.replace("``", "`") for cell in row)


def _words(member: Any) -> str:
    return str(member.name).lower().replace("_", " ")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="change nothing; exit 1 for a stale document")
    check: bool = parser.parse_args().check
    stale = []
    for name in DOCUMENTS:
        before = (ROOT / name).read_text()
        after = updated(before)
        if after != before:
            stale.append(name)
            if not check:
                write_whole(ROOT / name, after.encode())
    print("\n".join(f"{name}: {'stale: run python -m docs.tools.tables' if check else 'written'}" for name in stale))
    return int(check and bool(stale))


if __name__ == "__main__":
    sys.exit(main())
