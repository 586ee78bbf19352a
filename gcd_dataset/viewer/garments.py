"""The garments that a viewer turns over: of a data set, as published, or specification files beside the truth."""

import json
import re
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Int, UInt8

from gcd_dataset.bodies import Wearer
from gcd_dataset.errors import BodyError, ConfigError, GcdError, PatternError, ShardError, shown
from gcd_dataset.faults import require_valid
from gcd_dataset.generator.drawing import contact_sheet, draw_pattern, picture_of
from gcd_dataset.outfits import joined
from gcd_dataset.records import EdgeRef, Pattern, Sample
from gcd_dataset.shards import ShardReader
from gcd_dataset.shards.index import GRADES
from gcd_dataset.shards.layout import MAPS
from gcd_dataset.shards.store import FolderStore
from gcd_dataset.spec import pattern_name, read_pattern
from gcd_dataset.viewer.content import Content, body_of, content_of
from gcd_dataset.viewer.maps import map_pictures, require_maps
from gcd_dataset.viewer.page import page_of

if TYPE_CHECKING:
    from gcd_dataset.loaders import PublishedGarmentCodeData
    from gcd_dataset.metrics import PatternScore

Source = Callable[[], Pattern]
KEPT_MATCHES = 32  # albums whose keys are kept as a mapping
PREDICTED = re.compile("_(predicted|prediction)$")  # ends of names that are not part of a garment's
FIGURES = ("iou", "panel_l2", "edge_count_acc", "stitch_f1", "combinatorial")  # of ``PatternScore``
MOST_NAMES = 20  # names listed in a line
CHUNK = 64  # samples whose metadata are read at once; ``close`` waits for a chunk
META = "meta.json"
TAG, OUTCOME = "tag", "outcome"
NO_BODY = "body mesh"  # in the table of the recipe: why there is no body
SETTLED, UNSETTLED = "settled", "all but settled"  # no outcome has the latter name


@dataclass(frozen=True)
class Filter:
    """Conditions that a garment must meet; an empty text admits all."""

    kind: str = ""
    """A tag."""
    grade: str = ""
    outcome: str = ""


ANY = Filter()


@dataclass(frozen=True)
class Facets:
    """The values to filter by, each with the number of its garments."""

    grades: Mapping[str, int] = field(default_factory=dict)
    outcomes: Mapping[str, int] = field(default_factory=dict)
    kinds: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Found:
    """A garment among those that a filter admits."""

    position: int
    """In the album; -1 if the filter admits none."""
    rank: int
    count: int
    """Garments that the filter admits, of those known so far."""
    following: int
    """Position of the next garment that the filter admits, counted round."""


