"""Make drafts wearable: apply limits first, then remedies for faults in sewing or fit.

A parameter outside a limit is drawn again within the limit. For a fault that no limit describes, remedies are tried in
order: each draws one parameter, or some parts of the design, again and leaves the others as they are. Each redraw is
counted with its rule and its parameter; ``rules.py`` rejects designs with remaining faults.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from math import inf
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from gcd_dataset.generator.garments.assembly import bottom_rise
from gcd_dataset.generator.garments.design import GarmentDesign, MetaDesign, choice_of
from gcd_dataset.generator.garments.garment import GarmentChoice
from gcd_dataset.generator.garments.rules import (
    FIRM_BAND,
    LIGHT_LENGTH,
    LIGHT_SUNS,
    bottom_length,
    broken_by_weight,
    garment_length,
    has_firm_band,
    has_snug_band,
    has_tight_bottom,
    has_tight_cuffs,
    is_flared,
    is_gathered,
    is_too_tight,
    room_to_floor,
    top_girth,
    top_of_bottom,
    top_parameter,
)
from gcd_dataset.generator.garments.sewable import (
    SewingFault,
    SoundOutlines,
    bottom_fault,
    half_fault,
    sleeve_tightness,
    upper_fault,
    widest_neckline,
)
from gcd_dataset.generator.garments.skirt import SHORTEST
from gcd_dataset.generator.garments.space import Design, DesignSpace, redrawn, value_at, with_value
from gcd_dataset.generator.garments.upper import Shirt
from gcd_dataset.records import Measurements

TRIES = 4  # redraws by one remedy
MOST_REPAIRS = 10  # removed faults of a design: removing one may cause another

FindFault: TypeAlias = Callable[[GarmentDesign], SewingFault | None]
"""Returns the first fault of a design, or ``None``."""


class Redraw(NamedTuple):
    """The reason for a redraw, and the path of the parameter or part drawn again."""

    rule: str
    path: str


class Remedy(NamedTuple):
    """A parameter, or parts of a design, to draw again."""

    paths: tuple[str, ...]
    low: bool = False
    """Whether each redraw must give a lower number than the last."""
    high: bool = False
    """Whether each redraw must give a higher number than the last."""


@dataclass(frozen=True)
class DrawnDesign:
    """A random design, and the number of each of its redraws."""

    design: GarmentDesign
    redraws: Mapping[Redraw, int]

    def by_rule(self) -> Counter[str]:
        """Rule to the number of redraws that it caused."""
        total: Counter[str] = Counter()
        for redraw, count in self.redraws.items():
            total[redraw.rule] += count
        return total


@dataclass(frozen=True)
class Redrawing:
    """Draws parameters of a design again and counts the redraws."""

    rng: np.random.Generator
    space: DesignSpace[GarmentDesign]
    counts: Counter[Redraw] = field(default_factory=Counter)

    def again(
        self, design: GarmentDesign, rule: str, *paths: str, low: float = -np.inf, high: float = np.inf
    ) -> GarmentDesign:
        """The design with the parameters or parts at some paths drawn again, between ``low`` and ``high``.

        A part keeps its choices of garments, such as the base of a levels skirt: another garment has another section.
        """
        for path in paths:
            values = value_at(self.space, design, path)
            values = vars(values) if isinstance(values, Design) else {}
            garments = {name: value for name, value in values.items() if isinstance(value, GarmentChoice)}
            design = redrawn(self.space, design, path, self.rng, low, high)
            if garments:
                design = with_value(self.space, design, path, replace(value_at(self.space, design, path), **garments))
            self.counts[Redraw(rule, path)] += 1
        return design

    def within(self, design: GarmentDesign, rule: str, path: str, low: float, high: float) -> GarmentDesign:
        """The design; if the number at ``path`` is outside its limits, with this number drawn again within them."""
        if low <= value_at(self.space, design, path) <= high:
            return design
        return self.again(design, rule, path, low=low, high=high)

    def tried(self, design: GarmentDesign, rule: str, remedy: Remedy) -> Iterator[GarmentDesign]:
        """Up to ``TRIES`` designs, each the last one with the remedy applied again; unchanged designs are left out."""
        trial = design
        for _ in range(TRIES):
            low, high = -np.inf, np.inf
            if remedy.low or remedy.high:
                last = value_at(self.space, trial, remedy.paths[0])
                # Strictly beyond: a default equal to the last value would be kept with its probability.
                low, high = (low, np.nextafter(last, -np.inf)) if remedy.low else (np.nextafter(last, np.inf), high)
            trial = self.again(design, rule, *remedy.paths, low=low, high=high)
            if trial != design:
                yield trial

    def repaired(
        self,
        design: GarmentDesign,
        find: FindFault,
        remedies: Callable[[SewingFault], Sequence[Remedy]],
        *,
        limited: Callable[[GarmentDesign], GarmentDesign] = lambda design: design,
    ) -> GarmentDesign:
        """The design without faults; if no remedy helps, with the fault that no remedy could remove.

        ``limited`` puts a design with new parameters back within its limits.
        """
        fault = find(design)
        for _ in range(MOST_REPAIRS):
            if fault is None:
                break
            trials = chain.from_iterable(self.tried(design, fault.rule, remedy) for remedy in remedies(fault))
            found = ((trial, find(trial)) for trial in map(limited, trials))
            others = (pair for pair in found if pair[1] is None or pair[1].part != fault.part)
            design, left = next(others, (design, fault))
            if left is fault:
                break
            fault = left
        return design


# A shirt with a band or bottom sewn to its hem ends near the waist, where both have about the same girth.
JOINED_SHIRT = (0.8, 1.3)  # limits of shirt.length for such a shirt
WIDEST_END = 2.0  # largest sleeve.end_width
LEFT = "left."
TRUNK = "trunk"  # the part at fault where cloth is too tight or too heavy for the wearer
FLARED_CUFF = "sl_right_cuff_skirt_f"


def _remedies(*paths: str) -> tuple[Remedy, ...]:
    """The remedies for paths, which may end in ``-`` or ``+``: see ``BottomGarment.remedies``."""
    return tuple(Remedy((path.rstrip("+-"),), low=path.endswith("-"), high=path.endswith("+")) for path in paths)


def _half_remedies(half: str) -> Mapping[str, tuple[Remedy, ...]]:
    """Panel at fault of a shirt's half to the remedies; the empty name: a seam does not match or drawing fails.

    Both halves of a neckline have the same depth.
    """
    return {
        "right_ftorso": _remedies("collar.fc_depth-", f"{half}collar.f_collar", f"{half}collar.width"),
        "right_btorso": _remedies("collar.bc_depth-", f"{half}collar.b_collar", f"{half}collar.width"),
        FLARED_CUFF: _remedies(f"{half}sleeve.cuff.skirt_flare-", f"{half}sleeve.cuff.cuff_len+"),
        "": _remedies(f"{half}shirt.flare-", f"{half}collar.width", f"{half}shirt.width"),
    }


SHIRT_REMEDIES, LEFT_REMEDIES = _half_remedies(""), _half_remedies(LEFT)
"""For the right half of a shirt, and for the left half of an asymmetric one."""
WHOLE_SHIRT = tuple(map(Remedy, (("collar",), ("sleeve", "collar"), ("shirt", "sleeve", "collar"))))
WHOLE_LEFT = tuple(map(Remedy, (("left.collar",), ("left.shirt", "left.sleeve", "left.collar"))))


def wearable(
    draft: GarmentDesign, wearers: Sequence[Measurements], rng: np.random.Generator, space: DesignSpace[GarmentDesign]
) -> DrawnDesign:
    """The draft with parameters redrawn until all ``wearers`` can wear it, as far as remedies help."""
    redrawing = Redrawing(rng, space)
    fitting = _Fitting(redrawing, tuple(wearers))
    design = fitting.with_band(draft)
    if design.meta.upper:
        design = fitting.with_upper(design)
    if design.meta.bottom:
        design = fitting.with_bottom(design)
    design = fitting.with_lower_band(fitting.with_room(design))
    if design.meta.bottom:
        design = fitting.with_light_cloth(design)
    return DrawnDesign(design, dict(redrawing.counts))


@dataclass(frozen=True)
class _Fitting:
    """Limits and remedies of one design for its wearers."""

    redrawing: Redrawing
    sizes: tuple[Measurements, ...]
    sound: SoundOutlines = field(default_factory=set)

    def with_band(self, design: GarmentDesign) -> GarmentDesign:
        """The design; a waistband without an upper is at most as wide as the trunk."""
        if not design.meta.wb or design.meta.upper:
            return design
        snug = replace(design, waistband=replace(design.waistband, waist=1.0))
        widest = min(max(size.waist, size.hips) / top_girth(size, snug) for size in self.sizes)
        return self.redrawing.within(design, "slides_off", "waistband.waist", 1.0, widest)

    def with_upper(self, design: GarmentDesign) -> GarmentDesign:
        """The design with an upper that can be sewn and worn."""
        assert design.meta.upper is not None
        garment = design.meta.upper.garment
        if isinstance(garment, Shirt):
            limited = self._with_shoulders
            design = self._with_wide_ends(limited(design))
            return self.redrawing.repaired(design, self._shirt_fault, _shirt_remedies, limited=limited)
        section = Remedy((garment.section,))
        return self.redrawing.repaired(
            design,
            lambda trial: _first(upper_fault(size, trial, self.sound) for size in self.sizes),
            lambda fault: (section,),
        )

    def _with_wide_ends(self, design: GarmentDesign) -> GarmentDesign:
        """The design with sleeves whose ends are wide enough for the arms."""
        for number, prefix in enumerate(("", LEFT)[: len(design.halves())]):
            for _ in range(TRIES):
                tightness = max(sleeve_tightness(size, design, design.halves()[number]) for size in self.sizes)
                if tightness <= 1:
                    break
                design = self._with_wider_end(design, f"{prefix}sleeve", tightness)
        return design

    def _with_wider_end(self, design: GarmentDesign, path: str, tightness: float) -> GarmentDesign:
        """The design with fewer gathers over the cuff; if they do not suffice, a wider end; else a longer sleeve."""
        sleeve = value_at(self.redrawing.space, design, path)
        gathers = sleeve.cuff.top_ruffle if sleeve.cuff.type else 1.0
        ruffle, end = gathers / tightness, sleeve.end_width * tightness / gathers
        if ruffle >= 1:
            return self.redrawing.again(design, "tight_cuff", f"{path}.cuff.top_ruffle", high=ruffle)
        if end <= WIDEST_END:
            return self.redrawing.again(design, "tight_cuff", f"{path}.end_width", low=end)
        return self.redrawing.again(design, "tight_cuff", f"{path}.length", low=sleeve.length)

    def _shirt_fault(self, design: GarmentDesign) -> SewingFault | None:
        """The first fault of a half; for the left half ``part`` begins with ``LEFT``."""
        for prefix, half in zip(("", LEFT), design.halves(), strict=False):
            fault = _first(half_fault(size, design, half, self.sound) for size in self.sizes)
            if fault is not None:
                return SewingFault(fault.rule, prefix + fault.part)
        return None

    def _with_shoulders(self, design: GarmentDesign) -> GarmentDesign:
        """The design with an allowed shirt length, and with necklines that leave room for shoulder seams."""
        design = self._ending_in_place(design)
        for number, prefix in enumerate(("", LEFT)[: len(design.halves())]):
            widest = min(widest_neckline(size, design, design.halves()[number]) for size in self.sizes)
            if widest < inf:
                design = self.redrawing.again(design, "narrow_shoulder", f"{prefix}collar.width", high=widest)
        return design

    def _ending_in_place(self, design: GarmentDesign) -> GarmentDesign:
        """The design with a shirt that ends near the waist if a part is sewn to its hem, else above the floor."""
        assert design.meta.upper is not None
        if design.meta.upper.garment.at_waist:
            return design
        if design.meta.wb or design.meta.bottom:
            return self.redrawing.within(design, "off_the_waist", "shirt.length", *JOINED_SHIRT)
        longest = min(room_to_floor(size, design) / size.waist_line for size in self.sizes)
        return self.redrawing.within(design, "reaches_floor", "shirt.length", -np.inf, longest)

    def with_lower_band(self, design: GarmentDesign) -> GarmentDesign:
        """The design with the waistband lowered while a ring is too tight; a firm band stays firm."""
        for _ in range(TRIES if design.meta.wb else 0):
            if not self._is_tight(design):
                break
            height = design.waistband.width
            least = FIRM_BAND if height > FIRM_BAND else -inf
            design = self.redrawing.again(design, "too_tight", "waistband.width", low=least, high=height)
        return design

    def with_room(self, design: GarmentDesign) -> GarmentDesign:
        """The design with a straight shirt that leaves room for the hips.

        A shirt with a part sewn to its hem is shortened, so that the part is worn nearer to the waist, for which it is
        cut; a free hem is widened.
        """
        upper = design.meta.upper
        if upper is None or not isinstance(upper.garment, Shirt) or upper.garment.at_waist:
            return design
        fitting, joined = design, bool(design.meta.wb or design.meta.bottom)
        for _ in range(TRIES):
            if not self._is_tight(fitting):
                break
            if joined:
                shorter = float(np.nextafter(fitting.shirt.length, -inf))
                fitting = self.redrawing.again(
                    fitting, "too_tight", "shirt.length", low=min(shorter, JOINED_SHIRT[0]), high=shorter
                )
            else:  # more flare in the half that has less
                flares = [half[0].flare for half in fitting.halves()]
                least = int(np.argmin(flares))
                path, low = ("", LEFT)[least] + "shirt.flare", float(np.nextafter(flares[least], inf))
                fitting = self.redrawing.again(fitting, "too_tight", path, low=low)
        if fitting is design:
            return design
        return self.redrawing.repaired(fitting, self._shirt_fault, _shirt_remedies, limited=self._with_shoulders)

    def _is_tight(self, design: GarmentDesign) -> bool:
        return any(is_too_tight(size, design) for size in self.sizes)

    def with_light_cloth(self, design: GarmentDesign) -> GarmentDesign:
        """The design with a narrower or shorter bottom while shoulder seams or hips carry too much cloth."""

        def fault(trial: GarmentDesign) -> SewingFault | None:
            broken = next(filter(None, (broken_by_weight(size, trial) for size in self.sizes)), "")
            return SewingFault(broken, TRUNK) if broken else None

        if fault(design) is None:
            return design
        return self.redrawing.repaired(
            design,
            lambda trial: fault(trial) or self._bottom_fault(trial),
            lambda found: _load_remedies(design) if found.part == TRUNK else _bottom_remedies(design, found),
            limited=self._hanging_in_place,
        )

    def with_bottom(self, design: GarmentDesign) -> GarmentDesign:
        """The design with a bottom that can be sewn and worn, ends above the floor and suits the waistband."""
        limited = self._hanging_in_place
        return self.redrawing.repaired(
            limited(design), self._bottom_fault, partial(_bottom_remedies, design), limited=limited
        )

    def _hanging_in_place(self, design: GarmentDesign) -> GarmentDesign:
        """The design with a bottom that suits its band, as long as declared, above the floor, light if it flares."""
        design = self._with_snug_band(design)
        path, rise = _length_path(design), bottom_rise(design)
        # No skirt is drawn shorter than ``SHORTEST``, its waistband left out; lengths are fractions of hips to floor.
        least = max((SHORTEST - rise * size.hips_line) / size.leg_length for size in self.sizes)
        design = self.redrawing.within(design, "short_skirt", path, least, inf)
        excess = max((garment_length(s, design) - room_to_floor(s, design)) / s.leg_length for s in self.sizes)
        if excess > 0:
            design = self.redrawing.within(design, "reaches_floor", path, least, bottom_length(design) - excess)
        if design.meta.upper or not is_flared(design) or has_firm_band(design):
            return design
        design = self.redrawing.within(design, "too_heavy", path, least, LIGHT_LENGTH)
        return self._with_top_within(design, "fullness_parameter", -np.inf, LIGHT_SUNS, rule="too_heavy")

    def _bottom_fault(self, design: GarmentDesign) -> SewingFault | None:
        if any(has_tight_cuffs(size, design) for size in self.sizes):
            return SewingFault("tight_cuff", "cuff")
        if any(has_tight_bottom(size, design) for size in self.sizes):
            return SewingFault("too_tight", "ring")
        assert design.meta.bottom is not None
        garment = design.meta.bottom.garment
        is_plain = garment.always_sewable(garment.section_design(design))
        return None if is_plain else _first(bottom_fault(size, design, self.sound) for size in self.sizes)

    def _with_snug_band(self, design: GarmentDesign) -> GarmentDesign:
        """The design; a gathered bottom without upper gets a snug band, or no gathers if the overlay allows no band."""
        if design.meta.upper or not is_gathered(design) or has_snug_band(design):
            return design
        if top_parameter(design, "gather_parameter") <= 1:
            return design
        bands = choice_of(self.redrawing.space.of(MetaDesign), "wb")
        if all(option is None for option in bands.weighted_options):
            return self._with_top_within(design, "gather_parameter", 1.0, 1.0, rule="loose_gathers")
        if design.meta.wb is None:
            band = bands.only(present=True).draw(self.redrawing.rng)
            self.redrawing.counts[Redraw("loose_gathers", "meta.wb")] += 1
            design = replace(design, meta=replace(design.meta, wb=band))
            design = self.redrawing.again(design, "loose_gathers", "waistband")
        return self.redrawing.within(design, "loose_gathers", "waistband.waist", 1.0, 1.0)

    def _with_top_within(
        self,
        design: GarmentDesign,
        role: Literal["gather_parameter", "fullness_parameter"],
        low: float,
        high: float,
        *,
        rule: str,
    ) -> GarmentDesign:
        """The design with the parameter for gathers or fullness of the bottom's top within limits."""
        top = top_of_bottom(design)
        name = "" if top is None else getattr(top, role)
        if top is None or not name:
            return design
        return self.redrawing.within(design, rule, f"{top.section}.{name}", low, high)


