"""Makes the shards of a data set that are missing; any number of runs, jobs and machines may do so at a time.

    begin ─► missing tasks ─► samples, streamed in the order of the tasks ─► drafts ─► shards ─► complete

Equal plans give equal bytes, whoever makes which shard, and however often the work is interrupted.
"""

import logging
import shutil
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from gcd_dataset.errors import ConfigError, shown
from gcd_dataset.files import make_folder
from gcd_dataset.generator.recipes import find_recipe, recipe_names
from gcd_dataset.making.progress import Pace, Progress, ProgressCallback, ignore_progress
from gcd_dataset.making.store import place_of
from gcd_dataset.making.tasks import Job, Task, Work
from gcd_dataset.shards.access import locked, reading, writing
from gcd_dataset.shards.cache import default_cache
from gcd_dataset.shards.layout import FAILED, Bytes
from gcd_dataset.shards.manifest import MANIFEST, Manifest, Plan, ShardRecord, parse_manifest
from gcd_dataset.shards.notes import (
    EARLIER,
    OLD,
    Gathered,
    Note,
    gather,
    note_name,
    read_note,
    shards_named,
    stored_samples,
)
from gcd_dataset.shards.place import FolderPlace, Place
from gcd_dataset.shards.writer import DRAFT, Draft, draft_name, remove_drafts
from gcd_dataset.waits import WRITER, Waits, sum_waits, take_waits, timed

__all__ = ["Made", "Maker", "begin", "complete", "index", "make_shards", "place_for", "run"]

NO_WAITS: Waits = {}
NAMED = 3  # files named in a message

log = logging.getLogger("gcd_dataset")


class Made(NamedTuple):
    """A sample that was made, encoded; or the fault for which it was skipped."""

    number: int
    members: Mapping[str, Bytes] | None
    fault: str = ""
    failed: bool = False
    """Whether it goes to the split ``failed``."""
    rejects: tuple[str, ...] = ()
    """``rule: reason`` of each attempt rejected for its design; given for one sample of a design."""
    outcome: str | None = None
    """Name of the outcome of the drape; ``None`` without a drape."""
    waits: Waits = NO_WAITS
    """Waits of its worker, and of the draping processes, since the previous sample."""


Wanted = Sequence[tuple[Task, Sequence[int]]]
"""Tasks, each with the indices of its missing samples."""
MakeShards = Callable[[Place, Sequence[Task]], Generator[Made, None, None]]
Maker = Callable[[Wanted], Iterator[Made]]
"""Makes the missing samples of tasks, in order; its iterator is closed when the run stops."""


def run(
    work: Work, make: MakeShards, *, job: Job | None = None, on_progress: ProgressCallback = ignore_progress
) -> Progress:
    """Make the missing shards of a data set, or of one job, then manifest and index if all shards are there.

    ``make``: makes the shards of tasks, such as ``make_shards`` with a maker. Raises as ``begin`` and ``make`` do.
    """
    begin(work)
    tasks = list(work.tasks())
    own = tasks if job is None else tasks[job.number :: job.of]
    names = work.place.names()
    if any(task.tar not in names for task in tasks):
        work.place.remove(MANIFEST)  # of the shards before, or of a set with a shard that was deleted
    missing = [task for task in own if task.tar not in names]
    count = sum(len(task.indices) for task in own)
    progress, pace = Progress(count, count - sum(len(left) for _, left in _wanted(work.place, missing))), Pace()
    on_progress(progress)
    with closing(make(work.place, missing)) as samples:
        for made in samples:
            progress = progress.with_made(made.rejects, made.outcome, made.fault)
            progress = pace.of(progress, sum_waits(made.waits, take_waits()))
            on_progress(progress)
    complete(work)
    return progress


# ------------------------------------------------------------------------------------------------------------ beginning


def begin(work: Work) -> None:
    """Check that the place holds nothing else, and prepare it: shards of a smaller data set become ``EARLIER``.

    Raises ``ConfigError`` with the first difference to the data set there, ``ShardError`` for a broken one,
    ``OutputError`` where the place cannot be written.
    """
    place = work.place
    if isinstance(place, FolderPlace):
        make_folder(place.folder)
    if (plan := _stored_plan(work)) is None:
        return
    if plan.count < work.plan.count:
        _grow(work)
    _restore_notes(work)


def _stored_plan(work: Work) -> Plan | None:
    """The plan of the data set in the place; ``None`` without shards. Raises ``ConfigError`` for another data set."""
    place = work.place
    names = place.names()
    if any(map(OLD.fullmatch, names)):
        raise ConfigError(f"{place.location()}: a data set of an earlier version: choose another folder")
    shards = shards_named(names)
    noted = next((shard for shard in shards if note_name(*shard) in names), None)
    if noted is not None:
        name = note_name(*noted)
        plan = Note.from_bytes(next(place.read([name])), place.location(name)).plan
    elif MANIFEST in names:
        name = MANIFEST
        splits = parse_manifest(next(place.read([MANIFEST])), place.location(MANIFEST)).splits
        plan = next((record.plan for record in splits.values()), work.plan)
    elif shards:
        name = ShardRecord(shards[0][1], 0, 0, "").name(shards[0][0])
        plan = read_note(place, *shards[0], work.plan).plan
    else:
        return None
    plan.require_same(work.plan, place.location(name))
    if plan.count > work.plan.count:
        raise ConfigError(
            f"{place.location(name)}: a data set of {plan.count} samples, asked for {work.plan.count}: give the same "
            "number or more, or another folder"
        )
    return plan


