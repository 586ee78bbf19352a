"""Decode tokens into design parameters and body measures, from which the generator's programs draw the answer.

Each of the parameters of ``GarmentDesign``, and each of the 26 measures, has a query that attends to the tokens. A
choice has a logit for each option; a number has a value, and, where random designs often keep the default, a logit that
it is the default. Parameters without effect on the garment, such as the width of trouser legs of a skirt, are left out
of the loss.

Choices come first. Numbers and measures are predicted conditioned on the choices (teacher forcing in training): a skirt
has another length with a waistband than without, and their mean would fit neither.

Every answer can be sewn. Upper, waistband and bottom are chosen together, as the likeliest combination that exists.
Numbers are moved into their ranges. A design that cannot be drawn for the predicted measures is repaired as random
designs are (``wearable``), and if that fails its numbers become defaults.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar, cast

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.design_codes import (
    PARAMETERS,
    UNLEARNED,
    decode_design,
    encode_design,
    have_effect,
    options_of,
)
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import TensorExamples, mean_of
from benchmarks.reconstruction.panel_net import NEVER
from benchmarks.reconstruction.point_net import DecoderLayer
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.faults import Severity, check_pattern
from gcd_dataset.generator.garments import GarmentDesign, design_to_dict, draw_garment
from gcd_dataset.generator.garments.parameter import Choice
from gcd_dataset.generator.garments.space import DesignSpace
from gcd_dataset.generator.garments.wardrobe import Bottom, Upper
from gcd_dataset.generator.garments.wearable import wearable
from gcd_dataset.measurements import ANGLES, MEASURES, PARTS, Measurements
from gcd_dataset.records import Pattern

FEW = 12  # a whole number of at most this many values is a choice among them
VALUE_BEND = 0.05  # share of a range, or of a deviation: errors below it count by their square
LARGEST_PART = 0.95  # of the whole
WEIGHTS = {"choices": 1.0, "numbers": 5.0, "defaults": 0.5, "measures": 1.0}
LEAVES = tuple(leaf.path for leaf in PARAMETERS)
META = tuple(LEAVES.index(path) for path in ("meta.upper", "meta.wb", "meta.bottom"))


@dataclass(frozen=True)
class DesignTargets(TensorExamples):
    """Parameters and measures that garments were drawn from."""

    codes: Float[Tensor, "b d"]
    """Rows of ``encode_design``; NaN for an unknown parameter."""
    effective: Bool[Tensor, "b d"]
    """Known parameters that have an effect."""
    measures: Float[Tensor, "b m"]
    """Body measures in the order of ``MEASURES`` [cm, degrees]; NaN if unknown."""

    @staticmethod
    def of(garments: GarmentSet) -> "DesignTargets":
        """The targets of garments with the field ``design``, on a CPU."""
        codes = np.concatenate([garments.ragged["design"][k] for k in range(len(garments))]).astype(np.float32)
        effective = np.array([have_effect(decode_design(row)) for row in codes]).reshape(codes.shape)
        return DesignTargets(
            codes=torch.from_numpy(codes),
            effective=torch.from_numpy(effective & np.isfinite(codes)),
            measures=torch.from_numpy(garments.measures).float(),
        )


# ---------------------------------------------------------------------------------------------------------- the network


@dataclass(frozen=True)
class Words:
    """Predictions of the decoder."""

    outputs: Float[Tensor, "b d o"]
    """Logits of the options of each choice; for each number its share of the range, and the logit of its default."""
    measures: Float[Tensor, "b m"]
    """Body measures, in standard deviations from the mean."""


class DesignDecoder(nn.Module):
    """Tokens to a design and measures."""

    mean: Tensor
    deviation: Tensor
    least: Tensor
    most: Tensor

    def __init__(self, width: int, *, heads: int, layers: int) -> None:
        """``layers``: layers before the choices; half as many, rounded up, follow."""
        super().__init__()
        queries, options = len(PARAMETERS) + len(MEASURES), int(_TABLE.options.max())
        self.queries = nn.Parameter(torch.randn(queries, width))
        self.layers = nn.ModuleList(DecoderLayer(width, heads, 4 * width) for _ in range(layers))
        self.options = nn.Parameter(torch.randn(len(PARAMETERS), options, width))
        self.told = nn.ModuleList(DecoderLayer(width, heads, 4 * width) for _ in range((layers + 1) // 2))
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(2))
        self.weights = nn.Parameter(torch.randn(queries, width, options) / width)
        self.biases = nn.Parameter(torch.zeros(queries, options))
        for name in ("mean", "deviation", "least", "most"):
            self.register_buffer(name, torch.zeros(len(MEASURES)))
        for name, column in vars(_TABLE).items():
            self.register_buffer(f"table_{name}", torch.from_numpy(column), persistent=False)

    @property
    def all_layers(self) -> list[nn.Module]:
        """Its layers of attention."""
        return [*self.layers, *self.told]

    def learn_range(self, garments: GarmentSet) -> None:
        """Take the range of the measures from garments, unless it is known.

        Raises ``ConfigError`` if the measures of no body are complete.
        """
        if self.deviation.any():
            return
        known = garments.measures[np.isfinite(garments.measures).all(axis=1)].astype(np.float64)
        if not len(known):
            raise ConfigError("no garment with all measures of its body: give garments that gcd_dataset made")
        self.mean.copy_(torch.from_numpy(known.mean(axis=0)))
        self.deviation.copy_(torch.from_numpy(known.std(axis=0)).clamp(min=1e-3))
        self.least.copy_(torch.from_numpy(known.min(axis=0)))
        self.most.copy_(torch.from_numpy(known.max(axis=0)))

    def forward(self, tokens: Float[Tensor, "b t w"], true: DesignTargets) -> Words:
        """Predictions conditioned on the true choices that have an effect."""
        table = self._table()
        queries, said = self._chosen(tokens)
        rows = (true.codes.nan_to_num() - table.low).round().long()
        words = self._sized(queries, tokens, rows, true.effective)
        return replace(words, outputs=torch.where((table.options > 0)[:, None], said, words.outputs))

    def _chosen(self, tokens: Float[Tensor, "b t w"]) -> tuple[Float[Tensor, "b q w"], Float[Tensor, "b d o"]]:
        """The queries after the first layers, and their logits of the choices."""
        queries = self.queries.expand(len(tokens), -1, -1)
        for layer in self.layers:
            queries = layer(queries, tokens)
        return queries, self._read(queries, self.norms[0])[:, : len(PARAMETERS)]

    def _sized(
        self,
        queries: Float[Tensor, "b q w"],
        tokens: Float[Tensor, "b t w"],
        rows: Int[Tensor, "b d"],
        effective: Bool[Tensor, "b d"],
    ) -> Words:
        """Numbers and measures conditioned on the options ``rows``, where these are effective."""
        is_told = effective & (self._table().options > 0)
        option = torch.arange(self.options.shape[1], device=rows.device)
        chosen = (is_told[..., None] & (rows[..., None] == option)).to(queries.dtype)
        told = torch.einsum("bdo,dow->bdw", chosen, self.options)  # an index would be added up slowly in the gradient
        parts = (queries[:, : len(PARAMETERS)] + told, queries[:, len(PARAMETERS) :])
        queries = torch.cat(parts, dim=1)
        for layer in self.told:
            queries = layer(queries, tokens)
        found = self._read(queries, self.norms[1])
        return Words(found[:, : len(PARAMETERS)], found[:, len(PARAMETERS) :, 0])

    def _read(self, queries: Float[Tensor, "b q w"], norm: nn.Module) -> Float[Tensor, "b q o"]:
        with torch.autocast(queries.device.type, enabled=False):
            return torch.einsum("bqw,qwo->bqo", norm(queries.float()), self.weights) + self.biases

    def losses(self, words: Words, true: DesignTargets) -> dict[str, Tensor]:
        """The weighted loss terms."""
        with torch.autocast(true.codes.device.type, enabled=False):
            table = self._table()
            codes, outputs = true.codes.nan_to_num(), words.outputs
            is_choice = table.options > 0
            rows = (codes - table.low).round().long().clamp(min=0)
            rows = torch.where(is_choice, rows, 0)
            logits = self._logits(outputs)
            choices = functional.cross_entropy(logits.flatten(0, 1), rows.flatten(), reduction="none").view(rows.shape)
            is_default = (codes == table.default) & table.kept
            shares = (codes - table.low) / table.extent
            numbers = functional.smooth_l1_loss(outputs[..., 0], shares, beta=VALUE_BEND, reduction="none")
            binary = functional.binary_cross_entropy_with_logits
            defaults = binary(outputs[..., 1], is_default.to(outputs.dtype), reduction="none")
            known = true.measures.isfinite()
            apart = words.measures - ((true.measures - self.mean) / self.deviation).nan_to_num()
            zero = torch.zeros_like(apart)
            parts = {
                "choices": mean_of(choices, true.effective & is_choice),
                "numbers": mean_of(numbers, true.effective & ~is_choice & ~is_default),
                "defaults": mean_of(defaults, true.effective & ~is_choice & table.kept),
                "measures": mean_of(functional.smooth_l1_loss(apart, zero, beta=VALUE_BEND, reduction="none"), known),
            }
        return {name: WEIGHTS[name] * part for name, part in parts.items()}

    @torch.no_grad()
    def answers(self, *seen: Float[Tensor, "b t w"], noise: Tensor | float = 0.0) -> list["Answer"]:
        """The likeliest parameters and measures of each garment, on the CPU; ``seen``: tokens of several inputs of it,
        whose outputs are averaged; ``noise``: added to the logits of the choices."""
        table = self._table()
        asked = [(*self._chosen(tokens), tokens) for tokens in seen]
        logits = self._logits(torch.stack([said for _, said, _ in asked]).mean(dim=0)).log_softmax(dim=-1) + noise
        rows = logits.argmax(dim=-1)
        joint = _OUTFITS.to(logits.device)
        likelihood = logits[:, META[0], joint[:, 0]] + logits[:, META[1], joint[:, 1]] + logits[:, META[2], joint[:, 2]]
        rows[:, list(META)] = joint[likelihood.argmax(dim=1)]
        codes = torch.where(table.options > 0, rows + table.low, torch.nan)
        effective = np.array([have_effect(decode_design(row)) for row in codes.cpu().numpy()]).reshape(codes.shape)
        told = torch.from_numpy(effective).to(codes.device)
        said = [self._sized(queries, tokens, rows, told) for queries, _, tokens in asked]
        outputs, sizes = (torch.stack([getattr(one, name) for one in said]).mean(dim=0) for name in vars(said[0]))
        values = table.low + outputs[..., 0] * table.extent
        values = torch.where((outputs[..., 1] > 0) & table.kept, table.default, values)
        codes = torch.where(table.options > 0, codes, values)
        codes[:, torch.from_numpy(UNLEARNED)] = torch.nan  # such as a closure in front: never in a training set
        measures = (sizes * self.deviation + self.mean).clamp(self.least, self.most)
        usual = self.mean.double().cpu().numpy()
        return [Answer(*pair, usual) for pair in zip(codes.cpu().numpy(), measures.double().cpu().numpy(), strict=True)]

    @torch.no_grad()
    def proposals(self, seen: Sequence[Float[Tensor, "1 t w"]], count: int, chance: torch.Generator) -> list["Answer"]:
        """The likeliest answer for one garment, then others, their choices drawn with their chances."""
        noise = -(-torch.rand((count, *self.options.shape[:2]), generator=chance).clamp(min=1e-9).log()).log()  # Gumbel
        noise[0] = 0.0
        return self.answers(*(tokens.expand(count, -1, -1) for tokens in seen), noise=noise.to(self.queries.device))

    def _table(self) -> "Table":
        return Table(**{name: getattr(self, f"table_{name}") for name in vars(_TABLE)})

    def _logits(self, outputs: Float[Tensor, "b d o"]) -> Float[Tensor, "b d o"]:
        """Logits of the options; those beyond a parameter's own are never chosen."""
        option = torch.arange(outputs.shape[-1], device=outputs.device)
        return outputs.masked_fill(option >= self.table_options.clamp(min=1)[:, None], NEVER)  # type: ignore[operator]


