"""The garments of an outfit as one garment, for pictures, pages and files."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import accumulate

import numpy as np

from gcd_dataset.records import BoxMesh, Drape, EdgeRef, Outcome, Pattern, Sample

__all__ = ["apart", "joined", "joined_drape", "joined_mesh", "joined_pattern", "worn_panel"]


def apart(sample: Sample) -> list[Sample]:
    """The sample with each garment of its outfit alone, from the skin outwards."""
    if sample.outfit is None:
        return [sample]
    stages = ("pattern", "design", "box_mesh", "drape", "fabric")
    return [
        replace(sample, outfit=None, **{name: getattr(garment, name) for name in stages})
        for garment in sample.outfit.garments
    ]


def joined(sample: Sample) -> Sample:
    """The sample with its outfit as one garment of all panels, which are named by ``worn_panel``.

    The drape has the first outcome other than ``SETTLED``, and the crossings of all garments.
    Maps, which only the first garment has, are left out. A sample without an outfit stays as it is.
    """
    if sample.outfit is None:
        return sample
    garments = sample.outfit.garments
    meshes = [garment.box_mesh for garment in garments if garment.box_mesh is not None]
    drapes = [garment.drape for garment in garments if garment.drape is not None]
    return replace(
        sample,
        pattern=joined_pattern([garment.pattern for garment in garments]),
        box_mesh=joined_mesh(meshes, [len(g.pattern.seams) for g in garments])
        if len(meshes) == len(garments)
        else None,
        drape=joined_drape(drapes) if len(drapes) == len(garments) else None,
        maps=None,
        outfit=None,
    )


def worn_panel(number: int, name: str) -> str:
    """The name of a panel of garment ``number`` among those of the whole outfit.

    >>> worn_panel(0, "front"), worn_panel(1, "front")
    ('front', 'g1_front')
    """
    return f"g{number}_{name}" if number else name


def joined_pattern(patterns: Sequence[Pattern]) -> Pattern:
    """The patterns of garments as one pattern."""
    panels = [
        replace(panel, name=worn_panel(number, panel.name))
        for number, pattern in enumerate(patterns)
        for panel in pattern.panels
    ]
    seams = [
        replace(seam, left=_ref(number, seam.left), right=_ref(number, seam.right))
        for number, pattern in enumerate(patterns)
        for seam in pattern.seams
    ]
    return Pattern(patterns[0].name, tuple(panels), tuple(seams))


def _ref(number: int, ref: EdgeRef) -> EdgeRef:
    return replace(ref, panel=worn_panel(number, ref.panel))


def joined_mesh(meshes: Sequence[BoxMesh], seam_counts: Sequence[int]) -> BoxMesh:
    """The meshes of garments, with these numbers of seams, one after the other; vertices of seams are not the first."""
    vertices = _starts(len(mesh.vertices) for mesh in meshes)
    rows, panels = _starts(len(mesh.uv) for mesh in meshes), _starts(len(mesh.panel_names) for mesh in meshes)
    seams = _starts(seam_counts)
    labels: dict[str, np.ndarray] = {}
    for mesh, start in zip(meshes, vertices, strict=True):
        for label, ids in mesh.labels.items():
            labels[label] = np.concatenate([labels.get(label, np.zeros(0, int)), ids + start])
    numbered = list(enumerate(meshes))
    return BoxMesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        faces=np.concatenate([mesh.faces + vertices[k] for k, mesh in numbered]),
        uv=np.concatenate([mesh.uv for mesh in meshes]),
        corners=np.concatenate([mesh.corners + rows[k] for k, mesh in numbered]),
        uv_vertex=np.concatenate([mesh.uv_vertex + vertices[k] for k, mesh in numbered]),
        panel_id=np.concatenate([mesh.panel_id + panels[k] for k, mesh in numbered]),
        panel_names=tuple(worn_panel(k, name) for k, mesh in numbered for name in mesh.panel_names),
        panel_labels=tuple(label for mesh in meshes for label in mesh.panel_labels),
        seams=np.concatenate([mesh.seams + [vertices[k], seams[k]] for k, mesh in numbered]),
        labels=labels,
    )


def _starts(counts: Iterable[int]) -> list[int]:
    return list(accumulate(counts, initial=0))[:-1]


def joined_drape(drapes: Sequence[Drape]) -> Drape:
    """The drapes of garments as one drape."""
    return replace(
        drapes[0],
        vertices=np.concatenate([drape.vertices for drape in drapes]),
        outcome=next((drape.outcome for drape in drapes if drape.outcome is not Outcome.SETTLED), Outcome.SETTLED),
        self_crossings=sum(drape.self_crossings for drape in drapes),
        body_crossings=sum(drape.body_crossings for drape in drapes),
        body_through=sum(counts) if min(counts := [drape.body_through for drape in drapes]) >= 0 else -1,
        strain=None,
    )
