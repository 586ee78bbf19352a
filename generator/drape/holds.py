"""What holds a garment while it falls into place, and which parts of the body do not stop it.

Held edges are half-spaces, as in Korosteleva et al. (ECCV 2024): the waist of a bottom may not sink below the body's
waist, a strapless top not below the armpits, and the two halves of a neckline stay near the neck. Unlike theirs, the
waist of what hangs from the shoulders is left alone: held at the body's waist, a longer bodice is folded there and
crosses itself.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gcd_dataset.generator.drape.body_field import AXES, FOREARM
from gcd_dataset.generator.drape.config import DrapeJob
from gcd_dataset.records import BodyPart, BoxMesh, EdgeRole, Measurements, PanelRole
from gcd_dataset.spec import is_trouser_leg

__all__ = ["Wear", "fell", "floor_height", "held_from_below", "holds", "off_body", "own_parts", "unseen_parts"]

NECKLINE = frozenset({EdgeRole.LEFT_COLLAR, EdgeRole.RIGHT_COLLAR})
SLIDING_DROP = 18.0  # cm below its level at which a held edge counts as slid off: about armpits to waist
UNDER_HIPS = 4.0  # cm below the hips at which they hold nothing any more
KNEES = 0.4  # of the waist's height: what hung from the hips up and ends here is off the body
HIPS = 0.75  # of the same
TOP = 0.9  # quantile of the heights above which cloth without a labelled edge is taken to hold the rest
COLLAR_SLACK = 2.0  # cm by which the collar may lie nearer to the middle than the neck is wide


@dataclass(frozen=True)
class Wear:
    """What is to be known of how a garment is worn, worked out once."""

    hold_normal: Float[np.ndarray, "v 3"]
    hold_offset: Float[np.ndarray, " v"]
    unseen: Int[np.ndarray, " v"]
    own_part: Int[np.ndarray, " v"]
    keepers: Int[np.ndarray, " n"]
    lowest: float
    floor_height: float

    @classmethod
    def of(cls, job: DrapeJob) -> Self:
        return cls(
            *holds(job), unseen_parts(job.box_mesh), own_parts(job.box_mesh), *held_from_below(job), floor_height(job)
        )


def holds(job: DrapeJob) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, " v"]]:
    """Normal and offset [cm] of each vertex's half-space ``x · normal >= offset``; a zero normal for none."""
    normal = np.zeros((len(job.box_mesh.vertices), 3))
    offset = np.zeros(len(job.box_mesh.vertices))
    for label, (direction, level) in _half_spaces(job.measurements).items():
        ids = job.box_mesh.labels.get(label)
        if label is EdgeRole.LOWER_INTERFACE and _hangs_from_shoulders(job):
            continue
        if ids is not None and np.isfinite(level):
            normal[ids] = direction
            offset[ids] = level
    return normal, offset


def _half_spaces(size: Measurements) -> dict[EdgeRole, tuple[tuple[float, float, float], float]]:
    collar = -(size.neck_w - COLLAR_SLACK) / 2
    return {
        EdgeRole.RIGHT_COLLAR: ((1.0, 0.0, 0.0), collar),
        EdgeRole.LEFT_COLLAR: ((-1.0, 0.0, 0.0), collar),
        EdgeRole.STRAPLESS_TOP: ((0.0, 1.0, 0.0), size.height - size.head_l - size.armscye_depth),
        EdgeRole.LOWER_INTERFACE: ((0.0, 1.0, 0.0), size.waist_level),
    }


def held_from_below(job: DrapeJob) -> tuple[Int[np.ndarray, " n"], float]:
    """The vertices that keep the garment up, by label, and the level below which it has slid off [cm].

    What is held at the waist may slide to the hips, which hold it too; a strapless top has slid off at the waist. None
    for a garment with a neckline: shoulders keep it up, and its waist may hang where it likes.
    """
    size, labels = job.measurements, job.box_mesh.labels
    drops = {
        EdgeRole.STRAPLESS_TOP: SLIDING_DROP,
        EdgeRole.LOWER_INTERFACE: max(SLIDING_DROP, size.hips_line + UNDER_HIPS),
    }
    for label, drop in drops.items():
        lowest = _half_spaces(size)[label][1] - drop
        if label in labels and np.isfinite(lowest) and not _hangs_from_shoulders(job):
            return np.asarray(labels[label]), lowest
    return np.zeros(0, int), 0.0


