"""A reader of DXF tags, independent of the library that wrote them."""

from dataclasses import dataclass, field
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np


@dataclass
class Entity:
    """An entity with its tags; of a polyline also the vertices."""

    kind: str
    tags: dict[int, str]
    vertices: list[tuple[float, float]] = field(default_factory=list)

    @property
    def layer(self) -> str:
        return self.tags[8]

    @property
    def at(self) -> np.ndarray:
        return np.array([float(self.tags[10]), float(self.tags[20])])

    @property
    def end(self) -> np.ndarray:
        return np.array([float(self.tags[11]), float(self.tags[21])])


@dataclass
class Block:
    """A block, or the entities section under the name ``""``."""

    name: str
    entities: list[Entity]

    def of(self, layer: str, kind: str) -> list[Entity]:
        return [entity for entity in self.entities if (entity.layer, entity.kind) == (layer, kind)]

    def texts(self, layer: str) -> list[str]:
        return [entity.tags[1] for entity in self.of(layer, "TEXT")]


def read_dxf(path: Path) -> dict[str, Block]:
    """Block name to block; the entities section has the name ``""``."""
    lines = path.read_bytes().decode("ascii").splitlines()
    tags = [(int(code), value) for code, value in zip(lines[::2], lines[1::2], strict=True)]
    starts = [i for i, (code, _) in enumerate(tags) if code == 0]
    records = [(tags[i][1], dict(reversed(tags[i + 1 : j]))) for i, j in pairwise([*starts, len(tags)])]
    assert records[-1][0] == "EOF"
    blocks: dict[str, Block] = {}
    block: Block | None = None
    for kind, found in records:
        if kind == "BLOCK" or (kind == "SECTION" and found.get(2) == "ENTITIES"):
            name = found[2] if kind == "BLOCK" else ""
            assert name not in blocks
            block = blocks[name] = Block(name, [])
        elif kind in ("ENDBLK", "ENDSEC"):
            block = None
        elif block is not None and kind == "VERTEX":
            block.entities[-1].vertices.append((float(found[10]), float(found[20])))
        elif block is not None and kind != "SEQEND":
            block.entities.append(Entity(kind, found))
    return blocks


def layers_of(block: Block) -> dict[str, set[str]]:
    """Layer to the kinds of its entities."""
    ordered = sorted(block.entities, key=lambda entity: entity.layer)
    return {layer: {e.kind for e in group} for layer, group in groupby(ordered, key=lambda entity: entity.layer)}
