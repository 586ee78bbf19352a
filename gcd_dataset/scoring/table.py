"""Figures over test garments: means with bootstrap intervals and medians; the lines, the table and the JSON of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gcd_dataset.measurements import ANGLES, MEASURES
from gcd_dataset.metrics import bootstrap_means

if TYPE_CHECKING:
    from gcd_dataset.scoring.garments import Scored

UNITS = {
    **{name: "degrees" if name in ANGLES else "cm" for name in MEASURES},
    "body_crossings": "edges",
    "body_through": "edges",
    "boxmesh_cd": "cm",
    "error_cm": "cm",
    "error_degrees": "degrees",
    "error_p95_cm": "cm",
    "openings_cm": "cm",
    "panel_l2": "cm",
    "panel_l2_pen": "cm",
    "redrape_cd_cm": "cm",
    "rot_deg": "degrees",
    "self_crossings": "edges",
    "transl_cm": "cm",
}
"""Units of the scores that are not shares."""
COLUMNS = ("valid", "iou", "panel_count_acc", "edge_count_acc", "stitch_f1", "stitch_nm_f1", "combinatorial")
OF_ARRAYS = (
    "panel_label", "panels_exact", "seam_label", "seam_f1", "edge_label", "error_cm", "error_degrees", "error_p95_cm",
    "within_1cm", "stretch_error", "self_crossings", "body_crossings", "body_through",
)  # fmt: skip
"""Scores of answers that are no patterns."""
DRAPED = ("sim_ok", "redrape_cd_cm", "openings_cm", "strict_within_1cm", "strict_unaided")
"""Scores of drapes."""
SHORT = {
    "panel_count_acc": "panels", "edge_count_acc": "edges", "stitch_f1": "stitch", "stitch_nm_f1": "n:m",
    "combinatorial": "comb.", "redrape_cd_cm": "drape cm", "openings_cm": "open cm", "sim_ok": "sim ok",
    "strict_within_1cm": "≤1 cm", "strict_unaided": "unaided",
}  # fmt: skip
MOST_ROWS = 30  # garments of a printed table; more: those with a failure or a remark
DIGITS = 6  # decimals of a printed figure: rounding errors print as 0
LONGEST = 100  # characters of a reason in the table


@dataclass(frozen=True, slots=True)
class Summary:
    """A score over all test garments."""

    name: str
    mean: float
    low: float
    """Lower end of the 95 % bootstrap interval of the mean."""
    high: float
    median: float
    unit: str


def summaries(garments: Sequence["Scored"]) -> list[Summary]:
    """Every score over the garments; the bootstrap has a fixed seed."""
    names = list(garments[0].values)
    values = np.array([[garment.values[name] for name in names] for garment in garments])
    low, high = bootstrap_means(values, np.random.default_rng(0))
    medians, means = np.median(values, axis=0), values.mean(axis=0)
    return [
        Summary(name, float(mean), float(least), float(most), float(median), UNITS.get(name, "share"))
        for name, mean, least, most, median in zip(names, means, low, high, medians, strict=True)
    ]


def summaries_by_kind(garments: Sequence["Scored"]) -> dict[str, list[Summary]]:
    """Kind of garment to its scores, the kind with most garments first."""
    kinds: dict[str, list[Scored]] = {}
    for garment in garments:
        kinds.setdefault(garment.kind, []).append(garment)
    return {kind: summaries(own) for kind, own in sorted(kinds.items(), key=lambda item: (-len(item[1]), item[0]))}


def line_of(figure: Summary, prefix: str = "score") -> str:
    """``score.iou 0.91 share [0.88, 0.93] median 0.95``."""
    mean, low, high, median = (
        f"{round(value, DIGITS):.4g}" for value in (figure.mean, figure.low, figure.high, figure.median)
    )
    return f"{prefix}.{figure.name} {mean} {figure.unit} [{low}, {high}] median {median}"


def garment_table(garments: Sequence["Scored"]) -> str:
    """One line for each garment, with the reason of a failure; of many garments, only those with a remark."""
    chosen = [garment for garment in garments if len(garments) <= MOST_ROWS or garment.failure or garment.remarks]
    columns = [name for name in (*COLUMNS, *DRAPED, *OF_ARRAYS) if name in garments[0].values]
    rows = [["garment", "kind", *(SHORT.get(name, name) for name in columns), "remark"]]
    for garment in chosen[:MOST_ROWS]:
        remark = "; ".join(filter(None, (garment.failure, *garment.remarks)))
        cells = [f"{round(garment.values[name], DIGITS):.3g}" for name in columns]
        rows.append([garment.name, garment.kind, *cells, remark if len(remark) <= LONGEST else f"{remark[:LONGEST]}…"])
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]) - 1)]
    lines = ["  ".join([*(c.ljust(w) for c, w in zip(row, widths, strict=False)), row[-1]]).rstrip() for row in rows]
    if (left := len(garments) - len(chosen[:MOST_ROWS])) > 0:
        lines.append(f"… and {left} garments more: --json writes all")
    return "\n".join(lines)


def tree_of(
    garments: Sequence["Scored"],
    figures: Sequence[Summary],
    by_kind: Mapping[str, Sequence[Summary]],
    settings: Mapping[str, Any],
) -> dict[str, Any]:
    """Figures, garments and settings as a JSON tree."""

    def entries(rows: Sequence[Summary]) -> dict[str, Any]:
        return {
            row.name: {"mean": row.mean, "low": row.low, "high": row.high, "median": row.median, "unit": row.unit}
            for row in rows
        }

    return {
        "settings": dict(settings),
        "figures": entries(figures),
        "by_kind": {kind: entries(rows) for kind, rows in by_kind.items()},
        "garments": [
            {
                "name": garment.name,
                "kind": garment.kind,
                "failure": garment.failure or None,
                "remarks": list(garment.remarks),
                **garment.values,
            }
            for garment in garments
        ],
    }
