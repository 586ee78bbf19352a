"""A data set brought to the Hub."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from gcd_dataset.hub.partition import SHARES
from gcd_dataset.hub.publish import Staged, stage, upload

__all__ = ["Published", "publish"]


@dataclass(frozen=True)
class Published:
    """What went up, or would."""

    staged: Staged
    commit: str | None
    """Of the repository; ``None`` where nothing was sent."""


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
    told: Callable[[Staged], None] = lambda staged: None,
) -> Published:
    """Bring a folder of shards to the repository ``repo`` of the Hub, with card, Croissant and splits.

    ``out``: folder for what goes up, by default ``published`` in that of the data set; gone on with where an earlier
    call was stopped. ``told`` is called with what is in it before anything is sent; with ``dry_run`` nothing is. Raises
    as ``stage`` and ``upload`` do, of which the other options are.
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
    told(staged)
    commit = None if dry_run else upload(staged, repo, endpoint=endpoint, token=token, private=private)
    return Published(staged, commit)
