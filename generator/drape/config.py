"""Input of a drape: the job (garment, body, fabric) and the solver's options. The solver computes in cm, g and s."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import BodyError, ConfigError, DrapeError
from gcd_dataset.generator.body.pose import require_possible
from gcd_dataset.generator.drape.fabrics import STIFFEST, Fabric
from gcd_dataset.generator.dressing.worn import WornCloth
from gcd_dataset.generator.mesh import CoarseMesh
from gcd_dataset.records import Body, BoxMesh, Measurements, Pose

GRAVITY = 981.0  # cm/s²
USUAL_FABRIC = Fabric()


@dataclass(frozen=True, slots=True)
class DrapeConfig:
    """Options of the solver. Times are simulated seconds. Limits count frames: a slow machine gives the same result."""

    substeps: int = 40
    """Substeps of a frame; their length follows from the mesh and the fabric."""
    search_every: int = 8
    """Substeps between two checks whether a vertex has moved so far that contacts must be searched again."""
    max_frames: int = 300
    """Frames after which a garment that still moves ends as ``NOT_SETTLED``. The coarse mesh gets half as many, since
    its frames last twice as long."""
    holds: bool = True
    """Keep waist and collar in half-spaces while the garment falls into place."""
    gravity_free_start: bool = True
    """Switch gravity off during sewing."""
    self_contact: bool = True
    """Contacts of cloth with cloth: point-triangle and edge-edge."""
    exempt_crossings: bool = True
    """Create no contacts where cloth crosses cloth: contacts would lock the crossing in."""
    remember_sides: bool = True
    """Push cloth that has passed through cloth back to the side on which it was before."""
    untangle: bool = True
    """Move crossing cloth so that the intersection contour gets shorter."""
    pull_to_parts: bool = True
    """Where cloth of different body parts crosses, pull each toward the axis of its own part."""
    pull_from_body: bool = True
    """Move cloth that is inside the body out to the skin."""
    part_filters: bool = True
    """Collision filter: skirts and trousers pass through arms, sleeveless bodices above them through forearms."""
    untangling_steps: int = 60
    """Limit of the implicit steps that remove the self-crossings of a garment at rest; 0: no such steps."""
    exact_finish: bool = True
    """After the last frame, move cloth off the triangles of the skin: fingers and toes are finer than the voxels."""
    coarse_start: bool = True
    """Drape a mesh of twice the spacing first and continue from its shape: faster, with fewer crossings."""
    sewing_start: bool = True
    """Start wide skirts on a cone round the legs, wide bodices between the arms, and sleeves round the arms."""
    sewing_time: float = 0.2
    """The seams close over this time [s]."""
    most_drapes: int = 2
    """A garment that crosses itself or the body at rest is draped up to this many times, each time with twice the
    sewing time, and keeps the drape with the fewest crossings. 1: every garment is draped once."""
    held_time: float = 0.25
    """Shortest hold of waist and collar after sewing [s]."""
    longest_hold: float = 1.2
    """Longest hold after sewing, for a garment that does not fall into place [s]."""
    falling_share: float = 0.1
    """A garment has fallen into place once at most this share of its vertices is faster than ``calm_speed``."""
    damping: float = 3.4
    """Drag on the cloth [1/s]: close to critical damping for a swinging skirt, with the inertia that the drape adds."""
    sewing_damping: float = 12.0
    """Drag during sewing [1/s]."""
    braking: float = 17.0
    """Drag on a vertex that forces decelerate: ends swinging and ringing early, without delaying free fall [1/s]."""
    max_speed: float = 200.0
    """Speed limit of a vertex [cm/s]."""
    body_gap: float = 0.35
    """Distance of the cloth from the skin [cm]."""
    layer_gap: float = 0.2
    """Least distance of layers; a thicker fabric keeps its thickness [cm]."""
    stiffest: float = STIFFEST
    """Upper limit of tensile stiffness over density, see ``Fabric.softened`` [N·m/kg]. Substeps shorten with its square
    root."""
    contact_margin: float = 0.45
    """Pairs nearer than this are listed as contacts until the next search [cm]."""
    contact_capacity: int = 12
    """Capacity of each contact list, in pairs for each vertex. A garment that needs more is draped again with twice
    the capacity, up to 16 times; then it ends as ``OVERFULL``."""
    still_speed: float = 4.0
    """A vertex slower than this is at rest [cm/s]."""
    calm_speed: float = 18.0
    """Over the second half of the frames the speed limit of rest rises linearly from ``still_speed`` to this: 0.03 cm
    in 1/600 s, the limit of Korosteleva et al. [cm/s]."""
    moving_share: float = 0.06
    """A garment is at rest when at most this share of its vertices moves."""
    max_body_crossings: int = 35
    """Limit of cloth edges that cross the skin, including the skin of parts that the cloth may pass through. This limit
    and the next are from Korosteleva et al. (ECCV 2024), who count edges of the cloth alone. ``Drape.body_through``
    counts the edges of the skin that cross the cloth; they have no limit."""
    max_self_crossings: int = 300
    """Limit of cloth edges that cross the cloth."""
    max_stretch: float = 1.6
    """Limit of the 99th percentile of length over flat length of the edges."""

    def __post_init__(self) -> None:
        # Two buffers swap after each substep, and a frame replays one graph of ``search_every`` substeps.
        if self.search_every < 2 or self.search_every % 2 or self.substeps % self.search_every or self.substeps < 1:
            raise ConfigError(
                f"DrapeConfig: substeps={self.substeps}, search_every={self.search_every}: search_every must be even "
                "and divide substeps"
            )


@dataclass(frozen=True, slots=True)
class DrapeJob:
    """One garment to be draped on one body."""

    box_mesh: BoxMesh
    body: Body
    measurements: Measurements
    fabric: Fabric = USUAL_FABRIC
    coarse: CoarseMesh | None = None
    """The coarse mesh of ``coarse_start``. Without it the drape makes one, in the time of two drapes on a GPU."""
    start: Float[np.ndarray, "v 3"] | None = None
    """Start positions by ``dressing.sewing_start`` [cm], of ``coarse`` if given, otherwise of ``box_mesh``; None: the
    drape computes them."""
    tucked_below: float = -np.inf
    """Top edge of the garment into which this one is tucked [cm]; below it the cloth is taken in, and stays near the
    skin."""
    under: tuple[WornCloth, ...] = ()
    """The garments on the body under this one, from the skin outwards: this one drapes over them, and they stay as they
    are. Its crossings with them count as crossings with the body."""
    pose: Pose | None = None
    """The garment drapes on ``body``, which then moves to this pose, and comes to rest there; None: it stays."""

    def __post_init__(self) -> None:
        if self.pose is not None and self.under:
            raise ConfigError(
                "DrapeJob: a body that wears a garment under this one cannot move: leave pose or under out"
            )
        mesh = self.coarse.mesh if self.coarse else self.box_mesh
        if self.start is not None and len(self.start) != len(mesh.vertices):
            which = "the coarse mesh" if self.coarse else "the box mesh"
            raise ConfigError(
                f"DrapeJob: {len(self.start)} start positions for the {len(mesh.vertices)} vertices of {which}: give "
                "sewing_start of that mesh, or None"
            )

    def require_drapeable(self) -> None:
        """Raise ``DrapeError`` for a mesh or body without faces, or with indices beyond its vertices."""
        mesh, body = self.box_mesh, self.body
        if not all(np.isfinite(cloth.vertices).all() for cloth in self.under):
            raise DrapeError("a garment under it has a vertex that is not a number: drape that garment first")
        if self.pose is not None:
            try:
                require_possible(self.pose, body)
            except BodyError as error:
                raise DrapeError(str(error)) from error
        if not len(mesh.faces):
            raise DrapeError("a garment has no faces: build its box mesh from a pattern with panels")
        if not len(body.faces) or not np.isfinite(body.vertices).all():
            raise DrapeError(f"body {body.name} has no faces, or a vertex that is not a number: give a closed mesh")
        for name, numbers, count in (
            ("faces", mesh.faces, len(mesh.vertices)),
            ("corners", mesh.corners, len(mesh.uv)),
            ("uv_vertex", mesh.uv_vertex, len(mesh.vertices)),
            *((f"label {label}", ids, len(mesh.vertices)) for label, ids in mesh.labels.items()),
            ("faces of the body", body.faces, len(body.vertices)),
        ):
            if len(numbers) and not 0 <= numbers.min() <= numbers.max() < count:
                raise DrapeError(f"{name}: numbers {numbers.min()} to {numbers.max()}, but there are {count} rows")
