"""Publishes a data set on the Hub: divides it into splits, describes it, uploads it with ``huggingface_hub``."""

import hashlib
import json
import logging
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gcd_dataset.errors import ConfigError, RemoteError, ShardError, did_you_mean, shown
from gcd_dataset.files import drafted, make_folder
from gcd_dataset.hub.card import LICENSES, Release, card, croissant
from gcd_dataset.hub.download import remove_others, tars_of, write_changed
from gcd_dataset.hub.fetch import first_line
from gcd_dataset.hub.partition import DESIGN, SHARES, leaks, partition
from gcd_dataset.hub.remote import hub_endpoint
from gcd_dataset.hub.source import Repo, parse_source
from gcd_dataset.shards.access import REMEDY, Place, locked, reading
from gcd_dataset.shards.index import index_name
from gcd_dataset.shards.layout import FAILED
from gcd_dataset.shards.manifest import MANIFEST, Manifest, Plan, ShardRecord
from gcd_dataset.shards.notes import gather, hashed, note_name, note_of
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.shards.store import FolderStore
from gcd_dataset.shards.tar import END
from gcd_dataset.shards.writer import shard_size_of

CARD, CROISSANT = "README.md", "croissant.json"
ANY_ENDPOINT = "1.31"  # first tested version of huggingface_hub that publishes to any endpoint
STAGED = ".staged"  # marks a staging folder: its shards are copies and may be replaced
REPLACED = re.compile(r"(views/)?[^/]+-\d{5,}\.tar|[^/]+\.index")
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
    commit: str | None = None
    """Commit of the repository once they are uploaded."""

    @property
    def garments(self) -> int:
        """Number of garments in all splits."""
        return sum(self.manifest.counts.values())


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
) -> Staged:
    """Upload a folder of shards to the repository ``repo`` of the Hub, with card, Croissant and splits.

    ``out``: staging folder, by default ``published`` in the folder of the data set; an earlier call that was stopped is
    resumed. ``on_staged`` is called with the staged files before anything is sent; with ``dry_run`` nothing is sent.
    ``stage`` and ``upload`` describe the other options and the errors.
    """
    folder = Path(dataset) / "published" if out is None else Path(out)
    staged = stage(Path(dataset), repo, folder, shares=shares, license=license, endpoint=endpoint, partial=partial)
    on_staged(staged)
    if dry_run:
        return staged
    return replace(staged, commit=upload(staged, repo, endpoint=endpoint, token=token, private=private))


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
    does not know, splits that share designs, an unfinished data set, and for a staging folder that holds other files;
    ``ShardError`` for a damaged sample.
    """
    _repo_name(repo)
    license, store = _license(license), FolderStore(dataset)  # noqa: A001
    source = store.manifest()
    if not partial and (problem := next(filter(None, map(store.unfinished, source.splits)), None)) is not None:
        raise ConfigError(f"{dataset}: not whole: {problem}, or publish it with --partial")
    readers = {split: ShardReader(store, split) for split, record in source.splits.items() if record.count}
    divided = _divided(dataset, readers)
    make_folder(folder)
    with reading(folder):
        others = sorted(path.name for path in folder.iterdir()) if not (folder / STAGED).exists() else []
    if others:
        raise ConfigError(f"{folder}: holds {shown(others[0])}, not files to publish: choose another folder")
    write_changed(folder / STAGED, b"")
    with locked(folder / ".staging.lock", "staging it"):
        manifest = _copied(folder, readers) if divided is None else _divide(folder, readers, divided, shares)
        write_changed(folder / MANIFEST, manifest.to_bytes())
    tars = tars_of(manifest.splits)
    staged = {split: ShardReader(folder, split) for split in manifest.splits}
    settled = {split: int(reader.index.settled.sum()) for split, reader in staged.items()}
    first = staged.get("train", next(iter(staged.values())))
    others = [MANIFEST, *map(index_name, staged)]
    is_divided, hub = divided is not None or manifest.recipe is not None, hub_endpoint(endpoint)
    release = Release(repo, manifest, settled, first.layout.members, license, is_divided, hub)
    described = croissant(release, {**{name: hashed(folder / name) for name in others}, **tars})
    write_changed(folder / CARD, card(release).encode())
    write_changed(folder / CROISSANT, (json.dumps(described, indent=1) + "\n").encode())
    listed = [CARD, CROISSANT, *others, *sorted(tars)]
    return Staged(folder, manifest, {name: (folder / name).stat().st_size for name in listed})


def upload(
    staged: Staged, repo: str, *, endpoint: str | None = None, token: str | None = None, private: bool = False
) -> str:
    """Upload a staged folder to the Hub, creating the repository if needed; the commit's hash.

    New tars are sent first, by the upload of large folders; the last commit replaces changed files and the manifest:
    readers see the previous version or the new one. Raises ``RemoteError`` if the Hub does not answer, or refuses.
    """
    from huggingface_hub import CommitOperationAdd, CommitOperationDelete, HfApi

    api, name = HfApi(endpoint=hub_endpoint(endpoint), token=token), _repo_name(repo)
    _require_endpoint(api.endpoint)
    with _asking_hub(repo):
        api.create_repo(name, repo_type="dataset", private=private, exist_ok=True)
        present = api.list_repo_files(name, repo_type="dataset")
        if new := [path for path in staged.files if path.endswith(".tar") and path not in present]:
            wanted = new if any(path.endswith(".tar") for path in present) else "*.tar"
            folder, message = staged.folder, f"Tars of {staged.garments} garments"
            api.upload_folder(
                repo_id=name, folder_path=folder, repo_type="dataset", allow_patterns=wanted, commit_message=message
            )
        rest = [CommitOperationAdd(path, staged.folder / path) for path in staged.files if path not in new]
        stale = [path for path in present if REPLACED.fullmatch(path) and path not in staged.files]
        operations: list[CommitOperationAdd | CommitOperationDelete] = [*rest, *map(CommitOperationDelete, stale)]
        message = f"{staged.garments} garments"
        commit = api.create_commit(name, operations, repo_type="dataset", commit_message=message)
    return str(commit.oid)


def _repo_name(repo: str) -> str:
    source = parse_source(repo)
    if not isinstance(source, Repo):
        raise ConfigError(f"{repo}: not a repository: give ORG/NAME, and no local folder of that name")
    return source.name


def _license(name: str) -> str:
    """The Hub's identifier of a license, from that or the SPDX name. Raises ``ConfigError`` for any other."""
    families = re.fullmatch(r"(odc-by|odbl|pddl)-1\.0|(.*?)(?:-only|-or-later)?", name.lower(), re.DOTALL)
    known = (families and (families[1] or families[2])) or ""
    if known not in LICENSES:
        raise ConfigError(
            f"license {shown(name)}: unknown to the Hub: give cc-by-4.0, cc0-1.0, odc-by, cdla-permissive-2.0, "
            "apache-2.0, another that huggingface.co/docs/hub/repositories-licenses lists, or other"
            f"{did_you_mean(name.lower(), LICENSES)}"
        )
    return known


