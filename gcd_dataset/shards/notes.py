"""The producer's note of a shard, ``train-00012.json``, and what is gathered from all notes of a data set.

A note holds all that manifest and index say of its shard, so that gathering reads no tars. It is a function of the
plan and the samples: a lost note is made again from the tar.

``rejects.jsonl`` lists the rejected attempts of the data set, one JSON object per line, by design and attempt:

==============  ====================================================================================================
``seed``        of the data set
``design``      number of the design: index of its first sample // wearers per design
``attempt``     0 for the first attempt at this design
``index``       the sample for which the attempt failed: the design did not fit its wearer, or its drape failed
``rule``        the rule that rejected it, as counted in ``manifest.json``; ``drape`` for a failed drape
``reason``      a sentence; for a drape its outcome
``figures``     the numbers behind the rule; names end in their units: ``{"cuff_cm": 29.9, "limb_cm": 35.5}``
==============  ====================================================================================================
"""

import hashlib
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from gcd_dataset.errors import ConfigError, ShardError, shown
from gcd_dataset.files import open_regular
from gcd_dataset.jsonfile import found
from gcd_dataset.patternhash import PatternHash, hash_pattern
from gcd_dataset.records import Outcome
from gcd_dataset.shards.access import REMEDY, Place, mapped, read_file, reading
from gcd_dataset.shards.codec import patterns_of
from gcd_dataset.shards.index import GRADES, OUTCOMES, SplitIndex, index_name
from gcd_dataset.shards.layout import BODIES, GARMENTS, LARGEST_MANIFEST, META, Bytes, is_picture, key_of
from gcd_dataset.shards.manifest import (
    MANIFEST,
    MOST,
    Manifest,
    Plan,
    RecipeRecord,
    ShardRecord,
    SplitRecord,
    checked,
    other_schema,
    parse_manifest,
    ranked,
    shard_name,
)
from gcd_dataset.shards.meta import checked_meta, decode_json, is_count, json_bytes, read_meta, read_rejects
from gcd_dataset.shards.tar import BLOCK, END, padded, samples_in

REJECTS = "rejects.jsonl"
SHARD = re.compile(r"(.+)-(\d{5}|[1-9]\d{5,8})\.tar")
OLD = re.compile(r"index-.+\.npz")  # written before schema 3
KEY = re.compile(r"gcd_\d{9,18}")
DRAFT = re.compile(r"\..+-\d{5,}-of-(\d+)\.draft")
NOTHING = "no shards: give a folder made by gcd generate"
BEGUN = "no shard of %s samples is finished yet: give the command that makes this data set again, it goes on"
FOREIGN = 'tars of another program: read them with webdataset, or with load_dataset("webdataset", …) of datasets'


def note_name(split: str, number: int) -> str:
    """The file name of a shard's note."""
    return f"{split}-{number:05d}.json"


def shards_named(names: Iterable[str]) -> list[tuple[str, int]]:
    """Split and number of the shards among files, sorted."""
    matches = (SHARD.fullmatch(name) for name in names if "/" not in name and not name.startswith("."))
    return sorted((match[1], int(match[2])) for match in matches if match is not None)


class StoredSample(NamedTuple):
    """A sample in a tar."""

    number: int
    start: int
    """First byte, of the head of its first member."""
    end: int
    members: dict[str, memoryview]
    views_start: int | None = None
    """First byte of its pictures in their tar."""
    views_end: int = 0


def stored_samples(path: Path, views: Path | None = None, *, damaged: bool = False) -> Iterator[StoredSample]:
    """The samples of a shard, in order, with their pictures in the tar ``views`` if it is given.

    Raises ``ShardError`` for a damaged tar, or ends there if it is ``damaged``.
    """
    pictures = None if views is None else _samples_of(views, damaged)
    for sample in _samples_of(path, damaged):
        if pictures is not None:
            picture = next(pictures, None)
            if picture is None or picture.number != sample.number:
                if damaged:
                    return
                raise ShardError(f"{views}: its samples differ from those of {path.name}: {REMEDY}")
            members = sample.members | picture.members
            sample = sample._replace(members=members, views_start=picture.start, views_end=picture.end)
        yield sample


