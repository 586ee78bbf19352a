"""The records of the package: frozen dataclasses of bodies, patterns, meshes, drapes and samples.

Everywhere: centimetres; y up, the wearer faces +z, the wearer's left is +x, soles at y = 0; angles in radians.
Axis letters: ``v f e p`` vertices, faces, edges, panels; ``s`` seams; ``k`` shape components; ``c`` corner points.
A record holds read-only views of its arrays; records compare by value.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from enum import Enum, StrEnum
from math import cos, inf, nan, sin
from typing import Any, Self, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8

from gcd_dataset.curves import LINE, Curve, Point, curve_length
from gcd_dataset.errors import PatternError
from gcd_dataset.measurements import ANGLES, MEASURES, Measurements

__all__ = [
    "ANGLES", "MEASURES", "Body", "BodyPart", "BodyShape", "BoxMesh", "Closure", "Drape", "Ease", "Edge", "EdgeRef",
    "EdgeRole", "Fit", "FitLabel", "Grade", "InnerLine", "Layer", "LineRole", "Maps", "Measurements", "NamedFabric",
    "Outcome", "Outfit", "Panel", "PanelRole", "Pattern", "Placement", "Provenance", "Record", "Rejected", "Sample",
    "Seam", "StoredView", "Strain", "WornGarment", "role_of",
]  # fmt: skip


class Record:
    """Base of frozen dataclasses with arrays: the arrays become read-only views; ``==`` compares values."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray) and value.flags.writeable:
                frozen = value.view()
                frozen.flags.writeable = False
                object.__setattr__(self, name, frozen)

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        compared = [f.name for f in fields(self) if f.compare]  # type: ignore[arg-type]
        return all(_same(getattr(self, name), getattr(other, name)) for name in compared)

    __hash__ = None  # type: ignore[assignment]


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return np.array_equal(a, b, equal_nan=np.asarray(a).dtype.kind == "f")
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return list(a) == list(b) and all(_same(a[key], b[key]) for key in a)
    return bool(a == b)


class BodyPart(Enum):
    """Part of the body of a vertex; the value is the label stored in arrays."""

    TRUNK = 0
    LEFT_ARM = 1
    RIGHT_ARM = 2
    LEFT_LEG = 3
    RIGHT_LEG = 4
    HEAD = 5
    HANDS = 6
    FEET = 7
    INTERNAL = 8
    """Eyes, eye sockets and mouth: cloth never touches them."""


_LIMBS = ("shoulder", "upper_arm", "forearm", "hand", "thigh", "shin", "foot", "toes")
BONES = (
    *("pelvis", "lower_spine", "upper_spine", "neck", "head"),
    *(f"{side}_{limb}" for side in ("left", "right") for limb in _LIMBS),
)
"""The names of all bones; hands have no fingers of their own, and stay relaxed."""


@dataclass(frozen=True)
class Pose:
    """Rotations of bones from the A-pose; bones without one stay as they are."""

    turns: Mapping[str, tuple[float, float, float]]
    """Bone, one of ``BONES``, to bend, spread and twist: a rotation vector in the axes of the bone, which turns
    relative to its parent [rad]. Bend moves the tip of the bone forward, spread away from the middle of the body, twist
    turns its front outwards; of the trunk, bend is forward, spread and twist are to its left. Of a body of a model
    file also ``smpl:left_elbow`` and other joints, to a rotation vector in x, y and z."""
    name: str = "pose"
    cuts: int = 0
    """Edges at which the wearer's skin cuts itself in this pose, where they were counted."""

    @property
    def array(self) -> Float[np.ndarray, "21 3"]:
        """Bend, spread and twist of each of ``BONES`` [rad]."""
        return np.array([self.turns.get(bone, (0.0, 0.0, 0.0)) for bone in BONES])


@dataclass(frozen=True, eq=False)
class BodyShape(Record):
    """Shape and pose parameters of a body."""

    weights: Float[np.ndarray, " k"]
    """Weights of the shape components, in standard deviations of the population."""
    arm_angle: float = 0.0
    """Rotation of both arms from the A-pose [rad]; positive lifts the hands."""
    legs_apart: bool = False
    """Whether the feet are set apart, as trousers need; otherwise the legs are straight."""
    pose: Pose | None = None
    """The pose into which the body is turned from the one above."""


