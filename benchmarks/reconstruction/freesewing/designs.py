"""FreeSewing designs: which parts are cut how often, and which stretches of their outlines are sewn together.

FreeSewing draws the parts of a design and names their corners; it does not store seams. They are listed here, as the
instructions of each design describe them.

A stretch ``front:armhole>shoulder`` is the shorter way along the outline of piece ``front`` from corner ``armhole`` to
corner ``shoulder``; several are joined by spaces. ``~front:…`` is the mirrored half of a piece cut on the fold, or the
mirrored copy of a piece cut twice. A seam joins two such sides; both begin at the same end of the seam. The mirror
image of a seam is sewn too. A side is mirrored where only that joins right side to right side, so the table may name
either half. ``/2`` after a stretch divides it in halves: an edge whose two ends are one point, as those of a ring,
cannot be meshed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType

WOMEN = tuple(f"cisFemaleAdult{size}" for size in range(28, 47, 2))
MEN = tuple(f"cisMaleAdult{size}" for size in range(32, 51, 2))


class Cut(Enum):
    """How a part becomes panels."""

    FOLD = "half of a symmetrical panel"
    PAIR = "two panels, one the mirror image of the other"
    ONE = "one panel"


class Side(Enum):
    """Where a panel hangs before sewing."""

    FRONT = "before the body"
    BACK = "behind the body"
    ARM = "beside the arm"


@dataclass(frozen=True, slots=True)
class Piece:
    """A part of a drawing as it is cut."""

    part: str
    """Name of the part in FreeSewing."""
    cut: Cut
    side: Side
    fold: tuple[str, str] = ("", "")
    """Corners between which the fold lies, for a half."""
    middle: str = ""
    """Corner that hangs at the body's middle; empty for the drawing's own vertical axis."""


@dataclass(frozen=True)
class Design:
    """A FreeSewing design with its seams."""

    package: str
    models: tuple[str, ...]
    """Sets of measurements in ``@freesewing/models`` that it is drawn for."""
    pieces: Mapping[str, Piece]
    seams: tuple[tuple[str, str], ...]
    varied: tuple[str, ...]
    """Options that are drawn at random within FreeSewing's own range."""
    options: Mapping[str, object] = field(default_factory=lambda: MappingProxyType({}))
    """Options with a fixed value."""
    from_waist: bool = False
    """Whether drawings have their origin at the waist; otherwise it is at the highest point of the shoulder."""


SIDE = ("front:hem>armhole", "back:hem>armhole")
SHOULDER = ("front:shoulder>neck", "back:shoulder>neck")
CAP = ("sleeve:bicepsRight>capQ2 sleeve:capQ2>bicepsLeft", "front:armhole>shoulder ~back:shoulder>armhole")
UNDERARM = ("sleeve:bicepsRight>wristRight", "sleeve:bicepsLeft>wristLeft")


def _half(part: str, top: str, bottom: str) -> Piece:
    return Piece(part, Cut.FOLD, Side.BACK if part.endswith("back") else Side.FRONT, (top, bottom))


def _pair(part: str, middle: str = "") -> Piece:
    name = part.partition(".")[2]
    return Piece(part, Cut.PAIR, {"front": Side.FRONT, "back": Side.BACK}.get(name, Side.ARM), middle=middle)


