"""SewingLDM's array (Liu et al., 2025): 39 panels of 37 edges of 29 numbers.

``SlotColumn`` names the numbers. Nineteen are continuous: the step of an edge [cm], control points of a quadratic and
of a cubic curve in the edge frame, the radius of an arc [cm], the stitch tag [cm], and, repeated in all rows of a
panel, its quaternion (x, y, z, w) and the position of its top (``rows.top_of``) [cm]. Ten are discrete, given as scores
that are positive if the flag is likelier set than not.

Not held: labels other than the six of GarmentCode, labels of panels, the order of panels beyond their slots, arcs with
a radius over 950 cm, and more panels or edges than there is room for.
"""

from collections.abc import Mapping, Sequence
from enum import IntEnum

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Quadratic
from gcd_dataset.encodings.rows import (
    Scaling,
    edge_vectors,
    loop_corners,
    pair_edges,
    panel_from_vectors,
    quaternion,
    require_finite,
    require_room,
    seam_ends,
    seam_tags,
    seams_of,
    top_of,
)
from gcd_dataset.errors import PatternError
from gcd_dataset.records import EdgeRef, EdgeRole, Panel, Pattern

__all__ = [
    "CONTINUOUS",
    "PANEL_SLOTS",
    "SCALING",
    "SLOT_NAMES",
    "WIDTH",
    "SlotColumn",
    "decode",
    "encode",
    "panel_slots",
]

MAX_PANELS, MAX_EDGES = 39, 37
LARGEST_RADIUS = 950.0  # cm: larger radii are stored as this; pattern/core.py (there with up to 10 cm of noise)
LEAST_EDGES = 3  # a panel with fewer is padding

PANEL_SLOTS: Mapping[str, int] = {
    name: slot
    for slot, names in enumerate(
        (
            "right_sleeve_b", "right_sleeve_f", "right_ftorso", "right_btorso", "left_ftorso", "left_btorso",
            "left_sleeve_f", "left_sleeve_b", "left_collar_back", "left_collar_front", "right_collar_front",
            "right_collar_back", "sl_right_cuff_f", "sl_right_cuff_b", "sl_right_cuff_skirt_f",
            "sl_right_cuff_skirt_b", "sl_left_cuff_skirt_f", "sl_left_cuff_skirt_b", "sl_left_cuff_f",
            "sl_left_cuff_b", "left_hood", "right_hood", "wb_back", "wb_front", "pant_f_l skirt_front skirt_panel_0",
            "pant_b_l skirt_back skirt_panel_1", "pant_f_r skirt_front_0 ins_skirt_front_0 skirt_panel_2",
            "pant_b_r skirt_back_0 ins_skirt_back_0 skirt_panel_3",
            "pant_r_cuff_skirt_f skirt_front_1 ins_skirt_front_1 skirt_panel_4",
            "pant_r_cuff_skirt_b skirt_back_1 ins_skirt_back_1 skirt_panel_5",
            "pant_l_cuff_skirt_f ins_skirt_front_2 skirt_panel_6 skirt_front_2",
            "pant_l_cuff_skirt_b ins_skirt_back_2 skirt_panel_7 skirt_back_2",
            "pant_l_cuff_f ins_skirt_front_3 skirt_panel_8 skirt_front_3",
            "pant_l_cuff_b ins_skirt_back_3 skirt_panel_9 skirt_back_3",
            "pant_r_cuff_f ins_skirt_front_4 skirt_panel_10 skirt_front_4",
            "pant_r_cuff_b ins_skirt_back_4 skirt_panel_11 skirt_back_4", "skirt_panel_12 ins_skirt_front_5",
            "skirt_panel_13 ins_skirt_back_5", "skirt_panel_14",
        )
    )
    for name in names.split()
}  # fmt: skip
"""Slot of a GarmentCode panel by name (panel_order.json); a panel with another name takes the next free slot."""


SLOT_NAMES = tuple(
    f"bottom_panel_{slot - 24}" if 24 <= slot < 38 else next(name for name, at in PANEL_SLOTS.items() if at == slot)
    for slot in range(MAX_PANELS)
)
"""Name of each slot in predictions (panel_order.json)."""


