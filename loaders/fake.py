"""``FakeGarments``: tubes of two panels without the generator, for tests of training code."""

import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from PIL import Image

from gcd_dataset import __version__
from gcd_dataset.errors import ShardError
from gcd_dataset.loaders.base import Garments, Transform, require_integer
from gcd_dataset.records import (
    BodyShape,
    BoxMesh,
    Drape,
    Edge,
    EdgeRef,
    Layer,
    Measurements,
    NamedFabric,
    Outcome,
    Outfit,
    Panel,
    Pattern,
    Placement,
    Provenance,
    Sample,
    Seam,
    WornGarment,
)
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards.codec import encode_sample
from gcd_dataset.shards.layout import MOST_GARMENTS, Bytes, fields_of, garments_layout, key_of
from gcd_dataset.spec import pattern_from_spec, spec_from_pattern

LABEL = "lower_interface"  # the label of a skirt's upper edge; a drape holds it at the waist
COMPONENTS = 8
POINTS = 64
PICTURE = 16  # pixels


class FakeGarments(Garments):
    """``n`` valid garments of about a hundred vertices, with all fields of ``GarmentDataset``.

    ``garments``: of the largest outfit; from 2 on, items are outfits of 2 to so many, with fields ``g1_verts``, ….

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
        garments: int = 1,
        dtype: torch.dtype | None = torch.float32,
    ) -> None:
        self._most = require_integer("garments", garments, least=1, most=MOST_GARMENTS)
        available = fields_of(garments_layout(garments=self._most).members)
        super().__init__(fields, transform, available=available, dtype=dtype)
        self._n, self._seed = require_integer("n", n), require_integer("seed", seed)

    def __len__(self) -> int:
        return self._n

    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions that garment ``index`` is made with. Raises ``IndexError``."""
        made = fake_sample(self._seed, self._position(index)).provenance
        return {"seed": made.seed, "index": made.index, "recipe": dict(made.recipe), "versions": dict(made.versions)}

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` unless garment ``index`` has the same bytes when made twice."""
        position = self._position(index)
        if self._members(position, ()) != self._members(position, ()):
            raise ShardError(f"fake garment {position} has different bytes each time it is made")

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        count = 2 + position % (self._most - 1) if self._most > 1 else 1
        return encode_sample(fake_outfit(self._seed, position, count), garments=self._most)


def fake_sample(seed: int, index: int, *, fineness: int = 1, points: int = POINTS) -> Sample:
    """A skirt: a tube around the y axis, of two rectangles sewn together at both sides.

    ``fineness``: subdivisions of each cell edge; ``points``: number of surface points.
    """
    random = rng(seed, index, Stage.DESIGN)
    tube = _FakeTube(
        name=key_of(index),
        width=float(random.uniform(30.0, 50.0)),
        length=float(random.uniform(20.0, 40.0)),
        columns=int(random.integers(3, 7)) * fineness,
        rows=int(random.integers(4, 9)) * fineness,
    )
    return Sample(
        key=key_of(index),
        provenance=Provenance(seed, index, versions={"gcd_dataset": __version__}, recipe={"fake": True}),
        pattern=tube.pattern,
        measurements=Measurements(height=float(random.uniform(150.0, 190.0)), waist=2 * tube.width),
        design={"skirt": {"width": tube.width, "length": tube.length}},
        shape=BodyShape(random.normal(size=COMPONENTS).astype(np.float32).astype(float)),
        box_mesh=tube.box_mesh(),
        drape=Drape(tube.round_shape(), Outcome.SETTLED, int(random.integers(50, 300)), 0, 0, 1.0, 1.0),
        points=tube.surface_points(rng(seed, index, Stage.POINTS), points),
        front=_picture(random),
        back=_picture(random),
        gathers=tube.pattern.gather_ratios(),
    )


def fake_outfit(seed: int, index: int, count: int) -> Sample:
    """A skirt, and ``count`` - 1 over it, each 15 cm lower than the one before; with one layer for each two."""
    skirts = [fake_sample(seed, index), *(fake_sample(seed + 1, 10 * index + number) for number in range(1, count))]
    if count == 1:
        return skirts[0]
    garments = []
    for number, skirt in enumerate(skirts):
        drape = skirt.drape and replace(skirt.drape, vertices=skirt.drape.vertices - [0.0, 15.0 * number, 0.0])
        fabric = NamedFabric("denim", {"density": 0.4}) if number else skirt.fabric
        ways = {"tucked": number == 0, "closed": number != 1}
        garments.append(WornGarment(skirt.pattern, skirt.design, skirt.box_mesh, drape, fabric, **ways))
    layers = tuple(Layer(i, o, 7 * i + o, 20 + o, 0.25 * i) for o in range(count) for i in range(o))
    return replace(skirts[0], outfit=Outfit(tuple(garments), layers))


@dataclass(frozen=True)
class _FakeTube:
    """Two rectangles of ``columns`` × ``rows`` cells each; vertices of the seams are numbered first."""

    name: str
    width: float
    length: float
    columns: int
    rows: int

    @cached_property
    def pattern(self) -> Pattern:
        """Front and back, sewn together at both sides."""
        w, h = self.width, self.length
        corners = np.array([[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]])
        edges = tuple(Edge(i, (i + 1) % 4, label=LABEL if i == 2 else "") for i in range(4))
        front = Placement(np.array([-w / 2, 60.0, 20.0]), np.zeros(3))
        back = Placement(np.array([w / 2, 60.0, -20.0]), np.array([0.0, np.pi, 0.0]))
        panels = (Panel("front", corners, edges, front, "leg"), Panel("back", corners, edges, back, "leg"))
        seams = (Seam(EdgeRef("front", 1), EdgeRef("back", 3)), Seam(EdgeRef("front", 3), EdgeRef("back", 1)))
        # Through a specification and back: numbers that a shard stores exactly.
        return pattern_from_spec(spec_from_pattern(Pattern(self.name, panels, seams)), self.name)

    def box_mesh(self) -> BoxMesh:
        """Both rectangles placed, seams welded."""
        uv, vertex, corners = self._flat(), self._vertex(), self._corners()
        placed = np.concatenate([panel.placement.apply(uv) for panel in self.pattern.panels])
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
        """The draped vertices [cm]: a cylinder of girth twice the panels' width."""
        u, v = self._flat().T
        half_turns = np.concatenate([1 - u / self.width, -u / self.width])  # 0 is the wearer's left
        radius = self.width / np.pi
        points = np.stack(
            [radius * np.cos(np.pi * half_turns), 60 + np.tile(v, 2), radius * np.sin(np.pi * half_turns)], axis=1
        )
        vertices = np.zeros((self._vertex().max() + 1, 3))
        vertices[self._vertex()] = points
        return vertices

    def surface_points(self, random: np.random.Generator, count: int) -> Float[np.ndarray, "n 6"]:
        """Random points of the cylinder [cm] with outward normals."""
        angle, height = random.uniform(0, 2 * np.pi, count), random.uniform(60, 60 + self.length, count)
        outward = np.stack([np.cos(angle), np.zeros(count), np.sin(angle)], axis=1)
        points = self.width / np.pi * outward + np.stack([0 * height, height, 0 * height], axis=1)
        return np.concatenate([points, outward], axis=1)

    def _flat(self) -> Float[np.ndarray, "n 2"]:
        """Grid points of one rectangle, row by row from the bottom [cm]."""
        u, v = np.meshgrid(np.linspace(0, self.width, self.columns + 1), np.linspace(0, self.length, self.rows + 1))
        return np.stack([u.ravel(), v.ravel()], axis=1)

    def _vertex(self) -> Int[np.ndarray, " c"]:
        """The vertex of each grid point, front first; vertices are numbered left seam, right seam, interior."""
        side, inner = self.rows + 1, (self.rows + 1) * (self.columns - 1)
        grid = np.empty((2, side, self.columns + 1), np.int64)
        grid[0, :, -1] = grid[1, :, 0] = np.arange(side)
        grid[0, :, 0] = grid[1, :, -1] = side + np.arange(side)
        grid[:, :, 1:-1] = 2 * side + np.arange(2 * inner).reshape(2, side, -1)
        return grid.ravel()

    def _corners(self) -> Int[np.ndarray, "f 3"]:
        """Two triangles per cell, counter-clockwise in the panel's plane."""
        across = self.columns + 1
        cell = (np.arange(self.rows)[:, None] * across + np.arange(self.columns)).ravel()
        lower = np.stack([cell, cell + 1, cell + across + 1], axis=1)
        upper = np.stack([cell, cell + across + 1, cell + across], axis=1)
        front = np.concatenate([lower, upper])
        return np.concatenate([front, front + across * (self.rows + 1)])


def _picture(random: np.random.Generator) -> bytes:
    file = io.BytesIO()
    colour = tuple(int(c) for c in random.integers(256, size=3))
    Image.new("RGB", (PICTURE, PICTURE), colour).save(file, "JPEG", quality=90)
    return file.getvalue()
