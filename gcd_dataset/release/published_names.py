"""Names in the published layout of GarmentCodeData.

GarmentCodeData_v2_official_train_valid_test_data_split.json
garments_5000_0/default_body/dataset_properties_default_body.yaml
garments_5000_0/default_body/data.tar.gz                             as downloaded, or
garments_5000_0/default_body/data/rand_K3V9QX7T1B/                   extracted; version 1 without ``data``
    rand_K3V9QX7T1B_specification.json                               … and the other files of ``ENDINGS``
garments_5000_0/random_body/…                                        the same designs on other bodies
5000_body_shapes_and_measures/                                       the random bodies, see ``PublishedPeople``
"""

import re
from collections.abc import Mapping

from gcd_dataset.errors import ConfigError, did_you_mean
from gcd_dataset.filekinds import BODY_FOLDERS

REMEDY = "extract or download it again"

ENDINGS: Mapping[str, str] = {
    "spec": "_specification.json",
    "svg": "_pattern.svg",
    "drawing": "_pattern.png",
    "design": "_design_params.yaml",
    "measures": "_body_measurements.yaml",
    "box": "_boxmesh.ply",
    "sim": "_sim.ply",
    "segmentation": "_sim_segmentation.txt",
    "vertex_labels": "_vertex_labels.yaml",
    "rest_lengths": "_orig_lens.pickle",
    "texture": "_texture.png",
    "front": "_render_front.png",
    "back": "_render_back.png",
}
"""Kind of file to the ending of its name, which begins with the name of the garment."""

DEFAULT_BODY = "mean_all"
"""Name of the body in ``default_body``; the published files do not hold it."""

SPLIT_FILE = "*train_valid_test_data_split*.json"
SPLIT_NAMES: Mapping[str, tuple[str, ...]] = {
    "train": ("training", "train"),
    "validation": ("validation", "valid"),
    "test": ("test",),
}
"""Split to its names in split files: the official file, and redistributed copies."""


def properties_name(body_folder: str) -> str:
    """The name of the properties file of a batch: its failures and simulation counts on one kind of body."""
    return f"dataset_properties_{body_folder}.yaml"


def body_folders(bodies: str) -> tuple[str, ...]:
    """The folders to read for a choice of ``bodies``. Raises ``ConfigError``."""
    if bodies == "both":
        return tuple(BODY_FOLDERS.values())
    if bodies not in BODY_FOLDERS:
        nearest = did_you_mean(bodies, [*BODY_FOLDERS, "both"])
        raise ConfigError(f"bodies={bodies!r}: choose from {', '.join(BODY_FOLDERS)}, and both{nearest}")
    return (BODY_FOLDERS[bodies],)


def batch_order(name: str) -> tuple[object, ...]:
    """Sort key that puts ``garments_5000_10`` behind ``garments_5000_9``.

    >>> sorted(["b_10", "b_9", "a_11"], key=batch_order)
    ['a_11', 'b_9', 'b_10']
    """
    return tuple((int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name))
