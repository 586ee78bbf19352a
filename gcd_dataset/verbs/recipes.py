"""Data sets by name: what there is, whether a folder is one of them, and having one made."""

import logging
import multiprocessing
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from gcd_dataset.errors import ConfigError, GcdError, OutputError
from gcd_dataset.files import make_folder
from gcd_dataset.generator.recipe import recipe_of
from gcd_dataset.generator.recipes import Recipe, find_recipe, recipe_names
from gcd_dataset.generator.recipes.hashing import made_patterns
from gcd_dataset.patternhash import PatternHash
from gcd_dataset.shards.access import locked
from gcd_dataset.shards.contents import splits_in
from gcd_dataset.shards.folder import FolderStore
from gcd_dataset.shards.layout import recipe_hash
from gcd_dataset.shards.manifest import MANIFEST, Manifest, RecipeRecord, read_manifest
from gcd_dataset.shards.pattern_arrays import stored_patterns
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.verbs.making import MADE, generate_recipe
from gcd_dataset.verbs.progress import Progress
from gcd_dataset.verbs.seal import is_sealed
from gcd_dataset.workers import without_main_module

__all__ = ["have_recipe", "recipe_faults", "recipe_lines"]

SAMPLED = 32  # designs that are made again where a recipe does not tell the hash of all its patterns
LOCK = ".recipe.lock"

log = logging.getLogger(__name__)


# --------------------------------------------------------------------------------------------------------------- info


def recipe_lines(name: str = "") -> Iterator[str]:
    """A line for each recipe of the package; of the one of that name all it says. Raises ``ConfigError``."""
    if not name:
        recipes = [find_recipe(name) for name in recipe_names()]
        width = max(len(recipe.name) for recipe in recipes)
        yield from (f"{recipe.name:<{width}}  {recipe.about}" for recipe in recipes)
        return
    recipe = find_recipe(name)
    yield f"{recipe.name}: {recipe.about}"
    yield f"  {recipe.designs} designs, {recipe.count} garments, seed {recipe.seed}; sha256 {recipe.sha256}"
    yield f"  splits: {', '.join(f'{split} {size}' for split, size in recipe.sizes().items())}"
    made = {option: value for option, value in recipe_of(recipe.config).items() if option != "device"}
    yield f"  options: {', '.join(f'{option} {value}' for option, value in made.items() if value != {})}"
    yield f"  patterns: {recipe.patterns or 'nobody has made all of them yet'}"


# ------------------------------------------------------------------------------------------------------------- verify


def recipe_faults(folder: Path, recipe: Recipe) -> Iterator[str]:
    """Why a folder is not the data set of a recipe, one line each.

    Its manifest names the recipe; each split holds the samples that the recipe puts there, made with its seed and
    options on any device; and the patterns have the recipe's hash. Where the recipe does not tell that, some patterns
    are made again and compared. Raises ``ShardError`` for a folder that cannot be read.
    """
    manifest = read_manifest(folder) or Manifest()
    there = manifest.recipe or RecipeRecord("", "")
    if (there.name, there.sha256) != (recipe.name, recipe.sha256):
        named = f"{there.name} ({there.sha256})" if there.name else "none"
        yield f"{folder / MANIFEST}: tells of recipe {named}, asked for {recipe.name} ({recipe.sha256})"
        return
    faults = [*_split_faults(folder, manifest, recipe)]
    yield from faults
    if faults:
        return
    readers = [ShardReader(FolderStore(folder), split) for split in recipe.splits]
    try:
        found = sum((PatternHash.of(stored_patterns(reader)) for reader in readers), PatternHash())
    except GcdError as error:
        yield str(error)
        return
    if not there.patterns:
        yield f"{folder / MANIFEST}: no hash of the patterns yet: run gcd generate --recipe {recipe.name} again"
    elif not found.agrees(there.patterns):
        yield f"{folder}: its patterns have hash {found.text}, and {MANIFEST} tells of {there.patterns}"
    if recipe.patterns:
        if not found.agrees(recipe.patterns):
            yield f"{folder}: its patterns have hash {found.text}, those of {recipe.name} {recipe.patterns}"
    else:
        yield from _sampled_faults(folder, readers, recipe)


