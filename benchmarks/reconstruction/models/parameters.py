"""From surface points of a garment to design parameters and body measures, from which our own programs draw the answer.

Each of the parameters of ``OutfitDesign``, and each of the 26 measures, has a query that attends to the tokens of the
points. A choice has a logit for each option; a number has a value, and, where random designs often keep the default, a
logit that it is the default. Parameters that have no effect on the garment are left out of the loss: only meta.bottom
of a dress says that it has trousers, and nothing says how wide their legs would be.

Every answer can be sewn. Upper, waistband and bottom are chosen together, as the likeliest of the outfits that exist.
Numbers are moved into their ranges. A design that cannot be drawn for the predicted measures is repaired as random
designs are (``wearable``), and if that fails its numbers become defaults. Answers are confined to what the programs can
draw, so this model answers garments of other origin by the most similar ones of ours.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.attention import DecoderLayer
from benchmarks.reconstruction.design_codes import PARAMETERS, decode_design, encode_design, have_effect, options_of
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Examples, Learner, TensorExamples, uploaded
from benchmarks.reconstruction.models.panel_set import mean_of
from benchmarks.reconstruction.panel_net import NEVER
from benchmarks.reconstruction.panel_targets import UNIT
from benchmarks.reconstruction.point_net import CHUNK, EncoderConfig, PointTokens
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.generator.garments import OutfitDesign, design_to_dict, outfit
from gcd_dataset.generator.garments.outfit import BACKS
from gcd_dataset.generator.garments.parameter import Choice
from gcd_dataset.generator.garments.space import DesignSpace
from gcd_dataset.generator.garments.wardrobe import Bottom, Upper
from gcd_dataset.generator.garments.wearable import wearable
from gcd_dataset.measurements import MEASURES, Measurements
from gcd_dataset.records import Pattern
from gcd_dataset.validate import Severity, check_pattern
from gcd_dataset.workers import parallel_map

__all__ = [
    "SMOKE",
    "TASKS",
    "USUAL",
    "Answer",
    "Designs",
    "ParameterNet",
    "ParametersConfig",
    "ToDesigns",
    "Words",
    "build",
    "drawn",
]

TASKS = ("T0", "T1", "T1-scan")
FEW = 12  # a whole number of at most this many values is a choice among them
VALUE_BEND = 0.05  # share of a range, or of a deviation: errors below it count by their square
LARGEST_BACK = 0.95  # of the girth
WEIGHTS = {"choices": 1.0, "numbers": 5.0, "defaults": 0.5, "measures": 1.0}
USUAL: Mapping[str, Any] = {"batch": 256, "lr": 5e-4}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {
    "steps": 250, "batch": 8, "lr": 3e-3, "weight_decay": 0.0, "ema": 0.9, "log_every": 10, "checks": 2,
}  # fmt: skip
SMALL: Mapping[str, Any] = {
    "tokens": 32, "width": 64, "heads": 4, "layers": 1, "region_width": 32, "points": 256, "stored_points": 1024,
}  # fmt: skip
"""Options of the smallest training, for two CPU cores, and the sizes of its network."""
LEAVES = tuple(leaf.path for leaf in PARAMETERS)
META = tuple(LEAVES.index(path) for path in ("meta.upper", "meta.wb", "meta.bottom"))


@dataclass(frozen=True, slots=True)
class ParametersConfig(EncoderConfig):
    """Sizes of a network; half as many layers as the encoder's, rounded up, relate the queries to its tokens."""

    points: int = 4096
    """Points of a garment in a step."""
    stored_points: int = 8192
    """Points that they are drawn from."""


# ---------------------------------------------------------------------------------------------------------- the targets


@dataclass(frozen=True)
class Designs(TensorExamples):
    """Points of garments with the parameters and measures that they were drawn from."""

    points: Float[Tensor, "b n 6"]
    """Surface points relative to ``CENTRE`` [UNIT], and normals; f16."""
    codes: Float[Tensor, "b d"]
    """Rows of ``encode_design``; NaN for an unknown parameter."""
    effective: Bool[Tensor, "b d"]
    """Known parameters that have an effect."""
    measures: Float[Tensor, "b m"]
    """In the order of ``MEASURES`` [cm, degrees]; NaN for an unknown one."""


@dataclass(frozen=True)
class ToDesigns:
    """From garments with the field ``design`` to their ``Designs``, on a CPU."""

    points: int

    def __call__(self, garments: GarmentSet) -> Designs:
        codes = np.concatenate([garments.ragged["design"][k] for k in range(len(garments))]).astype(np.float32)
        effective = np.array([have_effect(decode_design(row)) for row in codes]).reshape(codes.shape)
        return Designs(
            points=self.scaled(garments.points),
            codes=torch.from_numpy(codes),
            effective=torch.from_numpy(effective & np.isfinite(codes)),
            measures=torch.from_numpy(garments.measures).float(),
        )

    def scaled(self, points: Float[np.ndarray, "g n 6"]) -> Float[Tensor, "g m 6"]:
        """The points of garments as networks read them."""
        found = torch.from_numpy(points[:, : self.points])
        return torch.cat([found[..., :3] / UNIT, found[..., 3:]], dim=-1)