@dataclass(frozen=True, eq=False)
class Body(Record):
    """A body mesh with part labels; its soles are at y = 0."""

    vertices: Float[np.ndarray, "v 3"]
    """Vertex positions [cm]."""
    faces: Int[np.ndarray, "f 3"]
    """Triangles, counter-clockwise seen from outside."""
    parts: UInt8[np.ndarray, " v"]
    """``BodyPart`` value of each vertex."""
    name: str = "body"
    posed: Callable[[Pose], Float[np.ndarray, "v 3"]] | None = field(default=None, compare=False, repr=False)
    """Vertices in a pose [cm], of a body of the user's model file; None: of the body model, or of a mesh file."""
    joints: Float[np.ndarray, "21 3"] | None = field(default=None, compare=False, repr=False)
    """Joints of ``BONES`` in a pose of the body model [cm]; None: those that the rig finds from the vertices."""


class PanelRole(StrEnum):
    """The part of the body that a panel covers; the value is its label in files."""

    BODY = "body"
    LEG = "leg"
    """Trouser legs and skirts."""
    ARM = "arm"


class EdgeRole(StrEnum):
    """Function of an edge in the drape, such as a collar that is held up; the value is its label in files."""

    LOWER_INTERFACE = "lower_interface"
    """The top edge of a garment that hangs from the waist."""
    LEFT_COLLAR = "left_collar"
    RIGHT_COLLAR = "right_collar"
    LEFT_ARMHOLE = "left_armhole"
    RIGHT_ARMHOLE = "right_armhole"
    STRAPLESS_TOP = "strapless_top"

    @property
    def mirrored(self) -> "EdgeRole":
        """The role of the edge's mirror image about x = 0."""
        return MIRRORED.get(self, self)


MIRRORED = {
    EdgeRole.LEFT_COLLAR: EdgeRole.RIGHT_COLLAR,
    EdgeRole.RIGHT_COLLAR: EdgeRole.LEFT_COLLAR,
    EdgeRole.LEFT_ARMHOLE: EdgeRole.RIGHT_ARMHOLE,
    EdgeRole.RIGHT_ARMHOLE: EdgeRole.LEFT_ARMHOLE,
}

R = TypeVar("R", bound=StrEnum)


def role_of(kind: type[R], label: str) -> R | str:
    """The role with this label; the label itself if no role has it.

    >>> role_of(PanelRole, "arm"), role_of(PanelRole, "pocket")
    (<PanelRole.ARM: 'arm'>, 'pocket')
    """
    return next((role for role in kind if role == label), label)


@dataclass(frozen=True, slots=True)
class Edge:
    """One edge of a panel, from vertex ``start`` to vertex ``end``."""

    start: int
    end: int
    curve: Curve = LINE
    label: EdgeRole | str = ""
    """Role of the edge in the drape, empty for none; a label in a file that matches no role stays a string."""
    name: str = ""
    """Name of the edge in its garment's program; not part of a specification file."""


class LineRole(StrEnum):
    """Purpose of a line inside a panel; the value is its label in files."""

    FOLD = "fold"
    PLACEMENT = "placement"
    """Where another panel, or the line of another panel, is laid or sewn on: the centre front of a buttoned shirt."""
    STITCH = "stitch"


@dataclass(frozen=True, slots=True)
class InnerLine:
    """A line drawn inside a panel, from vertex ``start`` to vertex ``end``; each may be a corner of the outline."""

    start: int
    end: int
    curve: Curve = LINE
    role: LineRole | str = LineRole.STITCH
    """A label in a file that matches no role stays a string."""
    angle: float = 0.0
    """Rest angle of a fold, the turn of the cloth from one side to the other [degrees]: 0 flat, 180 pressed together.

    Positive for a mountain fold: the line is a ridge on the right side; negative for a valley fold."""
    name: str = ""
    """Name of the line in its garment's program; not part of a specification file."""


