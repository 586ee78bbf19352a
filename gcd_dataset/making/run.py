"""Makes the shards of a data set that are missing; any number of runs, jobs and machines may do so at a time.

    begin ─► missing tasks ─► samples, streamed in the order of the tasks ─► drafts ─► shards ─► index

Equal plans give equal bytes, whoever makes which shard, and however often the work is interrupted.
"""

import contextlib
import logging
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.files import make_folder
from gcd_dataset.generator.recipes import find_recipe, recipe_names
from gcd_dataset.making.log import run_log
from gcd_dataset.making.progress import Pace, Progress, ProgressCallback, ignore_progress
from gcd_dataset.making.tasks import Job, Task, Work
from gcd_dataset.shards.access import Place, reading
from gcd_dataset.shards.layout import FAILED, META, Bytes
from gcd_dataset.shards.manifest import MANIFEST, Plan, parse_manifest, shard_name
from gcd_dataset.shards.meta import read_meta
from gcd_dataset.shards.notes import (
    DRAFT,
    OLD,
    Gathered,
    Note,
    gather,
    note_name,
    plan_of_sample,
    read_note,
    shards_named,
    stored_samples,
)
from gcd_dataset.shards.writer import Draft, draft_name, remove_drafts

OTHER_PATTERNS = (
    "%s: its patterns differ from the patterns of %s: this version of the package, of NumPy, SciPy or Shapely, draws "
    "different patterns; the data set can be used, but not under that name"
)

logger = logging.getLogger("gcd_dataset")


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


Wanted = Sequence[tuple[Task, Sequence[int]]]
"""Tasks, each with the indices of its missing samples."""
Maker = Callable[[Wanted], Iterator[Made]]
"""Makes the missing samples of tasks, in order; its iterator is closed when the run stops."""
MakeShards = Callable[[Place, Sequence[Task], Maker], Generator[Made, None, None]]
"""Makes the shards of tasks, as ``make_shards`` does."""


def run(
    work: Work,
    maker: Maker,
    *,
    job: Job | None = None,
    engine: MakeShards | None = None,
    on_progress: ProgressCallback = ignore_progress,
    log: Path | str | None = None,
    options: Mapping[str, Any] | None = None,
    devices: Sequence[str] = (),
) -> Progress:
    """Make the missing shards of a data set, or of one job, then manifest and index if all shards are there.

    ``engine``: by default ``make_shards``, in this process. ``log``: file for ``run_log``, with further ``options`` of
    the call and the ``devices`` of its samples. Raises as ``begin`` and the engine do.
    """
    place, plan = work.place, work.plan
    given = {"out": place.location(), "count": plan.count, "seed": plan.seed, "name": plan.named and plan.named[0]}
    given |= {**plan.recipe, "job": job and str(job), **(options or {})}
    with run_log(log, on_progress, options=given, recipe=plan.recipe, devices=devices) as report:
        begin(work)
        tasks, names = work.tasks(), place.names()
        if any(task.tar not in names for task in tasks):
            place.remove(MANIFEST)  # of the shards before, or of a set with a shard that was deleted
        own = tasks if job is None else tasks[job.number :: job.of]
        missing = [task for task in own if task.tar not in names]
        count = sum(len(task.indices) for task in own)
        progress, pace = Progress(count, count - sum(len(left) for _, left in _wanted(place, missing))), Pace()
        report(progress)
        with contextlib.closing((engine or make_shards)(place, missing, maker)) as samples:
            for made in samples:
                progress = progress.with_made(made.rejects, made.outcome, made.fault)
                progress = pace.of(progress)
                report(progress)
        names = place.names()
        if MANIFEST not in names and all(task.tar in names for task in tasks):
            index(place)
    return progress


def begin(work: Work) -> None:
    """Check that the place holds nothing else, and prepare it.

    Raises ``ConfigError`` with the first difference to the data set there, ``ShardError`` for a broken one,
    ``OutputError`` where the place cannot be written.
    """
    place = work.place
    if place.is_folder:
        make_folder(place.folder)
    _require_same_set(place, work.plan)
    _restore_notes(work)
    for name, content in work.files.items():
        if not place.exists(name):
            place.write(name, content)


def _require_same_set(place: Place, asked: Plan) -> None:
    """Raise ``ConfigError`` if the place holds another data set."""
    names = place.names()
    if any(map(OLD.fullmatch, names)):
        raise ConfigError(f"{place.location()}: a data set of an earlier version: choose another folder")
    noted = [note_name(*shard) for shard in shards_named(names) if note_name(*shard) in names]
    if noted:
        name = place.location(noted[0])
        plan = Note.from_bytes(next(place.read(noted[:1])), name).plan
    elif MANIFEST in names:
        name = place.location(MANIFEST)
        plan = next((split.plan for split in parse_manifest(next(place.read([MANIFEST])), name).splits.values()), asked)
    else:
        return  # ``_restore_notes`` looks at each shard
    plan.require_same(asked, name)
    if plan.count != asked.count:
        resume = f"; with gcd generate, --count {plan.count} resumes this one" if "stage" in plan.recipe else ""
        raise ConfigError(
            f"{name}: a data set of {plan.count} samples, asked for {asked.count}: choose another folder{resume}"
        )


