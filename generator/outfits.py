"""Outfits to be drawn: kinds of outfit, each a list of garments from the skin outwards.

A file of outfits is TOML: designs by name, each an overlay, and outfits that list them::

    [designs.shirt.meta]
    upper = "Shirt"
    bottom = "none"

    [[outfits]]
    weight = 3  # of all weights: how often
    worn = [{ design = "shirt", tucked = 0.6 }, { design = "trousers" }, { design = "jacket", closed = 0.5 }]

``tucked`` is the probability that the next garment goes over this one; otherwise this one is worn over the next, and
the two change places. ``closed`` is the probability that zip and buttons are closed (default: 1).

>>> from gcd_dataset.seeding import Stage, rng
>>> outfits = read_outfits("everyday")
>>> [len(outfits.draw(rng(0, number, Stage.OUTFIT))) for number in range(5)]
[2, 2, 2, 3, 2]
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.errors import ConfigError, did_you_mean, shown
from gcd_dataset.generator.dressing.frame import placed_outline
from gcd_dataset.generator.garments.design import MetaDesign, choice_of
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.garments.parameter import Flag
from gcd_dataset.generator.garments.sampling import HIPS_UNDER_SKIRT
from gcd_dataset.jsonfile import read_toml
from gcd_dataset.records import Body, Closure, Measurements, Outcome, Outfit, Pattern, WornGarment
from gcd_dataset.shards.layout import MOST_GARMENTS
from gcd_dataset.spec import is_trouser_leg

OUTFITS = ("everyday",)
"""The files of outfits in this package."""
BELOW_CROTCH = 10.0  # cm, a hand's breadth: the longest shirt tail that is tucked in


@dataclass(frozen=True)
class WornDesign:
    """A garment of an outfit, before its design is drawn."""

    design: Overlay
    tucked: bool = False
    closed: bool = True

    @cached_property
    def may_have_legs(self) -> bool:
        """Whether trousers may be drawn, so that the whole outfit is draped on a body with its legs apart."""
        bottoms = choice_of(self.design.space.of(MetaDesign), "bottom").weighted_options
        return any(bottom is not None and bottom.garment.legs for bottom in bottoms)

    @cached_property
    def may_have_sleeves(self) -> bool:
        """Whether a top with sleeves may be drawn."""
        uppers = choice_of(self.design.space.of(MetaDesign), "upper").weighted_options
        sleeveless = self.design.space.at("sleeve.sleeveless")
        return set(uppers) != {None} and isinstance(sleeveless, Flag) and False in sleeveless.weighted_options

    @property
    def is_skirt(self) -> bool:
        """Whether only skirts can be drawn, which hang on the hips."""
        uppers = choice_of(self.design.space.of(MetaDesign), "upper").weighted_options
        return set(uppers) == {None} and not self.may_have_legs


@dataclass(frozen=True)
class Kind:
    """A kind of outfit."""

    weight: float
    worn: tuple[tuple[Overlay, float | None, float], ...]
    """Design and probabilities of ``tucked`` and ``closed`` of each garment; ``None``: never tucked."""

    @cached_property
    def has_skirt(self) -> bool:
        """Whether one of its garments is a skirt, whatever is drawn."""
        return any(WornDesign(design).is_skirt for design, _, _ in self.worn)


@dataclass(frozen=True)
class Outfits:
    """Kinds of outfit; ``read_outfits`` makes one."""

    kinds: tuple[Kind, ...]
    content: Mapping[str, Any]
    """The content of the file; it decides what is drawn."""

    @property
    def most(self) -> int:
        """Number of garments of the largest outfit."""
        return max(len(kind.worn) for kind in self.kinds)

    def draw(self, rng: np.random.Generator, wearers: Iterable[Measurements] = ()) -> tuple[WornDesign, ...]:
        """The garments of a random outfit, from the skin outwards; without skirts where a wearer's hips hold none."""
        holds = all(size.hips - size.waist >= HIPS_UNDER_SKIRT for size in wearers)
        kinds = [kind for kind in self.kinds if holds or not kind.has_skirt] or self.kinds
        ends = np.cumsum([kind.weight for kind in kinds])
        kind = kinds[int(np.searchsorted(ends[:-1], ends[-1] * rng.random(), side="right"))]
        drawn = [
            WornDesign(one, rng.random() < (tucked or 0.0), rng.random() < closed) for one, tucked, closed in kind.worn
        ]
        for place, (_, tucked, _) in enumerate(kind.worn):
            if tucked is not None and not drawn[place].tucked:
                drawn[place : place + 2] = drawn[place + 1], drawn[place]
        return tuple(drawn)


def read_outfits(name_or_path: Path | str) -> Outfits:
    """One of ``OUTFITS``, or the outfits in a TOML file.

    Raises ``ConfigError`` with the file, the place and the fault.
    """
    path = Path(name_or_path)
    if str(name_or_path) in OUTFITS:
        path = Path(str(files("gcd_dataset.generator") / "data" / f"outfits_{name_or_path}.toml"))
    elif not path.suffix and not path.exists():
        nearest = did_you_mean(str(path), OUTFITS)
        raise ConfigError(f"no outfits {shown(str(path))}: there are {', '.join(OUTFITS)}, or a TOML file{nearest}")
    content = read_toml(path)
    try:
        return Outfits(_kinds(content), content)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def _kinds(content: Mapping[str, Any]) -> tuple[Kind, ...]:
    if unknown := sorted(content.keys() - {"designs", "outfits"}):
        raise ConfigError(f"no entry {shown(unknown[0])}: there are designs and outfits")
    designs, outfits = content.get("designs"), content.get("outfits")
    if not isinstance(designs, Mapping) or not isinstance(outfits, list) or not outfits:
        raise ConfigError("no outfits: give tables [designs.NAME] and [[outfits]]")
    overlays = {}
    for name, values in designs.items():
        try:
            overlays[name] = Overlay.from_dict(values)
        except (ConfigError, AttributeError, TypeError) as error:
            raise ConfigError(f"designs.{shown(name)}: {error}") from error
    return tuple(_kind(kind, overlays, f"outfit {number}") for number, kind in enumerate(outfits, 1))


