"""A data set brought to the Hub: divided into splits, described, and uploaded."""

import hashlib
import json
import logging
import re
import sys
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from gcd_dataset.errors import ConfigError, RemoteError, shown
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.hub.card import Release, card, croissant
from gcd_dataset.hub.partition import BODY, DESIGN, SHARES, leaks, partition
from gcd_dataset.hub.site import hub_endpoint
from gcd_dataset.hub.source import Repo, parse_source
from gcd_dataset.shards.access import locked, reading, writing
from gcd_dataset.shards.contents import splits_in
from gcd_dataset.shards.copying import copy_shard
from gcd_dataset.shards.index import ShardIndex
from gcd_dataset.shards.job_parts import require_merged
from gcd_dataset.shards.layout import FAILED, FOREIGN, fields_of, index_name, lock_name, shard_name, shards_in
from gcd_dataset.shards.manifest import MANIFEST, Manifest, SplitRecord
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.shards.unfinished import unfinished

__all__ = ["Staged", "stage", "upload"]

CARD, CROISSANT = "README.md", "croissant.json"
CLIENTS = ("httpx2", "httpx", "requests")  # of huggingface_hub 2, 1 and 0.36
ANY_ENDPOINT = (1, 31)  # of huggingface_hub: the first that was seen to publish to any
STAGED = ".staged"  # in a folder whose shards are copies, which may be made anew
OURS = re.compile(r"[^/]+-\d{5,}\.tar|index-[^/]+\.npz")
HUB_NAMES = {"training": "train", "val": "validation", "valid": "validation", "dev": "validation"}
"""What the Hub calls splits that others call otherwise."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Staged:
    """A folder that is ready to go up."""

    folder: Path
    manifest: Manifest
    files: Mapping[str, int]
    """Path to size of what goes up."""

    @property
    def garments(self) -> int:
        """How many there are in all splits."""
        return sum(shard.count for split in self.manifest.splits.values() for shard in split.shards)


@dataclass(frozen=True)
class _Plan:
    """Which samples go into a split."""

    reader: ShardReader
    record: SplitRecord
    positions: list[int]


def stage(
    dataset: Path,
    repo: str,
    folder: Path,
    *,
    shares: Mapping[str, float] = SHARES,
    license: str = "unknown",  # noqa: A002 - the Hub's word
    endpoint: str | None = None,
    partial: bool = False,
) -> Staged:
    """Put what is to be published as ``repo`` into ``folder``; gone on with where an earlier call was left.

    A data set of one split is divided by ``shares``, so that neither designs nor bodies are shared; several splits stay
    as they are. Raises ``ConfigError`` for splits that share designs, a data set that is not ours, one whose making was
    stopped, unless it is to be published in part (``partial``), one whose parts are not merged, or a folder that holds
    another data set.
    """
    if not isinstance(parse_source(repo), Repo):
        raise ConfigError(f"{repo}: no repository: write ORG/NAME, and see to it that no folder here is called so")
    require_merged(dataset, ConfigError)
    for split in splits_in(dataset):
        if not partial and (told := unfinished(dataset, split)) is not None:
            raise ConfigError(f"{dataset}: split {split} is not whole: {told}, or publish what is there with --partial")
    plans = _plans(dataset, shares)
    _begin(folder)
    splits: dict[str, SplitRecord] = {}
    settled: dict[str, int] = {}
    members: tuple[str, ...] = ()
    for name, plan in plans.items():
        with locked(folder / lock_name(name), f"writing split {name}"):
            splits[name] = _write_split(folder, name, plan)
        settled[name] = int(plan.reader.index.table.settled[plan.reader.rows(plan.positions)].sum())
        members = plan.reader.layout.members
    generator = next(iter(plans.values())).reader.manifest or Manifest()
    manifest = replace(generator, splits=splits)
    _tidy(folder, manifest)
    manifest.write(folder)
    is_divided = _only_split(splits_in(dataset)) is not None or manifest.recipe is not None
    release = Release(repo, manifest, settled, members, license, is_divided, hub_endpoint(endpoint))
    write_whole(folder / CARD, card(release).encode())
    listed = {name: _size_and_hash(folder / name) for name in [MANIFEST, *map(index_name, splits)]}
    listed |= {shard.name: (shard.size, shard.sha256) for split in splits.values() for shard in split.shards}
    described = croissant(release, listed)
    write_whole(folder / CROISSANT, (json.dumps(described, indent=1) + "\n").encode())
    names = [CARD, CROISSANT, *listed]
    return Staged(folder, manifest, {name: (folder / name).stat().st_size for name in names})


def upload(
    staged: Staged, repo: str, *, endpoint: str | None = None, token: str | None = None, private: bool = False
) -> str:
    """Bring what is staged to the Hub, which is made to hold it if need be; the commit.

    One commit holds all of it: until then a reader finds the release before, and from then on the whole of this one.
    Raises ``RemoteError`` for a Hub that does not answer, or refuses; ``ConfigError`` for an endpoint that this version
    of ``huggingface_hub`` cannot publish to.
    """
    from huggingface_hub import CommitOperationAdd, CommitOperationDelete, HfApi

    api = HfApi(endpoint=hub_endpoint(endpoint), token=token)
    name = _repo_name(repo)
    _require_endpoint(api.endpoint)
    with _asking_hub(repo):
        api.create_repo(name, repo_type="dataset", private=private, exist_ok=True)
        added = [CommitOperationAdd(path, staged.folder / path) for path in staged.files]
        api.preupload_lfs_files(name, added, repo_type="dataset")
        # Listed when all bytes are up, which may take hours.
        there = api.list_repo_files(name, repo_type="dataset")
        stale = [path for path in there if _is_ours(path) and path not in staged.files]
        commit = api.create_commit(
            name,
            [*added, *map(CommitOperationDelete, stale)],
            repo_type="dataset",
            commit_message=f"{staged.garments} garments",
        )
    return str(commit.oid)


def _begin(folder: Path) -> None:
    """Make the folder, marked as one of copies. Raises ``ConfigError`` for one that holds anything else."""
    make_folder(folder)
    if not (folder / STAGED).exists():
        if splits_in(folder):
            raise ConfigError(f"{folder}: holds a data set, whose shards would be replaced: choose another folder")
        with reading(folder):
            others = sorted(path.name for path in folder.iterdir())
        if others:
            raise ConfigError(f"{folder}: holds {shown(others[0])}: choose another folder, or an empty one")
        write_whole(folder / STAGED, b"")


def _plans(dataset: Path, shares: Mapping[str, float]) -> dict[str, _Plan]:
    """Split to what goes into it."""
    readers = {split: ShardReader(dataset, split) for split in splits_in(dataset)}
    if not readers:
        raise ConfigError(f"{dataset}: no shards: give a folder that gcd generate has made")
    for split, reader in readers.items():
        if reader.layout.kind == FOREIGN or reader.manifest is None or split not in reader.manifest.splits:
            raise ConfigError(f"{dataset}: {MANIFEST} does not tell how split {split} was made: run gcd generate again")
        if missing := [field for field in (DESIGN, BODY) if field not in fields_of(reader.layout.members)]:
            raise ConfigError(f"{dataset}: its garments have no {missing[0]} to divide them by: publish the whole")
    if told := leaks(readers):
        raise ConfigError(f"{dataset}: {told[0]}: publish it as one split, which is then divided, or make them anew")
    divided = _only_split(readers)
    plans = {
        HUB_NAMES.get(split, split): _Plan(reader, reader.manifest.splits[split], list(range(len(reader))))
        for split, reader in readers.items()
        if reader.manifest is not None and split != divided
    }
    return plans if divided is None else _divided(dataset, readers[divided], shares) | plans


def _divided(dataset: Path, reader: ShardReader, shares: Mapping[str, float]) -> dict[str, _Plan]:
    assert reader.manifest is not None
    record, parts = reader.manifest.splits[reader.split], partition(reader, shares)
    _tell_missing(dataset, shares, parts)
    return {name: _Plan(reader, _part(record, shares, name), positions) for name, positions in parts.items()}


def _only_split(splits: Collection[str]) -> str | None:
    """The split that is to be divided, if there is one alone; beside it drapes that failed may be kept."""
    others = [split for split in splits if split != FAILED] or [*splits]
    return others[0] if len(others) == 1 else None


def _tell_missing(dataset: Path, shares: Mapping[str, float], parts: Mapping[str, object]) -> None:
    """Warn of splits that have a share and get no garment, since fewer families are there than splits."""
    if missing := [name for name, share in shares.items() if share > 0 and name not in parts]:
        log.warning(
            "%s: nothing for %s: garments that share a design or a body stay in one split, and all of these fall into "
            "%s: add garments of other designs on other bodies, or give --shares 100,0,0",
            dataset,
            " and ".join(missing),
            " and ".join(parts),
        )


def _part(record: SplitRecord, shares: Mapping[str, float], name: str) -> SplitRecord:
    """How a part of a split was made; its shards hold as many samples as those of the whole, about."""
    cut = {"of": {split: round(share, 6) for split, share in shares.items()}, "name": name}
    return replace(
        record, recipe={**record.recipe, "part": cut}, shard_size=round(record.shard_size / max(shares[name], 0.01))
    )


def _write_split(folder: Path, name: str, plan: _Plan) -> SplitRecord:
    """The shards and the index of a split."""
    sample = plan.reader.index.table.sample[plan.reader.rows(plan.positions)]
    numbered = zip((sample // plan.record.shard_size).tolist(), plan.positions, strict=True)
    records, tables = [], {}
    for number, group in groupby(sorted(numbered), key=lambda entry: entry[0]):
        path = folder / shard_name(name, number)
        positions = [position for _, position in group]
        record, tables[path.name] = copy_shard(path, plan.reader, positions, plan.reader.layout, lambda size: None)
        records.append(record)
    ShardIndex.of(folder, tables, plan.reader.layout).write(folder / index_name(name))
    return replace(plan.record, shards=tuple(records))


def _tidy(folder: Path, manifest: Manifest) -> None:
    """Remove shards of an earlier call that are no longer part of it."""
    listed = {shard.name for split in manifest.splits.values() for shard in split.shards}
    for split in splits_in(folder):
        for path in shards_in(folder, split):
            if path.name not in listed:
                with writing(path):
                    path.unlink()


def _is_ours(path: str) -> bool:
    """Whether a file of a repository is one that a release replaces."""
    return OURS.fullmatch(path) is not None


def _size_and_hash(path: Path) -> tuple[int, str]:
    content = path.read_bytes()
    return len(content), hashlib.sha256(content).hexdigest()


def _repo_name(repo: str) -> str:
    place = parse_source(repo)
    assert isinstance(place, Repo)
    return place.name


@contextmanager
def _asking_hub(repo: str) -> Iterator[None]:
    """Turn what ``huggingface_hub`` raises into a ``RemoteError``."""
    from huggingface_hub.errors import HfHubHTTPError

    unreached: tuple[type[Exception], ...] = (
        ConnectionError,
        *_errors_of_clients("TransportError", "ConnectionError", "ReadTimeout"),
    )
    failed: tuple[type[Exception], ...] = (
        HfHubHTTPError,
        RuntimeError,
        ValueError,
        *_errors_of_clients("HTTPError", "RequestException"),
    )
    try:
        yield
    except unreached as error:
        raise _unpublished(repo, error, "see to the network and to HF_ENDPOINT") from error
    except failed as error:
        # An upload that fails comes as a RuntimeError or ValueError.
        raise _unpublished(repo, error, "see to the token (hf auth login) and your rights") from error


def _errors_of_clients(*names: str) -> tuple[type[Exception], ...]:
    """The exceptions of these names, of whichever HTTP client this version of ``huggingface_hub`` has loaded."""
    loaded = [sys.modules[client] for client in CLIENTS if client in sys.modules]
    return tuple(getattr(client, name) for client in loaded for name in names if hasattr(client, name))


def _require_endpoint(endpoint: str) -> None:
    """Raise ``ConfigError`` for another endpoint than ``HF_ENDPOINT`` where a commit to it could not be read back."""
    import huggingface_hub

    major, minor = map(int, huggingface_hub.__version__.split(".")[:2])
    if (major, minor) < ANY_ENDPOINT and endpoint != huggingface_hub.constants.ENDPOINT:
        raise ConfigError(
            f"--endpoint {endpoint}: huggingface_hub {huggingface_hub.__version__} publishes to HF_ENDPOINT alone: set "
            f"that, or install huggingface_hub {'.'.join(map(str, ANY_ENDPOINT))} or later"
        )


def _unpublished(repo: str, error: Exception, remedy: str) -> RemoteError:
    reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    return RemoteError(
        f"{repo}: cannot be published ({reason}): {remedy}, then run it again: what is up is not sent again"
    )
