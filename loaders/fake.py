"""Small garments that need no generator: tubes of two panels, for trying out code that trains on garments."""

import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from PIL import Image

from gcd_dataset import __version__
from gcd_dataset.errors import ShardError
from gcd_dataset.loaders.base import Garments, Transform, natural
from gcd_dataset.records import (
    BodyShape,
    BoxMesh,
    Drape,
    Edge,
    EdgeRef,
    Measurements,
    Outcome,
    Panel,
    Pattern,
    Placement,
    Provenance,
    Sample,
    Seam,
)
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards.codec import encode_sample
from gcd_dataset.shards.layout import Bytes, key_of
from gcd_dataset.spec import pattern_from_spec, spec_from_pattern

__all__ = ["FakeGarments", "fake_sample"]

LABEL = "lower_interface"  # what a skirt's upper edge is called: a drape holds it at the waist
COMPONENTS = 8
POINTS = 64
PICTURE = 16  # pixels


class FakeGarments(Garments):
    """``n`` valid garments of about a hundred vertices, in every field like those of ``GarmentDataset``.

    >>> ds = FakeGarments(3, fields=("faces", "measures"))
    >>> ds[0]["faces"].shape[1], sorted(ds[0]["measures"])
    (3, ['height', 'waist'])
    """

    def __init__(
        self,
        n: int,
        seed: int = 0,
        *,
        fields: Iterable[str] | None = None,
        transform: Transform | None = None,
        dtype: torch.dtype | None = torch.float32,
    ) -> None:
        super().__init__(fields, transform, dtype=dtype)
        self._n, self._seed = natural("n", n), natural("seed", seed)

    def __len__(self) -> int:
        return self._n

    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions that garment ``index`` is made with. Raises ``IndexError``."""
        made = fake_sample(self._seed, self._position(index)).provenance
        return {"seed": made.seed, "index": made.index, "recipe": dict(made.recipe), "versions": dict(made.versions)}

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` unless garment ``index`` comes out the same twice."""
        position = self._position(index)
        if self._members(position, ()) != self._members(position, ()):
            raise ShardError(f"fake garment {position} comes out different each time")

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        return encode_sample(fake_sample(self._seed, position))


def fake_sample(seed: int, index: int, *, fineness: int = 1, points: int = POINTS) -> Sample:
    """A skirt that is a tube round the y axis: front and back are rectangles, sewn together at both sides.

    ``fineness``: triangles along each that would be one; ``points``: how many lie on its surface.
    """
    random = rng(seed, index, Stage.DESIGN)
    tube = _Tube(
        width=float(random.uniform(30.0, 50.0)),
        length=float(random.uniform(20.0, 40.0)),
        columns=int(random.integers(3, 7)) * fineness,
        rows=int(random.integers(4, 9)) * fineness,
    )
    return Sample(
        key=key_of(index),
        provenance=Provenance(seed, index, versions={"gcd_dataset": __version__}, recipe={"fake": True}),
        pattern=tube.pattern(key_of(index)),
        measurements=Measurements(height=float(random.uniform(150.0, 190.0)), waist=2 * tube.width),
        design={"skirt": {"width": tube.width, "length": tube.length}},
        shape=BodyShape(random.normal(size=COMPONENTS).astype(np.float32).astype(float)),
        box_mesh=tube.box_mesh(),
        drape=Drape(tube.round_shape(), Outcome.SETTLED, int(random.integers(50, 300)), 0, 0, 1.0, 1.0),
        points=tube.surface_points(rng(seed, index, Stage.POINTS), points),
        front=_picture(random),
        back=_picture(random),
    )