def _samples_of(path: Path, damaged: bool) -> Iterator[StoredSample]:
    # A draft is not mapped: its owner may truncate it.
    content, position = memoryview(read_file(path)) if damaged else mapped(path), 0
    try:
        for key, members in samples_in(content):
            if KEY.fullmatch(key) is None:
                raise ShardError(f"{shown(key)} is not a sample of this package: move it elsewhere")
            end = position + sum(BLOCK + padded(len(data)) for data in members.values())
            yield StoredSample(int(key[4:]), position, end, members)
            position = end
        if not damaged and (len(content) != position + END or any(content[position:])):
            raise ShardError(f"cut off, or written on, at byte {position}")
    except ShardError as error:
        if not damaged:
            raise ShardError(f"{path}: {error}: {REMEDY}") from error


class Row(NamedTuple):
    """What a note says of a sample."""

    number: int
    start: int
    """[512 bytes]"""
    views_start: int
    """[512 bytes]; -1 without pictures"""
    grade: str
    outcome: str
    rejects: list[dict[str, Any]]
    """Lines of ``rejects.jsonl``."""
    redraws: Mapping[str, int]
    patterns: PatternHash
    """Of its patterns; empty for a data set without a published recipe."""


def row_of(plan: Plan, members: Mapping[str, Bytes], start: int, views_start: int | None) -> Row:
    """What the note says of a sample that begins at ``start`` and ``views_start`` [bytes]. Raises ``ShardError``."""
    meta = read_meta(members[META])
    number, grade = meta["index"], meta.get("grade") or ""
    outcomes = [(entry.get("drape") or {}).get("outcome", "") for entry in meta.get("outfit", [meta])]
    outcome = next((word for word in outcomes if word != Outcome.SETTLED.name), outcomes[0])
    if number >= MOST or grade not in GRADES or outcome not in OUTCOMES:
        raise ShardError(f"index {number}, grade {found(grade)}, outcome {found(outcome)}: one is out of range")
    rejects = [] if plan.kind == BODIES.kind else list(_lines(plan, number, read_rejects(members[META])))
    is_hashed = plan.named is not None and plan.kind == GARMENTS.kind
    patterns = hash_pattern(number, *patterns_of(members)) if is_hashed else PatternHash()
    blocks = start // BLOCK, -1 if views_start is None else views_start // BLOCK
    return Row(number, *blocks, grade, outcome, rejects, meta.get("redraws") or {}, patterns)


