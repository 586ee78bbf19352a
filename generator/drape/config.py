"""What a drape can be told: garment, wearer, fabric, and the solver's options. The solver's units are cm, g, s."""

from dataclasses import dataclass

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape.fabric import STIFFEST, Fabric
from gcd_dataset.generator.mesh import CoarseMesh
from gcd_dataset.records import Body, BoxMesh, Measurements

__all__ = ["DrapeConfig", "DrapeJob"]

GRAVITY = 981.0  # cm/s²
USUAL_FABRIC = Fabric()


@dataclass(frozen=True, slots=True)
class DrapeConfig:
    """Options of the solver. Times are simulated seconds; every limit is a count of frames, never a clock's time."""

    substeps: int = 40
    """Time steps in a frame; their length follows from the mesh and the fabric."""
    search_every: int = 8
    """Time steps after which it is asked whether contacts must be searched anew."""
    max_frames: int = 300
    """Frames after which a garment that still moves is left as it is; half as many of its coarse mesh, where frames are
    twice as long."""
    holds: bool = True
    """Hold waist and collar in half-spaces while the garment falls into place."""
    gravity_free_start: bool = True
    """Sew without weight."""
    self_contact: bool = True
    """Keep layers apart: points and triangles, edges and edges."""
    exempt_crossings: bool = True
    """Look for cloth that has crossed, and do not keep it apart: contacts would lock it in."""
    remember_sides: bool = True
    """Cloth that has passed through cloth is pushed back to the side on which it was before."""
    untangle: bool = True
    """Move crossing cloth so that the curve along which it crosses gets shorter."""
    pull_to_parts: bool = True
    """Draw crossing cloth of different parts of the body toward its own part."""
    pull_from_body: bool = True
    """Draw cloth that is inside the body to the skin."""
    part_filters: bool = True
    """Let skirts and trousers pass through the arms, and what they hang on through the forearms."""
    exact_finish: bool = True
    """In the end move cloth off the skin itself, where the distance field is too coarse."""
    coarse_start: bool = True
    """Drape a mesh of twice the spacing first, and go on from its shape: faster, and with fewer crossings."""
    curved_start: bool = False
    """Panels are bent round trunk and arms before they are sewn; else they start flat, where the pattern hangs them."""
    sewing_time: float = 0.2
    """Panels are drawn together over this time, without gravity [s]."""
    held_time: float = 0.25
    """After sewing, waist and collar stay held for this time at least [s]."""
    longest_hold: float = 1.2
    """They are let go after this time, even if the garment has not fallen into place [s]."""
    falling_share: float = 0.1
    """A garment has fallen into place when no more than this share of its vertices is faster than ``calm_speed``."""
    damping: float = 6.0
    """Drag on the cloth [1/s]: near critical for a skirt that swings."""
    sewing_damping: float = 12.0
    """The same while sewing [1/s]."""
    braking: float = 30.0
    """The same where forces slow a vertex down: swinging and ringing end soon, falling is not delayed [1/s]."""
    max_speed: float = 200.0
    """[cm/s]"""
    body_gap: float = 0.35
    """Distance kept from the skin [cm]."""
    layer_gap: float = 0.2
    """Layers are kept this far apart, or by the cloth's thickness where that is more [cm]."""
    stiffest: float = STIFFEST
    """Tensile stiffness over weight up to which a fabric is taken at its word: see ``Fabric.softened`` [N·m/kg]. With
    more, cloth gives less and time steps are shorter, by the square root."""
    contact_margin: float = 0.45
    """Pairs nearer than this are watched until the next search [cm]."""
    contact_capacity: int = 12
    """Room for contact pairs, for each vertex on average."""
    still_speed: float = 4.0
    """A vertex slower than this rests [cm/s]."""
    calm_speed: float = 18.0
    """The threshold rises linearly over the second half of the frames, up to this: 0.03 cm in 1/600 s, the limit of
    Korosteleva et al. [cm/s]."""
    moving_share: float = 0.015
    """A garment rests when no more than this share of its vertices moves."""
    max_body_crossings: int = 35
    """Edges of the cloth that cross the skin, of arms that the cloth may pass through too. This limit and the next are
    those of Korosteleva et al. (ECCV 2024), who count edges of the cloth alone. Edges of the skin that cross the cloth
    are counted beside them, in ``Drape.body_through``, and not limited."""
    max_self_crossings: int = 300
    max_stretch: float = 1.6
    """Length over flat length of the hundredth edge that is stretched most."""

    def __post_init__(self) -> None:
        # Two buffers change places in every step, and a frame is made of whole rounds of steps.
        if self.search_every < 2 or self.search_every % 2 or self.substeps % self.search_every or self.substeps < 1:
            raise ConfigError(
                f"{self.substeps} substeps with a search every {self.search_every}: the second must be even, and go "
                "into the first"
            )


@dataclass(frozen=True, slots=True)
class DrapeJob:
    """One garment to be draped on one body."""

    box_mesh: BoxMesh
    body: Body
    measurements: Measurements
    fabric: Fabric = USUAL_FABRIC
    coarse: CoarseMesh | None = None
    """The box mesh made coarser, by ``coarse_start``; made where it is left out, in which time a GPU drapes two."""