def _divided(dataset: Path, readers: Mapping[str, ShardReader]) -> str | None:
    """The split to divide: the only one besides ``failed``; ``None`` for several. Raises ``ConfigError``."""
    if not readers:
        raise ConfigError(f"{dataset}: no samples: give a folder made by gcd generate")
    for reader in readers.values():
        if DESIGN not in reader.layout.members:
            raise ConfigError(f"{dataset}: its garments have no {DESIGN} to divide them by: publish whole garments")
    if shared := leaks(readers):
        raise ConfigError(
            f"{dataset}: {shared[0]}: publish it as one split, which is then divided, or generate them again"
        )
    others = [split for split in readers if split != FAILED] or [*readers]
    return others[0] if len(others) == 1 else None


def _copied(folder: Path, readers: Mapping[str, ShardReader]) -> Manifest:
    """Copy the splits of a data set that has several, under the Hub's names; the manifest. Raises ``ShardError``."""
    splits = {}
    for split, reader in readers.items():
        name, content = HUB_NAMES.get(split, split), reader.index.to_bytes()
        splits[name] = replace(reader.record, index_sha256=hashlib.sha256(content).hexdigest())
        write_changed(folder / index_name(name), content)
        tars = tars_of({name: reader.record})
        for tar, copy in zip(tars_of({split: reader.record}), tars, strict=True):
            path, target = reader.store.location(tar), folder / copy
            if target.exists() and hashed(target) == tars[copy]:
                continue
            make_folder(target.parent)
            with drafted(target) as draft:
                shutil.copyfile(path, draft)
                if hashed(draft) != tars[copy]:
                    raise ShardError(f"{path}: its hash differs from {MANIFEST}: {REMEDY}")
    remove_others(folder, tars_of(splits))
    return replace(next(iter(readers.values())).manifest, splits=splits)