@dataclass(frozen=True)
class Table:
    """The parameters' spaces, a row each; arrays, or tensors on the network's device."""

    options: Any
    """Number of the options; 0 for a number."""
    low: Any
    """Least value of a number; 0 for a choice, whose code is the row of its option."""
    extent: Any
    """Width of a number's range."""
    default: Any
    kept: Any
    """Whether a number is often its default."""

    @staticmethod
    def of(spaces: Sequence[Any]) -> "Table":
        """The table of some spaces."""
        rows = [_row(space) for space in spaces]
        options, low, extent, default, kept = (np.array(column) for column in zip(*rows, strict=True))
        low, extent, default = (column.astype(np.float32) for column in (low, extent, default))
        return Table(options, low, extent, default, kept)


def _row(space: Any) -> tuple[int, float, float, float, bool]:
    if isinstance(space, Choice):
        return len(options_of(space)), 0.0, 1.0, 0.0, False
    low, high = space.range
    few = space.kind == "int" and high - low < FEW
    return int(few) * int(high - low + 1), low, high - low, space.default, space.keep is not None and not few


_TABLE = Table.of([leaf.space for leaf in PARAMETERS])


def _outfits() -> Int[Tensor, "c 3"]:
    """Rows of the options of upper, waistband and bottom of all combinations that exist."""
    spaces = [cast(Choice, PARAMETERS[row].space) for row in META]
    uppers, bands, bottoms = (options_of(space) for space in spaces)
    found = [
        (i, j, k)
        for i, upper in enumerate(uppers)
        for j, band in enumerate(bands)
        for k, bottom in enumerate(bottoms)
        if (upper or bottom) and (upper is None or Upper(upper).garment.carries or not (band or bottom))
    ]
    return torch.tensor(found)