class Album(ABC):
    """Garments in a fixed order, to filter by kind, grade and outcome. Methods may be called from several threads."""

    title: str
    beside: tuple[str, ...] = ("",)
    """Headings of the pages of a garment, from left to right."""
    known: int
    """Garments whose tags are known."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def key(self, position: int) -> str:
        """The name of a garment."""

    @abstractmethod
    def page(self, position: int, side: int = 0) -> str:
        """The HTML page of a garment. Raises ``GcdError`` for a damaged one."""

    @abstractmethod
    def picture(self, position: int, size: int) -> UInt8[np.ndarray, "h w 3"]:
        """Front of a garment, stored or rendered; without a drape its pattern. Raises ``GcdError`` for damage."""

    def links(self, position: int) -> dict[str, Any]:
        """Parts of the two pages of a garment that belong together; see ``SpecAlbum.links``."""
        return {"panels": [], "seams": []}

    def facets(self) -> Facets:
        """Grades, outcomes and kinds, as far as they are known."""
        return Facets()

    def read_tags(self, between: Callable[[], None] | None = None) -> None:  # noqa: B027 -- most albums have none
        """Read tags that are not known yet, until ``close``; ``between`` is called before each part."""

    def close(self) -> None:  # noqa: B027
        """Stop ``read_tags``."""

    def matches(self, where: Filter = ANY) -> Int[np.ndarray, " m"]:
        """Positions of the garments that a filter admits, of those known so far."""
        return np.arange(len(self))

    def found(self, rank: int, where: Filter = ANY) -> Found:
        """The garment at ``rank`` of those that a filter admits, counted round."""
        return _at(self.matches(where), rank)

    def nearest(self, position: int, where: Filter = ANY) -> Found:
        """The admitted garment at ``position`` or after it, or else the last one."""
        matches = self.matches(where)
        return _at(matches, min(int(np.searchsorted(matches, position)), max(len(matches) - 1, 0)))

    def position_of(self, text: str) -> int:
        """The position of a garment by its index or key. Raises ``ConfigError`` for an unknown one."""
        if text.strip().isdecimal() and int(text) < len(self):
            return int(text)
        raise ConfigError(f"no garment {text.strip()!r:.80}: give a number from 0 to {len(self) - 1}")


def _at(matches: Int[np.ndarray, " m"], rank: int) -> Found:
    if not len(matches):
        return Found(-1, 0, 0, -1)
    rank %= len(matches)
    return Found(int(matches[rank]), rank, len(matches), int(matches[(rank + 1) % len(matches)]))


class ShardAlbum(Album):
    """A split of a data set. Grades, and which drapes settled, come from the index; ``read_tags`` reads the rest.

    Tags of a remote data set are not read, since each takes a request.
    """

    def __init__(self, reader: ShardReader, title: str, *, maps: bool = False) -> None:
        """``maps``: show garments in the colours of their maps. Raises ``ConfigError`` for a data set without maps."""
        require_maps(not maps or MAPS in reader.layout.members, title)
        self.title, self._maps = title, maps
        self._reader, self._count = reader, len(reader)
        self._positions: dict[tuple[str, str], list[Int[np.ndarray, " m"]]] = {}
        self._lock, self._reading, self._closed = threading.Lock(), threading.Lock(), threading.Event()
        is_local = isinstance(reader.store, FolderStore)
        self.known = 0 if META in reader.layout.members and is_local else self._count
        rows = reader.rows(range(len(reader)))
        self._grade = reader.index.grade[rows]
        self._settled = reader.index.settled[rows]
        self._number = reader.index.number[rows]

    def __len__(self) -> int:
        return self._count

    def key(self, position: int) -> str:
        return self._reader.key(position)

    def page(self, position: int, side: int = 0) -> str:
        return page_of(content_of(self._reader.sample(position)), maps=self._maps)

    def picture(self, position: int, size: int) -> UInt8[np.ndarray, "h w 3"]:
        """As in ``Album``; with maps the front in four colourings."""
        return _front(self._reader.sample(position), size, maps=self._maps)

    def facets(self) -> Facets:
        counts = np.bincount(self._grade, minlength=len(GRADES)).tolist()
        settled = int(self._settled.sum())
        outcomes = {SETTLED: settled, UNSETTLED: len(self) - settled} if settled else {}
        unsettled = {word: count for word, count in self._counts(OUTCOME).items() if word not in outcomes}
        return Facets(
            grades={name: count for name, count in zip(GRADES, counts, strict=True) if name and count},
            outcomes={word: count for word, count in (outcomes | unsettled).items() if count},
            kinds=self._counts(TAG),
        )

    def read_tags(self, between: Callable[[], None] | None = None) -> None:
        with self._reading:
            while self.known < self._count and not self._closed.is_set():
                if between is not None:
                    between()
                chunk = range(self.known, min(self.known + CHUNK, self._count))
                self._add(chunk, self._metas(chunk))

    def close(self) -> None:
        self._closed.set()

    def matches(self, where: Filter = ANY) -> Int[np.ndarray, " m"]:
        admitted: Bool[np.ndarray, " n"] = np.ones(len(self), bool)
        if where.grade:
            admitted &= self._grade == (GRADES.index(where.grade) if where.grade in GRADES else len(GRADES))
        if where.outcome in (SETTLED, UNSETTLED):
            admitted &= self._settled == (where.outcome == SETTLED)
        elif where.outcome:
            admitted &= self._with(OUTCOME, where.outcome)
        if where.kind:
            admitted &= self._with(TAG, where.kind)
        return np.flatnonzero(admitted)

    def _with(self, field: str, word: str) -> Bool[np.ndarray, " n"]:
        """Whether a garment is known to have a word; ``field``: ``TAG`` or ``OUTCOME``."""
        mask = np.zeros(len(self), bool)
        with self._lock:
            for rows in self._positions.get((field, word), ()):
                mask[rows] = True
        return mask

    def _counts(self, field: str) -> dict[str, int]:
        """Word to the number of known garments with it, in alphabetical order; ``field``: ``TAG`` or ``OUTCOME``."""
        with self._lock:
            found = {word: sum(map(len, rows)) for (name, word), rows in self._positions.items() if name == field}
        return dict(sorted(found.items()))

    def _metas(self, chunk: Sequence[int]) -> list[Mapping[str, Any]]:
        """Of damaged garments, which their own pages and ``gcd check`` report, an empty mapping."""
        try:
            return [_parsed(members[META]) for members in self._reader.read_many(chunk, [META])]
        except ShardError:
            return [{}] if len(chunk) == 1 else [meta for position in chunk for meta in self._metas([position])]

    def _add(self, chunk: Sequence[int], metas: Sequence[Mapping[str, Any]]) -> None:
        found: dict[tuple[str, str], list[int]] = {}
        for position, meta in zip(chunk, metas, strict=True):
            for word in _tag_words(meta):
                found.setdefault(word, []).append(position)
        with self._lock:
            for word, rows in found.items():
                self._positions.setdefault(word, []).append(np.array(rows, np.int64))
            self.known = chunk[-1] + 1

    def position_of(self, text: str) -> int:
        digits = text.strip().rsplit("_", 1)[-1]
        if digits.isdecimal():
            position = int(np.searchsorted(self._number, int(digits)))
            if position < len(self) and self._number[position] == int(digits):
                return position
        raise ConfigError(
            f"{self.title} has no sample {text.strip()!r:.80}: give an index from {self._number[0]} to "
            f"{self._number[-1]}, or a key"
        )


class SpecAlbum(Album):
    """Specification files; with ``truth``, each beside the true pattern of the same name."""

    def __init__(
        self, paths: Sequence[Path], title: str, truth: Mapping[str, Source] | None = None, wearer: Wearer | None = None
    ) -> None:
        self.title, self._paths, self._truth, self._wearer = title, list(paths), truth or {}, wearer
        self.beside, self.known = ("",) if truth is None else ("predicted", "true"), len(self._paths)

    def __len__(self) -> int:
        return len(self._paths)

    def key(self, position: int) -> str:
        return _key(self._paths[position])

    def page(self, position: int, side: int = 0) -> str:
        pattern = self._pattern(position, side)
        try:
            return page_of(content_of(pattern, wearer=self._wearer))
        except Exception:  # predictions are shown unchecked; one that cannot be drawn breaks a rule
            require_valid(pattern, source=str(self._paths[position]) if not side else "")
            raise

    def picture(self, position: int, size: int) -> UInt8[np.ndarray, "h w 3"]:
        return _front(require_valid(read_pattern(self._paths[position])), size)

    def links(self, position: int) -> dict[str, Any]:
        """Numbers of matched panels, with their intersection over union, and of right seams: predicted, then true.

        Panels are matched as for scores (``gcd_dataset.metrics``); a right seam joins the matched edges of a true one.
        """
        if len(self.beside) < 2:
            return super().links(position)
        predicted, true = (self._pattern(position, side) for side in (0, 1))
        return _links(predicted, true)

    def scores(self) -> Iterator[str]:
        """Lines of text: names without a counterpart, the score of each prediction, and the means."""
        from gcd_dataset.metrics import mean_scores, score_pattern

        keys, scores = [_key(path) for path in self._paths], []
        for missing, names, others in (("true pattern", keys, self._truth), ("prediction", self._truth, set(keys))):
            if lacking := [shown(name) for name in names if name not in others]:
                more = ["…"] * (len(lacking) > MOST_NAMES)
                yield f"{len(lacking)} without a {missing}: {', '.join(lacking[:MOST_NAMES] + more)}"
        for position, key in enumerate(keys):
            if key in self._truth:
                try:
                    scores.append(score_pattern(self._pattern(position, 0), self._pattern(position, 1)))
                    yield f"{key}: {_score_text(scores[-1])}"
                except GcdError as error:
                    yield f"{key}: no score: {error}"
        if scores:
            yield f"mean of {len(scores)}: {_score_text(mean_scores(scores))}"

    def _pattern(self, position: int, side: int) -> Pattern:
        path = self._paths[position]
        if not side:
            return read_pattern(path)
        if _key(path) not in self._truth:
            raise ConfigError(f"{path}: no true pattern of this name")
        return self._truth[_key(path)]()

    def position_of(self, text: str) -> int:
        keys = _positions(tuple(map(_key, self._paths)))
        wanted = _key(Path(text.strip()))
        return keys[wanted] if wanted in keys else super().position_of(text)


class PublishedAlbum(Album):
    """GarmentCodeData as published, each garment on its body where the release's bodies are on disk."""

    def __init__(self, published: "PublishedGarmentCodeData", title: str) -> None:
        self.title, self._published, self.known = title, published, len(published)
        folders = np.array([name.split("/")[1] for name in published.names])
        self._kinds = {str(folder): np.flatnonzero(folders == folder) for folder in np.unique(folders)}

    def __len__(self) -> int:
        return len(self._published)

    def key(self, position: int) -> str:
        return self._published.name(position)

    def page(self, position: int, side: int = 0) -> str:
        return page_of(published_content(self._published, position))

    def picture(self, position: int, size: int) -> UInt8[np.ndarray, "h w 3"]:
        return _front(self._published.sample(position), size)

    def facets(self) -> Facets:
        return Facets(kinds={folder.replace("_", " "): len(rows) for folder, rows in self._kinds.items()})

    def matches(self, where: Filter = ANY) -> Int[np.ndarray, " m"]:
        if where.grade or where.outcome:
            return np.zeros(0, np.int64)
        if where.kind:
            return self._kinds.get(where.kind.replace(" ", "_"), np.zeros(0, np.int64))
        return np.arange(len(self))

    def position_of(self, text: str) -> int:
        names = _positions(self._published.names)
        wanted = text.strip()
        if wanted in names:
            return names[wanted]
        found = [position for name, position in names.items() if name.endswith(f"/{wanted}")]
        return found[0] if found else super().position_of(text)


