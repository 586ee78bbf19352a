"""The findings of an examination, as text and as JSON."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from gcd_dataset.check.checks import CHECKS, Check, Harm

EXAMPLES = 5
MOST_DETAILS = 1000  # different faults of one check that are kept
WIDTH = 9  # characters of the left column
ORDER = {Harm.HARMFUL: 0, Harm.WARNING: 1, Harm.NOTE: 2}


@dataclass(frozen=True, slots=True)
class Finding:
    """One kind of fault in one split."""

    check: Check
    split: str
    """``files`` for a fault outside of the splits."""
    count: int
    """Garments, or files, with the fault."""
    total: int
    """Garments examined in the split; 0 where ``count`` does not count garments."""
    details: Mapping[str, int] = field(default_factory=dict)
    """The fault in words to the number of garments, the most frequent first."""
    examples: tuple[str, ...] = ()
    """Keys or names of the first garments."""
    harm: Harm = Harm.HARMFUL

    def to_json(self) -> dict[str, Any]:
        """Name, harm, effect and remedy of the check, with the figures."""
        return {
            "check": self.check.name,
            "harm": self.harm.value,
            "split": self.split,
            "count": self.count,
            "total": self.total,
            "fault": self.check.fault,
            "details": dict(self.details),
            "examples": list(self.examples),
            "effect": self.check.effect,
            "remedy": self.check.remedy,
        }

    def lines(self) -> Iterator[str]:
        """The finding for a terminal."""
        number = f"{self.count}"
        if self.check.counts_garments:
            number = f"{self.count} of {self.total} garments" if self.total else "garments"
        yield f"{self.harm.upper():<{WIDTH}}{self.split}: {number} {self.check.fault} ({self.check.name})"
        for text, count in self.details.items():
            yield f"{'':<{WIDTH}}  {text}" + (f" ({count})" if count > 1 else "")
        if self.examples:
            more = ", …" if self.count > len(self.examples) else ""
            yield f"{'':<{WIDTH}}keys: {', '.join(self.examples)}{more}"
        yield f"{'':<{WIDTH}}effect: {self.check.effect}"
        yield f"{'':<{WIDTH}}remedy: {self.check.remedy}"


@dataclass(frozen=True, slots=True)
class SplitSummary:
    """Counts of one split."""

    name: str
    count: int
    examined: int
    """Garments read; fewer than ``count`` with ``quick``."""
    shares: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Grade, outcome, upper and bottom, each value to its number of garments."""
    medians: Mapping[str, float] = field(default_factory=dict)
    """Of panels, seams and vertices."""

    def lines(self) -> Iterator[str]:
        """The counts for a terminal."""
        part = "" if self.examined == self.count else f", {self.examined} examined"
        medians = ", ".join(f"{value:.0f} {name}" for name, value in self.medians.items())
        yield f"{self.name}: {self.count} garments{part}" + (f"; median {medians}" if medians else "")
        for name, amounts in self.shares.items():
            yield f"  {name}: " + ", ".join(f"{value} {count / self.examined:.0%}" for value, count in amounts.items())


@dataclass(frozen=True, slots=True)
class Report:
    """The result of an examination: findings, the most harmful first."""

    source: str
    splits: tuple[SplitSummary, ...]
    findings: tuple[Finding, ...]
    faults: tuple[str, ...] = ()
    """Damaged, missing and unlisted files of a folder of shards, one line each."""
    seconds: float = 0.0

    @property
    def harmful(self) -> tuple[Finding, ...]:
        """The findings that stop or spoil a training."""
        return tuple(finding for finding in self.findings if finding.harm is Harm.HARMFUL)

    def finding(self, name: str) -> Finding | None:
        """The first finding of a check; ``None`` without one."""
        return next((finding for finding in self.findings if finding.check.name == name), None)

    def to_json(self) -> dict[str, Any]:
        """The whole report as JSON values."""
        splits = [asdict(split) for split in self.splits]
        findings = [finding.to_json() for finding in self.findings]
        figures = {"faults": list(self.faults), "seconds": round(self.seconds, 2)}
        return {"source": self.source, "splits": splits, "findings": findings, **figures}

    def lines(self) -> Iterator[str]:
        """The report for a terminal."""
        yield self.source
        for split in self.splits:
            yield from split.lines()
        yield from self.faults
        for finding in self.findings:
            yield ""
            yield from finding.lines()
        yield ""
        count = Counter(finding.harm for finding in self.findings)
        if not count[Harm.HARMFUL] and not self.faults:
            yield f"nothing harmful found{_others(count)}"
        else:
            faults = f", {len(self.faults)} in files and splits" if self.faults else ""
            yield f"{count[Harm.HARMFUL]} harmful{_others(count)}{faults}"


def _others(count: Counter[Harm]) -> str:
    parts = [f"{count[harm]} {harm.value}{'s' if count[harm] > 1 else ''}" for harm in (Harm.WARNING, Harm.NOTE)]
    return "".join(f", {part}" for part, harm in zip(parts, (Harm.WARNING, Harm.NOTE), strict=True) if count[harm])


class Tally:
    """Collects faults and joins those of one check and split."""

    def __init__(self) -> None:
        self._count: Counter[tuple[Check, str]] = Counter()
        self._details: dict[tuple[Check, str], Counter[str]] = {}
        self._examples: dict[tuple[Check, str], list[str]] = {}

    def add(self, check: Check, split: str, key: str, details: Iterable[str] = (), count: int = 1) -> None:
        """Count garments or files with a fault; ``details``: the fault in words, without the garment's figures."""
        at = (check, split)
        self._count[at] += count
        amounts = self._details.setdefault(at, Counter())
        for text in details:
            if text in amounts or len(amounts) < MOST_DETAILS:
                amounts[text] += count
        examples = self._examples.setdefault(at, [])
        if key and len(examples) < EXAMPLES:
            examples.append(key)

    def wants_example(self, check: Check, split: str) -> bool:
        """Whether the key of one more garment would be listed."""
        return len(self._examples.get((check, split), ())) < EXAMPLES

    def count(self, check: Check, split: str) -> int:
        """Number of garments or files with a fault."""
        return self._count[check, split]

    def findings(self, totals: Mapping[str, int], harms: Mapping[tuple[Check, str], Harm]) -> tuple[Finding, ...]:
        """The findings in order of harm; ``totals``: split to garments examined; ``harms``: where not the check's."""
        found = [
            Finding(
                check,
                split,
                count,
                totals.get(split, 0) if check.counts_garments else 0,
                dict(self._details[check, split].most_common(EXAMPLES)),
                tuple(self._examples[check, split]),
                harms.get((check, split), check.harm),
            )
            for (check, split), count in self._count.items()
        ]
        return tuple(sorted(found, key=lambda f: (ORDER[f.harm], CHECKS.index(f.check), -f.count)))