def _split_faults(folder: Path, manifest: Manifest, recipe: Recipe) -> Iterator[str]:
    """Samples that are missing, or in the wrong split, and splits made otherwise."""
    held = splits_in(folder)
    for split in sorted(set(held) - set(recipe.splits)):
        yield f"{folder}: split {split} is none of {recipe.name}: take it away"
    asked = recipe_of(recipe.config)
    for split in recipe.splits:
        if split not in held:
            yield f"{folder}: no split {split}: run gcd generate --recipe {recipe.name} again"
            continue
        record = manifest.splits.get(split)
        if record is None or record.seed != recipe.seed:
            yield f"{folder / MANIFEST}: split {split} is not of seed {recipe.seed}"
        elif other := [
            name
            for name in sorted((asked.keys() | record.recipe.keys()) - {"device"})
            if recipe_hash({name: asked.get(name)}) != recipe_hash({name: record.recipe.get(name)})
        ]:
            met, wanted = record.recipe.get(other[0]), asked.get(other[0])
            yield f"{folder / MANIFEST}: split {split} was made with {other[0]}={met!r}, the recipe has {wanted!r}"
        reader = ShardReader(FolderStore(folder), split)
        there = reader.index.table.sample[reader.rows(range(len(reader)))]
        wanted = recipe.indices_in(split)
        if missing := len(np.setdiff1d(wanted, there)):
            yield f"{folder}: split {split} lacks {missing} of {len(wanted)} samples: run gcd generate again"
        if foreign := len(np.setdiff1d(there, wanted)):
            yield f"{folder}: split {split} holds {foreign} samples of other splits: delete it, and make it again"


def _sampled_faults(folder: Path, readers: Iterable[ShardReader], recipe: Recipe) -> Iterator[str]:
    """Designs whose patterns are others when they are made again."""
    designs = np.unique(np.linspace(0, recipe.designs - 1, min(recipe.designs, SAMPLED)).astype(int)).tolist()
    log.info("%s does not tell the hash of all its patterns: %d designs are made again", recipe.name, len(designs))
    made = dict(made_patterns(recipe, designs))
    for reader in readers:
        for index, pattern in stored_patterns(reader, of=made.keys()):
            if not PatternHash.of([(index, made[index])]).agrees(PatternHash.of([(index, pattern)]).text):
                yield f"{folder}: {pattern.name} has another pattern when it is made again"


# ------------------------------------------------------------------------------------------------------------ loading


def have_recipe(recipe: Recipe, folder: Path) -> None:
    """Have the data set of a recipe in a folder: made now, with a bar on stderr, unless all of it is there.

    Another process that asks for it meanwhile waits. Raises ``ConfigError`` for a folder that holds something else, or
    the data set as another version of this package made it; else as ``generate_recipe``.
    """
    if not is_sealed(folder, recipe):
        with _alone(make_folder(folder), recipe):
            if not is_sealed(folder, recipe):
                _make(recipe, folder)
    there = (read_manifest(folder) or Manifest()).recipe
    if recipe.patterns and there is not None and there.patterns != recipe.patterns:
        raise ConfigError(
            f"{folder}: {recipe.name} with other patterns than this version of the package draws: delete it, and it is "
            "made anew, or read it as a folder"
        )


def _make(recipe: Recipe, folder: Path) -> None:
    from tqdm import tqdm

    _tell_estimate(recipe, folder)
    workers = 0 if multiprocessing.current_process().daemon else None  # a DataLoader's worker may have no processes
    with tqdm(total=recipe.count, unit="garment", desc=recipe.name) as bar:

        def told(progress: Progress) -> None:
            bar.update(progress.done - bar.n)

        with without_main_module():
            generate_recipe(folder, recipe, workers=workers, told=told)


def _tell_estimate(recipe: Recipe, folder: Path) -> None:
    from gcd_dataset.generator.drape import seconds_to_drape
    from gcd_dataset.generator.drape.device import cores

    manifest = read_manifest(folder) or Manifest()
    there = sum(shard.count for split in manifest.splits.values() for shard in split.shards)
    missing, config = recipe.count - there, recipe.config
    seconds = MADE[config.stage] * missing / cores()
    if config.stage == "drape":
        seconds = max(seconds, seconds_to_drape(missing, config.device, config.resolution))
    log.warning(
        "%s: %d garments are to be made in %s, in about %s; stopped, it goes on from there",
        recipe.name,
        missing,
        folder,
        _spoken(seconds),
    )


def _spoken(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


@contextmanager
def _alone(folder: Path, recipe: Recipe) -> Iterator[None]:
    """Hold the folder; wait, and say so, while another process makes the data set there."""
    task = f"making {recipe.name}"
    with ExitStack() as held:
        try:
            held.enter_context(locked(folder / LOCK, task))
        except OutputError as error:
            if not isinstance(error.__cause__, BlockingIOError) or _begins_for_parent():
                raise
            log.warning("%s: another process is %s there: waiting for it", folder, task)
            held.enter_context(locked(folder / LOCK, task, wait=True))
        yield


def _begins_for_parent() -> bool:
    """Whether this process runs a program's top level again for the workers of the one that holds the lock.

    That one waits for us: multiprocessing ends such a process in the same way, by the same mark.
    """
    return bool(getattr(multiprocessing.current_process(), "_inheriting", False))