def _first(faults: Iterable[SewingFault | None]) -> SewingFault | None:
    return next((fault for fault in faults if fault is not None), None)


def _shirt_remedies(fault: SewingFault) -> tuple[Remedy, ...]:
    if fault.part.startswith(LEFT):
        return LEFT_REMEDIES.get(fault.part.removeprefix(LEFT), ()) + WHOLE_LEFT
    return SHIRT_REMEDIES.get(fault.part, ()) + WHOLE_SHIRT


def _bottom_remedies(design: GarmentDesign, fault: SewingFault) -> tuple[Remedy, ...]:
    """Redraws of the parameters named for the fault by the bottom and its parts, then of their whole sections."""
    assert design.meta.bottom is not None
    garment = design.meta.bottom.garment
    parts = (garment, *garment.parts(design))
    sections = tuple(dict.fromkeys(part.section for part in parts))
    if fault.rule == "too_tight":
        named = dict.fromkeys(f"{part.section}.{part.widened_by}+" for part in parts if part.widened_by)
    else:
        named = dict.fromkeys(f"{part.section}.{path}" for part in parts for path in part.remedies)
    return (*_remedies(*named), Remedy(sections))


def _load_remedies(design: GarmentDesign) -> tuple[Remedy, ...]:
    """A bottom of less cloth; if it does not suffice, straps."""
    top = top_of_bottom(design)
    full = (f"{top.section}.{top.fullness_parameter}-",) if top is not None and top.fullness_parameter else ()
    straps = ("shirt.strapless",) if design.meta.upper else ()
    return _remedies(*full, f"{_length_path(design)}-", *straps)


def _length_path(design: GarmentDesign) -> str:
    """The path of the bottom's ``length``."""
    assert design.meta.bottom is not None
    return f"{design.meta.bottom.garment.length_garment(design).section}.length"
