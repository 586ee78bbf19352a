"""Garments are made, stored and read as ``tests/data/record.py`` recorded them.

The storage format may choose the order of faces and points, and round positions.
"""

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float
from scipy.spatial import cKDTree

from gcd_dataset.records import Sample
from gcd_dataset.spec import spec_from_pattern
from gcd_dataset.tensors import PanelColumn, encode_pattern, sewn_rows
from tests.data.record import RECORDED, STAGES, garments, make_recipe, plain, read

Item = Mapping[str, Any]

STORED = 1e-3  # cm: positions
ROTATION = slice(PanelColumn.QUATERNION_W, PanelColumn.ANGLE_Z + 1)
TURNED = 1e-5  # rad: 0.01 mm at a metre
POINT = 2e-3  # cm, along each axis
NORMAL = 0.5  # degrees
TEXT = 1e-6, 0.0  # numbers in texts: absolute, relative
# Drapes of two machines: benchmarks/reports/drape_noise_floor.md
FOLDS = 0.3  # cm, mean over the vertices
SHADE = 2.0  # of 255, mean over the pixels
FRAMING = 0.05, 0.01  # cameras, which frame the drape: absolute, relative


@pytest.mark.parametrize("stage", STAGES)
def test_garments_are_the_recorded_ones(stage: str, tmp_path: Path) -> None:
    ds = garments(stage, tmp_path)
    for index, recorded in read(stage).items():
        made = plain(ds[index])  # written to the cache, from which the record is read
        assert (made.pop("closures") == sewn_rows(1)).all()  # a younger field than the record, as the next
        assert not len(made.pop("lines"))
        assert set(made) == set(recorded)
        assert not list(differences(recorded, made)), f"{stage} {index}"
        assert not list(differences(recorded, fields_of(ds.sample(index)))), f"the record of {stage} {index}"


def test_a_recipe_makes_the_recorded_splits_and_patterns(tmp_path: Path) -> None:
    recorded = json.loads((RECORDED / "recipe.json").read_text())
    splits, patterns = make_recipe(tmp_path)
    assert patterns.agrees(recorded.pop("patterns"))
    assert splits == recorded


def fields_of(sample: Sample) -> Item:
    """The fields of an item that a record holds, without pictures."""
    tensor, mesh = encode_pattern(sample.pattern), sample.box_mesh
    fields: dict[str, Any] = {"panels": tensor.panels, "edges": tensor.edges, "stitches": tensor.stitches}
    fields |= {"design": sample.design, "measures": sample.measurements.to_file_values(), "caption": sample.caption}
    fields |= {"spec": spec_from_pattern(sample.pattern), "points": sample.points}
    if sample.shape is not None:
        fields["body"] = sample.shape.weights
    if mesh is not None:
        fields |= {name: getattr(mesh, name) for name in ("faces", "uv", "panel_id", "corners", "uv_vertex", "seams")}
        labels = [(vertex, tensor.edge_labels.index(name)) for name, rows in mesh.labels.items() for vertex in rows]
        fields |= {"box": mesh.vertices, "labels": np.array(labels, int).reshape(-1, 2)}
    if sample.drape is not None:
        fields["verts"] = sample.drape.vertices
    return {name: value for name, value in fields.items() if value is not None}


def differences(recorded: Item, made: Item) -> Iterator[str]:
    """The fields of ``made`` that differ from the recorded ones, each with its fault."""
    old, new = canonical(recorded), canonical(renumbered(made, recorded))
    for name in new:
        if fault := fault_of(name, old[name], new[name], draped="verts" in old):
            yield f"{name}: {fault}"