def _grow(work: Work) -> None:
    """Move the shards of a smaller data set into ``EARLIER``: their samples are copied into the new shards."""
    place = work.place
    if not isinstance(place, FolderPlace):
        raise ConfigError(f"{place.location()}: holds fewer samples, and only folders grow: choose another URL")
    with locked(place.folder / f"{EARLIER}.lock", "moving its shards", wait=True):
        plan = _stored_plan(work)
        if plan is None or plan.count == work.plan.count:
            return  # moved by another process
        place.remove(MANIFEST)
        folder = make_folder(place.folder / EARLIER / str(plan.count))
        make_folder(folder / "views")
        names = place.names()
        for split, number in shards_named(names):
            record = ShardRecord(number, 0, 0, "")
            for name in (record.name(split), record.views_name(split), note_name(split, number)):
                if name in names:
                    with writing(folder / name):
                        (place.folder / name).replace(folder / name)


def _restore_notes(work: Work) -> None:
    """Make lost notes again. Raises ``ShardError`` for a shard that does not belong to the data set.

    Looked at are the shards without notes, and one with a note: published garments may differ in their numbers alone.
    """
    names = work.place.names()
    shards = shards_named(names)
    lost = [shard for shard in shards if note_name(*shard) not in names]
    if not shards:
        return
    first = next(iter(work.splits))
    tasks = {(task.split, task.number): task for task in work.tasks()} if lost else {}
    for split, number in lost or shards[:1]:
        own = first if split == FAILED and FAILED not in work.splits else split
        task = tasks.get((own, number)) if lost else next((t for t in work.tasks() if t[1:3] == (own, number)), None)
        note = None if task is None else read_note(work.place, split, number, task.plan)
        if task is None or note is None or not note.done <= set(task.indices):
            path = work.place.location(ShardRecord(number, 0, 0, "").name(split))
            raise ConfigError(f"{path}: not a shard of this data set: move it elsewhere, or choose another folder")
        if lost:
            work.place.write(note_name(split, number), note.to_bytes())


# --------------------------------------------------------------------------------------------------------------- making


def make_shards(place: Place, tasks: Iterable[Task], maker: Maker) -> Generator[Made, None, None]:
    """Make the shards of tasks that are not done, yielding each sample when it is stored.

    Samples of a killed run's drafts, and of ``EARLIER``, are kept. A task that another process works on is tried
    last, then waited for. Raises ``OutputError`` where the place cannot be written.
    """
    waiting, others = [task for task in tasks if not place.exists(task.tar)], set[str]()
    while waiting:
        # Beside another process begin at the end, so that the two meet once.
        order = [task for task in (waiting[::-1] if others else waiting) if task.tar not in others] or waiting[:1]
        wait = order[0].tar in others
        round_ = _Round(place, _wanted(place, order), maker, wait=wait)
        yield from round_.run()
        others = (others - {order[0].tar} if wait else others) | round_.others
        waiting = [task for task in waiting if not place.exists(task.tar)]


@dataclass
class _Round:
    """A stream of samples into drafts, until all tasks are done or one is found in the hands of another process."""

    place: Place
    wanted: Wanted
    maker: Maker
    wait: bool
    others: set[str] = field(default_factory=set)
    """Tars of the tasks of other processes."""

    def run(self) -> Iterator[Made]:
        stream = timed(self.maker([(task, left) for task, left in self.wanted if left]), WRITER)
        earlier = _Earlier(self.place)
        with closing(stream) as samples:  # type: ignore[type-var]
            for task, left in self.wanted:
                draft = Draft.open(self.place, *task, wait=self.wait)
                if draft is None:
                    if not self.place.exists(task.tar):
                        self.others.add(task.tar)
                    if left:
                        return  # the next samples are of this task: begin again without it
                    continue
                with draft:
                    is_done = yield from self._fill(draft, task, left, samples, earlier)
                    if not is_done:
                        return
                    draft.finish()

    def _fill(
        self, draft: Draft, task: Task, left: Sequence[int], samples: Iterator[Made], earlier: "_Earlier"
    ) -> Generator[Made, None, bool]:
        """Add the samples that a draft lacks. False if some of them were not asked for: the draft has lost them."""
        done, asked = draft.done, set(left)
        for index in task.indices:
            if index in done:
                continue
            if (known := earlier.read(task.split, index)) is not None:
                draft.add(index, known.members, failed=known.failed)
                continue
            if index not in asked:
                return False
            made = next(made for made in samples if made.number == index)  # another process may have added some
            if made.members is None:
                draft.skip(index, made.fault)
            else:
                draft.add(index, made.members, failed=made.failed)
            yield made
        return True