def _lines(plan: Plan, number: int, rejects: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    each = plan.recipe.get("bodies_each", 1)
    if not is_count(each) or not each:
        raise ShardError(f"bodies_each is {found(each)}")
    design = number // (each + (plan.recipe.get("bodies") == "both"))
    for attempt, reject in enumerate(rejects):
        line = {name: reject[name] for name in ("index", "rule", "reason")}
        figures = decode_json(reject["figures"].encode())
        yield {"seed": plan.seed, "design": design, "attempt": attempt, **line, "figures": figures}


def _unique(lines: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Lines of ``rejects.jsonl``, each once, in the order of designs and attempts."""
    numbered = {(line["design"], line["attempt"]): line for line in lines}
    return [line for _, line in sorted(numbered.items())]


def plan_of_sample(meta: Mapping[str, Any], plan: Plan) -> Plan:
    """``plan`` with the seed, recipe and version that a sample was made with."""
    generator = meta["versions"].get("gcd_dataset", plan.generator)
    return replace(plan, seed=meta["seed"], recipe=meta["recipe"], generator=generator)


@dataclass(frozen=True)
class Note:
    """The note of a shard."""

    split: str
    plan: Plan
    record: ShardRecord
    members: tuple[str, ...]
    """The members of every sample in file order, pictures last."""
    rows: Sequence[Sequence[Any]]
    """Number, start, start of its pictures, grade and outcome of each sample, as in ``Row``."""
    rejects: Sequence[Mapping[str, Any]] = ()
    """Lines of ``rejects.jsonl``."""
    rejected: Mapping[str, int] = field(default_factory=dict)
    """Rule to the number of rejected attempts, counted for each sample of their design."""
    redraws: Mapping[str, int] = field(default_factory=dict)
    patterns: PatternHash = field(default_factory=PatternHash)
    skipped: Mapping[str, str] = field(default_factory=dict)
    """Number to fault of the samples that could not be made."""

    @classmethod
    def of(
        cls,
        split: str,
        plan: Plan,
        record: ShardRecord,
        members: Iterable[str],
        rows: Sequence[Row],
        skipped: Mapping[int, str],
    ) -> Self:
        """The note of a shard with these samples."""
        return cls(
            split,
            plan,
            record,
            tuple(sorted(members, key=is_picture)),
            [row[:5] for row in rows],
            _unique(line for row in rows for line in row.rejects),
            ranked(Counter(line["rule"] for row in rows for line in row.rejects)),
            ranked(sum((Counter(row.redraws) for row in rows), Counter())),
            sum((row.patterns for row in rows), PatternHash()),
            {str(number): fault for number, fault in sorted(skipped.items())},
        )

    @property
    def done(self) -> set[int]:
        """Numbers of the samples, those included that could not be made."""
        return {row[0] for row in self.rows} | set(map(int, self.skipped))

    def to_bytes(self) -> bytes:
        """The content of the note's file."""
        patterns = [self.patterns.text, [f"{tie:x}" for tie in self.patterns.ties], self.patterns.count]
        own = {"plan": self.plan.to_json(), "record": self.record.to_json(), "patterns": patterns}
        return json_bytes({**self.__dict__, **own}) + b"\n"

    @classmethod
    def from_bytes(cls, content: bytes, path: str) -> Self:
        """The note in a file. Raises ``ShardError``, also for the note of a shard of another name."""
        try:
            entry = decode_json(content, limit=LARGEST_MANIFEST)
            values = checked(cls, entry, "the file")
            value, ties, count = values["patterns"]
            own = {
                "plan": Plan.from_json(entry["plan"], "plan"),
                "record": ShardRecord.from_json(entry["record"], "record"),
                "patterns": PatternHash(int(value, 16), tuple(int(tie, 16) for tie in ties), count),
            }
            note = cls(**{**values, **own})
            if not (all(map(_is_row, note.rows)) and all(map(_is_line, note.rejects)) and is_count(count)):
                raise ShardError("a row is out of range")
            if not all(map(str.isdecimal, note.skipped)):
                raise ShardError(f"skipped is {found(note.skipped)}")
            if len(note.rows) != note.record.count:
                raise ShardError(f"{len(note.rows)} rows for {note.record.count} samples")
            if path.rpartition("/")[2] != (name := note_name(note.split, note.record.number)):
                raise ShardError(f"it is {shown(name)}")
            return note
        except (ShardError, TypeError, ValueError) as error:
            raise ShardError(f"{path}: not the note of this shard ({error}): delete it, then run gcd index") from error


def _is_row(row: Any) -> bool:
    if not isinstance(row, list) or len(row) != 5 or {*map(type, row[:3])} != {int}:
        return False
    return 0 <= row[0] < MOST and 0 <= row[1] < MOST and -1 <= row[2] < MOST and row[3] in GRADES and row[4] in OUTCOMES


def _is_line(line: Any) -> bool:
    return isinstance(line, Mapping) and is_count(line.get("design")) and is_count(line.get("attempt"))


def note_of(path: Path, views: Path | None, split: str, number: int, plan: Plan | None) -> Note:
    """The note of a finished shard, from its tar and that of its pictures. Raises ``ShardError``.

    ``plan``: by default that of the first sample, as far as its ``meta.json`` tells.
    """
    rows, members = [], tuple[str, ...]()
    for sample in stored_samples(path, views):
        content = sample.members
        members = members or tuple(content)
        try:
            if tuple(content) != members:
                other = sorted({*content} ^ {*members}) or ["their order"]
                raise ShardError(f"its members differ from those of the first sample in {other[0]}")
            meta = checked_meta(content, sample.number)
            if plan is None:
                kind = BODIES.kind if {*BODIES.members} == {*content} else GARMENTS.kind
                plan = plan_of_sample(meta, Plan(kind, 0, {}, 0, 1))
            rows.append(row_of(plan, content, sample.start, sample.views_start))
        except ShardError as error:
            raise ShardError(f"{path}: sample {key_of(sample.number)}: {error}: {REMEDY}") from error
    if plan is None:
        raise ShardError(f"{path}: no samples, and its note is lost: run gcd generate again")
    return Note.of(split, plan, record_of(number, len(rows), path, views), members, rows, {})


def record_of(number: int, count: int, path: Path, views: Path | None) -> ShardRecord:
    """The record of a shard, from its files. Raises ``ShardError``."""
    of_views = (0, "") if views is None else hashed(views)
    return ShardRecord(number, count, *hashed(path), *of_views)


def hashed(path: Path) -> tuple[int, str]:
    """Size [bytes] and SHA-256 of a file. Raises ``ShardError``."""
    with reading(path), open_regular(path) as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        return file.tell(), digest


def read_note(place: Place, split: str, number: int, plan: Plan | None = None) -> Note:
    """The note of a shard; made again as by ``note_of`` where it is lost. Raises ``ShardError``."""
    name = note_name(split, number)
    if place.exists(name):
        return Note.from_bytes(next(place.read([name])), place.location(name))
    path, pictures = place.fetch(shard_name(split, number)), shard_name(split, number, views=True)
    views = place.fetch(pictures) if place.exists(pictures) else None
    head = bytes(mapped(path)[:BLOCK])
    if plan is None and any(head) and KEY.match(head.decode("latin-1")) is None:
        raise ShardError(f"{place.location()}: {FOREIGN}")
    return note_of(path, views, split, number, plan)


@dataclass(frozen=True)
class Gathered:
    """What the notes of a data set say together."""

    manifest: Manifest
    indices: Mapping[str, SplitIndex]
    rejects: bytes
    """Content of ``rejects.jsonl``."""

    @property
    def is_complete(self) -> bool:
        """Whether all planned samples are made."""
        return all(self.manifest.missing(split) is None for split in self.manifest.splits)

    def write(self, place: Place) -> None:
        """Write indices, ``rejects.jsonl`` and, last, the manifest. Raises ``OutputError``."""
        for split, index in self.indices.items():
            place.write(index_name(split), index.to_bytes())
        place.write(REJECTS, self.rejects)
        place.write(MANIFEST, self.manifest.to_bytes())


def gather(place: Place, published: Callable[[str, str], str] = lambda name, sha256: "") -> Gathered:
    """Manifest, indices and rejects of the finished shards; nothing is written.

    ``published``: from the name and SHA-256 of a recipe to the hash of its patterns, if it is known. Raises
    ``ShardError`` for a place without shards, and for shards that do not belong together.
    """
    names = place.names()
    if any(map(OLD.fullmatch, names)):
        raise ShardError(other_schema(place.location(), 2, None))
    if not (shards := shards_named(names)):
        begun = next(filter(None, map(DRAFT.fullmatch, names)), None)
        is_foreign = any(name.endswith(".tar") for name in names)
        raise ShardError(f"{place.location()}: {FOREIGN if is_foreign else BEGUN % begun[1] if begun else NOTHING}")
    notes = _notes(place, names, shards)
    splits, indices = {}, {}
    for split, of_split in groupby(notes, key=lambda note: note.split):
        splits[split], indices[split] = _gathered_split(place, list(of_split))
    manifest = Manifest(splits, notes[0].plan.generator)
    if (named := notes[0].plan.named) is not None:
        patterns = sum((note.patterns for note in notes), PatternHash())
        known = "" if any(manifest.missing(split) for split in splits) else published(*named) or patterns.text
        is_whole = patterns.count == sum(manifest.counts.values())
        text = (known if patterns.agrees(known) else patterns.text) if known and is_whole else ""
        manifest = replace(manifest, recipe=RecipeRecord(*named, text))
    return Gathered(manifest, indices, rejects_bytes(line for note in notes for line in note.rejects))


def rejects_bytes(lines: Iterable[Mapping[str, Any]]) -> bytes:
    """The content of ``rejects.jsonl``."""
    return b"".join(json_bytes(line) + b"\n" for line in _unique(lines))


def _notes(place: Place, names: frozenset[str], shards: list[tuple[str, int]]) -> list[Note]:
    there = [shard for shard in shards if note_name(*shard) in names]
    content = place.read([note_name(*shard) for shard in there])
    notes = {
        shard: Note.from_bytes(data, place.location(note_name(*shard)))
        for shard, data in zip(there, content, strict=True)
    }
    plans = {split: note.plan for (split, _), note in notes.items()}
    if len(there) < len(shards) and MANIFEST in names:
        manifest = parse_manifest(next(place.read([MANIFEST])), place.location(MANIFEST))
        plans = {split: record.plan for split, record in manifest.splits.items()} | plans
    for split, number in shards:
        if (split, number) not in notes:
            plan = plans.get(split) or next(iter(plans.values()), None)
            notes[split, number] = read_note(place, split, number, plan)
    # A note whose plan is lost gets the number of samples that there are.
    count = max(sum(len(note.done) for note in notes.values()), 1)
    size = max(1, *(note.record.count for note in notes.values()))
    return [
        note if note.plan.count else replace(note, plan=replace(note.plan, count=count, shard_size=size))
        for note in map(notes.__getitem__, shards)
    ]


def _gathered_split(place: Place, notes: list[Note]) -> tuple[SplitRecord, SplitIndex]:
    """Record and index of a split from its notes, by number."""
    for note in notes[1:]:
        try:
            note.plan.require_same(notes[0].plan, place.location(note_name(note.split, note.record.number)))
        except ConfigError as error:
            raise ShardError(str(error)) from error
    filled = [note for note in notes if note.rows]
    for note in filled:
        if note.members != filled[0].members:
            path = place.location(note.record.name(note.split))
            raise ShardError(f"{path}: its samples have other members than the first shard: delete it, make it again")
    record = SplitRecord(
        replace(notes[0].plan, count=max(note.plan.count for note in notes)),
        tuple(note.record for note in notes),
        filled[0].members if filled else (),
        ranked(sum((Counter(note.rejected) for note in notes), Counter())),
        ranked(sum((Counter(note.redraws) for note in notes), Counter())),
        skipped=sum(len(note.skipped) for note in notes),
    )
    rows = [row for note in notes for row in note.rows]
    numbers, starts, views_starts, grades, outcomes = zip(*rows, strict=True) if rows else ((),) * 5
    index = SplitIndex(
        record,
        np.array(numbers, np.int32),
        np.array(starts, np.int32),
        np.array([start for start in views_starts if start >= 0], np.int32),
        np.array([*map(GRADES.index, grades)], np.uint8),
        np.array([*map(OUTCOMES.index, outcomes)], np.uint8),
    )
    try:
        index.require_consistent()
    except ShardError as error:
        raise ShardError(
            f"{place.location()}: shards of split {notes[0].split} contradict each other: {error}: move those of "
            "another data set elsewhere, or delete all their notes, and run gcd index"
        ) from error
    record = replace(record, index_sha256=hashlib.sha256(index.to_bytes()).hexdigest())
    return record, replace(index, record=record)