def off_body(job: DrapeJob, vertices: Float[np.ndarray, "v 3"]) -> bool:
    """Whether a garment that is not held from below has come off the body without falling past it.

    A neckline has where it lies below the waist; a garment without labels that hung from the hips or higher, where its
    top lies below the knees.
    """
    mesh, waist = job.box_mesh, job.measurements.waist_level
    if len(held_from_below(job)[0]) or not np.isfinite(waist):
        return False
    if _hangs_from_shoulders(job):
        neckline = np.concatenate([mesh.labels[label] for label in sorted(NECKLINE & mesh.labels.keys())])
        return bool(vertices[neckline, 1].mean() < waist)
    start = mesh.vertices[:, 1]
    top = start >= np.quantile(start, TOP)
    return bool(start.max() > HIPS * waist and vertices[top, 1].mean() < KNEES * waist)


def floor_height(job: DrapeJob) -> float:
    """The height that the body stands on [cm]."""
    return min(0.0, float(job.body.vertices[:, 1].min()))


def fell(job: DrapeJob, vertices: Float[np.ndarray, "v 3"]) -> bool:
    """Whether the garment, or a piece that nothing is sewn to, lies below the floor with all of its vertices."""
    low = vertices[:, 1] <= np.float32(floor_height(job))
    if not low.any():
        return False
    sides = job.box_mesh.faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    graph = coo_array((np.ones(len(sides), bool), sides.T), shape=(len(vertices), len(vertices)))
    _, piece = connected_components(graph, directed=False)
    return bool((np.bincount(piece, ~low) == 0).any())


def _hangs_from_shoulders(job: DrapeJob) -> bool:
    return bool(NECKLINE & job.box_mesh.labels.keys())


def unseen_parts(mesh: BoxMesh) -> Int[np.ndarray, " v"]:
    """Bit set of body parts each vertex passes through: arms for what covers legs, forearms for what that hangs on.

    An A-pose hangs the arms where a skirt is drawn together, and a wide skirt would draw waistband and bodice over the
    hands. A bodice with sleeves meets the whole arm. A seam vertex passes through what all of its panels pass through.
    """
    labels = np.array(mesh.panel_labels)
    on_leg, on_arm = labels == PanelRole.LEG, labels == PanelRole.ARM
    forearms = 1 << FOREARM
    arms = forearms | sum(1 << part.value for part in (BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM, BodyPart.HANDS))
    panel_of_row = _panel_of_row(mesh)
    touched = np.zeros(len(mesh.vertices), bool)
    touched[mesh.uv_vertex[on_arm[panel_of_row]]] = True
    sewn_to_arm = np.bincount(panel_of_row, touched[mesh.uv_vertex], minlength=len(labels)) > 0
    above_legs = ~on_leg & ~on_arm & on_leg.any() & ~sewn_to_arm
    unseen = np.full(len(mesh.vertices), arms)
    np.bitwise_and.at(unseen, mesh.uv_vertex, np.where(on_leg, arms, np.where(above_legs, forearms, 0))[panel_of_row])
    return unseen


def own_parts(mesh: BoxMesh) -> Int[np.ndarray, " v"]:
    """The axis of ``BodyField.axes`` that each vertex's cloth goes round; -1 where no label tells.

    Sleeves and trousers by the side that their panel stands on. A seam vertex belongs to the last of its panels.
    """
    axes = list(AXES)
    panel_of_row = _panel_of_row(mesh)
    aside = np.bincount(panel_of_row, mesh.vertices[mesh.uv_vertex, 0], minlength=len(mesh.panel_names))
    axis = np.full(len(mesh.panel_names), -1)
    for panel, (name, label) in enumerate(zip(mesh.panel_names, mesh.panel_labels, strict=True)):
        side = "right" if aside[panel] < 0 else "left"
        if label == PanelRole.BODY:
            axis[panel] = axes.index("trunk")
        elif label == PanelRole.ARM:
            axis[panel] = axes.index(f"{side} arm")
        elif label == PanelRole.LEG:
            axis[panel] = axes.index(f"{side} leg" if is_trouser_leg(name) else "legs")
    own = np.full(len(mesh.vertices), -1)
    own[mesh.uv_vertex] = axis[panel_of_row]
    return own


def _panel_of_row(mesh: BoxMesh) -> Int[np.ndarray, " c"]:
    """The panel of each row of ``uv``."""
    panel = np.zeros(len(mesh.uv), int)
    panel[mesh.corners] = mesh.panel_id[:, None]
    return panel
