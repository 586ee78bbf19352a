"""Uploading a data set to the Hub."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from gcd_dataset.hub.partition import SHARES
from gcd_dataset.hub.publish import Staged, stage, upload

__all__ = ["Published", "publish"]


@dataclass(frozen=True)
class Published:
    """The result of ``publish``: the staged files and the commit."""

    staged: Staged
    commit: str | None
    """Commit of the repository; ``None`` for a dry run."""


def publish(
    dataset: Path | str,
    repo: str,
    *,
    out: Path | str | None = None,
    shares: Mapping[str, float] = SHARES,
    license: str = "unknown",  # noqa: A002 - the Hub's word
    partial: bool = False,
    private: bool = False,
    dry_run: bool = False,
    endpoint: str | None = None,
    token: str | None = None,
    on_staged: Callable[[Staged], None] = lambda staged: None,
) -> Published:
    """Upload a folder of shards to the repository ``repo`` of the Hub, with card, Croissant and splits.

    ``out``: staging folder, by default ``published`` in the folder of the data set; an earlier call that was stopped is
    resumed. ``on_staged`` is called with the staged files before anything is sent; with ``dry_run`` nothing is sent.
    ``hub.publish.stage`` and ``upload`` describe the other options and the errors.
    """
    folder = Path(dataset)
    staged = stage(
        folder,
        repo,
        folder / "published" if out is None else Path(out),
        shares=shares,
        license=license,
        endpoint=endpoint,
        partial=partial,
    )
    on_staged(staged)
    commit = None if dry_run else upload(staged, repo, endpoint=endpoint, token=token, private=private)
    return Published(staged, commit)