DESIGNS: Mapping[str, Design] = MappingProxyType(
    {
        "teagan": Design(
            "teagan",
            WOMEN + MEN,
            {
                "front": _half("teagan.front", "cfNeck", "cfHem"),
                "back": _half("teagan.back", "cbNeck", "cbHem"),
                "sleeve": _pair("teagan.sleeve"),
            },
            (SIDE, SHOULDER, CAP, ("sleeve:bicepsRight>hemRight", "sleeve:bicepsLeft>hemLeft")),
            ("chestEase", "lengthBonus", "sleeveLength", "necklineDepth", "necklineWidth", "hipsEase", "sleeveEase"),
        ),
        "aaron": Design(
            "aaron",
            MEN + WOMEN,
            {
                "front": _half("aaron.front", "cfNeck", "cfHem"),
                "back": _half("aaron.back", "cbNeck", "cbHem"),
                "arm_binding": _pair("aaron.armBinding"),
                "neck_binding": Piece("aaron.neckBinding", Cut.ONE, Side.FRONT),
            },
            (
                SIDE,
                ("front:strapRight>strapLeft", "back:strapRight>strapLeft"),
                ("arm_binding:topLeft>bottomLeft", "front:armhole>strapRight ~back:strapRight>armhole"),
                ("arm_binding:topLeft>topRight", "arm_binding:bottomLeft>bottomRight"),
                (
                    "neck_binding:topLeft>bottomLeft",
                    "front:strapLeft>cfNeck ~front:cfNeck>strapLeft back:strapLeft>cbNeck ~back:cbNeck>strapLeft",
                ),
                ("neck_binding:topLeft>topRight", "neck_binding:bottomLeft>bottomRight"),
            ),
            ("chestEase", "lengthBonus", "armholeDrop", "necklineDrop", "shoulderStrapWidth", "hipsEase"),
        ),
        "brian": Design(
            "brian",
            MEN + WOMEN,
            {
                "front": _half("brian.front", "cfNeck", "cfHem"),
                "back": _half("brian.back", "cbNeck", "cbHem"),
                "sleeve": _pair("library.sleeve"),
            },
            (SIDE, SHOULDER, CAP, UNDERARM),
            ("chestEase", "lengthBonus", "bicepsEase", "cuffEase", "collarEase", "sleeveLengthBonus"),
        ),
        "diana": Design(
            "diana",
            WOMEN,
            {
                "front": _half("diana.front", "cNeck", "cHem"),
                "back": _half("diana.back", "cNeck", "cHem"),
                "sleeve": _pair("diana.sleeve"),
            },
            (SIDE, SHOULDER, CAP, UNDERARM),
            ("chestEase", "lengthBonus", "drapeAngle", "waistEase", "hipsEase", "sleeveLengthBonus"),
        ),
        "sven": Design(
            "sven",
            MEN + WOMEN,
            {
                "front": _half("sven.front", "cfNeck", "cfHem"),
                "back": _half("sven.back", "cbNeck", "cbHem"),
                "sleeve": _pair("sven.sleeve"),
                "cuff": _pair("sven.cuff"),
                "waistband": Piece("sven.waistband", Cut.ONE, Side.FRONT),
            },
            (
                SIDE,
                SHOULDER,
                CAP,
                UNDERARM,
                ("cuff:topRight>bottomRight /2", "sleeve:wristLeft>wristRight"),
                ("cuff:topLeft>topRight", "cuff:bottomLeft>bottomRight"),
                (
                    "waistband:topRight>bottomRight",
                    "~front:hem>cfHem front:cfHem>hem ~back:hem>cbHem back:cbHem>hem",
                ),
                ("waistband:topLeft>topRight", "waistband:bottomLeft>bottomRight"),
            ),
            ("chestEase", "lengthBonus", "bicepsEase", "cuffEase", "hipsEase", "ribbingHeight", "ribbingStretch"),
        ),
        "bella": Design(
            "bella",
            WOMEN,
            {
                "front": _half("bella.frontSideDart", "cfNeck", "cfHem"),
                "back": _pair("bella.back"),
                "sleeve": _pair("bella.sleeve"),
            },
            (
                ("front:waistDartLeft>waistDartTip", "front:waistDartRight>waistDartTip"),
                ("front:bustDartBottom>bustDartTip", "front:bustDartTop>bustDartTip"),
                ("back:dartBottomLeft>dartTip", "back:dartBottomRight>dartTip"),
                ("back:cbNeck>waistCenter", "~back:cbNeck>waistCenter"),
                ("front:sideHem>bustDartBottom front:bustDartTop>armhole", "back:waistSide>armhole"),
                ("front:shoulder>hps", "back:shoulder>hps"),
                CAP,
                UNDERARM,
            ),
            ("chestEase", "waistEase", "waistDartLength", "backDartHeight", "bicepsEase", "cuffEase"),
        ),
        "breanna": Design(
            "breanna",
            WOMEN,
            {
                "front": _half("breanna.front", "cfNeck", "cfWaist"),
                "back": _pair("breanna.back"),
                "sleeve": _pair("breanna.sleeve"),
            },
            (
                ("front:primaryBustDart1>primaryBustDartTip", "front:primaryBustDart2>primaryBustDartTip"),
                ("front:secondaryBustDart1>secondaryBustDartTip", "front:secondaryBustDart2>secondaryBustDartTip"),
                ("back:waistDart1>waistDartTip", "back:waistDart2>waistDartTip"),
                ("back:cbNeck>cbWaist", "~back:cbNeck>cbWaist"),
                ("front:waist>secondaryBustDart1", "back:waist>armhole"),
                ("front:shoulder>hps", "back:shoulder>hps"),
                (
                    "sleeve:bicepsRight>capQ2 sleeve:capQ2>bicepsLeft",
                    "front:secondaryBustDart2>shoulder ~back:shoulder>armhole",
                ),
                UNDERARM,
            ),
            ("chestEase", "waistEase", "waistDartSize", "waistDartLength", "bicepsEase", "sleeveLengthBonus"),
        ),
        "titan": Design(
            "titan",
            MEN + WOMEN,
            {"front": _pair("titan.front", "fork"), "back": _pair("titan.back", "fork")},
            (
                ("front:styleWaistOut>floorOut", "back:styleWaistOut>floorOut"),
                ("front:fork>floorIn", "back:fork>floorIn"),
                ("front:styleWaistIn>fork", "~front:styleWaistIn>fork"),
                ("back:styleWaistIn>fork", "~back:styleWaistIn>fork"),
            ),
            ("waistEase", "seatEase", "kneeEase", "lengthBonus", "legBalance", "crotchDrop"),
            from_waist=True,
        ),
        "penelope": Design(
            "penelope",
            WOMEN,
            {"front": _half("penelope.front", "lWaist", "lHem"), "back": _pair("penelope.back")},
            (
                ("front:rHem>rWaist", "back:rHem>rWaist"),
                ("back:lWaist>lHem", "~back:lWaist>lHem"),
                ("front:dart1Start>dart1Middle", "front:dart1End>dart1Middle"),
                ("front:dart2Start>dart2Middle", "front:dart2End>dart2Middle"),
                ("back:dart1Start>dart1Middle", "back:dart1End>dart1Middle"),
                ("back:dart2Start>dart2Middle", "back:dart2End>dart2Middle"),
            ),
            ("lengthBonus", "hemBonus", "seatEase", "waistEase", "backDartDepthFactor", "frontDartDepthFactor"),
            MappingProxyType({"backVent": False, "waistband": False}),
            from_waist=True,
        ),
    }
)
"""The designs by name."""
