"""Publishes a data set on the Hub: divides it into splits, describes and uploads it."""

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

from gcd_dataset.errors import ConfigError, RemoteError, did_you_mean, shown
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.hub.card import LICENSES, Release, card, croissant
from gcd_dataset.hub.partition import BODY, DESIGN, SHARES, leaks, partition
from gcd_dataset.hub.retry import first_line
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
CLIENTS = ("httpx2", "httpx", "requests")  # HTTP libraries of huggingface_hub 2, 1 and 0.36
ANY_ENDPOINT = (1, 31)  # first tested version of huggingface_hub that publishes to any endpoint
LICENSE_LIST = "huggingface.co/docs/hub/repositories-licenses"
STAGED = ".staged"  # marks a staging folder: its shards are copies and may be replaced
REPLACED = re.compile(r"[^/]+-\d{5,}\.tar|index-[^/]+\.npz")
HUB_NAMES = {"training": "train", "val": "validation", "valid": "validation", "dev": "validation"}
"""Other names of splits to the Hub's names."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Staged:
    """A folder ready for upload."""

    folder: Path
    manifest: Manifest
    files: Mapping[str, int]
    """Path to size [bytes] of the files to upload."""

    @property
    def garments(self) -> int:
        """Number of garments in all splits."""
        return sum(shard.count for split in self.manifest.splits.values() for shard in split.shards)


@dataclass(frozen=True)
class _Plan:
    """The samples of one published split."""

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
    """Write the files to publish as ``repo`` into ``folder``, continuing an interrupted call.

    A data set of one split is divided by ``shares`` into splits that share no design, body or pattern; several splits
    are kept. ``partial`` allows a data set whose run was stopped. Raises ``ConfigError`` for a license that the Hub
    does not know, splits that share designs, foreign tars, an unfinished data set, parts that are not merged, and for a
    staging folder that holds other files.
    """
    if not isinstance(parse_source(repo), Repo):
        raise ConfigError(f"{repo}: not a repository: give ORG/NAME, and no local folder of that name")
    license = _license(license)  # noqa: A001
    require_merged(dataset, ConfigError)
    for split in splits_in(dataset):
        if not partial and (problem := unfinished(dataset, split)) is not None:
            raise ConfigError(f"{dataset}: split {split} is not whole: {problem}, or publish it with --partial")
    plans = _plans(dataset, shares)
    _prepare(folder)
    splits: dict[str, SplitRecord] = {}
    settled: dict[str, int] = {}
    members: tuple[str, ...] = ()
    for name, plan in plans.items():
        with locked(folder / lock_name(name), f"writing split {name}"):
            splits[name] = _write_split(folder, name, plan)
        settled[name] = int(plan.reader.index.table.settled[plan.reader.rows(plan.positions)].sum())
        members = plan.reader.layout.members
    source_manifest = next(iter(plans.values())).reader.manifest or Manifest()
    manifest = replace(source_manifest, splits=splits)
    _remove_unlisted(folder, manifest)
    manifest.write(folder)
    is_divided = _only_split(splits_in(dataset)) is not None or manifest.recipe is not None
    release = Release(repo, manifest, settled, members, license, is_divided, hub_endpoint(endpoint))
    write_whole(folder / CARD, card(release).encode())
    listed = {name: _size_and_hash(folder / name) for name in [MANIFEST, *map(index_name, splits)]}
    listed |= {shard.name: (shard.size, shard.sha256) for split in splits.values() for shard in split.shards}
    description = croissant(release, listed)
    write_whole(folder / CROISSANT, (json.dumps(description, indent=1) + "\n").encode())
    names = [CARD, CROISSANT, *listed]
    return Staged(folder, manifest, {name: (folder / name).stat().st_size for name in names})


def upload(
    staged: Staged, repo: str, *, endpoint: str | None = None, token: str | None = None, private: bool = False
) -> str:
    """Upload a staged folder to the Hub, creating the repository if needed; the commit's hash.

    All files are in one commit, so readers see either the previous version or the whole new one. Raises ``RemoteError``
    if the Hub does not answer, or refuses; ``ConfigError`` for an endpoint that this version of ``huggingface_hub``
    cannot publish to.
    """
    from huggingface_hub import CommitOperationAdd, CommitOperationDelete, HfApi

    api = HfApi(endpoint=hub_endpoint(endpoint), token=token)
    name = _repo_name(repo)
    _require_endpoint(api.endpoint)
    with _asking_hub(repo):
        api.create_repo(name, repo_type="dataset", private=private, exist_ok=True)
        added = [CommitOperationAdd(path, staged.folder / path) for path in staged.files]
        api.preupload_lfs_files(name, added, repo_type="dataset")
        # Listed after the upload, which may take hours.
        present = api.list_repo_files(name, repo_type="dataset")
        stale = [path for path in present if _is_replaced(path) and path not in staged.files]
        commit = api.create_commit(
            name,
            [*added, *map(CommitOperationDelete, stale)],
            repo_type="dataset",
            commit_message=f"{staged.garments} garments",
        )
    return str(commit.oid)


def _license(name: str) -> str:
    """The Hub's identifier of a license, from that or the SPDX name. Raises ``ConfigError`` for any other."""
    families = re.fullmatch(r"(odc-by|odbl|pddl)-1\.0|(.*?)(?:-only|-or-later)?", name.lower(), re.DOTALL)
    known = (families and (families[1] or families[2])) or ""
    if known not in LICENSES:
        raise ConfigError(
            f"license {shown(name)}: unknown to the Hub: give cc-by-4.0, cc0-1.0, odc-by, cdla-permissive-2.0, "
            f"apache-2.0, another that {LICENSE_LIST} lists, or other{did_you_mean(name.lower(), LICENSES)}"
        )
    return known


