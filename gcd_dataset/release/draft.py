"""Writes a release garment by garment; an interrupted run is continued.

Unfinished garments lie in a hidden folder, with a note that identifies their source; the folder is removed at the end.
Garments outside that folder are complete.
"""

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.files import make_folder, require_name, write_whole, writing_to
from gcd_dataset.shards.access import locked, reading

UNFINISHED, NOTE, LOCK = ".unfinished", ".garments", ".export.lock"


class ReleaseDraft:
    """The folder of a release during export."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._unfinished = folder, folder / UNFINISHED
        self._visited: set[Path] = set()

    def begin(self, garments: str) -> None:
        """Start or continue the export. Raises ``ConfigError`` for a folder with other ``garments`` or files."""
        note = self._unfinished / NOTE
        with reading(self.folder):
            begun = note.read_text() if note.exists() else None
            others = {path.name for path in self.folder.iterdir()} - {UNFINISHED, LOCK}
        if others and begun is None:
            raise ConfigError(f"{self.folder}: not empty: choose another folder")
        if others and begun != garments:
            raise ConfigError(
                f"{self.folder}: begun with other garments, or by another version of gcd_dataset: delete it, or choose "
                "another folder"
            )
        make_folder(self._unfinished)
        write_whole(note, garments.encode())

    def holds(self, path: Path) -> bool:
        """Whether the garment at ``path``, relative to the release, is complete.

        Raises ``ShardError`` for a path that was queried before, and for an unsafe one.
        """
        for part in path.parts:
            require_name(part, f"{self.folder}: a garment's path")
        if path in self._visited:
            raise ShardError(
                f"{self.folder / path}: two garments of the data set have this name: export their splits one by one"
            )
        self._visited.add(path)
        with reading(self.folder / path):
            return (self.folder / path).exists()

    def put(self, path: Path, files: Mapping[str, bytes]) -> None:
        """Write the files of a garment, atomically. Raises ``OutputError``."""
        folder, draft = self.folder / path, self._unfinished / path.name
        with writing_to(draft):
            if draft.exists():  # left by a run that was killed
                shutil.rmtree(draft)
        make_folder(draft)
        for name, content in files.items():
            write_whole(draft / name, content)
        make_folder(folder.parent)
        with writing_to(folder):
            draft.rename(folder)

    def end(self) -> None:
        """Remove the hidden folder: the export is complete. Raises ``OutputError``."""
        with writing_to(self._unfinished):
            shutil.rmtree(self._unfinished)


@contextmanager
def release_draft(folder: Path | str, garments: str) -> Iterator[ReleaseDraft]:
    """A release in ``folder``, complete when the block ends without an error; otherwise the next call continues it.

    ``garments``: a text that identifies the exported garments. Raises ``ConfigError`` for a folder with anything else
    in it, ``OutputError`` for one that cannot be written, or is locked by another process.
    """
    draft = ReleaseDraft(make_folder(folder))
    with locked(draft.folder / LOCK, "exporting"):
        draft.begin(garments)
        yield draft
        draft.end()
