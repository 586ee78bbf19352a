"""What holds a garment while it falls into place, and which parts of the body do not stop it.

Held edges are half-spaces, as in Korosteleva et al. (ECCV 2024): the waist of a bottom may not sink below the body's
waist, a strapless top not below the armpits, and the two halves of a neckline stay near the neck. Unlike theirs, the
waist of what hangs from the shoulders is left alone: held at the body's waist, a longer bodice is folded there and
crosses itself.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from gcd_dataset.generator.drape.body_field import AXES, FOREARM
from gcd_dataset.generator.drape.config import DrapeJob
from gcd_dataset.records import BodyPart, BoxMesh, Measurements

__all__ = ["held_from_below", "holds", "own_parts", "unseen_parts"]

NECKLINE = frozenset({"left_collar", "right_collar"})
SLIDING_DROP = 18.0  # cm below its level at which a held edge counts as slid off: about armpits to waist
UNDER_HIPS = 4.0  # cm below the hips at which they hold nothing any more
COLLAR_SLACK = 2.0  # cm by which the collar may lie nearer to the middle than the neck is wide


def holds(job: DrapeJob) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, " v"]]:
    """Normal and offset [cm] of each vertex's half-space ``x · normal >= offset``; a zero normal for none."""
    normal = np.zeros((len(job.box_mesh.vertices), 3))
    offset = np.zeros(len(job.box_mesh.vertices))
    for label, (direction, level) in _half_spaces(job.measurements).items():
        ids = job.box_mesh.labels.get(label)
        if label == "lower_interface" and _hangs_from_shoulders(job):
            continue
        if ids is not None and np.isfinite(level):
            normal[ids] = direction
            offset[ids] = level
    return normal, offset


def _half_spaces(size: Measurements) -> dict[str, tuple[tuple[float, float, float], float]]:
    collar = -(size.neck_w - COLLAR_SLACK) / 2
    return {
        "right_collar": ((1.0, 0.0, 0.0), collar),
        "left_collar": ((-1.0, 0.0, 0.0), collar),
        "strapless_top": ((0.0, 1.0, 0.0), size.height - size.head_l - size.armscye_depth),
        "lower_interface": ((0.0, 1.0, 0.0), size.waist_level),
    }


def held_from_below(job: DrapeJob) -> tuple[Int[np.ndarray, " n"], float]:
    """The vertices that keep the garment up, by label, and the level below which it has slid off [cm].

    What is held at the waist may slide to the hips, which hold it too; a strapless top has slid off at the waist. None
    for a garment with a neckline: shoulders keep it up, and its waist may hang where it likes.
    """
    size, labels = job.measurements, job.box_mesh.labels
    drops = {"strapless_top": SLIDING_DROP, "lower_interface": max(SLIDING_DROP, size.hips_line + UNDER_HIPS)}
    for label, drop in drops.items():
        lowest = _half_spaces(size)[label][1] - drop
        if label in labels and np.isfinite(lowest) and not _hangs_from_shoulders(job):
            return np.asarray(labels[label]), lowest
    return np.zeros(0, int), 0.0


def _hangs_from_shoulders(job: DrapeJob) -> bool:
    return bool(NECKLINE & job.box_mesh.labels.keys())


def unseen_parts(mesh: BoxMesh) -> Int[np.ndarray, " v"]:
    """Bit set of body parts each vertex passes through: arms for what covers legs, forearms for what that hangs on.

    An A-pose hangs the arms where a skirt is drawn together, and a wide skirt would draw waistband and bodice over the
    hands. A bodice with sleeves meets the whole arm. A seam vertex follows the panels that most of its faces belong to.
    """
    labels = np.array(mesh.panel_labels)
    on_leg = labels == "leg"
    forearms = 1 << FOREARM
    arms = forearms | sum(1 << part.value for part in (BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM, BodyPart.HANDS))
    above_legs = ~on_leg & (labels != "arm") & on_leg.any() & ~_sewn_to(mesh, labels == "arm")
    unseen = np.where(on_leg, arms, np.where(above_legs, forearms, 0))
    return np.where(_mostly(mesh, on_leg), arms, np.where(_mostly(mesh, unseen > 0), forearms, 0))


def own_parts(mesh: BoxMesh) -> Int[np.ndarray, " v"]:
    """The axis of ``BodyField.axes`` that each vertex's cloth goes round; -1 where no label tells.

    Sleeves and trousers by the side that their panel stands on. A seam vertex belongs to the last of its panels.
    """
    axes = list(AXES)
    middle = np.bincount(mesh.panel_id, mesh.vertices[mesh.faces, 0].mean(axis=1), minlength=len(mesh.panel_names))
    axis = np.full(len(mesh.panel_names), -1)
    for panel, (name, label) in enumerate(zip(mesh.panel_names, mesh.panel_labels, strict=True)):
        right = middle[panel] < 0
        if label == "body":
            axis[panel] = axes.index("trunk")
        elif label == "arm":
            axis[panel] = axes.index("right arm" if right else "left arm")
        elif label == "leg":
            one = "right leg" if right else "left leg"
            axis[panel] = axes.index(one if "pant" in name else "legs")
    own = np.full(len(mesh.vertices), -1)
    own[mesh.faces] = axis[mesh.panel_id][:, None]
    return own


def _sewn_to(mesh: BoxMesh, chosen: Bool[np.ndarray, " p"]) -> Bool[np.ndarray, " p"]:
    """Which panels share vertices with a chosen one."""
    touched = np.zeros(len(mesh.vertices), bool)
    touched[mesh.faces[chosen[mesh.panel_id]]] = True
    sewn = np.zeros(len(chosen), bool)
    sewn[mesh.panel_id[touched[mesh.faces].any(axis=1)]] = True
    return sewn


def _mostly(mesh: BoxMesh, chosen: Bool[np.ndarray, " p"]) -> Bool[np.ndarray, " v"]:
    """Which vertices have most of their faces in chosen panels."""
    own = np.repeat(chosen[mesh.panel_id].astype(float), 3)
    n = len(mesh.vertices)
    return np.bincount(mesh.faces.ravel(), own, minlength=n) > 0.5 * np.bincount(mesh.faces.ravel(), minlength=n)
