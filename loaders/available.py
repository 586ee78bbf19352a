"""The fields that garments hold, by the stage that they were made up to.

>>> sorted(absent_at_stage("mesh"))
['back', 'front', 'verts']
>>> select_present_fields(["points"], ("meta", "points"), absent_at_stage("pattern"))
Traceback (most recent call last):
...
gcd_dataset.errors.ConfigError: no field points: these garments end with stage pattern, and points come with stage mesh: choose among meta
"""  # noqa: E501 -- a message is one line

from collections.abc import Callable, Iterable, Mapping

from gcd_dataset.errors import ConfigError
from gcd_dataset.shards.layout import JOINT, select_fields

MESH = ("faces", "uv", "panel_id", "corners", "uv_vertex", "box", "labels", "seams")
OFTEN_EMPTY = ("labels", "seams")  # empty for a garment without labelled edges or without seams
ADDED: Mapping[str, tuple[str, ...]] = {"mesh": (*MESH, "points"), "drape": ("verts", "front", "back")}
"""Stage to the fields that it adds to those of the earlier stages."""
STAGES = ("pattern", *ADDED)
OPTIONAL: Mapping[str, str] = {
    "points": "have no surface points",
    "front": "have no pictures",
    "back": "have no pictures",
    "body": "have no shape weights of their bodies",
}
"""Optional fields, and the words for their absence in an error message."""


def select_present_fields(
    fields: Iterable[str] | None, available: Iterable[str], absent: Mapping[str, str]
) -> tuple[str, ...]:
    """The requested fields, in the order of ``available``; for ``None`` every field that is not ``absent``.

    ``views`` and its cameras may be requested where the fields of single views are available.

    ``absent``: field to the reason why no garment holds it. Raises ``ConfigError`` with that reason and the fields to
    choose from.
    """
    available = tuple(available)
    requested = available if fields is None else select_fields(fields, (*available, *_joint(available)))
    present = [field for field in select_fields(None, available) if field not in absent]
    if fields is None:
        return tuple(present)
    if missing := [field for field in requested if field in absent]:
        raise ConfigError(
            f"no field {', '.join(missing)}: these garments {absent[missing[0]]}: choose among {', '.join(present)}"
        )
    return requested


def _joint(available: Iterable[str]) -> list[str]:
    """The fields that join the available fields of single views."""
    known = set(available)
    first = {"jpg": "view_0", "json": "view_0_json"}
    return [field for field, ending in JOINT.items() if first[ending] in known and field not in known]


def absent_at_stage(stage: str, empty: Iterable[str] = ()) -> dict[str, str]:
    """Field to the reason for its absence, for garments of a stage; ``empty``: fields that are empty in all of them."""
    later = STAGES[STAGES.index(stage) + 1 :]
    reasons = {
        field: f"end with stage {stage}, and {field} come{'' if field.endswith('s') else 's'} with stage {other}"
        for other in later
        for field in ADDED[other]
    }
    return {field: OPTIONAL[field] for field in empty if field in OPTIONAL} | reasons


def absent_when_empty(is_empty: Callable[[str], bool], available: Iterable[str]) -> dict[str, str]:
    """Field to the reason for its absence, judged by the stored fields that are empty in all garments.

    ``available``: the stored fields; ``is_empty`` is called for these alone.
    """
    stored = set(available)
    mesh = [field for field in MESH if field in stored and field not in OFTEN_EMPTY]
    empty = [field for field in OPTIONAL if field in stored and is_empty(field)]
    if mesh and all(map(is_empty, mesh)):
        stage = "pattern"
    elif "verts" in stored and is_empty("verts"):
        stage = "mesh"
    else:
        stage = "drape"
    return absent_at_stage(stage, empty)