@dataclass(frozen=True, eq=False)
class Placement(Record):
    """Rigid placement of a panel in space before sewing: ``(x, y) -> R (x, y, 0) + translation``."""

    translation: Float[np.ndarray, "3"]
    """[cm]"""
    rotation: Float[np.ndarray, "3"]
    """Angles about the fixed x, y, z axes, applied in that order [rad]: ``R = Rz Ry Rx``."""

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """The rotation as a matrix."""
        x, y, z = self.rotation.tolist()
        cx, cy, cz, sx, sy, sz = cos(x), cos(y), cos(z), sin(x), sin(y), sin(z)
        return np.array(
            [
                [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
                [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
                [-sy, cy * sx, cy * cx],
            ]
        )

    def apply(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 3"]:
        """Points of the panel's plane in space [cm]."""
        return np.asarray(points) @ self.matrix[:, :2].T + self.translation


@dataclass(frozen=True, eq=False)
class Panel(Record):
    """A piece of cloth: a closed loop of edges in the plane, and its placement before sewing.

    The loop runs counter-clockwise as seen on the right (outer) side of the cloth.
    """

    name: str
    vertices: Float[np.ndarray, "v 2"]
    """Corner points in the panel's plane [cm]."""
    edges: tuple[Edge, ...]
    placement: Placement
    label: PanelRole | str = ""
    """Part of the body that the panel covers, empty if unknown; a label that matches no role stays a string."""
    lines: tuple[InnerLine, ...] = ()
    """Lines inside the outline. They meet each other and the outline only in common vertices."""

    def edge(self, index: int) -> Edge | InnerLine:
        """Edge ``index``; after the edges come the lines, see ``EdgeRef``."""
        return self.edges[index] if index < len(self.edges) else self.lines[index - len(self.edges)]

    def edge_ends(self, index: int) -> tuple[Point, Point]:
        """Start and end point of edge ``index``, or of a line [cm]."""
        edge = self.edge(index)
        (x0, y0), (x1, y1) = self.vertices[edge.start].tolist(), self.vertices[edge.end].tolist()
        return (x0, y0), (x1, y1)

    def edge_lengths(self) -> list[float]:
        """Lengths of all edges [cm]. Raises ``PatternError`` for an arc that does not span its chord."""
        corners: list[Point] = [(x, y) for x, y in self.vertices.tolist()]
        return [curve_length(corners[edge.start], corners[edge.end], edge.curve) for edge in self.edges]

    def lengths(self) -> list[float]:
        """Lengths of all edges, then of all lines [cm]. Raises ``PatternError`` as ``edge_lengths``."""
        lines = range(len(self.edges), len(self.edges) + len(self.lines))
        return self.edge_lengths() + [curve_length(*self.edge_ends(i), self.edge(i).curve) for i in lines]


@dataclass(frozen=True, slots=True)
class EdgeRef:
    """An edge of a pattern: panel name and index of the edge in the panel's loop.

    An index of ``len(panel.edges)`` or more is that of a line: ``Panel.edge`` takes both.
    """

    panel: str
    edge: int


class Closure(StrEnum):
    """How the two edges of a seam are joined; the value is its word in files."""

    SEWN = "sewn"
    OPEN = "open"
    """Not joined: the edges of a cardigan's fronts."""
    ZIP = "zip"
    BUTTONS = "buttons"
    """The panel of ``left`` lies over that of ``right``. Joined along two lines they overlap between line and edge."""


@dataclass(frozen=True, slots=True)
class Seam:
    """Two edges sewn together.

    By default the right sides meet, so the start of ``left`` meets the end of ``right``; with ``right_wrong`` the
    starts meet, and one of the panels is sewn in wrong side out. Unequal lengths are gathered. An edge has the
    direction of its panel's loop, a line its own. Only this rule decides which ends meet; the placement of the panels
    does not (``check_pattern`` warns if the ends would be nearer when joined the other way).
    """

    left: EdgeRef
    right: EdgeRef
    right_wrong: bool = False
    closure: Closure | str = Closure.SEWN
    """A word in a file that matches no closure stays a string."""
    closed: tuple[float, float] = (0.0, 1.0)
    """The part that is joined, from and to, as shares of the length from the start of ``left``; see ``joined``."""

    @property
    def joined(self) -> tuple[float, float]:
        """``closed``, and (0, 0) for an open seam."""
        return (0.0, 0.0) if self.closure == Closure.OPEN else self.closed

    @property
    def is_plain(self) -> bool:
        """Whether the edges are sewn together from end to end."""
        return self.closure == Closure.SEWN and self.closed == (0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Pattern(Record):
    """Panels and the seams between them; the order of the panels numbers the vertices of the mesh."""

    name: str
    panels: tuple[Panel, ...]
    seams: tuple[Seam, ...]
    extra: Mapping[str, Any] = field(default_factory=dict)
    """Other content of the specification file (``parameters``, ``properties``, …), passed through."""

    def gather_ratios(self) -> tuple[float, ...]:
        """Gathers or ease of each seam: length of its left edge over that of its right edge, to four decimals.

        1: a plain seam; above 1 the left edge is gathered or eased onto the right one, below 1 the right onto the left.
        A seam of a missing edge, or of one without length, counts as plain: ``check_pattern`` reports it.
        """
        lengths = {panel.name: panel.lengths() for panel in self.panels}

        def length(ref: EdgeRef) -> float:
            edges = lengths.get(ref.panel, ())
            return float(edges[ref.edge]) if 0 <= ref.edge < len(edges) else 0.0

        pairs = ((length(seam.left), length(seam.right)) for seam in self.seams)
        return tuple(round(left / right, 4) if left and right else 1.0 for left, right in pairs)

    def layers(self, seam: Seam) -> bool:
        """Whether a seam joins layers of a stack: two edges of a panel that meet at the end of a fold, as in a pleat.

        An edge may be in such seams and in one other: a waistband is sewn to the uppermost layer of a stack.
        """
        if seam.left.panel != seam.right.panel:
            return False
        panel = next((panel for panel in self.panels if panel.name == seam.left.panel), None)
        if panel is None or not max(seam.left.edge, seam.right.edge) < len(panel.edges):
            return False
        folds = {vertex for line in panel.lines if line.angle for vertex in (line.start, line.end)}
        ends = [{panel.edges[ref.edge].start, panel.edges[ref.edge].end} for ref in (seam.left, seam.right)]
        return bool(ends[0] & ends[1] & folds)

    def without_lines(self) -> Self:
        """The pattern without lines and their seams, for forms that hold edges alone."""
        edges = {panel.name: len(panel.edges) for panel in self.panels if panel.lines}
        if not edges:
            return self
        panels = tuple(replace(panel, lines=()) for panel in self.panels)
        sides = ((seam, (seam.left, seam.right)) for seam in self.seams)
        kept = tuple(seam for seam, both in sides if all(ref.edge < edges.get(ref.panel, inf) for ref in both))
        return replace(self, panels=panels, seams=kept)

    def _repr_html_(self) -> str:
        from gcd_dataset.viewer.notebook import pattern_html

        return pattern_html(self)

    def panel(self, name: str) -> Panel:
        """The panel of that name. Raises ``PatternError`` with the known names."""
        for panel in self.panels:
            if panel.name == name:
                return panel
        raise PatternError(f"no panel named {name}: there are {', '.join(p.name for p in self.panels)}")


POSITION_STEP = 2.0**-9
"""Draped positions are multiples of this [cm], so that what is judged is what shards store."""
FPS = 30.0
"""Frames of a motion a second, where none are given."""
MOTION_STEP = 2.0**-4
"""Positions of a garment in motion are multiples of this [cm] after its first frame."""
UV_STEP = 2.0**-10
"""Shards store positions in panels as multiples of this [cm]."""


def as_stored(positions: Float[np.ndarray, "*n"], step: float) -> Float[np.ndarray, "*n"]:
    """Positions as files store them: rounded to multiples of ``POSITION_STEP``, ``MOTION_STEP`` or ``UV_STEP``."""
    return np.rint(np.asarray(positions, float) / step) * step


@dataclass(frozen=True, eq=False)
class BoxMesh(Record):
    """A pattern as a triangle mesh: flat panels placed round the body, seams welded; the start of the drape.

    Vertices of seams come first, in the order of the seams, then the rest panel by panel. Faces begin with their least
    corner and are sorted by corners, so panel by panel; published meshes keep their order. The rest shape is flat:
    ``uv[corners]`` holds every face's corners in the plane of its panel.
    """

    vertices: Float[np.ndarray, "v 3"]
    """Start positions [cm]; a seam vertex is the midpoint of the points it joins."""
    faces: Int[np.ndarray, "f 3"]
    """Triangles, counter-clockwise on the garment's outside, oriented consistently across every seam.

    The outside is the cloth's right side, except for panels that a ``right_wrong`` seam turns over, as a lapel: their
    faces run against the panel's loop (``generator.mesh.turned_panels``). Published meshes are unchanged: all their
    faces are counter-clockwise on the right side, so the orientation flips across such seams.
    """
    uv: Float[np.ndarray, "c 2"]
    """Panel-plane coordinates [cm] of the seam-split vertices."""
    corners: Int[np.ndarray, "f 3"]
    """Rows of ``uv`` at each face's corners."""
    uv_vertex: Int[np.ndarray, " c"]
    """Vertex of each row of ``uv``."""
    panel_id: Int[np.ndarray, " f"]
    """Row of ``panel_names`` for each face."""
    panel_names: tuple[str, ...]
    panel_labels: tuple[PanelRole | str, ...]
    """``Panel.label`` of each panel, in the order of ``panel_names``."""
    seams: Int[np.ndarray, "s 2"]
    """Pairs (vertex, row of the pattern's seams); one row for each seam that runs through a vertex."""
    labels: Mapping[EdgeRole | str, Int[np.ndarray, " n"]] = field(default_factory=dict)
    """Edge label to the ids of the vertices on such edges."""
    folds: Float[np.ndarray, "k 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    """Mesh edges along folds with a rest angle, and along layers sewn to each other: two rows of ``uv``, and the rest
    angle [degrees]; shards leave them to ``meshedges.fold_edges``."""

    @property
    def n_seam_vertices(self) -> int:
        """Vertices 0 … n-1 lie on seams."""
        return int(self.seams[:, 0].max()) + 1 if len(self.seams) else 0

    @property
    def panel_of_row(self) -> Int[np.ndarray, " c"]:
        """The panel of each row of ``uv``; 0 for rows without a face."""
        panel = np.zeros(len(self.uv), int)
        panel[self.corners] = self.panel_id[:, None]
        return panel


NO_MESH = BoxMesh(
    vertices=np.zeros((0, 3)),
    faces=np.zeros((0, 3), int),
    uv=np.zeros((0, 2)),
    corners=np.zeros((0, 3), int),
    uv_vertex=np.zeros(0, int),
    panel_id=np.zeros(0, int),
    panel_names=(),
    panel_labels=(),
    seams=np.zeros((0, 2), int),
)
"""The mesh without vertices, of a sample that ends with stage ``pattern`` and of a picture of the body alone."""


class Outcome(Enum):
    """Result of a drape; the value is a message with a remedy."""

    SETTLED = "hangs still, within the limits for crossings"
    NOT_SETTLED = "still moving at the last frame: allow more frames, or look for a garment that slides"
    THROUGH_BODY = "too many edges of cloth and body cross: a looser fit, or a body with arms and legs further apart"
    THROUGH_ITSELF = "too many edges cross other cloth: panels start tangled; place them further apart"
    OVERSTRETCHED = "cloth is stretched out of shape: it is caught on the body, or cut too small for it"
    SLID_OFF = "slid off the body: narrow the waist or the neckline, or label the edge that should be held"
    FELL = "fell below the floor, or reaches below it: check its seams and its length, or label the edge to be held"
    OVERFULL = "more contacts than there was room for: raise the contact capacity"
    REFUSED = "not draped: its file cannot be read, or its pattern or mesh cannot be draped"
    DIVERGED = "positions stopped being numbers: the mesh holds a degenerate triangle, or the time step is too long"
    CANNOT_BE_PUT_ON = "not draped: a ring is too narrow for what it passes or closes round: choose a larger size"


MISFITS = frozenset({Outcome.SLID_OFF, Outcome.OVERSTRETCHED, Outcome.CANNOT_BE_PUT_ON})
"""Outcomes that describe the fit of a garment with a ``Fit``: no failed drapes, no reasons to draw another design."""


class Grade(Enum):
    """Quality of a draped garment; the value is the word in files."""

    CLEAN = "clean"
    """At rest, without a crossing."""
    PAPER = "paper"
    """Within the limits of GarmentCodeData's own quality control."""
    FAILED = "failed"


@dataclass(frozen=True)
class Strain:
    """Principal stretches of the cloth; 1 is unstretched."""

    principal: tuple[float, float]
    """Largest and smallest of the whole garment, without outliers."""
    panels: tuple[tuple[float, float], ...]
    """Largest and smallest of each panel."""


@dataclass(frozen=True, eq=False)
class Drape(Record):
    """A garment after the simulation on a body: at rest if ``outcome`` is ``SETTLED``."""

    vertices: Float[np.ndarray, "v 3"]
    """Positions [cm], in the order of the box mesh."""
    outcome: Outcome
    frames: int
    """Frames simulated until the cloth came to rest, or the limit; frames of the coarse mesh included."""
    self_crossings: int
    """Number of cloth edges that cross a cloth triangle."""
    body_crossings: int
    """Number of cloth edges that cross the body, or a garment of the outfit under this one."""
    stretch_median: float
    """Median of length / flat length over the mesh edges; 1 is unstretched."""
    stretch_p99: float
    """99th percentile of length / flat length."""
    strain: Strain | None = None
    """Principal stretches; ``None`` if not measured."""
    body_through: int = 0
    """Number of edges of these that cross the cloth; -1 where not counted: older versions, published data."""
    reason: str = field(default="", compare=False)
    """Where a garment lies that slid off or fell, with heights [cm], or why it was refused; not stored in data sets."""


@dataclass(frozen=True, eq=False)
class GarmentMotion(Record):
    """A garment on a body that moves, at equal intervals of time."""

    vertices: Float32[np.ndarray, "t v 3"]
    """Positions [cm], as files store them; in the first frame the garment is at rest."""
    faces: Int[np.ndarray, "f 3"]
    poses: tuple[Pose, ...]
    """Of the body, in each frame."""
    fps: float
    """Frames a second."""
    crossings: Int[np.ndarray, "t 3"]
    """``self_crossings``, ``body_crossings`` and ``body_through`` of the drape in each frame, before rounding."""
    asked: int = 0
    """Frames of the whole motion of the body; this and ``ended`` are not in ``.motion.z``."""
    ended: Outcome = Outcome.SETTLED
    """``SETTLED``, or the outcome of the next frame, which ended the motion."""

    @property
    def is_clean(self) -> Bool[np.ndarray, " t"]:
        """Whether a frame has no crossings."""
        return np.asarray((self.crossings == 0).all(axis=1))


GIRTHS = (
    "neck", "bust", "underbust", "waist", "hips", "thigh", "knee", "calf", "upper_arm", "elbow", "wrist",
)  # fmt: skip
LENGTHS = ("back", "sleeve", "outseam", "inseam")
EASE = (*GIRTHS, *LENGTHS)
"""The girths and lengths of ``Sample.ease``."""


@dataclass(frozen=True)
class Ease:
    """A girth or length of a garment and of its wearer [cm]; NaN: no cloth goes round, or a measure is missing."""

    cloth: float = nan
    """As cut: along the panels, at the place where the pattern has it."""
    body: float = nan
    worn: float = nan
    """As worn: along the panels round the body, without the rise and fall of folds. NaN for lengths."""

    @property
    def ease(self) -> float:
        """Cloth as cut beyond the body; below 0 the cloth must stretch."""
        return self.cloth - self.body


@dataclass(frozen=True, eq=False)
class Maps(Record):
    """Figures of a drape by vertex; NaN for one that diverged or was not made.

    Shards store them as float16, larger ones than 65,504 as 65,504.
    """

    stretch: Float[np.ndarray, "v 2"]
    """Largest and smallest principal stretch, mean over the faces of the vertex by area; 1 is unstretched."""
    gap: Float[np.ndarray, " v"]
    """Signed distance to the nearest point of the skin [cm], negative inside."""
    pressure: Float[np.ndarray, " v"]
    """Pressure on the skin of the fabric's own tension and weight [kPa]; 0 off the skin."""
    softened: float
    """Stiffness of the fabric over that in the drape, see ``Fabric.softened``: where cloth hangs by its weight instead
    of being held by the body, the pressure is too high by up to this factor. 1: not at all."""

    @classmethod
    def unknown(cls, count: int) -> Self:
        """All NaN, for a drape that diverged or was not made, of ``count`` vertices."""
        nothing = np.full(count, np.nan)
        return cls(np.stack([nothing, nothing], axis=1), nothing, nothing, 1.0)

    @property
    def is_known(self) -> bool:
        """Whether the drape was made and did not diverge."""
        return bool(np.isfinite(self.gap).all())

    @property
    def by_vertex(self) -> dict[str, Float[np.ndarray, "v *channels"]]:
        """The arrays by name."""
        return {"stretch": self.stretch, "gap": self.gap, "pressure": self.pressure}


@dataclass(frozen=True)
class Rejected:
    """A rejected attempt at a design."""

    index: int
    """Index of the sample it was tried for."""
    rule: str
    """The rule it broke; ``drape`` for a failed drape."""
    reason: str
    """The fault, in words."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """Measured quantities behind the rule, as far as known; each name ends in its unit: ``cuff_cm``."""

    def __str__(self) -> str:
        return f"{self.rule}: {self.reason}"


@dataclass(frozen=True, eq=False)
class Provenance(Record):
    """Origin of a sample: seed, index, versions and options, enough to generate it again."""

    seed: int
    index: int
    attempts: int = 1
    """Designs tried for this sample, the accepted one included."""
    rejects: tuple[str, ...] = ()
    """Rules and reasons of the rejected attempts at this index, in order."""
    redraws: Mapping[str, int] = field(default_factory=dict)
    """Rule to the number of redraws that it caused: of a parameter, a part, or the numbers of the whole design."""
    versions: Mapping[str, str] = field(default_factory=dict)
    recipe: Mapping[str, Any] = field(default_factory=dict)
    """The options it was made with."""
    body_name: str = ""
    source: str = ""
    """Path of a published garment in its release; empty for generated ones."""
    turned_down: tuple[Rejected, ...] = field(default=(), compare=False)
    """``rejects`` with their figures, for a sample just made; a data set stores them in ``rejects.jsonl``."""


@dataclass(frozen=True)
class NamedFabric:
    """The fabric of a garment."""

    name: str
    """The name of a built-in fabric, or ``random`` for one drawn for the sample."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Mechanical parameters, in SI units except for the thickness [cm]."""


@dataclass(frozen=True)
class FitLabel:
    """A rule that a garment breaks on its wearer."""

    rule: str
    """Such as ``too_tight``."""
    reason: str
    """The fault, in words."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """Measured quantities of garment and wearer; each name ends in its unit: ``ring_cm``, ``body_cm``."""


@dataclass(frozen=True)
class Fit:
    """The size for which a garment is cut, beside its wearer's."""

    chart: str
    """Name of the size chart."""
    cut_for: str
    wearer_size: str
    """Empty for a wearer outside the chart."""
    step: int
    """``cut_for`` less ``wearer_size``, in sizes; 0 for a wearer outside the chart."""
    labels: tuple[FitLabel, ...] = ()

    @property
    def obstacle(self) -> FitLabel | None:
        """The label ``cannot_be_put_on``; ``None`` for a garment that can be put on."""
        return next((label for label in self.labels if label.rule == CANNOT_BE_PUT_ON), None)


CANNOT_BE_PUT_ON = Outcome.CANNOT_BE_PUT_ON.name.lower()
"""The rule of the labels with this outcome."""


@dataclass(frozen=True)
class StoredView:
    """A picture of a garment, with its camera, light and materials."""

    picture: bytes
    """JPEG."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """Camera, light and materials."""


@dataclass(frozen=True, eq=False)
class WornGarment(Record):
    """A garment of an outfit, with all stages of its making; a stage that did not run is ``None``."""

    pattern: Pattern
    design: Mapping[str, Any] = field(default_factory=dict)
    box_mesh: BoxMesh | None = None
    drape: Drape | None = None
    fabric: NamedFabric | None = None
    tucked: bool = False
    """Whether it lies under the next garment below that garment's top edge."""
    closed: bool = True
    """Whether its closures are shut: a jacket may be worn open."""


@dataclass(frozen=True)
class Layer:
    """How two garments of an outfit lie: ``outer`` over ``inner``."""

    inner: int
    """Number of the garment in the outfit, from the skin outwards."""
    outer: int
    crossings: int
    """Number of edges of either garment that cross a triangle of the other."""
    covered: int
    """Number of vertices of the inner garment with the outer one before or behind them, along the skin's normal."""
    wrong_order: float
    """Share of the covered vertices that have the outer garment between them and the skin; 0 where none is covered."""


@dataclass(frozen=True, eq=False)
class Outfit(Record):
    """Garments worn over each other on one body."""

    garments: tuple[WornGarment, ...]
    """From the skin outwards; two or more."""
    layers: tuple[Layer, ...] = ()
    """Each pair of draped garments, by ``outer``, then ``inner``."""


@dataclass(frozen=True, eq=False)
class Sample(Record):
    """A made-to-measure garment with all stages of its making; a stage that did not run (``--stage``) is ``None``."""

    key: str
    """``gcd_000000012``: the name in a shard."""
    provenance: Provenance
    pattern: Pattern
    measurements: Measurements
    design: Mapping[str, Any]
    shape: BodyShape | None = None
    box_mesh: BoxMesh | None = None
    drape: Drape | None = None
    maps: Maps | None = None
    """``None`` unless the recipe asks for them."""
    motion: GarmentMotion | None = None
    """Of the body whose pose is that of ``shape`` in the first frame; ``None`` for one that stays."""
    points: Float[np.ndarray, "n 6"] | None = None
    """Surface points and normals [cm, 1]."""
    front: bytes | None = None
    """JPEG of the front."""
    back: bytes | None = None
    """JPEG of the back."""
    grade: Grade | None = None
    """``None`` for a garment without a grade."""
    fabric: NamedFabric | None = None
    gathers: tuple[float, ...] = ()
    """Gathers or ease of each seam, in the order of ``pattern.seams``: see ``Pattern.gather_ratios``; empty if unknown.

    The design decides them: ``levels-skirt.level_ruffle`` is the ratio of each seam between two levels.
    """
    ease: Mapping[str, Ease] = field(default_factory=dict)
    """Girths and lengths of cloth and wearer, by the names in ``EASE``; empty unless the recipe asks for them."""
    tags: tuple[str, ...] = ()
    """The tailor's names for the style, words of ``gcd_dataset.generator.garments.TAGS``; empty if unknown."""
    caption: str | None = None
    """The garment in English, see ``gcd_dataset.captions``; either all samples of a data set have one, or none."""
    views: tuple[StoredView, ...] = ()
    """Further pictures; the same number for every sample of a data set."""
    fit: Fit | None = None
    """``None`` for a garment cut for its wearer."""
    outfit: Outfit | None = None
    """``None`` for a single garment. The first garment of an outfit is that of the sample: it shares its values."""

    def _repr_html_(self) -> str:
        from gcd_dataset.viewer.notebook import sample_html

        return sample_html(self)
