"""Statistics of a batch of garments, with the keys of the release's ``dataset_properties_….yaml``."""

from collections import Counter
from collections.abc import Iterable, Mapping
from statistics import mean, median
from typing import Any

import numpy as np

from gcd_dataset.generator.garments.wardrobe import Bottom, Upper
from gcd_dataset.release.published_names import DEFAULT_BODY

UPPERS = {member.value: member.garment for member in Upper}
BOTTOMS = {member.value: member.garment for member in Bottom}
DRESS = 1.4  # least sum of the lengths of top, belt and skirt of a dress
LENGTHS = ((0.3, "mini"), (0.5, "knee_len"), (0.65, "midi"), (np.inf, "maxi"))  # upper bounds of a bottom's length
SHORT_SLEEVE = 0.5
FAILS = (
    "crashes", "cloth_body_intersection", "cloth_self_intersection", "static_equilibrium", "fast_finish",
    "pattern_loading", "multi_stitching", "gt_edges_creation",
)  # fmt: skip


def garment_type(design: Mapping[str, Any]) -> dict[str, Any]:
    """Main type and styles of a design tree, by the rules of GarmentCodeData's sampler."""

    def value(*path: str) -> Any:
        node: Any = design
        for key in path:
            node = node.get(key) if isinstance(node, Mapping) else None
        return node.get("v") if isinstance(node, Mapping) else node

    upper, bottom = UPPERS.get(value("meta", "upper")), BOTTOMS.get(value("meta", "bottom"))
    below = float(value(bottom.statistics_length_section or bottom.section, "length") or 0.0) if bottom else 0.0
    at_waist = upper is not None and upper.at_waist
    top = 1.0 if at_waist else float(value(upper.section if upper else "shirt", "length") or 0.0)
    belt = float(value("waistband", "width") or 0.0) if value("meta", "wb") else 0.0
    legs = bottom is not None and bottom.legs
    if upper:
        main = "jumpsuit" if legs else "dress" if upper.carries and top + belt + below >= DRESS else "upper_garment"
    else:
        main = "pants" if legs else "skirt"
    asymmetric = bool(upper and value("left", "enable_asym"))
    styles = ["asymmetric_top"] if asymmetric else []
    if upper and not asymmetric and "Hood" in str(value("collar", "component", "style")):
        styles.append("hoodie")
    if upper:
        branches = [("sleeve",), ("left", "sleeve")] if asymmetric else [("sleeve",)]
        lengths = [value(*at, "length") or 0.0 for at in branches if not value(*at, "sleeveless")]
        long = max(lengths, default=0.0) >= SHORT_SLEEVE
        styles += ["with_sleeves", "long_sleeve" if long else "short_sleeve"] if lengths else ["sleeveless"]
    if bottom:
        styles.append(next(name for most, name in LENGTHS if below < most))
    return {"main": main, "styles": styles}


def batch_properties(
    batch: str,
    panels: Mapping[str, int],
    types: Mapping[str, Mapping[str, Any]],
    counts: Mapping[str, Mapping[str, int]],
    fails: Mapping[str, str],
) -> dict[str, Any]:
    """The tree of the properties file: figures of each garment by name, and summaries over the batch.

    By name of the garment: ``panels``: number of panels; ``types``: ``garment_type``; ``counts``: ``fin_frame``,
    ``self_collisions``, ``body_collisions`` and ``face_count``; ``fails``: class of the failure.
    """
    by_name: dict[str, dict[str, int]] = {
        key: {name: count[key] for name, count in counts.items()}
        for key in ("fin_frame", "self_collisions", "body_collisions", "face_count")
    }
    failed = {kind: [name for name, of in fails.items() if of == kind] for kind in FAILS}
    collisions = {
        f"{key}_{name}": figure
        for key in ("self_collisions", "body_collisions")
        for name, figure in _spread(by_name[key].values()).items()
    }
    return {
        "body_default": DEFAULT_BODY,
        "body_samples": "5000_body_shapes_and_measures",
        "size": len(panels),
        "name": batch,
        "to_subfolders": True,
        "generator": {
            "stats": {
                "panel_count": dict(panels),
                "garment_types": {name: dict(kind) for name, kind in types.items()},
                "garment_types_summary": _summary(types.values()),
                "panel_count_avg": mean(panels.values()),
                "panel_count_med": float(median(panels.values())),
                "panel_count_min": min(panels.values()),
                "panel_count_max": max(panels.values()),
            }
        },
        "data_folder": batch,
        "sim": {
            "stats": {
                "fails": failed,
                **by_name,
                "stop_over": [],
                "fin_frame_avg": float(mean(by_name["fin_frame"].values())),
                **collisions,
                "fails_count": len(fails),
            }
        },
        "frozen": True,
    }


def _spread(values: Iterable[int]) -> dict[str, float]:
    array = np.array(list(values))
    figures = {"avg": array.mean(), "med": np.median(array)} | {f"p{p}": np.percentile(array, p) for p in (80, 95)}
    return {name: float(figure) for name, figure in figures.items()}


def _summary(types: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Numbers of garments by main type, and by style and main type."""
    kinds = list(types)
    styles: dict[str, Counter[str]] = {}
    for kind in kinds:
        for style in kind["styles"]:
            styles.setdefault(style, Counter()).update(("total", kind["main"]))
    return {
        "main": dict(Counter(kind["main"] for kind in kinds)),
        "style": {style: dict(counts) for style, counts in styles.items()},
    }