def _restore_notes(work: Work) -> None:
    """Make lost notes again. Raises ``ConfigError`` for a shard that does not belong to the data set.

    Looked at are the shards without notes, and one with a note: published garments may differ in their numbers alone.
    """
    place, names = work.place, work.place.names()
    shards = shards_named(names)
    lost = [shard for shard in shards if note_name(*shard) not in names]
    tasks = {(task.split, task.number): task for task in work.tasks()} if shards else {}
    for split, number in lost or shards[:1]:
        own = next(iter(work.splits)) if split == FAILED and FAILED not in work.splits else split
        task, tar = tasks.get((own, number)), shard_name(split, number)
        note = None if task is None else read_note(place, split, number, task.plan)
        if task is None or note is None or not note.done <= set(task.indices):
            path = place.location(tar)
            raise ConfigError(f"{path}: not a shard of this data set: move it elsewhere, or choose another folder")
        if lost:
            for sample in stored_samples(place.fetch(tar)):
                plan_of_sample(read_meta(sample.members[META]), task.plan).require_same(task.plan, place.location(tar))
            place.write(note_name(split, number), note.to_bytes())
    if lost:
        place.remove_fetched()


def make_shards(place: Place, tasks: Sequence[Task], maker: Maker) -> Generator[Made, None, None]:
    """Make the shards of tasks that are not done, yielding each sample when it is stored.

    Samples of a killed run's drafts are kept. A task that another process works on is tried last, then waited for.
    Raises ``OutputError`` where the place cannot be written.
    """
    others = set[str]()  # tars of the tasks of other processes
    while missing := _missing(place, tasks):
        # Beside another process begin at the end, so that the two meet once.
        free = [task for task in (missing[::-1] if others else missing) if task.tar not in others]
        wanted = _wanted(place, free or missing[:1])
        samples = maker([(task, left) for task, left in wanted if left])
        with contextlib.ExitStack() as opened:
            if isinstance(samples, Generator):
                opened.callback(samples.close)
            yield from _fill_drafts(place, wanted, samples, others, wait=not free)
        if not free:
            others.discard(missing[0].tar)


def _missing(place: Place, tasks: Sequence[Task]) -> list[Task]:
    names = place.names() if tasks else ()
    return [task for task in tasks if task.tar not in names]


def _fill_drafts(
    place: Place, wanted: Wanted, samples: Iterator[Made], others: set[str], *, wait: bool
) -> Generator[Made, None, None]:
    """Make shards from a stream of samples, until a sample of the stream belongs to another process."""
    for task, left in wanted:
        draft = Draft.open(place, *task, wait=wait)
        if draft is None:
            if not place.exists(task.tar):
                others.add(task.tar)
            if left:
                return
            continue
        with draft:
            done, asked = draft.done, set(left)
            for index in task.indices:
                if index in done:
                    continue
                if index not in asked:  # the draft has lost it
                    return
                made = next(made for made in samples if made.number == index)  # others may have added some
                if made.members is None:
                    draft.skip(index, made.fault)
                else:
                    draft.add(index, made.members, failed=made.failed)
                yield made
            draft.finish()


def _wanted(place: Place, tasks: Sequence[Task]) -> Wanted:
    """The tasks with the indices of the samples that are not in their drafts."""
    drafts = set[str]()
    if place.work.is_dir():
        with reading(place.work):
            drafts = {path.name for path in place.work.iterdir() if DRAFT.fullmatch(path.name)}
    wanted = []
    for task in tasks:
        names = {draft_name(split, task.number, task.plan.count) for split in (task.split, FAILED)} & drafts
        done = set[int]().union(*(_samples_in(place.work / name) for name in names))
        wanted.append((task, [index for index in task.indices if index not in done]))
    return wanted


def _samples_in(draft: Path) -> set[int]:
    """The indices of the whole samples in a draft; none if another process has finished it meanwhile."""
    try:
        return {sample.number for sample in stored_samples(draft, damaged=True)}
    except ShardError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return set()
        raise


def index(place: Place) -> Gathered:
    """Gather manifest, index and rejects of the finished shards, and write them; if all are there, tidy up.

    A data set with the patterns of a published recipe gets that recipe's hash of them: machines round differently.
    Raises ``ShardError`` for a place without shards, and for a broken shard, ``OutputError``.
    """
    gathered = gather(place, _published)
    if gathered.is_complete:
        remove_drafts(place)
        recipe = gathered.manifest.recipe
        known = "" if recipe is None else _published(recipe.name, recipe.sha256)
        if recipe is not None and known and recipe.patterns != known:
            logger.warning(OTHER_PATTERNS, place.location(), recipe.name)
    gathered.write(place)
    place.remove_fetched()
    return gathered


def _published(name: str, sha256: str) -> str:
    """The hash of the patterns of a recipe of this package; empty if it is not known."""
    recipe = find_recipe(name) if name in recipe_names() else None
    return recipe.patterns if recipe is not None and recipe.sha256 == sha256 else ""
