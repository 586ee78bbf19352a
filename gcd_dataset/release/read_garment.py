"""Reads a published garment into our records; welds the split PLY vertices back to the numbers of the labels."""

import functools
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from gcd_dataset.bodyfiles import parse_measurements
from gcd_dataset.errors import BodyError, ShardError, SpecError, shown
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import BoxMesh, Drape, Measurements, Outcome, Panel, Pattern
from gcd_dataset.release.batches import Facts
from gcd_dataset.release.meshes import Ply, read_ply, weld
from gcd_dataset.release.published_names import DEFAULT_BODY, ENDINGS, REMEDY
from gcd_dataset.spec import pattern_from_spec
from gcd_dataset.yamlfile import PlainLoader, require_shallow, require_small

SEAM = "stitch_"  # prefix of seam vertices in the segmentation file
SEAM_NUMBER = re.compile(r"[0-9]{1,9}")
BROKEN = (yaml.YAMLError, ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError)
"""Exceptions of PyYAML on invalid dates, ``!!bool maybe``, a map that is its own key, …"""
SHORTEST = 1e-6  # cm: flat length below which an edge has no stretch
FLATNESS = 0.02  # cm: tolerance between an inner vertex of a panel and its texture coordinates


@dataclass(frozen=True, eq=False)
class PublishedGarment:
    """One garment; its files are read on demand.

    Properties raise ``ShardError`` naming a missing or invalid file.
    """

    name: str
    location: str
    """Its folder or archive entry, for messages."""
    read: Callable[[Sequence[str]], Mapping[str, bytes]]
    """Reads kinds of file: kind to content, without missing ones."""
    facts: Facts
    default_body: bool
    """Whether the garment is on the default body."""

    def fetch(self, kinds: Iterable[str]) -> None:
        """Read several files in one call of ``read``."""
        if missing := [kind for kind in kinds if kind not in self._files]:
            self._files.update(self.read(missing))

    def broken(self, kind: str, problem: str) -> ShardError:
        """The error for an invalid file: path, problem, remedy."""
        return ShardError(f"{self._path(kind)}: {problem}: {REMEDY}")

    @functools.cached_property
    def pattern(self) -> Pattern:
        """The sewing pattern; ``gcd_dataset.faults`` checks whether it can be sewn."""
        try:
            pattern = pattern_from_spec(json.loads(self._file("spec")), self.name, source=self._path("spec"))
        except (ValueError, RecursionError, SpecError) as error:
            raise self.broken("spec", str(error).removeprefix(f"{self._path('spec')}: ")) from error
        for panel in pattern.panels:
            for number, edge in enumerate(panel.edges):
                if not 0 <= min(edge.start, edge.end) <= max(edge.start, edge.end) < len(panel.vertices):
                    raise self.broken(
                        "spec", f"{shown(panel.name)}, edge {number}: no vertex {edge.start} or {edge.end}"
                    )
        edges = {panel.name: len(panel.edges) for panel in pattern.panels}
        for number, seam in enumerate(pattern.seams):
            for side in (seam.left, seam.right):
                if not 0 <= side.edge < edges.get(side.panel, 0):
                    raise self.broken(
                        "spec", f"seam {number} joins {shown(side.panel)}, edge {side.edge}, which does not exist"
                    )
        return pattern

    @functools.cached_property
    def design(self) -> Mapping[str, Any]:
        """The tree of design parameters, unused parts included: value ``v``, range and type of each."""
        design = self._yaml("design").get("design")
        if not isinstance(design, dict):
            raise self.broken("design", "no map named design")
        return design

    @functools.cached_property
    def measurements(self) -> Measurements:
        """The wearer's measures."""
        try:
            return parse_measurements(self._yaml("measures"), self._path("measures"))
        except BodyError as error:
            raise self.broken("measures", str(error).removeprefix(f"{self._path('measures')}: ")) from error

    @property
    def measures(self) -> dict[str, float]:
        """All numbers of the measurement file, derived ones included: cm, inclinations in degrees."""
        self.measurements  # noqa: B018 -- raises for an invalid file
        table = self._yaml("measures")["body"]
        return {key: value for key, value in table.items() if type(value) in (int, float) and abs(value) < math.inf}

    @property
    def body_name(self) -> str:
        """Name of the wearer: ``mean_all``, or a person and pose such as ``00345_straight``."""
        table = self._yaml("measures").get("body")
        body = table if isinstance(table, Mapping) else {}
        name = body.get("body_sample", DEFAULT_BODY if self.default_body else None)
        if not isinstance(name, str):
            raise self.broken("measures", "body_sample is missing, such as 00345_straight")
        return name

    @functools.cached_property
    def box_mesh(self) -> BoxMesh:
        """The mesh before sewing; ``uv`` in the planes of the panels [cm]."""
        box, pattern = self._box, self.pattern
        first, vertex = self._welded
        panel_of_row = self._panel_of_row
        return BoxMesh(
            vertices=box.vertices[first].astype(float),
            faces=vertex[box.faces],
            uv=self._in_panel_planes(panel_of_row),
            corners=box.faces,
            uv_vertex=vertex,
            panel_id=panel_of_row[box.faces[:, 0]],
            panel_names=tuple(panel.name for panel in pattern.panels),
            panel_labels=tuple(panel.label for panel in pattern.panels),
            seams=self._seams,
            labels=self._labels,
        )

    @functools.cached_property
    def vertices(self) -> Float[np.ndarray, "v 3"]:
        """Vertex positions at rest [cm]."""
        return self._sim.vertices[self._welded[0]]

    @property
    def faces(self) -> Int[np.ndarray, "f 3"]:
        """Triangles, rows of ``vertices``."""
        return self._welded[1][self._sim.faces]

    @property
    def drape(self) -> Drape:
        """The settled garment; counts are -1 where the batch's properties lack them."""
        stretch = _stretch(self.box_mesh, self.vertices.astype(float))
        median, p99 = np.percentile(stretch, [50, 99]).tolist() if len(stretch) else (np.nan, np.nan)
        facts = self.facts
        return Drape(
            self.vertices,
            Outcome.SETTLED,
            facts.frames,
            facts.self_crossings,
            facts.body_crossings,
            median,
            p99,
            body_through=-1,  # the publication does not count them
        )

    def picture(self, side: str) -> bytes:
        """The PNG of ``front`` or ``back``."""
        return self._file(side)

    @functools.cached_property
    def _sim(self) -> Ply:
        return self._ply("sim")

    @functools.cached_property
    def _box(self) -> Ply:
        """The mesh before sewing, with the rows and faces of the drape."""
        box = self._ply("box")
        if not np.array_equal(box.faces, self._sim.faces) or len(box.vertices) != len(self._sim.vertices):
            raise self.broken("box", f"its mesh differs from {self.name}{ENDINGS['sim']}")
        return box

    @functools.cached_property
    def _segments(self) -> tuple[str, ...]:
        """Panel, or comma-separated seams, of every vertex."""
        text = self._file("segmentation").decode("utf-8", "replace")
        return tuple(text.removesuffix("\n").split("\n"))

    @functools.cached_property
    def _welded(self) -> tuple[Int[np.ndarray, " v"], Int[np.ndarray, " c"]]:
        """First row of each welded vertex, welded vertex of each row."""
        count, sim = len(self._segments), self._sim.vertices
        first, vertex = weld(sim)
        if len(first) != count:  # vertices may coincide in the drape; they are apart before sewing
            first, vertex = weld(sim, self._box.vertices)
        if len(first) != count:
            raise self.broken("segmentation", f"labels {count} vertices, but the mesh has {len(first)}")
        return first, vertex

    @functools.cached_property
    def _seams(self) -> Int[np.ndarray, "s 2"]:
        rows = [
            (vertex, int(number) if SEAM_NUMBER.fullmatch(number := entry.removeprefix(SEAM)) else -1)
            for vertex, segment in enumerate(self._segments)
            if segment.startswith(SEAM)
            for entry in segment.split(",")
        ]
        seams = np.array(rows, np.int64).reshape(-1, 2)
        if len(seams) and not 0 <= seams[:, 1].min() <= seams[:, 1].max() < len(self.pattern.seams):
            raise self.broken("segmentation", f"names a stitch outside the {len(self.pattern.seams)} of the pattern")
        return seams[np.argsort(seams[:, 1], kind="stable")]

    @functools.cached_property
    def _panel_of_row(self) -> Int[np.ndarray, " c"]:
        """Panel of each row: rows connected by triangles belong to one panel."""
        names = [panel.name for panel in self.pattern.panels]
        free = {segment: -1 for segment in self._segments if segment.startswith(SEAM)}
        number = free | {name: row for row, name in enumerate(names)}
        if unknown := sorted(set(self._segments) - number.keys()):
            raise self.broken("segmentation", f"names {shown(unknown[0])}, which is not a panel of the pattern")
        named = np.array([number[segment] for segment in self._segments])[self._welded[1]]
        count, piece = _pieces(self._box.faces, len(named))
        panel = np.full(count, -1)
        panel[piece[named >= 0]] = named[named >= 0]
        if (panel[piece[named >= 0]] != named[named >= 0]).any():
            raise self.broken("segmentation", "names two panels in one piece of cloth")
        # Pieces with only seam vertices name no panel; faces are sorted by panel.
        left = [row for row in range(len(names)) if row not in panel]
        unnamed = [p for p in dict.fromkeys(piece[self._box.faces[:, 0]].tolist()) if panel[p] < 0]
        if len(left) != len(unnamed):
            raise self.broken("box", f"{count} pieces of cloth for {len(names)} panels")
        panel[unnamed] = left
        return panel[piece]

    @functools.cached_property
    def _labels(self) -> Mapping[str, Int[np.ndarray, " n"]]:
        known = {edge.label for panel in self.pattern.panels for edge in panel.edges}
        labels = {}
        for label, ids in self._yaml("vertex_labels").items():
            if not isinstance(ids, list) or not all(type(i) is int and 0 <= i < len(self._segments) for i in ids):
                raise self.broken("vertex_labels", f"{shown(str(label))} is not a list of vertices of the mesh")
            if label not in known:
                raise self.broken("vertex_labels", f"{shown(str(label))} is on no edge of the pattern")
            labels[label] = np.array(ids, np.int64)
        return labels

    def _in_panel_planes(self, panel_of_row: Int[np.ndarray, " c"]) -> Float[np.ndarray, "c 2"]:
        """Every row in the plane of its panel [cm].

        Rows off seams follow from the placement of their panel. Rows on seams do not, since they are welded; their
        texture coordinates are plane coordinates up to a translation per panel, and common scales along x and y.
        """
        box, texture = self._box, self._box.texture
        on_seam = np.zeros(len(self._segments), bool)
        on_seam[self._seams[:, 0]] = True
        free = ~on_seam[self._welded[1]]
        flat = np.zeros((len(texture), 2))
        for row, panel in enumerate(self.pattern.panels):
            inner = free & (panel_of_row == row)
            flat[inner] = ((box.vertices[inner] - panel.placement.translation) @ panel.placement.matrix)[:, :2]
        scale = _common_scale(texture[free], flat[free], panel_of_row[free])
        scaled = texture * scale
        for row, panel in enumerate(self.pattern.panels):
            in_panel = panel_of_row == row
            known = in_panel & free
            offset = (flat - scaled)[known].mean(axis=0) if known.any() else _offset(scaled[in_panel], panel)
            if not np.abs((scaled + offset - flat)[known]).max(initial=0.0) <= FLATNESS:  # false for NaN
                raise self.broken("box", f"texture coordinates of panel {panel.name} do not match its plane")
            flat[in_panel & ~free] = scaled[in_panel & ~free] + offset
        return flat

    @functools.cached_property
    def _files(self) -> dict[str, bytes]:
        return {}

    def _file(self, kind: str) -> bytes:
        self.fetch([kind])
        try:
            return self._files[kind]
        except KeyError as error:
            raise ShardError(f"{self._path(kind)}: missing: {REMEDY}") from error

    def _ply(self, kind: str) -> Ply:
        try:
            return read_ply(self._file(kind))
        except ShardError as error:
            raise error if str(error).startswith(self.location) else self.broken(kind, str(error)) from error

    def _yaml(self, kind: str) -> dict[str, Any]:
        try:
            content = self._file(kind)
            require_shallow(content)
            table = yaml.load(content, Loader=PlainLoader)
            require_small(table)
        except BROKEN as error:
            raise self.broken(kind, f"not YAML ({' '.join(str(error).split())})") from error
        return table if isinstance(table, dict) else {}

    def _path(self, kind: str) -> str:
        return f"{self.location}/{self.name}{ENDINGS[kind]}"