def _kind(kind: Any, overlays: Mapping[str, Overlay], place: str) -> Kind:
    worn = kind.get("worn") if isinstance(kind, Mapping) else None
    if (
        not isinstance(worn, list)
        or not all(isinstance(one, Mapping) for one in worn)
        or kind.keys() - {"weight", "worn"}
    ):
        raise ConfigError(f'{place}: give weight and worn = [{{ design = "NAME" }}, …]')
    if not 2 <= len(worn) <= MOST_GARMENTS:
        raise ConfigError(f"{place}: {count_fault(len(worn))}")
    weight = kind.get("weight", 1)
    if type(weight) not in (int, float) or not 0 < weight < np.inf:
        raise ConfigError(f"{place}: weight is {weight!r:.99}: give a number above 0")
    names = [str(one.get("design")) for one in worn]
    for name, one in zip(names, worn, strict=True):
        if name not in overlays:
            raise ConfigError(f"{place}: no design {shown(name)}: there are {', '.join(overlays)}")
        if names.count(name) > 1:
            raise ConfigError(f"{place}: {shown(name)} is worn twice: name another design")
        for key, share in one.items():
            if key != "design" and (
                key not in ("tucked", "closed") or type(share) not in (int, float, bool) or not 0 <= share <= 1
            ):
                raise ConfigError(
                    f"{place}: {shown(name)} has {shown(key)} = {share!r:.99}: give tucked or closed, from 0 to 1"
                )
    if "tucked" in worn[-1]:
        raise ConfigError(
            f"{place}: {shown(names[-1])} is the outermost garment, which is tucked into none: leave it out"
        )
    shares = ((one.get("tucked"), float(one.get("closed", 1.0))) for one in worn)
    return Kind(float(weight), tuple((overlays[name], *pair) for name, pair in zip(names, shares, strict=True)))


def count_fault(count: int) -> str:
    """The message for an outfit with too few or too many garments."""
    return f"an outfit of {count} garment{'s' * (count != 1)}: give 2 to {MOST_GARMENTS}, from the skin outwards"


def worn_open(pattern: Pattern) -> Pattern:
    """The pattern with its zips and buttons open from end to end."""
    fastened = (Closure.ZIP, Closure.BUTTONS)
    seams = (replace(seam, closed=(0.0, 0.0)) if seam.closure in fastened else seam for seam in pattern.seams)
    return replace(pattern, seams=tuple(seams))


def order_fault(under: Sequence[Pattern], outer: Pattern, size: Measurements) -> str:
    """Why a garment cannot be worn over others, all placed on a wearer; empty if it can.

    A skirt or trousers go over cloth that their waist holds: over a top with a joined front that ends at most
    ``BELOW_CROTCH`` below the crotch; trousers also over other trousers, skirts over any garment without a top.
    """
    if _has_top(outer, size):
        return ""
    trousers = any(is_trouser_leg(panel.name) for panel in outer.panels)
    for inner in under:
        has_top = _has_top(inner, size)
        if has_top and any(seam.closure != Closure.SEWN and seam.joined == (0.0, 0.0) for seam in inner.seams):
            return f"{outer.name} over {inner.name}, whose front is open: give {outer.name} before it"
        legs = not has_top and any(is_trouser_leg(panel.name) for panel in inner.panels)
        hem = min(placed_outline(panel)[:, 1].min() for panel in inner.panels)
        below = size.leg_length - size.crotch_hip_diff - hem
        if (has_top or trousers) and not legs and below > BELOW_CROTCH:
            return (
                f"{outer.name} over {inner.name}, which hangs {below:.0f} cm below the crotch: a skirt or trousers "
                f"take in at most {BELOW_CROTCH:.0f} cm: give {outer.name} before it"
            )
    return ""


def is_tucked(inner: Pattern, outer: Pattern, size: Measurements) -> bool:
    """Whether a garment is tucked into the next one: a top into a skirt or trousers."""
    return _has_top(inner, size) and not _has_top(outer, size)


def worn_outfit(garments: Sequence[WornGarment], body: Body) -> Outfit:
    """The outfit, with the layers of its draped garments; they are counted on the CPU, on every machine alike."""
    from gcd_dataset.generator.drape import layers_of
    from gcd_dataset.generator.dressing.worn import WornCloth

    cloths = [
        WornCloth.of(one.box_mesh, one.drape.vertices)
        for one in garments
        if one.box_mesh and one.drape and one.drape.outcome is not Outcome.REFUSED
        if np.isfinite(one.drape.vertices).all()
    ]
    return Outfit(tuple(garments), layers_of(cloths, body, device="cpu") if len(cloths) > 1 else ())


def _has_top(pattern: Pattern, size: Measurements) -> bool:
    """Whether a garment reaches above the middle between waist and nape."""
    top = max(placed_outline(panel)[:, 1].max() for panel in pattern.panels)
    return bool(top > size.waist_level + 0.5 * size.waist_line)
