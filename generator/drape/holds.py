"""Constraints between a garment and its body: holds, keepers and collision filters; and whether a garment came off.

Holds are half-spaces, as in Korosteleva et al. (ECCV 2024): the waist of a bottom may not sink below the body's waist,
a strapless top not far below the armpits, and both halves of a neckline stay near the neck. In contrast to their drape,
a garment that hangs from the shoulders has no hold at the waist: there a long bodice would fold and cross itself.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from gcd_dataset.generator.drape.body_field import ARMS, AXES, FOREARM
from gcd_dataset.generator.drape.config import DrapeJob
from gcd_dataset.records import BoxMesh, EdgeRole, Measurements, PanelRole
from gcd_dataset.spec import is_trouser_leg

NECKLINE = frozenset({EdgeRole.LEFT_COLLAR, EdgeRole.RIGHT_COLLAR})
SLIDING_DROP = 18.0  # cm below its hold at which an edge has slid off: about armpits to waist
UNDER_HIPS = 4.0  # cm below the hips: the hips do not support a waistband that has slid further
KNEES = 0.4  # share of the waist's height: a garment that started at hip height and ends here is off the body
HIPS = 0.75  # share of the waist's height
ASIDE = 5.0  # cm to either side of the middle: cloth that lies further out on both goes round both legs
BURIED = 0.2  # share of the cloth below the floor
TOP = 0.9  # quantile of the heights: cloth above it carries a garment without a labelled edge
COLLAR_SLACK = 2.0  # cm by which the collar may be narrower than the neck
UNDER_ARMPIT = 2.5  # cm to which a strapless top may sink: at the armpit no cloth fits between arm and trunk


@dataclass(frozen=True)
class BodyConstraints:
    """Constraints between a garment and its body; needs no device, so any thread may compute it."""

    hold_normal: Float[np.ndarray, "v 3"]
    """Normals of the hold half-spaces, see ``holds``."""
    hold_offset: Float[np.ndarray, " v"]
    """Offsets of the half-spaces [cm]."""
    ignored_parts: Int[np.ndarray, " v"]
    """Bit set of the body parts that each vertex passes through, see ``ignored_parts``."""
    own_part: Int[np.ndarray, " v"]
    """Index of the body part that each vertex covers, see ``own_parts``."""
    keepers: Int[np.ndarray, " n"]
    """Vertices that keep the garment up, see ``find_keepers``."""
    lowest: float
    """Mean height of the keepers below which the garment has slid off [cm]."""
    floor_height: float
    """Height that the body stands on [cm]."""
    held: int
    """Number of vertices with a hold."""

    @classmethod
    def of(cls, job: DrapeJob) -> Self:
        mesh, panel_of_row = job.box_mesh, job.box_mesh.panel_of_row
        normal, offset = holds(job)
        return cls(
            normal.astype(np.float32),
            offset.astype(np.float32),
            ignored_parts(mesh, panel_of_row).astype(np.int32),
            own_parts(mesh, panel_of_row).astype(np.int32),
            *find_keepers(job),
            floor_height(job),
            int(np.count_nonzero(normal.any(axis=1))),
        )


def holds(job: DrapeJob) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, " v"]]:
    """Normal and offset [cm] of each vertex's hold ``x · normal >= offset``; the normal is zero where there is none."""
    normal = np.zeros((len(job.box_mesh.vertices), 3))
    offset = np.zeros(len(job.box_mesh.vertices))
    for label, (direction, level) in _half_spaces(job.measurements).items():
        ids = job.box_mesh.labels.get(label)
        if label is EdgeRole.LOWER_INTERFACE and hangs_from_shoulders(job):
            continue
        if ids is not None and np.isfinite(level):
            normal[ids] = direction
            offset[ids] = level
    return normal, offset


def _half_spaces(size: Measurements) -> dict[EdgeRole, tuple[tuple[float, float, float], float]]:
    collar = -(size.neck_w - COLLAR_SLACK) / 2
    armpit = size.height - size.head_l - size.armscye_depth
    return {
        EdgeRole.RIGHT_COLLAR: ((1.0, 0.0, 0.0), collar),
        EdgeRole.LEFT_COLLAR: ((-1.0, 0.0, 0.0), collar),
        EdgeRole.STRAPLESS_TOP: ((0.0, 1.0, 0.0), armpit - UNDER_ARMPIT),
        EdgeRole.LOWER_INTERFACE: ((0.0, 1.0, 0.0), size.waist_level),
    }


def find_keepers(job: DrapeJob) -> tuple[Int[np.ndarray, " n"], float]:
    """Keepers: the vertices of the edge that keeps the garment up, and the level below which it has slid off [cm].

    A waistband may slide to the hips, which support it too; a strapless top has slid off at the waist. A garment with a
    neckline has no keepers: it hangs from the shoulders, and its waist may hang at any height.
    """
    size, labels = job.measurements, job.box_mesh.labels
    drops = {
        EdgeRole.STRAPLESS_TOP: SLIDING_DROP,
        EdgeRole.LOWER_INTERFACE: max(SLIDING_DROP, size.hips_line + UNDER_HIPS),
    }
    for label, drop in drops.items():
        lowest = _half_spaces(size)[label][1] - drop
        if label in labels and np.isfinite(lowest) and not hangs_from_shoulders(job):
            return np.asarray(labels[label]), lowest
    return np.zeros(0, int), 0.0