_OUTFITS = _outfits()


# ---------------------------------------------------------------------------------------------------------- the drawing


@dataclass(frozen=True)
class Answer:
    """Parameters and measures of a garment, before it is drawn."""

    codes: Float[np.ndarray, " d"]
    measures: Float[np.ndarray, " m"]
    """[cm, degrees]"""
    usual: Float[np.ndarray, " m"]
    """Measures of a body that designs fit."""


def drawn(answer: Answer) -> Pattern:
    """The first pattern that can be sewn.

    Tried in order: the design; repaired; with its numbers at their defaults; that on the usual body; a circle skirt.
    """
    size, usual = size_of(answer.measures), size_of(answer.usual)
    design = decode_design(answer.codes)
    for number in range(5):
        pattern = _tried(design, size, usual, number)
        if pattern is not None:
            return pattern
    raise ConfigError("no circle skirt can be drawn for the mean body of the training set: give other garments")


def _tried(design: GarmentDesign, size: Measurements, usual: Measurements, number: int) -> Pattern | None:
    try:
        if number == 1:
            design = wearable(design, [size], np.random.default_rng(0), DesignSpace.declared(GarmentDesign)).design
        if number in (2, 3):
            design = _with_defaults(design)
        if number == 4:
            design = decode_design(encode_design({"meta": {"bottom": Bottom.CIRCLE.value}}))
        pattern = draw_garment(size if number < 3 else usual, design)
    except GcdError:
        return None
    return None if any(fault.severity is Severity.ERROR for fault in check_pattern(pattern)) else pattern


