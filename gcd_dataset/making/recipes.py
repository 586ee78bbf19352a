"""Data sets of recipes: verifying a folder against a recipe, and generating on demand."""

import logging
import multiprocessing
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from gcd_dataset.errors import ConfigError, GcdError, OutputError
from gcd_dataset.files import make_folder
from gcd_dataset.generator.recipe import recipe_of
from gcd_dataset.generator.recipes import Recipe
from gcd_dataset.generator.recipes.hashing import made_patterns
from gcd_dataset.making.garments import CPU_SECONDS, generate_recipe
from gcd_dataset.making.progress import Progress
from gcd_dataset.patternhash import PatternHash
from gcd_dataset.shards.access import locked
from gcd_dataset.shards.folder import FolderStore
from gcd_dataset.shards.manifest import MANIFEST, Manifest, RecipeRecord, read_manifest
from gcd_dataset.shards.pattern_arrays import stored_patterns
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.workers import without_main_module

SAMPLED = 32  # designs generated again to verify a recipe that has no hash of all its patterns
LOCK = ".recipe.lock"

log = logging.getLogger(__name__)


# ------------------------------------------------------------------------------------------------------------- verify


def recipe_faults(folder: Path, recipe: Recipe) -> Iterator[str]:
    """The differences between a folder and the data set of a recipe, one line each.

    Checked: the manifest names the recipe; each split holds the samples that the recipe assigns to it, made with its
    seed and options on any device; the patterns have the recipe's hash. For a recipe without a hash, some patterns are
    made again and compared. Raises ``ShardError`` for a folder that cannot be read.
    """
    manifest = FolderStore(folder).manifest()
    stored = manifest.recipe or RecipeRecord("", "")
    if (stored.name, stored.sha256) != (recipe.name, recipe.sha256):
        named = f"{stored.name} ({stored.sha256})" if stored.name else "none"
        yield f"{folder / MANIFEST}: names recipe {named}, asked for {recipe.name} ({recipe.sha256})"
        return
    if faults := [*_split_faults(folder, manifest, recipe)]:
        yield from faults
        return
    readers = [ShardReader(FolderStore(folder), split) for split in recipe.splits]
    try:
        found = sum((PatternHash.of(stored_patterns(reader)) for reader in readers), PatternHash())
    except GcdError as error:
        yield str(error)
        return
    if not stored.patterns:
        yield f"{folder / MANIFEST}: no hash of the patterns yet: run gcd generate --recipe {recipe.name} again"
    elif not found.agrees(stored.patterns):
        yield f"{folder}: its patterns have hash {found.text}, but {MANIFEST} lists {stored.patterns}"
    if not recipe.patterns:
        yield from _sampled_faults(folder, readers, recipe)
    elif not found.agrees(recipe.patterns):
        yield f"{folder}: its patterns have hash {found.text}, but recipe {recipe.name} has {recipe.patterns}"


def _split_faults(folder: Path, manifest: Manifest, recipe: Recipe) -> Iterator[str]:
    """Samples that are missing or in the wrong split, and splits made with another seed or other options."""
    for split in sorted(set(manifest.splits) - set(recipe.splits)):
        yield f"{folder}: split {split} does not belong to {recipe.name}: remove it"
    asked = recipe_of(recipe.config)
    for split in recipe.splits:
        if split not in manifest.splits:
            yield f"{folder}: no split {split}: run gcd generate --recipe {recipe.name} again"
            continue
        plan = manifest.splits[split].plan
        same = replace(plan, seed=recipe.seed, recipe={**asked, "device": plan.recipe.get("device")})
        try:
            plan.require_same(same, f"{folder / MANIFEST}, split {split}")
        except ConfigError as error:
            yield str(error)
        stored = ShardReader(FolderStore(folder), split).index.number
        wanted = recipe.indices_in(split)
        if missing := len(np.setdiff1d(wanted, stored)):
            yield f"{folder}: split {split} lacks {missing} of {len(wanted)} samples: run gcd generate again"
        if foreign := len(np.setdiff1d(stored, wanted)):
            yield f"{folder}: split {split} holds {foreign} samples of other splits: delete it, and make it again"