def renumbered(made: Item, recorded: Item) -> Item:
    """A garment whose vertices have the numbers of the recorded ones at their places on the panels.

    Rounding, which differs between CPUs, decides which of the equal circles of a symmetric panel is filled first.
    """
    if "uv" not in made or made["uv"].shape != recorded["uv"].shape:
        return made
    places = []
    for item in (made, recorded):
        panel = np.zeros(len(item["uv"]))
        panel[item["corners"]] = item["panel_id"][:, None]
        places.append(np.column_stack([1e4 * panel, item["uv"]]))
    _, row = cKDTree(places[1]).query(places[0])
    vertex = np.zeros(len(made["box"]), int)
    vertex[made["uv_vertex"]] = recorded["uv_vertex"][row]
    fields = {**made, "corners": row[made["corners"]], "faces": vertex[made["faces"]]}
    for name in ("labels", "seams"):
        fields[name] = np.column_stack([vertex[made[name][:, 0]], made[name][:, 1:]])
    fields |= {name: made[name][np.argsort(row)] for name in ("uv", "uv_vertex")}
    fields["uv_vertex"] = vertex[fields["uv_vertex"]]
    return fields | {name: made[name][np.argsort(vertex)] for name in ("box", "verts") if name in made}


def canonical(item: Item) -> dict[str, Any]:
    """An item whose rows have one order, wherever their order has no meaning; ``triangles`` replaces faces."""
    fields = dict(item)
    if "faces" in fields:
        corners = fields.pop("corners")
        turn = (corners.argmin(axis=1)[:, None] + np.arange(3)) % 3
        turned = [np.take_along_axis(ids, turn, axis=1) for ids in (corners, fields.pop("faces"))]
        fields["triangles"] = np.column_stack([*turned, fields.pop("panel_id")])
    for name in {"triangles", "labels", "seams"} & set(fields):
        fields[name] = fields[name][np.lexsort(fields[name].T[::-1])]
    return fields


def fault_of(name: str, old: Any, new: Any, *, draped: bool) -> str:
    """How a field differs from the recorded one; empty if it is the same."""
    if not isinstance(old, np.ndarray):
        return next(unlike(old, new, FRAMING if name == "view_0_json" else TEXT), "")
    if old.shape != new.shape:
        return f"shape {new.shape}, recorded {old.shape}"
    if name == "points":
        return points_fault(old, new, draped=draped)
    apart: Any = np.abs(new.astype(float) - old)
    limit: Any = {"edges": STORED, "uv": STORED, "box": STORED, "body": TURNED}.get(name, 0.0)
    if name == "verts":
        apart, limit = np.linalg.norm(apart, axis=1).mean(), FOLDS
    elif old.dtype == np.uint8:
        apart, limit = apart.mean(), SHADE
    elif name == "panels":
        limit = np.full(len(PanelColumn), STORED)
        limit[ROTATION] = TURNED
    return "" if np.all(apart <= limit) else f"up to {np.max(apart):.3g} apart"


def points_fault(old: Float[np.ndarray, "n 6"], new: Float[np.ndarray, "n 6"], *, draped: bool) -> str:
    """How points differ from the recorded ones, in any order; folds of a drape differ between machines."""
    apart, nearest = cKDTree(new[:, :3]).query(old[:, :3], p=np.inf)
    if draped:
        return "" if apart.mean() <= FOLDS else f"{apart.mean():.3g} cm apart"
    if len(set(nearest.tolist())) < len(old) or apart.max() > POINT:
        return f"others, up to {apart.max():.3g} cm apart"
    lengths = np.linalg.norm(old[:, 3:], axis=1) * np.linalg.norm(new[nearest, 3:], axis=1)
    angles = np.degrees(np.arccos(np.clip((old[:, 3:] * new[nearest, 3:]).sum(axis=1) / lengths, -1, 1)))
    return "" if angles.max() <= NORMAL else f"normals up to {angles.max():.3g} degrees apart"


def unlike(old: Any, new: Any, limit: tuple[float, float], at: str = "") -> Iterator[str]:
    """The places at which two JSON trees differ by more than rounding."""
    if isinstance(old, Mapping) and isinstance(new, Mapping) and old.keys() == new.keys():
        for key in old:
            yield from unlike(old[key], new[key], limit, f"{at}.{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for row, pair in enumerate(zip(old, new, strict=True)):
            yield from unlike(*pair, limit, f"{at}[{row}]")
    elif isinstance(old, float) and isinstance(new, float | int):
        if not math.isclose(old, new, abs_tol=limit[0], rel_tol=limit[1]):
            yield f"{at} {new}, recorded {old}"
    elif old != new:
        yield f"{at} {new!r:.200}, recorded {old!r:.200}"
