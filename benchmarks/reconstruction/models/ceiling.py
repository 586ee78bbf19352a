"""The ceiling: the truth in the output format of ``panel_set``, the best that this network can answer."""

from functools import partial

import torch

from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.panel_net import NetConfig
from benchmarks.reconstruction.panel_targets import ToTargets, patterns_from
from gcd_dataset.records import Pattern
from gcd_dataset.workers import parallel_map


def answers(known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0) -> list[Pattern]:
    """Each true pattern, encoded and decoded."""
    config = NetConfig()
    encode = ToTargets(config.queries, config.slots, config.edges, points=0)
    return list(parallel_map(partial(_decoded, encode), (unseen.pattern(k) for k in range(len(unseen))), workers))


def _decoded(encode: ToTargets, pattern: Pattern) -> Pattern:
    return patterns_from(encode.of(pattern))[0]