@dataclass(frozen=True)
class DrawnDesigns:
    """Designs whose batches have some of the stored points, others in each step."""

    whole: Designs
    points: int

    def __len__(self) -> int:
        return len(self.whole)

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> Designs:
        found = self.whole.batch(rows)
        if chance is None:
            chosen = torch.arange(min(self.points, found.points.shape[1]))
        else:
            chosen = torch.randperm(found.points.shape[1], generator=chance)[: self.points]
        points = found.points[:, uploaded(chosen, found.device)]
        return Designs(points, found.codes, found.effective, found.measures)


# ---------------------------------------------------------------------------------------------------------- the network


@dataclass(frozen=True)
class Words:
    """What is said about a garment."""

    outputs: Float[Tensor, "b d o"]
    """Of a choice: logits of its options. Of a number: its value as a share of the range, and the default's logit."""
    measures: Float[Tensor, "b m"]
    """In deviations from the mean."""


class ParameterNet(Learner[Designs, Pattern]):
    """Points and normals to a design and measures, and so to a pattern."""

    mean: Tensor
    deviation: Tensor
    least: Tensor
    most: Tensor

    def __init__(self, config: ParametersConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or ParametersConfig()
        if not 1 <= config.tokens <= config.points or config.tokens & (config.tokens - 1):
            given = f"{config.tokens} tokens of {config.points} points"
            raise ConfigError(f"{given}: give a power of 2, at most the points")
        self.tokens = PointTokens(config)
        queries, width, options = len(PARAMETERS) + len(MEASURES), config.width, int(_TABLE.options.max())
        self.queries = nn.Parameter(torch.randn(queries, width))
        self.layers = nn.ModuleList(
            DecoderLayer(width, config.heads, 4 * width) for _ in range((config.layers + 1) // 2)
        )
        self.norm = nn.LayerNorm(width)
        self.weights = nn.Parameter(torch.randn(queries, width, options) / width)
        self.biases = nn.Parameter(torch.zeros(queries, options))
        for name in ("mean", "deviation", "least", "most"):
            self.register_buffer(name, torch.zeros(len(MEASURES)))
        for name, column in vars(_TABLE).items():
            self.register_buffer(f"table_{name}", torch.from_numpy(column), persistent=False)

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> DrawnDesigns:
        """Targets of the garments. The first set prepared, the training set, gives the range of the measures."""
        bare = replace(garments, points=garments.points[:, :0])
        parts = (bare.select(range(k, min(k + CHUNK, len(bare)))) for k in range(0, len(bare), CHUNK))
        whole = Designs.join(list(parallel_map(self.encoder(), parts, workers)))
        whole = replace(whole, points=self.encoder().scaled(garments.points))
        if not self.deviation.any():
            known = garments.measures[np.isfinite(garments.measures).all(axis=1)].astype(np.float64)
            if not len(known):
                raise ConfigError("no garment with all measures of its body: give garments that gcd_dataset made")
            self.mean.copy_(torch.from_numpy(known.mean(axis=0)))
            self.deviation.copy_(torch.from_numpy(known.std(axis=0)).clamp(min=1e-3))
            self.least.copy_(torch.from_numpy(known.min(axis=0)))
            self.most.copy_(torch.from_numpy(known.max(axis=0)))
        return DrawnDesigns(whole.to(device), self.config.points)

    def drawn_from(self, encoded: TensorExamples) -> DrawnDesigns:
        return DrawnDesigns(cast(Designs, encoded), self.config.points)

    def encoder(self) -> ToDesigns:
        return ToDesigns(self.config.stored_points)

    def compile_parts(self) -> None:
        self.tokens.encoder.compile()
        for layer in self.layers:
            layer.compile()

    def said(self, points: Float[Tensor, "b n 6"]) -> Words:
        """What the queries say."""
        tokens = self.tokens(points)
        queries = self.queries.expand(len(tokens), -1, -1)
        for layer in self.layers:
            queries = layer(queries, tokens)
        with torch.autocast(points.device.type, enabled=False):
            found = torch.einsum("bqw,qwo->bqo", self.norm(queries.float()), self.weights) + self.biases
        count = len(PARAMETERS)
        return Words(found[:, :count], found[:, count:, 0])

    def loss(self, batch: Designs) -> dict[str, Tensor]:
        words = self.said(batch.points)
        with torch.autocast(batch.points.device.type, enabled=False):
            table = self._table()
            codes, outputs = batch.codes.nan_to_num(), words.outputs
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
            known = batch.measures.isfinite()
            apart = words.measures - ((batch.measures - self.mean) / self.deviation).nan_to_num()
            zero = torch.zeros_like(apart)
            parts = {
                "choices": mean_of(choices, batch.effective & is_choice),
                "numbers": mean_of(numbers, batch.effective & ~is_choice & ~is_default),
                "defaults": mean_of(defaults, batch.effective & ~is_choice & table.kept),
                "measures": mean_of(functional.smooth_l1_loss(apart, zero, beta=VALUE_BEND, reduction="none"), known),
            }
        return {name: WEIGHTS[name] * part for name, part in parts.items()}

    def _table(self) -> "Table":
        return Table(**{name: getattr(self, f"table_{name}") for name in vars(_TABLE)})

    def _logits(self, outputs: Float[Tensor, "b d o"]) -> Float[Tensor, "b d o"]:
        """Logits of the options; those beyond a parameter's own are never chosen."""
        option = torch.arange(outputs.shape[-1], device=outputs.device)
        return outputs.masked_fill(option >= self.table_options.clamp(min=1)[:, None], NEVER)  # type: ignore[operator]

    # ------------------------------------------------------------------------------------------------------ the answers

    def predict(self, batch: Designs) -> list[Pattern]:
        return [drawn(one) for one in self._answers(batch)]

    def answers(self, examples: Examples[Designs], count: int, *, batch: int, workers: int = 0) -> Iterator[Pattern]:
        rows = torch.split(torch.arange(count), batch)
        said = [one for part in rows for one in self._answers(examples.batch(part))]
        return parallel_map(drawn, said, workers)

    @torch.no_grad()
    def _answers(self, batch: Designs) -> list["Answer"]:
        words, table = self.said(batch.points[:, : self.config.points]), self._table()
        logits = self._logits(words.outputs).log_softmax(dim=-1)
        chosen = logits.argmax(dim=-1) + table.low
        values = table.low + words.outputs[..., 0] * table.extent
        values = torch.where((words.outputs[..., 1] > 0) & table.kept, table.default, values)
        codes = torch.where(table.options > 0, chosen, values)
        joint = _OUTFITS.to(logits.device)
        likelihood = logits[:, META[0], joint[:, 0]] + logits[:, META[1], joint[:, 1]] + logits[:, META[2], joint[:, 2]]
        codes[:, list(META)] = joint[likelihood.argmax(dim=1)].to(codes.dtype)
        measures = (words.measures * self.deviation + self.mean).clamp(self.least, self.most)
        pairs = zip(codes.cpu().numpy(), measures.double().cpu().numpy(), strict=True)
        return [Answer(row, sizes, self.mean.double().cpu().numpy()) for row, sizes in pairs]


def build(*, smoke: bool, options: Mapping[str, Any]) -> ParameterNet:
    """The learner; ``options``: fields of ``ParametersConfig``."""
    given = {**(SMALL if smoke else {}), **options}
    unknown = set(given) - set(ParametersConfig.__dataclass_fields__)
    if unknown:
        known = ", ".join(ParametersConfig.__dataclass_fields__)
        raise ConfigError(f"no size {min(unknown)} of a parameters network: choose of {known}")
    return ParameterNet(ParametersConfig(**given))


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
    """Rows of the options of upper, waistband and bottom of all outfits that exist."""
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
    size, usual = _size(answer.measures), _size(answer.usual)
    design = decode_design(answer.codes)
    for number in range(5):
        pattern = _tried(design, size, usual, number)
        if pattern is not None:
            return pattern
    raise ConfigError("no circle skirt can be drawn for the mean body of the training set: give other garments")


def _tried(design: OutfitDesign, size: Measurements, usual: Measurements, number: int) -> Pattern | None:
    try:
        if number == 1:
            design = wearable(design, [size], np.random.default_rng(0), DesignSpace.declared(OutfitDesign)).design
        if number in (2, 3):
            design = _with_defaults(design)
        if number == 4:
            design = decode_design(encode_design({"meta": {"bottom": Bottom.CIRCLE.value}}))
        pattern = outfit(size if number < 3 else usual, design)
    except GcdError:
        return None
    return None if any(fault.severity is Severity.ERROR for fault in check_pattern(pattern)) else pattern


def _with_defaults(design: OutfitDesign) -> OutfitDesign:
    """The design with its choices alone."""
    codes = encode_design(design_to_dict(design))
    is_number = np.array([not isinstance(leaf.space, Choice) for leaf in PARAMETERS])
    return decode_design(np.where(is_number, np.nan, codes))


def _size(measures: Float[np.ndarray, " m"]) -> Measurements:
    """The measures, with backs that are part of their girths."""
    values = dict(zip(MEASURES, measures.tolist(), strict=True))
    for back, girth in BACKS:
        values[back] = min(values[back], LARGEST_BACK * values[girth])
    return Measurements.from_file_values(values)