def off_body(job: DrapeJob, vertices: Float[np.ndarray, "v 3"]) -> str:
    """How a garment, or a piece that is not sewn to the rest, has come off the body without falling below the floor.

    A sentence if its neckline lies below the waist, or if the top of a piece without a neckline and without keepers
    lies below the knees, and the piece started at hip height or above, or lies round both legs. A sock, which does
    neither, is not judged; neither is a body whose waist is unknown. Keepers: see ``find_keepers``.
    """
    mesh, waist = job.box_mesh, job.measurements.waist_level
    if not np.isfinite(waist):
        return ""
    supported = find_keepers(job)[0]
    if hangs_from_shoulders(job):
        supported = np.concatenate([mesh.labels[label] for label in sorted(NECKLINE & mesh.labels.keys())])
        armpit = job.measurements.height - job.measurements.head_l - job.measurements.armscye_depth
        neckline = vertices[supported, 1]
        if neckline.mean() < waist:
            return f"its neckline lies at {neckline.mean():.0f} cm, below the waist at {waist:.0f} cm"
        if neckline.max() < armpit:
            return f"its neckline lies at {neckline.max():.0f} cm, below the armpits at {armpit:.0f} cm"
    start, (x, now, _) = mesh.vertices[:, 1], vertices.T
    if not (now < KNEES * waist).any():
        return ""
    piece, middle = _pieces(mesh), float(job.body.vertices[:, 0].mean())
    for number in np.setdiff1d(piece, piece[supported]):
        own = piece == number
        top = now[own & (start >= np.quantile(start[own], TOP))].mean()
        round_both = x[own].min() < middle - ASIDE and x[own].max() > middle + ASIDE
        if top < KNEES * waist and (round_both or start[own].max() > HIPS * waist):
            return f"its top lies at {top:.0f} cm, below the knees at {KNEES * waist:.0f} cm"
    return ""


def floor_height(job: DrapeJob) -> float:
    """Height that the body stands on [cm]."""
    return min(0.0, float(job.body.vertices[:, 1].min()))


def fell(job: DrapeJob, vertices: Float[np.ndarray, "v 3"]) -> str:
    """A sentence if all vertices of the garment or of a connected component lie below the floor, or many.

    Many count if no part of the garment is as high as the hips: a train may have a third of its cloth below the floor.
    """
    low, top = vertices[:, 1] <= np.float32(floor_height(job)), float(vertices[:, 1].max())
    buried = low.mean() > BURIED and top < HIPS * job.measurements.waist_level
    if buried or (low.any() and (np.bincount(_pieces(job.box_mesh), ~low) == 0).any()):
        lowest = float(vertices[:, 1].min())
        return f"{low.mean():.0%} of the cloth lies below the floor; it hangs from {top:.0f} to {lowest:.0f} cm"
    return ""


def _pieces(mesh: BoxMesh) -> Int[np.ndarray, " v"]:
    """The connected component of each vertex: panels that share a vertex, which lies on a seam, belong together."""
    columns, panel = mesh.faces.T, np.zeros(len(mesh.vertices), int)
    for column in columns:
        panel[column] = mesh.panel_id
    sewn = np.flatnonzero(np.logical_or.reduce([column < mesh.n_seam_vertices for column in columns]))
    shared = np.zeros((len(mesh.panel_names),) * 2, bool)
    for column in columns:
        shared[panel[column[sewn]], mesh.panel_id[sewn]] = True
    _, piece = connected_components(shared, directed=False)
    return np.asarray(piece)[panel]


def hangs_from_shoulders(job: DrapeJob) -> bool:
    """Whether a garment has a neckline."""
    return bool(NECKLINE & job.box_mesh.labels.keys())


def ignored_parts(mesh: BoxMesh, panel_of_row: Int[np.ndarray, " c"]) -> Int[np.ndarray, " v"]:
    """Collision filter: bit set of the body parts that each vertex passes through.

    Skirts and trousers ignore the arms, sleeveless bodices above them the forearms: in an A-pose the arms hang where a
    skirt is sewn together, and a wide skirt would pull waistband and bodice over the hands. A seam vertex ignores the
    parts that all of its panels ignore.
    """
    labels = np.array(mesh.panel_labels)
    on_leg, on_arm = labels == PanelRole.LEG, labels == PanelRole.ARM
    touched = np.zeros(len(mesh.vertices), bool)
    touched[mesh.uv_vertex[on_arm[panel_of_row]]] = True
    sewn_to_arm = np.bincount(panel_of_row, touched[mesh.uv_vertex], minlength=len(labels)) > 0
    above_legs = ~on_leg & ~on_arm & on_leg.any() & ~sewn_to_arm
    ignored = np.full(len(mesh.vertices), ARMS)
    forearms = np.where(above_legs, 1 << FOREARM, 0)
    np.bitwise_and.at(ignored, mesh.uv_vertex, np.where(on_leg, ARMS, forearms)[panel_of_row])
    return ignored


def own_parts(mesh: BoxMesh, panel_of_row: Int[np.ndarray, " c"]) -> Int[np.ndarray, " v"]:
    """Index into ``BodyField.axes`` of the body part that each vertex covers; -1 for panels without a label.

    Sleeves and trouser legs take the side on which their panel is placed. A seam vertex takes the last of its panels.
    """
    axes = list(AXES)
    side_sum = np.bincount(panel_of_row, mesh.vertices[mesh.uv_vertex, 0], minlength=len(mesh.panel_names))
    axis = np.full(len(mesh.panel_names), -1)
    for panel, (name, label) in enumerate(zip(mesh.panel_names, mesh.panel_labels, strict=True)):
        side = "right" if side_sum[panel] < 0 else "left"
        if label == PanelRole.BODY:
            axis[panel] = axes.index("trunk")
        elif label == PanelRole.ARM:
            axis[panel] = axes.index(f"{side} arm")
        elif label == PanelRole.LEG:
            axis[panel] = axes.index(f"{side} leg" if is_trouser_leg(name) else "legs")
    own = np.full(len(mesh.vertices), -1)
    own[mesh.uv_vertex] = axis[panel_of_row]
    return own