@dataclass(frozen=True)
class _Tube:
    """Two rectangles of ``columns`` × ``rows`` cells each; the vertices of the seams come first."""

    width: float
    length: float
    columns: int
    rows: int

    def pattern(self, name: str) -> Pattern:
        """Front and back, sewn right to left and left to right."""
        w, h = self.width, self.length
        corners = np.array([[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]])
        edges = tuple(Edge(i, (i + 1) % 4, label=LABEL if i == 2 else "") for i in range(4))
        front = Placement(np.array([-w / 2, 60.0, 20.0]), np.zeros(3))
        back = Placement(np.array([w / 2, 60.0, -20.0]), np.array([0.0, np.pi, 0.0]))
        panels = (Panel("front", corners, edges, front, "leg"), Panel("back", corners, edges, back, "leg"))
        seams = (Seam(EdgeRef("front", 1), EdgeRef("back", 3)), Seam(EdgeRef("front", 3), EdgeRef("back", 1)))
        # Through a specification and back, so that the sample is one that a shard can hold to the last digit.
        return pattern_from_spec(spec_from_pattern(Pattern(name, panels, seams)), name)

    def box_mesh(self) -> BoxMesh:
        """Both rectangles in place, joined at the sides."""
        uv, vertex, corners = self._flat(), self._vertex(), self._corners()
        placed = np.concatenate([panel.placement.apply(uv) for panel in self.pattern("").panels])
        total = np.zeros((vertex.max() + 1, 3))
        np.add.at(total, vertex, placed)
        side = np.arange(self.rows + 1)
        sides = [np.stack([side + seam * (self.rows + 1), np.full_like(side, seam)], axis=1) for seam in (0, 1)]
        return BoxMesh(
            vertices=total / np.bincount(vertex)[:, None],
            faces=vertex[corners],
            uv=np.concatenate([uv, uv]),
            corners=corners,
            uv_vertex=vertex,
            panel_id=np.repeat([0, 1], len(corners) // 2),
            panel_names=("front", "back"),
            panel_labels=("leg", "leg"),
            seams=np.concatenate(sides),
            labels={LABEL: np.unique(vertex.reshape(2, self.rows + 1, -1)[:, -1])},
        )

    def round_shape(self) -> Float[np.ndarray, "v 3"]:
        """The tube as a cylinder whose girth is twice the panels' width [cm]."""
        u, v = self._flat().T
        share = np.concatenate([1 - u / self.width, -u / self.width])  # of half a turn; 0 is the wearer's left
        radius = self.width / np.pi
        points = np.stack([radius * np.cos(np.pi * share), 60 + np.tile(v, 2), radius * np.sin(np.pi * share)], axis=1)
        vertices = np.zeros((self._vertex().max() + 1, 3))
        vertices[self._vertex()] = points
        return vertices

    def surface_points(self, random: np.random.Generator, count: int) -> Float[np.ndarray, "n 6"]:
        """Points of the cylinder with outward normals."""
        angle, height = random.uniform(0, 2 * np.pi, count), random.uniform(60, 60 + self.length, count)
        outward = np.stack([np.cos(angle), np.zeros(count), np.sin(angle)], axis=1)
        place = self.width / np.pi * outward + np.stack([0 * height, height, 0 * height], axis=1)
        return np.concatenate([place, outward], axis=1)

    def _flat(self) -> Float[np.ndarray, "n 2"]:
        """Grid points of one rectangle, row by row from below [cm]."""
        u, v = np.meshgrid(np.linspace(0, self.width, self.columns + 1), np.linspace(0, self.length, self.rows + 1))
        return np.stack([u.ravel(), v.ravel()], axis=1)

    def _vertex(self) -> Int[np.ndarray, " c"]:
        """The vertex of every grid point, the front's first: left side, right side, then what lies between."""
        side, inner = self.rows + 1, (self.rows + 1) * (self.columns - 1)
        grid = np.empty((2, side, self.columns + 1), np.int64)
        grid[0, :, -1] = grid[1, :, 0] = np.arange(side)
        grid[0, :, 0] = grid[1, :, -1] = side + np.arange(side)
        grid[:, :, 1:-1] = 2 * side + np.arange(2 * inner).reshape(2, side, -1)
        return grid.ravel()

    def _corners(self) -> Int[np.ndarray, "f 3"]:
        """Two triangles a cell, counter-clockwise in the panel's plane."""
        across = self.columns + 1
        cell = (np.arange(self.rows)[:, None] * across + np.arange(self.columns)).ravel()
        lower = np.stack([cell, cell + 1, cell + across + 1], axis=1)
        upper = np.stack([cell, cell + across + 1, cell + across], axis=1)
        one = np.concatenate([lower, upper])
        return np.concatenate([one, one + across * (self.rows + 1)])


def _picture(random: np.random.Generator) -> bytes:
    """A JPEG of one colour."""
    file = io.BytesIO()
    colour = tuple(int(c) for c in random.integers(256, size=3))
    Image.new("RGB", (PICTURE, PICTURE), colour).save(file, "JPEG", quality=90)
    return file.getvalue()
