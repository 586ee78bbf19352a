"""Displays of patterns, samples, items, batches and data sets in notebooks: the texts of their ``_repr_html_``.

Each is static HTML with inline SVG and pictures; it needs no script and no server, so that saved notebooks keep it.
"""

import base64
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from html import escape
from importlib import resources
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import UInt8

from gcd_dataset.errors import GcdError
from gcd_dataset.generator.drawing import jpeg_bytes
from gcd_dataset.generator.lay_plan import LayPlan
from gcd_dataset.generator.svg import pattern_svg
from gcd_dataset.outfits import joined
from gcd_dataset.records import Pattern, Sample
from gcd_dataset.shards.codec import decode_field
from gcd_dataset.spec import pattern_from_spec

if TYPE_CHECKING:
    from gcd_dataset.loaders import Garments


@cache
def asset(name: str) -> str:
    """The text of a template, style or script of this package."""
    return (resources.files(__package__) / name).read_text("utf-8")


def script_data(value: Any) -> str:
    """JSON text that cannot end its script element. Raises ``ValueError`` for numbers that are not finite."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def inline_svg(pattern: Pattern, attributes: str = "", plan: LayPlan | None = None) -> str:
    """The drawing of a pattern as an ``<svg>`` element without a size of its own; ``attributes``: HTML, escaped.

    ``plan``: the pattern's ``lay_out``, where it is known.
    """
    text = pattern_svg(pattern, plan).decode()
    head, _, rest = text[text.index("<svg") :].partition(">")
    kept = head[head.index("viewBox=") :]
    return f'<svg xmlns="http://www.w3.org/2000/svg" {attributes} {kept}>{rest}'


def picture(encoded: bytes, text: str, style: str = "") -> str:
    """A JPEG or PNG as an ``<img>`` element; ``text`` describes it."""
    kind = "png" if encoded.startswith(b"\x89PNG") else "jpeg"
    content = base64.b64encode(encoded).decode()
    return f'<img alt="{escape(text)}" style="{style}" src="data:image/{kind};base64,{content}">'


def table(rows: Iterable[tuple[str, Any]], *, breaks: bool = False) -> str:
    """A table of names and values; ``breaks``: a name may be broken after a dot or an underscore."""
    texts = ((escape(str(name)), escape(str(value))) for name, value in rows)
    broken = ((re.sub(r"([._])(?=.)", r"\1<wbr>", name) if breaks else name, value) for name, value in texts)
    lines = (f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in broken)
    return f"<table>{''.join(lines)}</table>"


SHOWN = 6  # garments of a data set or a batch
PICTURES = ("front", "back")
VIEWS = {"views", "sketch"}  # fields of ``Views`` and ``Sketch``
BOX = "display:flex;flex-wrap:wrap;gap:12px;align-items:flex-start;margin:6px 0"
SHEET = "display:block;height:320px;width:400px;max-width:100%;background:#fafaf8;border-radius:8px"
LARGE = "height:320px;max-width:100%;border-radius:8px"
SMALL = "height:150px;border-radius:6px"
SMALL_SHEET = "height:150px;width:150px;background:#fafaf8;border-radius:6px"


def pattern_html(pattern: Pattern) -> str:
    """The panels as a drawing, with name and counts."""
    counts = f"{_count(len(pattern.panels), 'panel')}, {_count(len(pattern.seams), 'seam')}"
    return f"<div>{_heading(pattern.name, counts)}{_sheet(pattern, SHEET)}</div>"


def sample_html(sample: Sample) -> str:
    """Front, back and pattern of a sample, with its caption, tags and outcome."""
    facts = [sample.provenance.body_name, sample.drape.outcome.name.lower().replace("_", " ") if sample.drape else ""]
    sample = joined(sample)
    counts = f"{_count(len(sample.pattern.panels), 'panel')}, {_count(len(sample.pattern.seams), 'seam')}"
    pictures = [
        picture(encoded, f"{sample.key}, {side}", LARGE)
        for side, encoded in zip(PICTURES, (sample.front, sample.back), strict=True)
        if encoded
    ]
    views = [
        picture(view.picture, f"{sample.key}, view {number}", SMALL)
        for number, view in enumerate(sample.views[:SHOWN])
        if view.picture
    ]
    return (
        f"<div>{_heading(sample.key, ' · '.join([counts, *filter(None, facts)]))}"
        f"{_paragraph(sample.caption)}{_paragraph(', '.join(sample.tags))}"
        f'<div style="{BOX}">{"".join(pictures)}{_sheet(sample.pattern, SHEET)}</div>{_row(views)}</div>'
    )


def item_html(item: Mapping[str, Any]) -> str:
    """Pictures and pattern of a loaded garment, and its fields with shapes and types."""
    key = _entry(item.get("meta"), "key") or item.get("name") or "garment"
    stored = [side for side in PICTURES if getattr(item.get(side), "ndim", 0) == 3]
    pictures = [picture(_encoded(item[side]), f"{key}, {side}", LARGE) for side in stored]
    sheet = _sheet_of_spec(item.get("spec"), str(key), SHEET)
    views = [picture(jpeg_bytes(pixels), f"{key}, {name}", SMALL) for name, pixels in _views_of(item)]
    shown = f'<div style="{BOX}">{"".join(pictures)}{sheet}</div>{_row(views)}'
    return f"<div>{_heading(str(key), '')}{shown}{_fields(item)}</div>"


def batch_html(batch: Mapping[str, Any]) -> str:
    """Fronts or patterns of the first garments of a batch, and its fields with shapes and types."""
    size = int(batch.get("batch_size", 0))
    shown = "".join(islice(_of_batch(batch, size), SHOWN))
    heading = _heading(type(batch).__name__, _count(size, "garment"))
    return f'<div>{heading}<div style="{BOX}">{shown}</div>{_fields(batch)}</div>'


def dataset_html(dataset: "Garments") -> str:
    """Description of a data set, with fronts or patterns of its first garments if they are stored.

    Garments that would be generated for the display are left out, as are those that cannot be read.
    """
    shown = "".join(_of_dataset(dataset)) if dataset.reads_only else ""
    facts = [_count(len(dataset), "garment"), *dataset._description()]
    heading = _heading(type(dataset).__name__, " · ".join(facts))
    return f'<div>{heading}<div style="{BOX}">{shown}</div>{_paragraph(", ".join(dataset.fields))}</div>'


def _of_batch(batch: Mapping[str, Any], size: int) -> Iterator[str]:
    """Front or pattern of each garment of a batch."""
    metas = batch.get("meta") or [None] * size
    keys = [str(_entry(meta, "key") or f"garment {number}") for number, meta in enumerate(metas)]
    for number, key in enumerate(keys):
        if "front" in batch:
            yield _captioned(picture(_encoded(batch["front"][number]), key, SMALL), key)
        elif drawn := [pixels for _, pixels in _views_of({name: batch[name][number] for name in VIEWS & batch.keys()})]:
            yield _captioned(picture(jpeg_bytes(drawn[0]), key, SMALL), key)
        elif "spec" in batch:
            yield _captioned(_sheet_of_spec(batch["spec"][number], key, SMALL_SHEET), key)


def _of_dataset(dataset: "Garments") -> Iterator[str]:
    """Front or pattern of each of the first garments of a data set."""
    field = next((name for name in ("front", "spec") if name in dataset._member_of), None)
    if field is None:
        return
    member = dataset._member_of[field]
    for position in range(min(SHOWN, len(dataset))):
        try:
            key, content = dataset._key(position), dataset._members(position, (member,))
            if field == "front":
                yield _captioned(picture(bytes(content[member]), key, SMALL), key)
            else:
                yield _captioned(_sheet_of_spec(decode_field("spec", content), key, SMALL_SHEET), key)
        except GcdError:
            continue


def _heading(name: str, facts: str) -> str:
    return f'<b>{escape(name)}</b> <span style="opacity:0.7">{escape(facts)}</span>'


def _paragraph(text: str | None) -> str:
    return f'<div style="opacity:0.85;white-space:pre-line">{escape(text)}</div>' if text else ""


def _captioned(element: str, text: str) -> str:
    return (
        f'<figure style="margin:0">{element}<figcaption style="font-size:11px;opacity:0.7">{escape(text)}'
        "</figcaption></figure>"
    )


def _sheet(pattern: Pattern, style: str) -> str:
    """The drawing of a pattern; empty for one without panels, or with an edge that cannot be drawn."""
    if not pattern.panels:
        return ""
    try:
        return inline_svg(pattern, f'style="{style}" role="img" aria-label="{escape(pattern.name)}"')
    except GcdError:
        return ""


def _sheet_of_spec(spec: Any, name: str, style: str) -> str:
    """The drawing of a specification; empty for one without panels, or that is no specification."""
    if not isinstance(spec, Mapping):
        return ""
    try:
        pattern = pattern_from_spec(spec, name)
    except GcdError:
        return ""
    return _sheet(pattern, style)


def _fields(entries: Mapping[str, Any]) -> str:
    """A folded table of the entries: shape and type of tensors, the type of other values."""
    rows = ((name, _form(value)) for name, value in entries.items())
    return f"<details><summary>{len(entries)} fields</summary>{table(rows)}</details>"


def _form(value: Any) -> str:
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"{list(value.shape)} {str(value.dtype).removeprefix('torch.')}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"{type(value).__name__} of {len(value)}"
    return str(value) if isinstance(value, (int, float)) else type(value).__name__


def _views_of(item: Mapping[str, Any]) -> Iterator[tuple[str, UInt8[np.ndarray, "h w 3"]]]:
    """Names and pixels of the first pictures that ``Views`` or ``Sketch`` drew."""
    for name in sorted(VIEWS & item.keys()):
        stack = np.asarray(item[name].cpu() if hasattr(item[name], "cpu") else item[name])
        if stack.dtype != np.uint8 or stack.ndim not in (3, 4):
            continue  # of another origin
        for number, pixels in enumerate(stack[:SHOWN]):
            yield f"{name} {number}", pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)


def _row(elements: Sequence[str]) -> str:
    return f'<div style="{BOX}">{"".join(elements)}</div>' if elements else ""


def _encoded(picture: Any) -> bytes:
    """A u8 tensor [3, h, w] as a JPEG."""
    pixels: UInt8[np.ndarray, "h w 3"] = np.ascontiguousarray(np.moveaxis(np.asarray(picture.cpu()), 0, -1))
    return jpeg_bytes(pixels)


def _entry(mapping: Any, name: str) -> Any:
    return mapping.get(name) if isinstance(mapping, Mapping) else None


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