class SlotColumn(IntEnum):
    """Columns of the array; a name with several numbers is its first column."""

    STEP = 0
    """(dx, dy) [cm]."""
    QUADRATIC = 2
    """Control point of a quadratic curve."""
    CUBIC = 4
    """Two control points of a cubic curve."""
    RADIUS = 8
    """Of an arc [cm]."""
    TAG = 9
    """Stitch tag [cm], three numbers."""
    QUATERNION = 12
    """Of the panel, (x, y, z, w)."""
    TOP = 16
    """Of the panel [cm], three numbers."""
    LARGE = 19
    """Flag: an arc longer than half a circle."""
    RIGHT = 20
    """Flag: an arc that bulges to the right."""
    KIND = 21
    """Two flags: 00 a line, 01 a quadratic curve, 10 an arc, 11 a cubic curve."""
    LABEL = 23
    """Three flags; see ``LABELS``."""
    SEWN = 26
    """Flag: the edge has a seam."""
    TURNED = 27
    """Flag: the seam is ``right_wrong``."""
    EDGE = 28
    """Flag: the row is an edge."""


WIDTH = 29
CONTINUOUS = 19
"""Number of continuous columns, which come first."""
LABELS: Mapping[tuple[int, ...], EdgeRole] = {
    (0, 0, 1): EdgeRole.LOWER_INTERFACE,
    (0, 1, 0): EdgeRole.RIGHT_COLLAR,
    (0, 1, 1): EdgeRole.LEFT_COLLAR,
    (1, 0, 0): EdgeRole.STRAPLESS_TOP,
    (1, 0, 1): EdgeRole.RIGHT_ARMHOLE,
    (1, 1, 0): EdgeRole.LEFT_ARMHOLE,
}
"""Flags of a labelled edge; 000 is an edge without a label."""

SCALING = Scaling(
    (
        0.0, 0.0, 0.0435069315135479, -0.0013821386964991689, 0.02369004860520363, 6.655487231910229e-05,
        0.04348168149590492, 0.00011081719276262447, 6.126057147979736,
        0.016028186306357384, 81.98733520507812, 0.7275835275650024,
        0.0041581252589821815, -0.029093468561768532, 3.425481918384321e-05, 0.9375355243682861,
        -0.010849719867110252, 112.52392578125, 2.6280436515808105,
    ),
    (
        21.05330467224121, 18.41973876953125, 0.14928792417049408, 0.04463037848472595, 0.09293685108423233,
        0.06073087453842163, 0.16462074220180511, 0.060732707381248474, 44.484989166259766,
        22.296857833862305, 45.6525993347168, 17.834659576416016,
        0.051953211426734924, 0.18981429934501648, 0.20662523806095123, 0.19682729244232178,
        27.13235855102539, 33.73225784301758, 23.4309139251709,
    ),
)  # fmt: skip
"""How the released network standardises the continuous columns (configs/ae/ae.py)."""


def encode(
    pattern: Pattern, *, max_panels: int = MAX_PANELS, max_edges: int = MAX_EDGES
) -> Float[np.ndarray, "p e 29"]:
    """The pattern as SewingLDM's array, not standardised; flags are 1 and -1.

    Raises ``PatternError`` for too many panels or edges, an open loop, a seam to a missing edge or an unknown label.
    """
    pattern = pattern.without_lines()
    require_room(pattern, panels=max_panels, edges=max_edges, what="SewingLDM's arrays")
    array = np.zeros((max_panels, max_edges, WIDTH))
    array[..., CONTINUOUS:] = -1.0
    slots = panel_slots([panel.name for panel in pattern.panels], max_panels)
    flags_of = {label: flags for flags, label in LABELS.items()}
    for slot, panel in zip(slots, pattern.panels, strict=True):
        rows = array[slot, : len(panel.edges)]
        rows[:, SlotColumn.STEP : SlotColumn.QUADRATIC] = edge_vectors(panel)
        top = panel.placement.apply(top_of(loop_corners(panel), panel.placement.matrix))
        array[slot, :, SlotColumn.QUATERNION : SlotColumn.LARGE] = (*quaternion(panel.placement), *top)
        rows[:, SlotColumn.EDGE] = 1.0
        for index, edge in enumerate(panel.edges):
            _write_curve(rows[index], edge.curve)
            if edge.label:
                if edge.label not in flags_of:
                    raise PatternError(
                        f"panel {panel.name}, edge {index}: SewingLDM's arrays hold no label {edge.label}: remove it"
                    )
                rows[index, SlotColumn.LABEL : SlotColumn.SEWN] = _signs(*flags_of[EdgeRole(edge.label)])
    places = [(slot, e) for slot, panel in zip(slots, pattern.panels, strict=True) for e in range(len(panel.edges))]
    for seam, ends, tag in zip(pattern.seams, seam_ends(pattern), seam_tags(pattern), strict=True):
        for end in ends:
            row = array[places[end]]
            row[SlotColumn.TAG : SlotColumn.QUATERNION] = tag
            row[SlotColumn.SEWN] = 1.0
            row[SlotColumn.TURNED] = 1.0 if seam.right_wrong else -1.0
    return array