def _pieces(faces: Int[np.ndarray, "f 3"], rows: int) -> tuple[int, Int[np.ndarray, " c"]]:
    """Number of connected components of the mesh, and the component of every row."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]]).T
    return connected_components(coo_matrix((np.ones(ends.shape[1]), ends), shape=(rows, rows)), directed=False)


def _common_scale(
    texture: Float[np.ndarray, "n 2"], flat: Float[np.ndarray, "n 2"], panel: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "2"]:
    """Centimetres per texture unit along x and y: a least-squares fit over all panels, with a translation each."""
    count = np.maximum(np.bincount(panel), 1)

    def centred(values: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        middle = np.stack([np.bincount(panel, values[:, axis]) / count for axis in (0, 1)], axis=1)
        return values - middle[panel]

    t, x = centred(texture), centred(flat)
    return (t * x).sum(axis=0) / np.maximum((t * t).sum(axis=0), np.finfo(float).tiny)


def _offset(scaled: Float[np.ndarray, "n 2"], panel: Panel) -> Float[np.ndarray, "2"]:
    """Translation onto the panel for a mesh without inner rows, by ICP between the panel's corners and the rows."""
    corners = panel.vertices[[edge.start for edge in panel.edges]]
    offset = 0.5 * (corners.min(axis=0) + corners.max(axis=0) - scaled.min(axis=0) - scaled.max(axis=0))
    for _ in range(8):
        apart = corners[:, None] - (scaled + offset)[None]
        nearest = np.linalg.norm(apart, axis=2).argmin(axis=1)
        offset = offset + apart[np.arange(len(corners)), nearest].mean(axis=0)
    return offset


def _stretch(mesh: BoxMesh, vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, " e"]:
    """Stretch of the mesh edges: length / flat length, without edges of zero flat length."""
    a, b = mesh_edges(mesh.corners).ends.T
    flat = np.linalg.norm(mesh.uv[a] - mesh.uv[b], axis=1)
    placed = vertices[mesh.uv_vertex]
    has_length = flat > SHORTEST
    return np.linalg.norm(placed[a] - placed[b], axis=1)[has_length] / flat[has_length]
