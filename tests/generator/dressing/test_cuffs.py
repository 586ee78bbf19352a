"""Gathered and flared cuffs start round the arm or the leg."""

import numpy as np
import pytest
import trimesh

from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Body, BoxMesh

DEPTH = 0.3  # cm under the skin: rounding decides on which side of the skin a cuff lies that touches it


def faces_through_limbs(mesh: BoxMesh, vertices: np.ndarray, body: Body) -> dict[str, int]:
    """The number of edges of the body, ``DEPTH`` under its skin, that pass through each panel."""
    cloth = trimesh.Trimesh(vertices, mesh.faces, process=False)
    skin = trimesh.Trimesh(body.vertices, body.faces, process=False)
    under, edges = body.vertices - DEPTH * skin.vertex_normals, skin.edges_unique
    start = under[edges[:, 0]]
    along = under[edges[:, 1]] - start
    length = np.linalg.norm(along, axis=1)
    hits, ray, face = cloth.ray.intersects_location(start, along / length[:, None], multiple_hits=False)
    pierced = mesh.panel_id[face[np.linalg.norm(hits - start[ray], axis=1) < length[ray]]]
    return {name: int((pierced == number).sum()) for number, name in enumerate(mesh.panel_names)}


@pytest.mark.parametrize(
    ("index", "cuff"),
    [
        (320, "sl_left_cuff_"),  # a wide sleeve gathered into a narrow cuff
        (742, "sl_left_cuff_"),
        (254, "pant_l_cuff_"),  # flared cuffs that reach past the other leg
        (255, "pant_l_cuff_"),
    ],
)
def test_cuffs_start_round_their_limbs(index: int, cuff: str) -> None:
    design = prepare(90125, index // 2, MakeConfig(bodies="both", resolution=2.0, device="cpu"))
    wearer = design.dressed[index % 2]
    assert wearer.start is not None
    assert wearer.coarse is not None
    through = faces_through_limbs(wearer.coarse.mesh, wearer.start, wearer.body)
    assert any(name.startswith(cuff) for name in through)
    assert not {name: count for name, count in through.items() if name.startswith(cuff) and count}


def test_trousers_with_a_narrow_cuff_end_before_the_foot() -> None:
    """The flare below the cuff is loose, but the cuff would not slip off the foot."""
    design = prepare(31415, 126, MakeConfig(bodies="both", resolution=2.0, device="cpu"))
    wearer = design.dressed[1]
    assert wearer.start is not None
    assert wearer.coarse is not None
    mesh = wearer.coarse.mesh
    flare = [number for number, name in enumerate(mesh.panel_names) if name.startswith("pant_l_cuff_skirt")]
    cloth = np.unique(mesh.faces[np.isin(mesh.panel_id, flare)])
    assert wearer.start[cloth, 1].min() > 0.0
