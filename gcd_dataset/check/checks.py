"""The faults of a data set, in order of harm: what each does to a training, and its remedy."""

from dataclasses import dataclass
from enum import StrEnum


class Harm(StrEnum):
    """What a finding means for a training."""

    HARMFUL = "harmful"
    """Stops the training, or spoils the model or its scores; ``gcd check`` exits 1."""
    WARNING = "warning"
    """Wastes time or data, or biases the model, and may be intended."""
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Check:
    """A kind of fault."""

    name: str
    fault: str
    """In the plural, after ``3 of 64 garments``."""
    effect: str
    """What it does to a training."""
    remedy: str
    harm: Harm = Harm.HARMFUL
    counts_garments: bool = True
    """Whether a finding counts garments; otherwise ``fault`` says what it counts."""


UNREADABLE = Check(
    "unreadable",
    "cannot be read",
    "an epoch ends with an error at the first of them",
    "gcd check --bytes names the damaged files: copy or download them again, or generate them again",
)
INCOMPLETE = Check(
    "incomplete",
    "garments of a split are missing",
    "the split is smaller than its manifest or list: scores do not compare with those on the whole split",
    "download or extract them again",
    counts_garments=False,
)
LEAKED_DESIGN = Check(
    "leaked-design",
    "have a design that is in another split too",
    "a model recalls the design instead of reconstructing it: test scores are too good",
    "split by design: gcd publish divides a data set so that splits share no design, body or pattern",
)
LEAKED_PATTERN = Check(
    "leaked-pattern",
    "have a pattern that is in another split too",
    "a model recalls the pattern instead of reconstructing it: test scores are too good",
    "remove them from the test split, or generate one data set and let gcd publish divide it",
)
LEAKED_BODY = Check(
    "leaked-body",
    "are worn by a body that is in another split too",
    "scores do not show how the model does on new people",
    "split by body: gcd publish divides a data set so that splits share no design, body or pattern",
)
NOT_FINITE = Check(
    "nan",
    "hold NaN or infinity",
    "one such garment makes the loss NaN and, by its gradient, every weight",
    'leave them out: GarmentDataset(quality="paper"), or settled_only=True; generate with --on-fail retry',
)
UNITS = Check(
    "units",
    "are not in centimetres",
    "they dominate the loss, or vanish in it; a model sees two populations of sizes",
    "scale vertices, uv, pattern and measures to cm before writing the shards",
)
AXES = Check(
    "axes",
    "do not stand upright facing +z, left at +x",
    "front and back, left and right, or the vertical differ between garments: placement cannot be learned",
    "turn them so that y is up, the wearer faces +z and the wearer's left is +x",
)
WINDING = Check(
    "winding",
    "have triangles whose normals point into the body, or both ways within a panel",
    "normals, signed distances and one-sided rendering are wrong",
    "order the corners of each triangle counter-clockwise as seen on the right side of the cloth",
)
MIRRORED = Check(
    "mirrored-uv",
    "have panels whose uv are mirrored against their outlines",
    "textures, prints and panel segmentation are mirrored: a left panel is learned as a right one",
    "take uv from the panel's own plane, x to the right as seen on the right side of the cloth",
)
LOOPS = Check(
    "reversed-loops",
    "have panels whose edge loops run clockwise as seen from outside",
    "edge sequences have two directions: bulges and seam ends change sign between garments",
    "reverse these loops with their curves, and renumber the edges of their seams",
)
UNSEWABLE = Check(
    "invalid-patterns",
    "have a pattern that cannot be sewn",
    "outlines and stitches of no garment are learned as truth",
    "gcd check SPEC lists the faults of a pattern: correct or remove them",
)
REFERENCES = Check(
    "references",
    "have arrays that contradict each other",
    "indexing fails, or silently takes the wrong vertex, panel or seam",
    "write them again with gcd generate or gcd convert",
)
OPEN_SEAMS = Check(
    "open-seams",
    "have seams that are not sewn: their edges have no common vertices in the mesh",
    "the mesh falls into pieces where the pattern says it is sewn: seam labels are wrong",
    "weld the vertices of the two edges of each seam, in the order of the pattern's stitches",
)
SEAM_LENGTHS = Check(
    "seam-lengths",
    "have seams whose edges differ in length by other than their gathers",
    "the pattern cannot be sewn into the mesh: seam lengths and stitches contradict each other",
    "correct the pattern (gcd check lists its seams), or the ratios in meta[gathers]",
)
MISSING = Check(
    "missing-members",
    "lack an array that other garments of the split have",
    "collate fails, or a batch silently mixes garments with and without it",
    "generate all garments up to the same --stage, or read only the fields that all have",
)
FAILED_DRAPE = Check(
    "failed-drapes",
    "have a drape that failed or did not settle",
    "shapes that no cloth has are learned as truth",
    'leave them out: GarmentDataset(quality="paper"); generate with --on-fail retry',
)
ORPHANS = Check(
    "orphans",
    "garments or bodies are outside of every split",
    "none directly: data that was paid for is not trained on",
    "add garments to the split file; remove what is not wanted",
    Harm.WARNING,
    counts_garments=False,
)
BODILESS = Check(
    "bodiless",
    "bodies of garments lack files",
    "transforms that need the body (Views, Scan) fail on them",
    "extract 5000_body_shapes_and_measures into the same folder",
    Harm.WARNING,
    counts_garments=False,
)
SKEWED = Check(
    "skewed",
    "kinds of garments have unusual shares",
    "rare kinds are hardly learned, and a score on the test split weighs kinds as training does not",
    "draw more of the rare kinds (gcd generate --config), or weight them in training (MixedDataset)",
    Harm.WARNING,
    counts_garments=False,
)
FEW_FIELDS = Check(
    "fields",
    "fields of a full data set are missing",
    "tasks that need these fields cannot be trained",
    "download or generate them if they are needed",
    Harm.NOTE,
    counts_garments=False,
)

CHECKS = (
    UNREADABLE, INCOMPLETE, LEAKED_DESIGN, LEAKED_PATTERN, LEAKED_BODY, NOT_FINITE, UNITS, AXES, WINDING, MIRRORED,
    LOOPS, UNSEWABLE, REFERENCES, OPEN_SEAMS, SEAM_LENGTHS, MISSING, FAILED_DRAPE, ORPHANS, BODILESS,
    SKEWED, FEW_FIELDS,
)  # fmt: skip
"""All checks, the most harmful first."""
