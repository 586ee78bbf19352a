"""The bodies that published garments were draped on: ``neutral_body/mean_all.obj``, or a person in one pose.

The meshes of random bodies come in an archive of their own, ``5000_body_shapes_and_measures.tar.gz``, to be extracted
beside the batches.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np

from gcd_dataset.bodies import POSES
from gcd_dataset.errors import BodyError
from gcd_dataset.records import Body, BodyPart
from gcd_dataset.release.body_folder import FOLDER
from gcd_dataset.release.obj import read_obj
from gcd_dataset.release.published_names import DEFAULT_BODY

METRE = 100.0  # cm
NEUTRAL = "neutral_body"
KEPT = 4  # bodies: 1.4 MB each


@lru_cache(KEPT)
def published_body(root: Path, name: str) -> Body:
    """The body ``name``, such as ``mean_all`` or ``00345_apart``, of a release; ``root``: the folder of its batches.

    Soles at y = 0. All vertices count as trunk: the release has no part labels. Raises ``BodyError`` where the mesh is
    not on disk, or is damaged.
    """
    person, _, pose = name.rpartition("_")
    is_person = person.isdecimal() and pose in POSES
    if not is_person and name != DEFAULT_BODY:
        raise BodyError(f"{name!r:.80}: no body of the release: bodies are {DEFAULT_BODY}, 00345_straight, 00345_apart")
    folders = (FOLDER, "") if is_person else (NEUTRAL, "")
    paths = [root / folder / ("meshes" if is_person else "") / f"{name}.obj" for folder in folders]
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        source = f"extract {FOLDER}.tar.gz there" if is_person else f"download the folder {NEUTRAL} too"
        raise BodyError(f"{paths[0]}: missing, so the body is left out: {source}")
    text = read_obj(path)
    positions = text.positions() * METRE
    parts = np.full(len(positions), BodyPart.TRUNK.value, np.uint8)
    return Body(positions - [0.0, positions[:, 1].min(), 0.0], text.triangles(), parts, name)
