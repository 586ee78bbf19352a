"""References without training: nearest neighbours, constant answers, bounds, and our own solver."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from torch import Tensor

from benchmarks.reconstruction.drapes import DrapedVertices, redraped, truth_of
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.judging import numbers_of
from benchmarks.reconstruction.labelled_surfaces import true_labels
from benchmarks.reconstruction.models.measures import scans_of
from benchmarks.reconstruction.motions import skinned_motions
from benchmarks.reconstruction.panel_net import NetConfig
from benchmarks.reconstruction.panel_targets import ToTargets, patterns_from
from benchmarks.reconstruction.picture_model import pictures_of
from gcd_dataset.metrics import VertexLabels
from gcd_dataset.records import Pattern
from gcd_dataset.workers import parallel_map

POINTS = 512  # of each garment, compared by nearest neighbours
TYPICAL = 500  # training garments among which the typical one is chosen
PAIRS_AT_ONCE = 2**26  # point pairs at once: 0.3 GB of distances
COARSE = 3.0  # cm, edge length of ``coarse_drape``
PATTERNS = ("T0", "T1", "T1-scan")


@dataclass(frozen=True)
class Baseline:
    """A reference, with the attributes that ``train`` reads of a network's module."""

    answers: Callable[..., list[Any]]
    """Answers for unseen garments: ``answers(known, unseen, device=…, workers=…)``."""
    TASKS: tuple[str, ...]


def nearest(known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0) -> list[Pattern]:
    """The pattern of the known garment at the least chamfer distance, for each unseen one."""
    rows = nearest_garments(positions(unseen, POINTS, device), positions(known, POINTS, device))
    return [known.pattern(row) for row in rows.tolist()]


def typical(known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0) -> list[Pattern]:
    """The same pattern for all, of the known garment with the least mean distance to the others."""
    row = most_typical(positions(known.select(range(min(TYPICAL, len(known)))), POINTS, device))
    return [known.pattern(row)] * len(unseen)


def ceiling(known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0) -> list[Pattern]:
    """Each true pattern in the output format of ``panel_set``: the best that this network can answer."""
    config = NetConfig()
    encode = ToTargets(config.queries, config.slots, config.edges, points=0)
    return list(parallel_map(partial(_decoded, encode), (unseen.pattern(k) for k in range(len(unseen))), workers))


def _decoded(encode: ToTargets, pattern: Pattern) -> Pattern:
    return patterns_from(encode.of(pattern))[0]


def nearest_labels(
    known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0
) -> list[VertexLabels]:
    """Each vertex takes the labels of the nearest vertex of the nearest known garment."""
    rows = nearest_garments(positions(unseen, POINTS, device), positions(known, POINTS, device)).tolist()
    found = []
    for k, row in enumerate(rows):
        _, closest = cKDTree(known.ragged["verts"][row]).query(unseen.ragged["verts"][k])
        true = true_labels(known, row)
        first = [columns.argmax(axis=1) for columns in (true.panels, true.classes, true.seams, true.edges)]
        first[2] = np.where(true.seams.any(axis=1), first[2], -1)
        found.append(VertexLabels(*(labels[closest] for labels in first)))
    return found


def mean_measures(known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0) -> list[np.ndarray]:
    """The mean measures of the known bodies, or size and ease of the known garments, for each unseen one."""
    return [_mean(known)] * len(unseen)


def _mean(known: GarmentSet) -> np.ndarray:
    """The mean of the known numbers; 0 for a ring that no garment has."""
    return np.asarray(np.ma.masked_invalid(numbers_of(known).astype(float)).mean(axis=0).filled(0.0))


def nearest_measures(
    known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0
) -> list[np.ndarray]:
    """The measures of the known body at the least chamfer distance of the scans, for each unseen one."""
    scans = (scans_of(garments) for garments in (unseen, known))
    ours, theirs = (scan[:, :POINTS, :3].to(device) for scan in scans)
    return [known.measures[row].astype(float) for row in nearest_garments(ours, theirs).tolist()]