def _with_defaults(design: GarmentDesign) -> GarmentDesign:
    """The design with its choices alone."""
    codes = encode_design(design_to_dict(design))
    is_number = np.array([not isinstance(leaf.space, Choice) for leaf in PARAMETERS])
    return decode_design(np.where(is_number, np.nan, codes))


def size_of(measures: Float[np.ndarray, " m"]) -> Measurements:
    """The measures, with parts that are less than the whole."""
    values = dict(zip(MEASURES, measures.tolist(), strict=True))
    for whole, (first, *others) in PARTS:
        values[first] = min(values[first], LARGEST_PART * values[whole] - sum(values[name] for name in others))
    return Measurements.from_file_values(values)


Targets = TypeVar("Targets", bound=DesignTargets)

PATHS = [leaf.path for leaf in PARAMETERS]
SLITS = ("pencil-skirt.left_slit", "pencil-skirt.right_slit")
TILT, PLACE = PATHS.index("pencil-skirt.low_angle"), PATHS.index("flare-skirt.cut.place")
HALVES, PANELS = PATHS.index("left.enable_asym"), PATHS.index("flare-skirt.skirt-many-panels.n_panels")
"""The programs draw no mirror image of different halves, nor of a skirt of many panels, which begins at one side."""
EQUAL = float(encode_design({"left": {"enable_asym": False}})[HALVES])
CENTIMETRES = (
    "godet-skirt.insert_w", "godet-skirt.insert_depth", "sleeve.standing_shoulder_len",
    "left.sleeve.standing_shoulder_len",
)  # fmt: skip
"""Numbers that are lengths; all others are proportions or angles. Lengths among the choices, such as the depth of a
collar, are whole centimetres up to 10: they are left as they are, off by one at most."""