def _prepare(folder: Path) -> None:
    """Make the staging folder. Raises ``ConfigError`` for a folder that holds anything else."""
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
    """Published split to its samples. Raises ``ConfigError`` as ``stage`` does."""
    readers = {split: ShardReader(dataset, split) for split in splits_in(dataset)}
    if not readers:
        raise ConfigError(f"{dataset}: no shards: give a folder made by gcd generate")
    for split, reader in readers.items():
        if reader.layout.kind == FOREIGN or reader.manifest is None or split not in reader.manifest.splits:
            raise ConfigError(f"{dataset}: {MANIFEST} has no recipe of split {split}: run gcd generate again")
        if missing := [field for field in (DESIGN, BODY) if field not in fields_of(reader.layout.members)]:
            raise ConfigError(
                f"{dataset}: its garments have no {missing[0]} to divide them by: publish a data set with all fields"
            )
    if shared := leaks(readers):
        raise ConfigError(
            f"{dataset}: {shared[0]}: publish it as one split, which is then divided, or generate them again"
        )
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
    _warn_of_empty_splits(dataset, shares, parts)
    return {name: _Plan(reader, _part(record, shares, name), positions) for name, positions in parts.items()}


def _only_split(splits: Collection[str]) -> str | None:
    """The split to divide: the only one besides ``failed``; ``None`` for several."""
    others = [split for split in splits if split != FAILED] or [*splits]
    return others[0] if len(others) == 1 else None


def _warn_of_empty_splits(dataset: Path, shares: Mapping[str, float], parts: Mapping[str, object]) -> None:
    """Warn of splits that have a share but get no garment: there are fewer families than splits."""
    if missing := [name for name, share in shares.items() if share > 0 and name not in parts]:
        log.warning(
            "%s: no garments for %s: garments that share a design or a body stay in one split, and all garments fall "
            "into %s: add garments of other designs on other bodies, or give --shares 100,0,0",
            dataset,
            " and ".join(missing),
            " and ".join(parts),
        )


def _part(record: SplitRecord, shares: Mapping[str, float], name: str) -> SplitRecord:
    """The record of a part of a split; its shards hold about as many samples as the shards of the undivided split."""
    cut = {"of": {split: round(share, 6) for split, share in shares.items()}, "name": name}
    return replace(
        record, recipe={**record.recipe, "part": cut}, shard_size=round(record.shard_size / max(shares[name], 0.01))
    )


def _write_split(folder: Path, name: str, plan: _Plan) -> SplitRecord:
    """Write shards and index of a split; its record."""
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


def _remove_unlisted(folder: Path, manifest: Manifest) -> None:
    """Remove shards of an earlier call that the manifest does not list."""
    listed = {shard.name for split in manifest.splits.values() for shard in split.shards}
    for split in splits_in(folder):
        for path in shards_in(folder, split):
            if path.name not in listed:
                with writing(path):
                    path.unlink()


def _is_replaced(path: str) -> bool:
    """Whether a file of a repository is a shard or an index, which an upload replaces."""
    return REPLACED.fullmatch(path) is not None


def _size_and_hash(path: Path) -> tuple[int, str]:
    content = path.read_bytes()
    return len(content), hashlib.sha256(content).hexdigest()


def _repo_name(repo: str) -> str:
    source = parse_source(repo)
    assert isinstance(source, Repo)
    return source.name


@contextmanager
def _asking_hub(repo: str) -> Iterator[None]:
    """Turn errors of ``huggingface_hub`` into ``RemoteError``."""
    from huggingface_hub.errors import HfHubHTTPError

    connection_errors: tuple[type[Exception], ...] = (
        ConnectionError,
        *_errors_of_clients("TransportError", "ConnectionError", "ReadTimeout"),
    )
    request_errors: tuple[type[Exception], ...] = (
        HfHubHTTPError,
        RuntimeError,
        ValueError,
        *_errors_of_clients("HTTPError", "RequestException"),
    )
    try:
        yield
    except connection_errors as error:
        raise _publish_error(repo, error, "check the network and HF_ENDPOINT") from error
    except request_errors as error:
        # huggingface_hub raises RuntimeError or ValueError for a failed upload.
        raise _publish_error(repo, error, "check the token (hf auth login) and your rights") from error


def _errors_of_clients(*names: str) -> tuple[type[Exception], ...]:
    """The exceptions of these names in the HTTP clients that are loaded."""
    loaded = [sys.modules[client] for client in CLIENTS if client in sys.modules]
    return tuple(getattr(client, name) for client in loaded for name in names if hasattr(client, name))


def _require_endpoint(endpoint: str) -> None:
    """Raise ``ConfigError`` for an endpoint other than ``HF_ENDPOINT`` where huggingface_hub cannot publish to it."""
    import huggingface_hub

    major, minor = map(int, huggingface_hub.__version__.split(".")[:2])
    if (major, minor) < ANY_ENDPOINT and endpoint != huggingface_hub.constants.ENDPOINT:
        raise ConfigError(
            f"--endpoint {endpoint}: huggingface_hub {huggingface_hub.__version__} publishes to HF_ENDPOINT only: set "
            f"it, or install huggingface_hub {'.'.join(map(str, ANY_ENDPOINT))} or later"
        )


def _publish_error(repo: str, error: Exception, remedy: str) -> RemoteError:
    return RemoteError(
        f"{repo}: cannot be published ({first_line(error)}): {remedy}, then run it again: uploaded files are not sent "
        "again"
    )
