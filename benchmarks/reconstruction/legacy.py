"""The metrics of published tables, as their papers and public code define them, to compare with those tables only.

Garments, panels and edges are matched by slot or position, failures are left out, and distances are averaged over
empty slots: the presets differ from each other and from ``PatternScore`` on the same predictions, and a change that
leaves the garment the same can cost a prediction all its points. Where a source averages over no garment at all, the
value is NaN.

A prediction is a pattern or ``None`` for a failure. Its panels without a closed outline, and those with an arc too
small for its chord, count as missing. What the sources leave open is marked "chosen".

``neuraltailor`` (Korosteleva and Lee 2022, ``nn/metrics/metrics.py``): a slot is a panel name. Arrays have 23 slots, or
as many as there are names in ``true`` and ``predicted``; a panel that is missing is a row of zeros.

- ``panel_l2``: distance of corners and control points, each panel's mean at the origin and cut to the true number of
  edges, over all true panels [cm].
- ``panels``: garments with the right number of panels. An edge that steps at most 1.8 cm in x and 2.2 cm in y and is
  straight is not counted; fewer than three edges are no panel.
- ``edges``: slots with the right number of edges, so counted, divided by the true number of panels.
- ``rot_l2``: distance of quaternions with their signs, mean over all slots, empty ones included.
- ``transl_l2``: distance of the panels' tops in space, mean over all slots [cm].
- ``stitch_precision``, ``stitch_recall``: mean over garments, 0 without a predicted seam.
- ``*_correct``: the same over the garments with the right number of panels.

``aipparel`` (Nakayama et al. 2025, ``gcd_garment_tokenizer.py: evaluate_patterns``): panels are matched by their place
in the list, for ``edges`` by name; seams by names.

- ``panels``: garments with the right number of panels; failures count as wrong.
- ``edges``: predicted panels with the right number of edges, divided by the predicted number; without failures.
- ``edges_correct``, ``panel_l2`` (with the first control point of a cubic curve), ``transl_l2``, ``rot_l2``
  (quaternions without sign), ``stitch_recall``: over garments with the right number of panels only.

``garmentdiffusion`` (Li et al. 2025; no code is public, so that all but the names is chosen): a slot is a place in the
list; a missing panel is a row of zeros.

- ``panel_l2``, ``panels``, ``edges``, ``transl_l2``: as in ``neuraltailor``, with plain numbers of edges, over true
  panels.
- ``rot_l2``: distance of Euler angles [rad], over true panels.
- ``stitch_precision``, ``stitch_recall``, ``stitch_f1``: mean over garments.

``stitched`` (StEm-Net, ``evaluate_specification.py``): panels are matched at least total shape distance (Hungarian
method); that distance compares corners, at their best cyclic shift and direction, padded with zeros at the centre.
Failures are left out.

- ``panels``: right number of panels; ``edges``: matched panels with the right number of edges.
- ``panel_l2``, ``transl_l2`` (of local origins), ``rot_l2`` (of Euler angles, in degrees though called radians): over
  matched panels, then over garments; infinite if a prediction has no panel.
- ``stitch_precision``, ``stitch_recall``: by numbers of edges that do not follow the shift.

``reweaver`` (Li et al. 2026, ``metric/metric.py``): panels are matched at least one-way distance of their points in
space, from predicted to true; there the points are of the draped garment, here of the flat panels as placed (chosen).

- ``panels``: right number of panels. All but this leave out the other garments (there as -1).
- ``edges``: panels with the right number of edges; ``topology``: mean ``panels`` times mean ``edges``.
- ``edge_cd``: two-way mean distance of outlines; ``iou``: of outlines, not aligned, exact (there drawn at 100 pixels a
  unit). Outlines are about the mean of their points, in units of the largest distance from it (chosen).
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
import shapely
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from gcd_dataset.curves import sample_curve
from gcd_dataset.encodings.neuraltailor import MAX_PANELS, SCALINGS, edge_rows
from gcd_dataset.encodings.rows import loop_corners, quaternion, top_of
from gcd_dataset.encodings.sewformer import edge_rows_7
from gcd_dataset.errors import ConfigError, GcdError, PatternError, did_you_mean
from gcd_dataset.records import EdgeRef, Panel, Pattern
from gcd_dataset.scoring.answers import AnswerReader
from gcd_dataset.scoring.garments import read_true, true_files

Pair: TypeAlias = tuple[Pattern | None, Pattern]

EMPTY = 0.07  # standardised units: an edge with all values this close to those of padding is padding; metrics.py
RELATIVE = 1e-5  # rtol of numpy.isclose, which adds to it
LEAST_EDGES = 3  # of a panel
CURVE_POINTS = 50  # points of an edge; config.py: points_per_curve
RINGS = (0.25, 0.5, 0.75, 1.0)  # copies of an outline that fill the panel with points


def legacy_scores(preset: str, predicted: Sequence[Pattern | None], true: Sequence[Pattern]) -> dict[str, float]:
    """The mean scores of a preset; see the module for their definitions.

    Raises ``ConfigError`` for an unknown preset, lists of unequal length or empty ones, and ``PatternError`` for a true
    pattern with an open outline.
    """
    if preset not in PRESETS:
        raise ConfigError(f"preset {preset}: give one of {', '.join(PRESETS)}{did_you_mean(preset, PRESETS)}")
    if len(predicted) != len(true) or not true:
        raise ConfigError(f"{len(predicted)} predictions for {len(true)} patterns: give one for each, at least one")
    return PRESETS[preset]([(_readable(ours), theirs) for ours, theirs in zip(predicted, true, strict=True)])


# --------------------------------------------------------------------------------------------------------- neuraltailor


def _neuraltailor(pairs: Sequence[Pair]) -> dict[str, float]:
    names = {panel.name for pair in pairs for pattern in pair if pattern is not None for panel in pattern.panels}
    slots = max(MAX_PANELS, len(names))
    shapes, right, edges, rot, transl, seams = [], [], [], [], [], []
    for ours, theirs in pairs:
        mine = {panel.name: panel for panel in ours.panels} if ours else {}
        wanted = {panel.name: panel for panel in theirs.panels}
        counts = {name: _counted_edges(edge_rows(panel)) for name, panel in mine.items()}
        real = {name: count for name, count in counts.items() if count >= LEAST_EDGES}
        right.append(len(real) == len(wanted))
        right_edges = sum(name in wanted and count == len(wanted[name].edges) for name, count in real.items())
        edges.append(_share(right_edges, len(wanted)))
        shapes.append(
            [_shape_distance(mine.get(name), panel) for name, panel in wanted.items() if len(panel.edges) > 2]
        )
        every = mine.keys() | wanted.keys()
        rot.append(sum(_step(mine.get(name), wanted.get(name), _turn) for name in every) / slots)
        transl.append(sum(_step(mine.get(name), wanted.get(name), _top) for name in every) / slots)
        found, actual = _unordered(ours), _unordered(theirs)
        hits = sum(seam in set(actual) for seam in found)
        seams.append((_share(hits, len(found)), _share(hits, len(actual)) if found else 0.0))

    def over(kept: Sequence[bool]) -> dict[str, float]:
        chosen = np.flatnonzero(kept).tolist()
        return {
            "panel_l2": _mean([value for i in chosen for value in shapes[i]]),
            "edges": _mean([edges[i] for i in chosen]),
            "rot_l2": _mean([rot[i] for i in chosen]),
            "transl_l2": _mean([transl[i] for i in chosen]),
            "stitch_precision": _mean([seams[i][0] for i in chosen]),
            "stitch_recall": _mean([seams[i][1] for i in chosen]),
        }

    everyone, correct = over([True] * len(pairs)), over(right)
    return {
        "panels": _mean(right),
        **everyone,
        **{f"{name}_correct": value for name, value in correct.items()},
    }


def _counted_edges(rows: Float[np.ndarray, "e 4"]) -> int:
    """Edges that differ from padding. (The source adds one for a gap between the ends; here outlines are closed.)"""
    scaling = SCALINGS["outlines"]
    scale, shift = np.array(scaling.scale), np.array(scaling.shift)
    empty = np.all(np.abs(rows) / scale <= EMPTY + RELATIVE * np.abs(shift / scale), axis=1)
    return int(np.sum(~empty))


def _shape_distance(ours: Panel | None, theirs: Panel) -> float:
    wanted = edge_rows(theirs)
    given = edge_rows(ours) if ours else np.zeros((0, 4))
    return _distance(_corners_and_controls(_fitted(given, len(wanted))), _corners_and_controls(wanted))


# ------------------------------------------------------------------------------------------------------------- aipparel


def _aipparel(pairs: Sequence[Pair]) -> dict[str, float]:
    right, edges = [], []
    kept: dict[str, list[float]] = {
        name: [] for name in ("edges_correct", "panel_l2", "transl_l2", "rot_l2", "stitch_recall")
    }
    for ours, theirs in pairs:
        if ours is None or not ours.panels:
            right.append(False)
            continue
        right.append(len(ours.panels) == len(theirs.panels))
        wanted = {panel.name: len(panel.edges) for panel in theirs.panels}
        edges.append(_share(sum(wanted.get(p.name) == len(p.edges) for p in ours.panels), len(ours.panels)))
        if not right[-1]:
            continue
        both = list(zip(ours.panels, theirs.panels, strict=True))
        kept["edges_correct"].append(_mean([len(a.edges) == len(b.edges) for a, b in both]))
        kept["panel_l2"].append(_mean([_padded_distance(a, b) for a, b in both]))
        kept["transl_l2"].append(_mean([_step(a, b, _top) for a, b in both]))
        kept["rot_l2"].append(_mean([_unsigned(_turn(a), _turn(b)) for a, b in both]))
        partner = {
            ref: other for seam in ours.seams for ref, other in ((seam.left, seam.right), (seam.right, seam.left))
        }
        found = sum(partner.get(seam.left) == seam.right for seam in theirs.seams)
        kept["stitch_recall"].append(_share(found, len(theirs.seams)))
    return {"panels": _mean(right), "edges": _mean(edges), **{name: _mean(values) for name, values in kept.items()}}


def _padded_distance(ours: Panel, theirs: Panel) -> float:
    rows = [edge_rows_7(panel)[:, :4] for panel in (ours, theirs)]
    count = max(map(len, rows))
    return _distance(*(_corners_and_controls(_fitted(part, count)) for part in rows))


def _unsigned(one: Float[np.ndarray, "4"], other: Float[np.ndarray, "4"]) -> float:
    return float(min(np.linalg.norm(one - other), np.linalg.norm(one + other)))


# ----------------------------------------------------------------------------------------------------- garmentdiffusion


def _garmentdiffusion(pairs: Sequence[Pair]) -> dict[str, float]:
    shapes, right, edges, rot, transl, seams = [], [], [], [], [], []
    for ours, theirs in pairs:
        mine = list(ours.panels) if ours else []
        slots = [(mine[i] if i < len(mine) else None, panel) for i, panel in enumerate(theirs.panels)]
        right.append(len(mine) == len(slots))
        edges.append(_mean([a is not None and len(a.edges) == len(b.edges) for a, b in slots]))
        shapes += [_shape_distance(a, b) for a, b in slots]
        rot += [_step(a, b, lambda panel: panel.placement.rotation) for a, b in slots]
        transl += [_step(a, b, _top) for a, b in slots]
        found, actual = (set(_by_place(pattern)) for pattern in (ours, theirs))
        hits = len(found & actual)
        seams.append((_share(hits, len(found)), _share(hits, len(actual)), _share(2 * hits, len(found) + len(actual))))
    precision, recall, f1 = (_mean([row[k] for row in seams]) for k in range(3))
    return {
        "panels": _mean(right),
        "panel_l2": _mean(shapes),
        "edges": _mean(edges),
        "rot_l2": _mean(rot),
        "transl_l2": _mean(transl),
        "stitch_precision": precision,
        "stitch_recall": recall,
        "stitch_f1": f1,
    }


def _by_place(pattern: Pattern | None) -> list[frozenset[tuple[int, int]]]:
    """Seams as pairs of (place of the panel, edge)."""
    if pattern is None:
        return []
    place = {panel.name: number for number, panel in enumerate(pattern.panels)}
    return [frozenset((place.get(ref.panel, -1), ref.edge) for ref in (s.left, s.right)) for s in pattern.seams]


# ------------------------------------------------------------------------------------------------------------- stitched


def _stitched(pairs: Sequence[Pair]) -> dict[str, float]:
    rows = [_stitched_garment(ours, theirs) for ours, theirs in pairs if ours is not None]
    return {name: _mean([row[name] for row in rows]) for name in STITCHED}


STITCHED = ("panels", "edges", "panel_l2", "transl_l2", "rot_l2", "stitch_precision", "stitch_recall")


def _stitched_garment(ours: Pattern, theirs: Pattern) -> dict[str, float]:
    cost = np.array([[_cyclic_distance(a.vertices, b.vertices) for b in theirs.panels] for a in ours.panels])
    places = zip(*linear_sum_assignment(cost), strict=True) if cost.size else ()
    matched = [(ours.panels[i], theirs.panels[j], float(cost[i, j])) for i, j in places]
    renamed = {a.name: b.name for a, b, _ in matched}

    def named(ref: EdgeRef) -> EdgeRef:
        return replace(ref, panel=renamed.get(ref.panel, ref.panel))

    found = {frozenset((named(seam.left), named(seam.right))) for seam in ours.seams}
    actual = {frozenset((seam.left, seam.right)) for seam in theirs.seams}
    hits = len(found & actual)

    def over(values: Sequence[float]) -> float:
        return _mean(values) if matched else float("inf")

    return {
        "panels": float(len(ours.panels) == len(theirs.panels)),
        "edges": _mean([len(a.edges) == len(b.edges) for a, b, _ in matched]) if matched else 0.0,
        "panel_l2": over([distance for _, _, distance in matched]),
        "transl_l2": over([_norm(a.placement.translation - b.placement.translation) for a, b, _ in matched]),
        "rot_l2": over([_norm(np.degrees(a.placement.rotation - b.placement.rotation)) for a, b, _ in matched]),
        "stitch_precision": _share(hits, len(found)),
        "stitch_recall": _share(hits, len(actual)) if actual else 1.0,
    }


def _cyclic_distance(one: Float[np.ndarray, "n 2"], other: Float[np.ndarray, "m 2"]) -> float:
    """Mean distance of corners about their means, padded with zeros, at the best shift and direction."""
    count = max(len(one), len(other))
    first, second = (_fitted(points - points.mean(axis=0), count) for points in (one, other))
    rolled = second[(np.arange(count)[None] - np.arange(count)[:, None]) % count]
    return float(np.linalg.norm(first - np.concatenate([rolled, rolled[:, ::-1]]), axis=2).mean(axis=1).min())


# ------------------------------------------------------------------------------------------------------------- reweaver


def _reweaver(pairs: Sequence[Pair]) -> dict[str, float]:
    right, rows = [], []
    for ours, theirs in pairs:
        right.append(ours is not None and len(ours.panels) == len(theirs.panels))
        if ours is not None and right[-1]:
            rows.append(_reweaver_garment(ours, theirs))
    edges, distance, iou = (_mean([row[k] for row in rows]) for k in range(3))
    return {"panels": _mean(right), "edges": edges, "topology": _mean(right) * edges, "edge_cd": distance, "iou": iou}


def _reweaver_garment(ours: Pattern, theirs: Pattern) -> tuple[float, float, float]:
    trees, clouds = ([KDTree(_cloud(panel)) for panel in theirs.panels], [_cloud(panel) for panel in ours.panels])
    cost = np.array([[float(tree.query(points)[0].mean()) for points in clouds] for tree in trees])
    pairs = [(ours.panels[j], theirs.panels[i]) for i, j in zip(*linear_sum_assignment(cost), strict=True)]
    edges = _mean([len(a.edges) == len(b.edges) for a, b in pairs])
    outlines = [(_unit_outline(a), _unit_outline(b)) for a, b in pairs]
    distance = _mean([(_one_way(a, b) + _one_way(b, a)) / 2 for a, b in outlines])
    return edges, distance, _mean([_overlap(a, b) for a, b in outlines])


def _cloud(panel: Panel) -> Float[np.ndarray, "n 3"]:
    """Points of the panel in space [cm]."""
    outline = _outline(panel)
    middle = outline.mean(axis=0)
    return panel.placement.apply(np.concatenate([middle + ring * (outline - middle) for ring in RINGS]))


def _outline(panel: Panel) -> Float[np.ndarray, "n 2"]:
    return np.concatenate(
        [sample_curve(*panel.edge_ends(i), edge.curve, CURVE_POINTS) for i, edge in enumerate(panel.edges)]
    )


def _unit_outline(panel: Panel) -> Float[np.ndarray, "n 2"]:
    points = _outline(panel)
    points = points - points.mean(axis=0)
    return points / np.linalg.norm(points, axis=1).max()


def _one_way(one: Float[np.ndarray, "n 2"], other: Float[np.ndarray, "m 2"]) -> float:
    return float(KDTree(other).query(one)[0].mean())


def _overlap(one: Float[np.ndarray, "n 2"], other: Float[np.ndarray, "m 2"]) -> float:
    a, b = (shapely.buffer(shapely.make_valid(shapely.Polygon(points)), 0.0) for points in (one, other))
    union = shapely.area(shapely.union(a, b))
    return float(shapely.area(shapely.intersection(a, b)) / union) if union else 0.0


PRESETS: Mapping[str, Callable[[Sequence[Pair]], dict[str, float]]] = {
    "neuraltailor": _neuraltailor,
    "aipparel": _aipparel,
    "garmentdiffusion": _garmentdiffusion,
    "stitched": _stitched,
    "reweaver": _reweaver,
}
"""Preset to the function of its scores."""


# -------------------------------------------------------------------------------------------------------------- helpers


def _readable(pattern: Pattern | None) -> Pattern | None:
    """The pattern without panels that cannot be drawn."""
    return None if pattern is None else replace(pattern, panels=tuple(p for p in pattern.panels if _can_be_drawn(p)))


def _can_be_drawn(panel: Panel) -> bool:
    placed = (panel.vertices, panel.placement.translation, panel.placement.rotation)
    if not all(np.all(np.isfinite(values)) for values in placed):
        return False
    try:
        edge_rows(panel)
        return bool(np.all(np.isfinite(_outline(panel))))
    except PatternError:
        return False


def _corners_and_controls(rows: Float[np.ndarray, "e 4"]) -> Float[np.ndarray, "2e+1 2"]:
    """The first corner, then control point and end of every edge, about their mean [cm].

    The control point of a straight edge is its start.
    """
    steps, controls = rows[:, :2], rows[:, 2:]
    starts = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    normals = np.stack([-steps[:, 1], steps[:, 0]], axis=1)
    points = starts[:-1] + controls[:, :1] * steps + controls[:, 1:] * normals
    both = np.concatenate([starts[:1], np.stack([points, starts[1:]], axis=1).reshape(-1, 2)])
    return both - both.mean(axis=0)


def _fitted(rows: Float[np.ndarray, "n d"], count: int) -> Float[np.ndarray, "count d"]:
    """The first ``count`` rows, padded with zeros."""
    return np.concatenate([rows[:count], np.zeros((max(count - len(rows), 0), rows.shape[1]))])


def _distance(one: Float[np.ndarray, "n 2"], other: Float[np.ndarray, "n 2"]) -> float:
    return float(np.linalg.norm(one - other, axis=1).mean())


def _step(ours: Panel | None, theirs: Panel | None, place: Callable[[Panel], np.ndarray]) -> float:
    """Distance of two placements; a missing panel has zeros."""
    one, other = (0.0 if panel is None else place(panel) for panel in (ours, theirs))
    return _norm(np.asarray(one) - other)


def _turn(panel: Panel) -> Float[np.ndarray, "4"]:
    return quaternion(panel.placement)


def _top(panel: Panel) -> Float[np.ndarray, "3"]:
    return panel.placement.apply(top_of(loop_corners(panel), panel.placement.matrix))


def _unordered(pattern: Pattern | None) -> list[frozenset[EdgeRef]]:
    return [] if pattern is None else [frozenset((seam.left, seam.right)) for seam in pattern.seams]


def _norm(values: np.ndarray) -> float:
    return float(np.linalg.norm(values))


def _share(part: float, whole: float) -> float:
    return part / whole if whole else 0.0


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the scores of presets. Returns the exit code; exits 2 for wrong usage."""
    parser = argparse.ArgumentParser(prog="benchmarks.reconstruction.legacy", description=main.__doc__)
    parser.add_argument("answers", type=Path, metavar="ANSWERS")
    parser.add_argument("truth", type=Path, metavar="TRUTH")
    parser.add_argument("--preset", action="append", choices=PRESETS, required=True, metavar="NAME")
    options = parser.parse_args(arguments)
    try:
        true = {name: read_true(path) for name, path in sorted(true_files(options.truth).items())}
        answers = {name: answer.pattern for name, answer in AnswerReader(repair=True).read(options.answers).items()}
        for preset in options.preset:
            scores = legacy_scores(preset, [answers.get(name) for name in true], list(true.values()))
            print(*(f"{preset}.{name} {value:.4g} as published" for name, value in scores.items()), sep="\n")
    except GcdError as error:
        print(f"legacy: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
