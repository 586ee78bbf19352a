"""A learner that fits a line, for tests of the training loop."""

from dataclasses import dataclass
from math import cos, sin
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from benchmarks.reconstruction.learners import Learner, TensorExamples
from benchmarks.reconstruction.models import load_model
from benchmarks.reconstruction.stitching.graphs import EdgeBatch, PackedGraphs, edge_refs, graph_of
from benchmarks.reconstruction.stitching.net import StitchConfig, StitchNet
from gcd_dataset.curves import Arc, Quadratic
from gcd_dataset.records import EdgeRef, Panel, Pattern, Seam
from tests.generator.mesh import shapes


@dataclass(frozen=True)
class Line(TensorExamples):
    """Points of the line y = 2 x0 - x1 + 1."""

    x: Float[Tensor, "b 2"]
    y: Float[Tensor, " b"]


def line(count: int = 64) -> Line:
    x = torch.randn(count, 2, generator=torch.Generator().manual_seed(1))
    return Line(x, x @ torch.tensor([2.0, -1.0]) + 1.0)


class LineLearner(Learner[Line, float]):
    """A line, and dropout, which draws from the global random stream."""

    def __init__(self, dropout: float = 0.0) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.net = nn.Sequential(nn.Dropout(dropout), nn.Linear(2, 1))

    def prepare(self, garments: object, *, device: torch.device, workers: int = 0) -> Line:
        return line().to(device)

    def loss(self, batch: Line) -> dict[str, Tensor]:
        return {"square": (self.net(batch.x)[:, 0] - batch.y).square().mean()}

    def predict(self, batch: Line) -> list[float]:
        with torch.no_grad():
            return self.net(batch.x)[:, 0].tolist()


def small(model: str, **sizes: float) -> Learner[Any, Any]:
    """The network of the smallest training, with other sizes where given; its weights are the same in each call."""
    torch.manual_seed(0)
    module = load_model(model)
    learner: Learner[Any, Any] = module.build({**module.SMALL, **sizes})
    return learner


def loss_of(learner: Learner[Any, Any], batch: Any) -> float:
    with torch.no_grad():
        return float(sum(part.item() for part in learner.loss(batch).values()))


# -------------------------------------------------------------------------------------------------------- sewn patterns


SMALL = StitchConfig(width=32, heads=2, layers=2, pair_width=16)
HEM, SIDE_R, ARMHOLE_R, SHOULDER_R, NECK, SHOULDER_L, ARMHOLE_L, SIDE_L = range(8)
WRIST, UNDERARM_1, CAP_1, CAP_2, UNDERARM_2 = range(5)


def rectangle(name: str, width: float, height: float, x: float = 0.0) -> Panel:
    return shapes.panel(name, shapes.rectangle(width, height), at=(x, 0.0, 0.0))


def t_shirt() -> Pattern:
    """Front, back and two sleeves in one piece; the cap of a sleeve is two arcs of one circle."""
    corners = [(-25, 0), (25, 0), (25, 40), (20, 60), (8, 62), (-8, 62), (-20, 60), (-25, 40)]
    half, radius = float(np.hypot(5, 20)), 30.0
    angle = half / radius
    end, top = radius * sin(angle), radius * (1 - cos(angle))
    cap = [(-15.0, -30.0), (15.0, -30.0), (end, 0.0), (0.0, top), (-end, 0.0)]
    arc = Arc(radius, large=False, right=True)
    panels = (
        shapes.panel("front", corners, curves={NECK: Quadratic((0.5, 0.5))}, at=(0, 80, 20)),
        shapes.panel("back", corners, curves={NECK: Quadratic((0.5, 0.1))}, at=(0, 80, -20)),
        shapes.panel("one", cap, curves={CAP_1: arc, CAP_2: arc}, at=(60, 120, 0)),
        shapes.panel("two", cap, curves={CAP_1: arc, CAP_2: arc}, at=(-60, 120, 0)),
    )
    pairs = [
        ("front", SIDE_R, "back", SIDE_L), ("front", SIDE_L, "back", SIDE_R),
        ("front", SHOULDER_R, "back", SHOULDER_L), ("front", SHOULDER_L, "back", SHOULDER_R),
        ("front", ARMHOLE_R, "one", CAP_2), ("back", ARMHOLE_L, "one", CAP_1),
        ("front", ARMHOLE_L, "two", CAP_1), ("back", ARMHOLE_R, "two", CAP_2),
        ("one", UNDERARM_1, "one", UNDERARM_2), ("two", UNDERARM_1, "two", UNDERARM_2),
    ]  # fmt: skip
    return Pattern("t_shirt", panels, tuple(Seam(EdgeRef(a, i), EdgeRef(b, j)) for a, i, b, j in pairs))


def tube() -> Pattern:
    """Two equal rectangles sewn at both sides, with a belt of two at the top."""
    panels = (*(rectangle(name, 40, 60) for name in ("f", "b")), *(rectangle(name, 40, 5) for name in ("bf", "bb")))
    pairs = [("f", 1, "b", 3), ("f", 3, "b", 1), ("bf", 1, "bb", 3), ("bf", 3, "bb", 1), ("f", 2, "bf", 0)]
    pairs.append(("b", 2, "bb", 0))
    return Pattern("tube", panels, tuple(Seam(EdgeRef(a, i), EdgeRef(b, j)) for a, i, b, j in pairs))


def rewritten(pattern: Pattern, rng: np.random.Generator) -> tuple[Pattern, dict[EdgeRef, EdgeRef]]:
    """The same garment in another file: panels reordered, renamed, turned and moved, loops started elsewhere."""
    panels, new_ref = [], {}
    for number in rng.permutation(len(pattern.panels)).tolist():
        old = pattern.panels[number]
        shift, angle = int(rng.integers(len(old.edges))), float(rng.uniform(0, 6))
        turn = np.array([[cos(angle), -sin(angle)], [sin(angle), cos(angle)]])
        name = f"panel {rng.integers(10**9)}"
        edges = old.edges[shift:] + old.edges[:shift]
        panels.append(Panel(name, old.vertices @ turn.T + rng.normal(size=2), edges, old.placement))
        for i in range(len(edges)):
            new_ref[EdgeRef(old.name, (i + shift) % len(edges))] = EdgeRef(name, i)
    seams = tuple(Seam(new_ref[s.left], new_ref[s.right], s.right_wrong) for s in pattern.seams)
    return Pattern("other", tuple(panels), seams), new_ref


def batch_of(*patterns: Pattern) -> EdgeBatch:
    return PackedGraphs.of([graph_of(pattern) for pattern in patterns])[torch.arange(len(patterns))]


def net_of(config: StitchConfig = SMALL) -> StitchNet:
    torch.manual_seed(0)
    return StitchNet(config).eval()


def nothing_known(batch: EdgeBatch) -> torch.Tensor:
    return torch.full_like(batch.partners, -1)


def seams_of(pattern: Pattern) -> set[frozenset[EdgeRef]]:
    return {frozenset((seam.left, seam.right)) for seam in pattern.seams}


def rows_of(pattern: Pattern) -> list[tuple[int, int]]:
    rows = {ref: row for row, ref in enumerate(edge_refs(pattern))}
    return [(rows[seam.left], rows[seam.right]) for seam in pattern.seams]
