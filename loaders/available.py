"""Which fields garments hold: those of the steps that were taken to make them.

>>> sorted(lacking_at("mesh"))
['back', 'front', 'verts']
>>> fields_held(["points"], ("meta", "points"), lacking_at("pattern"))
Traceback (most recent call last):
...
gcd_dataset.errors.ConfigError: no field points: these garments end with stage pattern, and points come with stage mesh: choose among meta
"""  # noqa: E501 -- a message is one line

from collections.abc import Callable, Iterable, Mapping

from gcd_dataset.errors import ConfigError
from gcd_dataset.shards.layout import select_fields

__all__ = ["fields_held", "lacking_at", "lacking_where"]

MESH = ("faces", "uv", "panel_id", "corners", "uv_vertex", "box", "labels", "seams")
OFTEN_EMPTY = ("labels", "seams")  # of a garment without labelled edges, or without seams
ADDED: Mapping[str, tuple[str, ...]] = {"mesh": (*MESH, "points"), "drape": ("verts", "front", "back")}
"""Stage to the fields that it adds to those of the stages before."""
STAGES = ("pattern", *ADDED)
OPTIONAL: Mapping[str, str] = {
    "points": "have no surface points",
    "front": "have no pictures",
    "back": "have no pictures",
    "body": "do not tell the weights of their bodies' shapes",
}
"""Fields that garments of a stage may do without, and why they do."""


def fields_held(fields: Iterable[str] | None, there: Iterable[str], lacking: Mapping[str, str]) -> tuple[str, ...]:
    """The fields asked for, in the order of those that are ``there``; for ``None`` all but the ``lacking``.

    ``lacking``: field to the reason why no garment holds it. Raises ``ConfigError`` with the reason and the fields
    there are.
    """
    asked = select_fields(fields, there)
    held = [field for field in select_fields(None, there) if field not in lacking]
    if fields is None:
        return tuple(held)
    if missing := [field for field in asked if field in lacking]:
        raise ConfigError(
            f"no field {', '.join(missing)}: these garments {lacking[missing[0]]}: choose among {', '.join(held)}"
        )
    return asked


def lacking_at(stage: str, empty: Iterable[str] = ()) -> dict[str, str]:
    """Field to the reason why no garment of a stage holds it; ``empty``: fields that could be there and are not."""
    later = STAGES[STAGES.index(stage) + 1 :]
    reasons = {
        field: f"end with stage {stage}, and {field} come{'' if field.endswith('s') else 's'} with stage {other}"
        for other in later
        for field in ADDED[other]
    }
    return {field: OPTIONAL[field] for field in empty if field in OPTIONAL} | reasons


def lacking_where(is_empty: Callable[[str], bool], there: Iterable[str]) -> dict[str, str]:
    """The same for garments of which it is known which fields are empty in all of them.

    ``there``: the fields that are stored; whether others are empty is not asked.
    """
    known = set(there)
    mesh = [field for field in MESH if field in known and field not in OFTEN_EMPTY]
    empty = [field for field in OPTIONAL if field in known and is_empty(field)]
    if mesh and all(map(is_empty, mesh)):
        stage = "pattern"
    elif "verts" in known and is_empty("verts"):
        stage = "mesh"
    else:
        stage = "drape"
    return lacking_at(stage, empty)