class DesignAugmentation:
    """Changes the targets of a batch as their garments are changed; its constants lie on one device."""

    def __init__(self, device: torch.device) -> None:
        rows = list(range(len(PATHS)))
        left, right = (PATHS.index(path) for path in SLITS)
        rows[left], rows[right] = right, left
        self._rows = torch.tensor(rows, device=device)
        self._is_length = torch.tensor([name not in ANGLES for name in MEASURES], device=device)
        self._is_centimetres = torch.tensor([path in CENTIMETRES for path in PATHS], device=device)

    def can_mirror(self, targets: DesignTargets) -> Bool[Tensor, " b"]:
        """Whether the mirror image of a garment is one of the same programs."""
        has_equal_halves = ~targets.effective[:, HALVES] | (targets.codes[:, HALVES] == EQUAL)
        return has_equal_halves & ~targets.effective[:, PANELS]

    def mirrored(self, targets: Targets, chosen: Bool[Tensor, " b"]) -> Targets:
        """The targets, of mirror images where ``chosen``."""
        codes = targets.codes[:, self._rows]
        codes[:, TILT] = -codes[:, TILT]
        place = codes[:, PLACE]  # above 0 in front, from the wearer's right: 0 to 1; else behind: -1 to 0
        codes[:, PLACE] = torch.where(place > 0, 1 - place, -1 - place)
        rows = chosen[:, None]
        return replace(
            targets,
            codes=torch.where(rows, codes, targets.codes),
            effective=torch.where(rows, targets.effective[:, self._rows], targets.effective),
        )

    def scaled(self, targets: Targets, scales: Float[Tensor, " b"]) -> Targets:
        """The targets of garments that are scaled with their bodies."""
        by = scales[:, None]
        return replace(
            targets,
            codes=torch.where(self._is_centimetres, targets.codes * by, targets.codes),
            measures=torch.where(self._is_length, targets.measures * by, targets.measures),
        )
