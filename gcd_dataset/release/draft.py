"""A release that is being written: every garment in its place is whole, and a later run goes on.

What is not whole lies in a hidden folder of the release, beside a note of which garments it is made from; that folder
goes when everything is there.
"""

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.files import make_folder, write_whole, writing_to
from gcd_dataset.names import require_name
from gcd_dataset.shards.access import locked, reading

__all__ = ["ReleaseDraft", "release_draft"]

UNFINISHED, NOTE, LOCK = ".unfinished", ".garments", ".export.lock"


class ReleaseDraft:
    """The folder of a release while garments are put into it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._apart = folder, folder / UNFINISHED
        self._put: set[Path] = set()

    def begin(self, garments: str) -> None:
        """Begin, or go on where a run with the same ``garments`` was stopped. Raises ``ConfigError`` for others."""
        note = self._apart / NOTE
        with reading(self.folder):
            begun = note.read_text() if note.exists() else None
            others = {path.name for path in self.folder.iterdir()} - {UNFINISHED, LOCK}
        if others and begun is None:
            raise ConfigError(
                f"{self.folder}: not empty: choose another folder, so that nothing of two data sets is mixed"
            )
        if others and begun != garments:
            raise ConfigError(
                f"{self.folder}: begun from other garments, or by another version of gcd_dataset: delete it, or choose "
                "another folder"
            )
        make_folder(self._apart)
        write_whole(note, garments.encode())

    def holds(self, place: Path) -> bool:
        """Whether the garment of that place is there.

        Raises ``ShardError`` for a place that was asked for before, and for one outside the release.
        """
        for part in place.parts:
            require_name(part, f"{self.folder}: a garment's place")
        if place in self._put:
            raise ShardError(
                f"{self.folder / place}: two garments of the data set have this name: export their splits one by one"
            )
        self._put.add(place)
        with reading(self.folder / place):
            return (self.folder / place).exists()

    def put(self, place: Path, files: Mapping[str, bytes]) -> None:
        """The files of a garment, all of them or none. Raises ``OutputError``."""
        folder, draft = self.folder / place, self._apart / place.name
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
        """All is there. Raises ``OutputError``."""
        with writing_to(self._apart):
            shutil.rmtree(self._apart)


@contextmanager
def release_draft(folder: Path | str, garments: str) -> Iterator[ReleaseDraft]:
    """A release in ``folder``, whole when the block ends well; else the same ``garments`` may be gone on with.

    ``garments``: what tells them from others. Raises ``ConfigError`` for a folder with anything else in it,
    ``OutputError`` for one that cannot be written, or that another process writes.
    """
    draft = ReleaseDraft(make_folder(folder))
    with locked(draft.folder / LOCK, "exporting"):
        draft.begin(garments)
        yield draft
        draft.end()
