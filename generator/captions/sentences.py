"""Sentences from the facts of a garment, at three lengths. Random choices decide wordings and forms, never facts."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain

import numpy as np

from gcd_dataset.captions import LEVELS
from gcd_dataset.generator.captions.facts import GarmentFacts
from gcd_dataset.generator.garments.description import Words, Zone, joined, with_article

MOST_SHORT_WORDS = 12
USUAL_SHORT_WORDS = 10
MOST_LISTED = 4  # details in one sentence
UPPER = (Zone.NECK, Zone.SLEEVES, Zone.BODY)


@dataclass(frozen=True, slots=True)
class Said:
    """A caption, and the facts that it states: words and noun phrases of its text."""

    text: str
    facts: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Phrase:
    """The chosen wording of a detail."""

    text: str
    place: Zone
    main: bool


@dataclass(frozen=True, slots=True)
class _Garment:
    """The facts of a garment, each in its chosen wording."""

    adjectives: tuple[str, ...]  # in their order before the noun
    noun: str
    parts: tuple[str, ...]
    lower: str
    details: tuple[_Phrase, ...]
    is_plural: bool

    @property
    def named(self) -> tuple[str, ...]:
        """The facts of the garment's name."""
        return (*self.adjectives, self.noun)

    def head(self) -> str:
        """The garment's name with its article."""
        return _noun_phrase(" ".join(self.named))

    @property
    def it_has(self) -> str:
        return "They have" if self.is_plural else "It has"


def say(facts: GarmentFacts, rng: np.random.Generator) -> Mapping[str, Said]:
    """The caption of each of ``LEVELS``; each states the facts of the one before, in the same words, and more."""
    garment = _chosen(facts, rng)
    return dict(zip(LEVELS, (_short(garment), _medium(garment), _full(facts, garment, rng)), strict=True))


def _chosen(facts: GarmentFacts, rng: np.random.Generator) -> _Garment:
    """Each fact in one of its wordings."""

    def pick(words: Words) -> str:
        return words[int(rng.integers(len(words)))]

    length = (facts.length,) if facts.length else ()
    return _Garment(
        adjectives=tuple(pick(words) for words in (*facts.traits, *length, *facts.cut)),
        noun=pick(facts.noun),
        parts=tuple(pick(words) for words in facts.parts),
        lower=facts.lower,
        details=tuple(_Phrase(pick(detail.words), detail.place, detail.main) for detail in facts.details),
        is_plural=facts.is_plural,
    )


def _short(garment: _Garment) -> Said:
    """The name with its parts, or with its first main detail that is short enough."""
    head, named = garment.head(), garment.named
    options: list[tuple[str, ...]] = [(detail.text,) for detail in garment.details if detail.main]
    if garment.parts:
        options = [garment.parts, garment.parts[-1:]]
    for most in (USUAL_SHORT_WORDS, MOST_SHORT_WORDS):
        for option in options:
            text = f"{head} with {joined(map(_noun_phrase, option) if garment.parts else option)}"
            if len(text.split()) <= most:
                return Said(_sentence(text), (*named, *option))
    return Said(_sentence(head), named)


def _medium(garment: _Garment) -> Said:
    """The name with its parts, and the main details; one more detail if the short caption states all these."""
    main = [detail.text for detail in garment.details if detail.main]
    if set(_short(garment).facts) >= {*garment.named, *garment.parts, *main}:
        main += [detail.text for detail in garment.details if not detail.main][:1]
    facts = (*garment.named, *garment.parts, *main)
    if garment.parts:
        first = f"{garment.head()} with {joined(map(_noun_phrase, garment.parts))}"
        return Said(_sentence(first, *([f"{garment.it_has} {joined(main)}"] if main else [])), facts)
    now, later = main[:MOST_LISTED], main[MOST_LISTED:]
    extra = [f"{garment.it_has} {joined(later)} too"] if later else []
    return Said(_sentence(f"{garment.head()} with {joined(now)}", *extra), facts)


def _full(facts: GarmentFacts, garment: _Garment, rng: np.random.Generator) -> Said:
    """All facts, from the top down."""
    head = garment.head()
    if garment.parts:
        head = f"{head} with {joined(map(_noun_phrase, garment.parts))}"
    sentences = [head]
    for number, (subject, listed) in enumerate(_paragraph(garment)):
        verb = "have" if subject in ("They", "The trousers", "The shorts") else "has"
        if subject == "It" and number == 0:
            verb = str(rng.choice(["has", "features"]))
        elif number:
            verb = f"also {verb}" if subject in ("It", "They") else verb
        sentences.append(f"{subject} {verb} {joined(listed)}")
    sentences[-1] += _symmetry(facts, garment, rng)
    said = chain.from_iterable(listed for _, listed in _paragraph(garment))
    return Said(_sentence(*sentences), (*garment.named, *garment.parts, *said))


def _paragraph(garment: _Garment) -> list[tuple[str, list[str]]]:
    """Subject and details of each sentence after the first."""
    it = "They" if garment.is_plural else "It"

    def at(*places: Zone) -> list[str]:
        return [detail.text for detail in garment.details if detail.place in places]

    if garment.parts:
        above = at(*UPPER, Zone.WAIST)
        if len(above) > MOST_LISTED:
            groups = [("It", at(Zone.NECK, Zone.SLEEVES)), ("It", at(Zone.BODY, Zone.WAIST))]
        else:
            groups = [("It", above)]
        groups.append((f"The {garment.lower}", at(Zone.LOWER, Zone.HEM)))
    elif garment.lower:
        groups = [(it, at(Zone.WAIST, Zone.LOWER)), (it, at(Zone.HEM))]
    else:
        groups = [(it, at(Zone.NECK, Zone.SLEEVES)), (it, at(Zone.BODY, Zone.WAIST, Zone.HEM))]
        if len(garment.details) <= MOST_LISTED:
            groups = [(it, at(*Zone))]
    return [(subject, listed) for subject, listed in groups if listed]


def _symmetry(facts: GarmentFacts, garment: _Garment, rng: np.random.Generator) -> str:
    """A clause about the two sides, or nothing."""
    if facts.is_symmetrical:
        return str(rng.choice([", and both sides match", ", and left and right are alike"]))
    if "asymmetric" in garment.adjectives:
        return str(rng.choice([", and the two sides differ", ", and left and right are cut differently"]))
    return ""


def _noun_phrase(noun: str) -> str:
    """The noun with its article; a plural without."""
    return noun if noun.endswith(("trousers", "shorts")) else with_article(noun)


def _sentence(*clauses: str) -> str:
    """Clauses as sentences."""
    return " ".join(f"{clause[0].upper()}{clause[1:]}." for clause in clauses)