def _divide(folder: Path, readers: Mapping[str, ShardReader], divided: str, shares: Mapping[str, float]) -> Manifest:
    """Write the parts of a split, and ``failed``, with their notes and indices; the manifest."""
    parts = {name: (readers[divided], own) for name, own in partition(readers[divided], shares).items()}
    if missing := [name for name, share in shares.items() if share > 0 and name not in parts]:
        log.warning(
            "%s: no garments for %s: garments that share a design or a body stay in one split, and all garments fall "
            "into %s: add garments of other designs on other bodies, or give --shares 100,0,0",
            *(readers[divided].store.location(), " and ".join(missing), " and ".join(parts)),
        )
    parts |= {split: (reader, [*range(len(reader))]) for split, reader in readers.items() if split != divided}
    source, names = readers[divided].manifest, set[str]()
    is_whole = not any(map(source.missing, source.splits))
    garments = sum(len(own) for _, own in parts.values())
    for split, (reader, own) in parts.items():
        plan, size = reader.record.plan, shard_size_of(len(own))
        recipe = {**plan.recipe, "part": {"of": dict(shares)}}
        plan = replace(plan, recipe=recipe, count=garments if is_whole else plan.count, shard_size=size)
        for number in range(-(-len(own) // size)):
            names |= _write_shard(folder, split, number, reader, own[number * size : (number + 1) * size], plan)
    remove_others(folder, names)
    gathered = gather(Place(folder))
    for split, index in gathered.indices.items():
        write_changed(folder / index_name(split), index.to_bytes())
    return replace(gathered.manifest, recipe=source.recipe, generator=source.generator)


def _write_shard(
    folder: Path, split: str, number: int, reader: ShardReader, positions: Sequence[int], plan: Plan
) -> set[str]:
    """Write a shard of checked samples, its pictures and its note; the names of the tars. Raises ``ShardError``."""
    record, index, shards = ShardRecord(number, 0, 0, ""), reader.index, reader.record.shards
    rows, names = list(positions), []
    for position in positions:
        reader.check(position)
    for views in (False, True) if index.has_views else (False,):
        starts, ends = (index.views_start, index.views_end) if views else (index.start, index.end)
        spans = zip(index.shard[rows].tolist(), starts[rows].tolist(), ends[rows].tolist(), strict=True)
        samples = [reader.store.part(reader.split, shards[shard], *span, views=views) for shard, *span in spans]
        names.append(record.name(split, views=views))
        make_folder((folder / names[-1]).parent)
        write_changed(folder / names[-1], b"".join([*samples, bytes(END)]))
    views_path = folder / names[1] if index.has_views else None
    note = note_of(folder / names[0], views_path, split, number, plan)
    write_changed(folder / note_name(split, number), note.to_bytes())
    return {*names}


def _require_endpoint(endpoint: str) -> None:
    """Raise ``ConfigError`` for an endpoint other than ``HF_ENDPOINT`` where huggingface_hub cannot publish to it."""
    from huggingface_hub import __version__ as version
    from huggingface_hub import constants
    from packaging.version import Version  # a requirement of huggingface_hub

    if Version(version) < Version(ANY_ENDPOINT) and endpoint != constants.ENDPOINT:
        raise ConfigError(
            f"--endpoint {endpoint}: huggingface_hub {version} publishes to HF_ENDPOINT only: set it, or install "
            f"huggingface_hub {ANY_ENDPOINT} or later"
        )


@contextmanager
def _asking_hub(repo: str) -> Iterator[None]:
    """Turn errors of ``huggingface_hub``, and of the HTTP client that it uses, into ``RemoteError``."""
    from huggingface_hub.errors import HfHubHTTPError

    client: Any = HfHubHTTPError.__bases__  # httpx.HTTPError, or OSError of requests
    try:
        yield
    except (*client, OSError, RuntimeError, ValueError) as error:
        raise RemoteError(
            f"{repo}: cannot be published ({first_line(error)}): check the network, HF_ENDPOINT, the token (hf auth "
            "login) and your rights, then run it again: uploaded files are not sent again"
        ) from error