def published_content(published: "PublishedGarmentCodeData", position: int) -> Content:
    """The content of a published garment, with its body; where that is missing, the table of the recipe says so.

    Raises ``ShardError`` for a damaged garment.
    """
    sample = published.sample(position)
    try:
        body, problem = published.body(position), ""
    except BodyError as error:
        body, problem = None, str(error)
    content = replace(content_of(sample, body), title=sample.pattern.name)
    if not problem:
        return content
    recipe = ((NO_BODY, problem), *content.tables.get("Recipe", ()))
    return replace(content, tables={**content.tables, "Recipe": recipe})


def spec_album(source: Path, truth: Path | ShardReader | None = None, wearer: Wearer | None = None) -> SpecAlbum:
    """A specification file, or all of a folder; ``truth``: the same, or a data set, with true patterns.

    ``wearer``: the body that the panels are placed round, with legs straight or apart, by default the neutral one.
    Raises ``ConfigError`` for a folder without any, and ``SpecError`` for a single file that is invalid.
    """
    paths = list(_by_key(source).values())
    if not paths:
        raise ConfigError(f"{source}: no specification file (.json): give a data set or a folder of specifications")
    if source.is_file():
        read_pattern(source)
    if isinstance(truth, ShardReader):
        return SpecAlbum(paths, str(source), _patterns_of(truth), wearer)
    true = None if truth is None else {key: partial(read_pattern, path) for key, path in _by_key(truth).items()}
    if true == {}:
        raise ConfigError(f"--truth {truth}: no specification file (.json): give true ones, or a data set")
    return SpecAlbum(paths, str(source), true, wearer)