def _sampled_faults(folder: Path, readers: Iterable[ShardReader], recipe: Recipe) -> Iterator[str]:
    """Make the patterns of some designs again and compare them with the stored ones; one line for each difference."""
    designs = np.unique(np.linspace(0, recipe.designs - 1, min(recipe.designs, SAMPLED)).astype(int)).tolist()
    log.info("%s has no hash of all its patterns: %d designs are made again", recipe.name, len(designs))
    made = dict(made_patterns(recipe, designs))
    for reader in readers:
        for index, pattern in stored_patterns(reader, of=made.keys()):
            if not PatternHash.of([(index, made[index])]).agrees(PatternHash.of([(index, pattern)]).text):
                yield f"{folder}: {pattern.name} has another pattern when made again: generate the data set anew"


# ------------------------------------------------------------------------------------------------------------ loading


def ensure_recipe(recipe: Recipe, folder: Path) -> None:
    """Make the data set of a recipe in a folder, with a progress bar on stderr, unless it is complete there.

    Concurrent calls wait for each other. Raises ``ConfigError`` for a folder that holds something else, or a data
    set whose patterns another version of this package drew; otherwise as ``generate_recipe``.
    """
    if not is_made(folder, recipe):
        with _lock_folder(make_folder(folder), recipe):
            if not is_made(folder, recipe):
                _make(recipe, folder)
    stored = (read_manifest(folder) or Manifest()).recipe
    if recipe.patterns and stored is not None and stored.patterns != recipe.patterns:
        raise ConfigError(
            f"{folder}: holds {recipe.name} with patterns drawn by another version of the package: delete the "
            "folder to generate it again, or read it by its path"
        )


def is_made(folder: Path, recipe: Recipe) -> bool:
    """Whether the manifest of a folder names the recipe and has the hash of its patterns: the data set is complete."""
    stored = (read_manifest(folder) or Manifest()).recipe
    return stored is not None and (stored.name, stored.sha256) == (recipe.name, recipe.sha256) and bool(stored.patterns)


def _make(recipe: Recipe, folder: Path) -> None:
    from tqdm.auto import tqdm

    workers = 0 if multiprocessing.current_process().daemon else None  # a DataLoader's worker cannot start processes
    with tqdm(total=recipe.count, unit="garment", desc=recipe.name) as bar:

        def report(progress: Progress) -> None:
            if not progress.made:
                _log_estimate(recipe, folder, progress.count - progress.done)
            bar.update(progress.done - bar.n)

        with without_main_module():
            generate_recipe(folder, recipe, workers=workers, on_progress=report)


def _log_estimate(recipe: Recipe, folder: Path, missing: int) -> None:
    from gcd_dataset.generator.drape import seconds_to_drape
    from gcd_dataset.generator.drape.device import cores

    config = recipe.config
    seconds = CPU_SECONDS[config.stage] * missing / cores()
    if config.stage == "drape":
        seconds = max(seconds, seconds_to_drape(missing, config.device, config.resolution))
    takes = f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
    log.warning(
        "%s: making %d garments in %s takes about %s; the next call resumes a stopped one",
        recipe.name,
        missing,
        folder,
        takes if seconds < 6000 else f"{seconds / 3600:.1f} h",
    )


@contextmanager
def _lock_folder(folder: Path, recipe: Recipe) -> Iterator[None]:
    """Lock the folder for the block; waits, with a warning, while another process makes the data set there."""
    task = f"making {recipe.name}"
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(folder / LOCK, task))
        except OutputError as error:
            if not isinstance(error.__cause__, BlockingIOError) or _is_importing_main():
                raise
            log.warning("%s: another process is %s there: waiting for it", folder, task)
            stack.enter_context(locked(folder / LOCK, task, wait=True))
        yield


def _is_importing_main() -> bool:
    """Whether this is a spawned worker that imports the main module again.

    The parent may hold the lock and wait for this worker, so waiting here would deadlock. The module
    ``multiprocessing`` checks the same flag before it starts a process.
    """
    return bool(getattr(multiprocessing.current_process(), "_inheriting", False))