def nearest_fit(known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0) -> list[np.ndarray]:
    """Size and ease of the known garment with the least distance of some pixels; the mean for a ring that it lacks."""
    pixels = (pictures_of(garments)["pictures"][:, :, 4::8, 4::8] for garments in (unseen, known))
    ours, theirs = (some.flatten(1).float().to(device) for some in pixels)
    rows = numbers_of(known)[torch.cdist(ours, theirs).argmin(dim=1).cpu().numpy()].astype(float)
    return list(np.where(np.isfinite(rows), rows, _mean(known)))


def box_mesh(known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0) -> list[DrapedVertices]:
    """The box mesh of each unseen garment, as if nothing moved."""
    return [DrapedVertices(unseen.ragged["box"][k].astype(float), 0.0) for k in range(len(unseen))]


def coarse_drape(
    known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0
) -> list[DrapedVertices]:
    """Each unseen garment draped by our solver at 3 cm, interpolated to its mesh."""
    return redraped(unseen, spacing=COARSE, device=device, workers=workers)


def solver(known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0) -> list[DrapedVertices]:
    """Each unseen garment draped again at its resolution: the error that another machine's rounding makes."""
    return redraped(unseen, spacing=float(unseen.recipe["recipe"]["resolution"]), device=device, workers=workers)


def frozen(known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0) -> list[DrapedVertices]:
    """Each unseen garment stays where it is in the first frame."""
    true = (truth_of(unseen, k) for k in range(len(unseen)))
    return [DrapedVertices(np.repeat(places[:1], len(places), axis=0), 0.0) for places in true]


def skinned(known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0) -> list[DrapedVertices]:
    """Each vertex of an unseen garment moves as the point of the skin that is nearest to it in the first frame."""
    return [DrapedVertices(each.cloth.transpose(1, 0, 2), each.ms) for each in skinned_motions(unseen, workers=workers)]


BASELINES: Mapping[str, Baseline] = {
    "nearest": Baseline(nearest, PATTERNS),
    "typical": Baseline(typical, (*PATTERNS, "T2")),
    "ceiling": Baseline(ceiling, (*PATTERNS, "T2")),
    "nearest_labels": Baseline(nearest_labels, ("T4",)),
    "mean_measures": Baseline(mean_measures, ("T5", "T7")),
    "nearest_measures": Baseline(nearest_measures, ("T5",)),
    "nearest_fit": Baseline(nearest_fit, ("T7",)),
    "box_mesh": Baseline(box_mesh, ("T6",)),
    "coarse_drape": Baseline(coarse_drape, ("T6",)),
    "solver": Baseline(solver, ("T6",)),
    "frozen": Baseline(frozen, ("T8",)),
    "skinned": Baseline(skinned, ("T8",)),
}


# ------------------------------------------------------------------------------------------------------------ distances


def positions(garments: GarmentSet, count: int, device: torch.device) -> Float[Tensor, "g n 3"]:
    """Positions of the first points of garments [cm]."""
    return torch.from_numpy(garments.points[:, :count, :3]).to(device).float()


def nearest_garments(points: Float[Tensor, "b n 3"], others: Float[Tensor, "t n 3"]) -> Int[Tensor, " b"]:
    """The row of the nearest other garment, for each garment."""
    return torch.stack([chamfer_distances(garment, others).argmin() for garment in points])


def most_typical(points: Float[Tensor, "b n 3"]) -> int:
    """The row of the garment with the least mean distance to the rest: an answer that ignores the input."""
    return int(torch.stack([chamfer_distances(garment, points) for garment in points]).mean(dim=0).argmin())


def chamfer_distances(garment: Float[Tensor, "n 3"], others: Float[Tensor, "t m 3"]) -> Float[Tensor, " t"]:
    """Chamfer distance: the mean distance to the nearest point, added over both directions."""
    distances = []
    step = max(1, PAIRS_AT_ONCE // (len(garment) * others.shape[1]))
    for first in range(0, len(others), step):
        part = others[first : first + step]
        apart = torch.cdist(garment.expand(len(part), -1, -1), part)
        distances.append(apart.amin(dim=2).mean(dim=1) + apart.amin(dim=1).mean(dim=1))
    return torch.cat(distances)