def _patterns_of(reader: ShardReader) -> dict[str, Source]:
    """The patterns of a data set by their names, which for generated garments are the keys."""
    keys = list(map(reader.key, range(len(reader))))
    if reader.sample(0).pattern.name != keys[0]:
        keys = [reader.sample(position).pattern.name for position in range(len(keys))]
    return {key: partial(lambda i: reader.sample(i).pattern, position) for position, key in enumerate(keys)}


def _front(garment: Sample | Pattern, size: int, *, maps: bool = False) -> UInt8[np.ndarray, "h w 3"]:
    if isinstance(garment, Pattern):
        return draw_pattern(garment, size=size)
    if garment.front and not maps:
        return picture_of(garment.front, size)
    whole, body = joined(garment), body_of(garment)
    mesh, drape = whole.box_mesh, whole.drape
    if mesh is None or drape is None or body is None or not np.isfinite(drape.vertices).all():
        return draw_pattern(whole.pattern, size=size)
    if maps and garment.maps is not None and garment.maps.is_known:
        half = size // 2
        return contact_sheet([_front(garment, half), *map_pictures(garment, size=half)], columns=2, gap=0)
    from gcd_dataset.generator.render import render_garment

    return render_garment(drape.vertices, mesh, body, size=size)[0]


def _links(predicted: Pattern, true: Pattern) -> dict[str, Any]:
    from gcd_dataset.metrics import match_panels, matched_edges, score_pattern

    try:
        pairs, score = match_panels(predicted, true), _score_text(score_pattern(predicted, true))
    except PatternError:  # a true panel without a closed outline: there are no scores either
        return {"panels": [], "seams": []}
    numbers = [{panel.name: i for i, panel in enumerate(pattern.panels)} for pattern in (predicted, true)]
    panels = [
        [numbers[0][pair.predicted.panel.name], numbers[1][pair.true.panel.name], round(pair.iou, 3)] for pair in pairs
    ]
    edges: dict[EdgeRef, EdgeRef | None] = {ref: other for pair in pairs for ref, other in matched_edges(pair).items()}
    seam_of: dict[frozenset[EdgeRef | None], int]
    seam_of = {frozenset((seam.left, seam.right)): number for number, seam in enumerate(true.seams)}
    matched = (seam_of.get(frozenset((edges.get(seam.left), edges.get(seam.right)))) for seam in predicted.seams)
    return {"panels": panels, "seams": [[i, j] for i, j in enumerate(matched) if j is not None], "score": score}