def decode(array: Float[np.ndarray, "p e 29"], name: str = "", *, names: Sequence[str] | None = None) -> Pattern:
    """The pattern of an array that is not standardised; seams join the edges with the nearest stitch tags.

    A placement is the mean over all rows of its panel, as in their code; a seam is ``right_wrong`` if both of its edges
    say so. ``names``: of the panels (``panel_0``, … if ``None``). Raises ``PatternError`` for another shape, or values
    that are not finite.
    """
    if array.ndim != 3 or array.shape[2] != WIDTH:
        raise PatternError(f"SewingLDM's array has shape {array.shape}, not (panels, edges, {WIDTH}): give one garment")
    require_finite(array, "the array")
    panels, refs = list[Panel](), dict[int, EdgeRef]()
    for slot, rows in enumerate(array):
        kept = np.flatnonzero(rows[:, SlotColumn.EDGE] > 0)
        if len(kept) < LEAST_EDGES:
            continue
        edges = rows[kept]
        title = f"panel_{slot}" if names is None or slot >= len(names) else names[slot]
        panels.append(
            panel_from_vectors(
                title,
                edges[:, SlotColumn.STEP : SlotColumn.QUADRATIC],
                [_read_curve(row) for row in edges],
                [LABELS.get(_flags(row[SlotColumn.LABEL : SlotColumn.SEWN]), "") for row in edges],
                rows[:, SlotColumn.QUATERNION : SlotColumn.TOP].mean(axis=0),
                rows[:, SlotColumn.TOP : SlotColumn.LARGE].mean(axis=0),
            )
        )
        refs |= {slot * array.shape[1] + int(row): EdgeRef(title, i) for i, row in enumerate(kept)}
    flat = array.reshape(-1, WIDTH)
    tags = flat[:, SlotColumn.TAG : SlotColumn.QUATERNION]
    pairs = pair_edges(cdist(tags, tags), flat[:, SlotColumn.SEWN] <= 0, -flat[:, SlotColumn.SEWN])
    turned = [bool(np.all(flat[list(pair), SlotColumn.TURNED] > 0)) for pair in pairs]
    return Pattern(name, tuple(panels), seams_of(pairs, refs, turned))


def panel_slots(names: Sequence[str], count: int) -> list[int]:
    """A slot for each panel: by its name, or the next free one."""
    wanted = [PANEL_SLOTS.get(name, count) for name in names]
    taken: dict[int, int] = {}
    for index, slot in enumerate(wanted):
        if slot < count:
            taken.setdefault(slot, index)
    free = iter(slot for slot in range(count) if slot not in taken)
    return [slot if taken.get(slot) == index else next(free) for index, slot in enumerate(wanted)]


def _write_curve(row: Float[np.ndarray, "29"], curve: Curve) -> None:
    match curve:
        case Quadratic(control):
            row[SlotColumn.QUADRATIC : SlotColumn.CUBIC] = control
            row[SlotColumn.KIND : SlotColumn.LABEL] = _signs(0, 1)
        case Cubic(control0, control1):
            row[SlotColumn.CUBIC : SlotColumn.RADIUS] = (*control0, *control1)
            row[SlotColumn.KIND : SlotColumn.LABEL] = _signs(1, 1)
        case Arc(radius, large, right):
            row[SlotColumn.RADIUS] = min(radius, LARGEST_RADIUS)
            row[SlotColumn.LARGE : SlotColumn.KIND] = _signs(large, right)
            row[SlotColumn.KIND : SlotColumn.LABEL] = _signs(1, 0)
        case _:
            assert curve == LINE


def _read_curve(row: Float[np.ndarray, "29"]) -> Curve:
    a, b, c, d, e, f = row[SlotColumn.QUADRATIC : SlotColumn.RADIUS].tolist()
    match _flags(row[SlotColumn.KIND : SlotColumn.LABEL]):
        case (0, 1):
            return Quadratic((a, b))
        case (1, 1):
            return Cubic((c, d), (e, f))
        case (1, 0):
            return Arc(float(row[SlotColumn.RADIUS]), bool(row[SlotColumn.LARGE] > 0), bool(row[SlotColumn.RIGHT] > 0))
        case _:
            return LINE


def _signs(*flags: int | bool) -> list[float]:
    return [1.0 if flag else -1.0 for flag in flags]


def _flags(scores: Float[np.ndarray, " n"]) -> tuple[int, ...]:
    return tuple(int(score > 0) for score in scores)