def _wanted(place: Place, tasks: Sequence[Task]) -> Wanted:
    """The tasks with the indices of the samples that are neither in their drafts nor in ``EARLIER``."""
    earlier = _Earlier(place)
    with reading(place.work):
        drafts = (
            {path.name for path in place.work.iterdir() if DRAFT.fullmatch(path.name)} if place.work.is_dir() else set()
        )
    wanted = []
    for task in tasks:
        names = {draft_name(split, task.number) for split in (task.split, FAILED)} & drafts
        done = {sample.number for name in names for sample in stored_samples(place.work / name, damaged=True)}
        wanted.append((task, [i for i in task.indices if i not in done and not earlier.has(task.split, i)]))
    return wanted


class _Known(NamedTuple):
    """A sample of an earlier shard."""

    members: Mapping[str, Bytes]
    failed: bool


class _Earlier:
    """The samples in ``EARLIER``."""

    def __init__(self, place: Place) -> None:
        self._where: dict[tuple[str, int], tuple[Path, str, int]] = {}
        self._read: dict[str, tuple[Path, dict[int, Mapping[str, Bytes]]]] = {}
        root = place.work / EARLIER
        for folder in sorted(root.iterdir()) if isinstance(place, FolderPlace) and root.is_dir() else ():
            old = FolderPlace(folder)
            for split, number in shards_named(old.names()):
                for row in read_note(old, split, number).rows:
                    self._where[split, row[0]] = folder, split, number

    def has(self, split: str, index: int) -> bool:
        """Whether a sample of a split, or its failed drape, is known."""
        return bool(self._where) and ((split, index) in self._where or (FAILED, index) in self._where)

    def read(self, split: str, index: int) -> _Known | None:
        """A sample; ``None`` if it is not known. Keeps the last shard that was read. Raises ``ShardError``."""
        if not self.has(split, index):
            return None
        folder, own, number = self._where.get((split, index)) or self._where[FAILED, index]
        record = ShardRecord(number, 0, 0, "")
        path, views = folder / record.name(own), folder / record.views_name(own)
        if self._read.get(own, (None,))[0] != path:
            content: dict[int, Mapping[str, Bytes]] = {s.number: s.members for s in stored_samples(path)}
            for sample in stored_samples(views) if views.exists() else ():
                content[sample.number] = {**content[sample.number], **sample.members}
            self._read[own] = path, content
        return _Known(self._read[own][1][index], own == FAILED and split != FAILED)


# ----------------------------------------------------------------------------------------------------------- completing


def complete(work: Work) -> Gathered | None:
    """Write manifest and index if all shards are there and they are missing; ``None`` while shards are missing.

    Raises ``ShardError`` for a broken shard, ``OutputError`` where the place cannot be written.
    """
    names = work.place.names()
    if MANIFEST in names or any(task.tar not in names for task in work.tasks()):
        return None
    return index(work.place)


def index(place: Place) -> Gathered:
    """Gather manifest, index and rejects of the finished shards, and write them; if all are there, tidy up.

    A data set with the patterns of a published recipe gets that recipe's hash of them: machines round differently.
    Raises ``ShardError`` for a place without shards, and for a broken shard, ``OutputError``.
    """
    gathered = gather(place, _published)
    if gathered.is_complete:
        remove_drafts(place)
        if isinstance(place, FolderPlace) and (place.folder / EARLIER).is_dir():
            with writing(place.folder / EARLIER):
                shutil.rmtree(place.folder / EARLIER)
        _warn_of_patterns(place, gathered.manifest)
    gathered.write(place)
    return gathered


def _published(name: str, sha256: str) -> str:
    """The hash of the patterns of a recipe of this package; empty if it is not known."""
    recipe = find_recipe(name) if name in recipe_names() else None
    return recipe.patterns if recipe is not None and recipe.sha256 == sha256 else ""


def _warn_of_patterns(place: Place, manifest: Manifest) -> None:
    recipe = manifest.recipe
    if recipe is not None and (known := _published(recipe.name, recipe.sha256)) and recipe.patterns != known:
        log.warning(
            "%s: its patterns differ from the patterns of %s: this version of the package, of NumPy, SciPy or Shapely, "
            "draws different patterns; the data set can be used, but not under that name",
            place.location(),
            recipe.name,
        )


def place_for(out: Path | str) -> Place:
    """The folder or store that a user names. Raises ``ConfigError`` for a URL that cannot be written to."""
    place = place_of(out, default_cache(None))
    if isinstance(place, FolderPlace) and place.folder.is_dir():
        _warn_of_others(place)
    return place


def _warn_of_others(place: FolderPlace) -> None:
    """Log a warning before a new data set is written into a folder with other files."""
    names = sorted(name for name in place.names() if "/" not in name and not name.startswith("."))
    if MANIFEST in names or shards_named(names):
        return
    if others := [shown(name) for name in names if name != "views" and not name.startswith("mesh-")]:
        named = ", ".join(others[:NAMED]) + (f" and {len(others) - NAMED} more" if len(others) > NAMED else "")
        log.warning("%s: holds other files (%s), which stay beside the data set: right folder?", place.folder, named)
