"""The data set of a recipe, generated on demand."""

import logging
import multiprocessing
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from gcd_dataset.errors import ConfigError, OutputError
from gcd_dataset.files import make_folder
from gcd_dataset.generator.recipes import Recipe
from gcd_dataset.making.garments import generate_recipe
from gcd_dataset.making.progress import Progress
from gcd_dataset.shards.access import locked
from gcd_dataset.shards.manifest import Manifest, read_manifest
from gcd_dataset.workers import without_main_module

LOCK = ".recipe.lock"

log = logging.getLogger(__name__)


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
                missing = progress.count - progress.done
                log.warning(
                    "%s: making %d garments in %s; the next call resumes a stopped one", recipe.name, missing, folder
                )
            bar.update(progress.done - bar.n)

        with without_main_module():
            generate_recipe(folder, recipe, workers=workers, on_progress=report)


@contextmanager
def _lock_folder(folder: Path, recipe: Recipe) -> Iterator[None]:
    """Lock the folder for the block; waits, with a warning, while another process makes the data set there."""
    task = f"making {recipe.name}"
    # A spawned worker that imports the main module again must not wait: its parent may hold the lock and wait for it.
    # ``multiprocessing`` checks the same flag before it starts a process.
    is_importing_main = getattr(multiprocessing.current_process(), "_inheriting", False)
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(folder / LOCK, task))
        except OutputError as error:
            if not isinstance(error.__cause__, BlockingIOError) or is_importing_main:
                raise
            log.warning("%s: another process is %s there: waiting for it", folder, task)
            stack.enter_context(locked(folder / LOCK, task, wait=True))
        yield