def _score_text(score: "PatternScore") -> str:
    return ", ".join(f"{name} {getattr(score, name):.3f}" for name in FIGURES)


def _by_key(source: Path) -> dict[str, Path]:
    """Name to specification file: the file itself, or those in a folder; without any, those in its subfolders."""
    found: dict[str, Path] = {}
    paths = sorted(source.glob("*.json")) or sorted(source.rglob("*specification.json"))
    for path in [source] if source.is_file() else paths:
        if found.setdefault(_key(path), path) != path:
            raise ConfigError(f"{path}: {found[_key(path)]} is named after the same garment: leave one of them")
    return found


def _key(path: Path) -> str:
    """The garment that a file, true or predicted, is named after."""
    return PREDICTED.sub("", pattern_name(path) if path.suffix in (".json", "") else path.name)


@lru_cache(KEPT_MATCHES)
def _positions(keys: tuple[str, ...]) -> dict[str, int]:
    return {key: position for position, key in enumerate(keys)}


def _parsed(content: memoryview) -> Mapping[str, Any]:
    try:
        meta = json.loads(bytes(content))
    except (ValueError, RecursionError):
        return {}
    return meta if isinstance(meta, Mapping) else {}


def _tag_words(meta: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Tags and outcome of a garment, each once."""
    tags, drape = meta.get("tags"), meta.get("drape")
    found = dict.fromkeys((TAG, tag) for tag in tags if isinstance(tag, str) and tag) if isinstance(tags, list) else {}
    outcome = drape.get("outcome") if isinstance(drape, Mapping) else None
    if isinstance(outcome, str) and outcome:
        found[OUTCOME, outcome.lower().replace("_", " ")] = None
    return list(found)
