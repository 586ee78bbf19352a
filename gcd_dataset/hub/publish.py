"""Publishes a data set on the Hub: divides it into splits, describes it, uploads it with ``huggingface_hub``."""

import io
import json
import logging
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from gcd_dataset.errors import ConfigError, RemoteError, did_you_mean, shown
from gcd_dataset.files import make_folder
from gcd_dataset.hub.card import LICENSES, PREVIEW, Release, card, croissant
from gcd_dataset.hub.download import tar_files, write_changed
from gcd_dataset.hub.fetch import first_line, sha256_of
from gcd_dataset.hub.partition import DESIGN, SHARES, leaks, partition
from gcd_dataset.hub.remote import hub_endpoint
from gcd_dataset.hub.source import Repo, parse_source
from gcd_dataset.shards.access import locked, reading, writing
from gcd_dataset.shards.folder import FolderStore
from gcd_dataset.shards.index import index_name
from gcd_dataset.shards.layout import FAILED
from gcd_dataset.shards.manifest import MANIFEST, Manifest, Plan, ShardRecord
from gcd_dataset.shards.notes import META, gather, note_name, note_of
from gcd_dataset.shards.place import FolderPlace
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.shards.tar import END
from gcd_dataset.shards.writer import shard_size_of

CARD, CROISSANT = "README.md", "croissant.json"
CLIENTS = ("httpx2", "httpx")  # HTTP libraries of huggingface_hub 2 and 1; errors of requests are OSErrors
ANY_ENDPOINT = "1.31"  # first tested version of huggingface_hub that publishes to any endpoint
STAGED = ".staged"  # marks a staging folder: its shards are copies and may be replaced
REPLACED = re.compile(r"(views/)?[^/]+-\d{5,}\.tar|[^/]+\.index|preview\.parquet")
HUB_NAMES = {"training": "train", "val": "validation", "valid": "validation", "dev": "validation"}
"""Other names of splits to the Hub's names."""
PREVIEWED = 100  # garments
TEXTS, FRONT = ("caption.txt", "measures.json", "design.txt"), "front.jpg"

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


Part = tuple[ShardReader, dict[int, list[int]]]
"""The samples of a published split: their reader, number of a shard to positions of its samples."""


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
    parts = _parts(dataset, readers, divided, shares)
    _prepare(folder)
    with locked(folder / ".staging.lock", "staging it"):
        manifest = _write_splits(folder, source, parts, shares if divided else None)
    settled = {name: int(ShardReader(folder, name).index.settled.sum()) for name in parts}
    members, preview = next(iter(parts.values()))[0].layout.members, _preview(folder, next(iter(parts)))
    if preview is not None:
        write_changed(folder / PREVIEW, preview)
    is_divided, hub = divided is not None or manifest.recipe is not None, hub_endpoint(endpoint)
    release = Release(repo, manifest, settled, members, license, is_divided, hub, preview is not None)
    tars = {path.relative_to(folder).as_posix() for path in tar_files(folder)}
    listed = [MANIFEST, *map(index_name, parts), *([PREVIEW] if preview else []), *sorted(tars)]
    described = croissant(
        release, {name: ((folder / name).stat().st_size, sha256_of(folder / name)) for name in listed}
    )
    write_changed(folder / CARD, card(release).encode())
    write_changed(folder / CROISSANT, (json.dumps(described, indent=1) + "\n").encode())
    return Staged(folder, manifest, {name: (folder / name).stat().st_size for name in [CARD, CROISSANT, *listed]})


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


def _prepare(folder: Path) -> None:
    """Make the staging folder. Raises ``ConfigError`` for a folder that holds anything else."""
    make_folder(folder)
    with reading(folder):
        others = sorted(path.name for path in folder.iterdir()) if not (folder / STAGED).exists() else []
    if others:
        raise ConfigError(f"{folder}: holds {shown(others[0])}, not files to publish: choose another folder")
    write_changed(folder / STAGED, b"")


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


def _parts(
    dataset: Path, readers: Mapping[str, ShardReader], divided: str | None, shares: Mapping[str, float]
) -> dict[str, Part]:
    """Published split to its samples: parts of the divided split, then the others shard by shard."""
    parts: dict[str, Part] = {}
    if divided is not None:
        positions = partition(readers[divided], shares)
        _warn_of_empty_splits(dataset, shares, positions)
        for name, own in positions.items():
            size = shard_size_of(len(own))
            numbered = {number: own[number * size : (number + 1) * size] for number in range(-(-len(own) // size))}
            parts[name] = readers[divided], numbered
    for split, reader in readers.items():
        if split != divided:
            shards: dict[int, list[int]] = {}
            for position, shard in enumerate(reader.index.shard.tolist()):
                shards.setdefault(reader.record.shards[shard].number, []).append(position)
            parts[HUB_NAMES.get(split, split)] = reader, shards
    return parts


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


def _write_splits(
    folder: Path, source: Manifest, parts: Mapping[str, Part], shares: Mapping[str, float] | None
) -> Manifest:
    """Write the shards and indices of all splits, remove others, write the manifest; ``shares``: of divided splits."""
    place, names = FolderPlace(folder), set[str]()
    is_whole = not any(map(source.missing, source.splits))
    garments = sum(len(own) for _, shards in parts.values() for own in shards.values())
    for name, (reader, shards) in parts.items():
        plan, size = reader.record.plan, max(map(len, shards.values()))
        recipe = dict(plan.recipe) if shares is None else {**plan.recipe, "part": {"of": dict(shares)}}
        plan = replace(plan, recipe=recipe, count=garments if is_whole else plan.count, shard_size=size)
        for number, positions in shards.items():
            names |= _write_shard(folder, name, number, reader, positions, plan)
    for path in tar_files(folder):
        if path.relative_to(folder).as_posix() not in names:
            with writing(path):
                path.unlink()
    gathered = gather(place)
    for name, index in gathered.indices.items():
        write_changed(folder / index_name(name), index.to_bytes())
    manifest = replace(gathered.manifest, recipe=source.recipe, generator=source.generator)
    write_changed(folder / MANIFEST, manifest.to_bytes())
    return manifest


def _write_shard(
    folder: Path, split: str, number: int, reader: ShardReader, positions: Sequence[int], plan: Plan
) -> set[str]:
    """Write a shard of checked samples, its pictures and its note; the names of the tars. Raises ``ShardError``."""
    record, paths = ShardRecord(number, 0, 0, ""), []
    for position in positions:
        reader.check(position)
    for views in (False, True) if reader.index.has_views else (False,):
        spans = _spans(reader, views)
        samples = [reader.store.part(reader.split, *spans[position], views=views) for position in positions]
        paths.append(folder / record.name(split, views=views))
        make_folder(paths[-1].parent)
        write_changed(paths[-1], b"".join([*samples, bytes(END)]))
    note = note_of(paths[0], paths[1] if len(paths) > 1 else None, split, number, plan)
    write_changed(folder / note_name(split, number), note.to_bytes())
    return {path.relative_to(folder).as_posix() for path in paths}


@lru_cache(maxsize=4)
def _spans(reader: ShardReader, views: bool) -> list[tuple[ShardRecord, int, int]]:
    """Shard, start and end of each sample, or of its pictures."""
    index, shards = reader.index, reader.record.shards
    starts, ends = (index.views_start, index.views_end) if views else (index.start, index.end)
    found = zip(index.shard.tolist(), starts.tolist(), ends.tolist(), strict=True)
    return [(shards[shard], start, end) for shard, start, end in found]


def _preview(folder: Path, split: str) -> bytes | None:
    """A table of the first garments of a split, which the Hub shows; ``None`` without ``pyarrow``."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        log.warning("without a preview, which needs pyarrow: pip install 'gcd-dataset[publish]'")
        return None
    reader = ShardReader(folder, split)
    members = [member for member in (META, *TEXTS, FRONT) if member in reader.layout.members]
    rows, positions = [], range(min(PREVIEWED, len(reader)))
    for position, found in zip(positions, reader.read_many(positions, members), strict=True):
        meta = json.loads(bytes(found[META]))
        row = {"key": reader.key(position), "grade": meta["grade"], "outcome": (meta["drape"] or {}).get("outcome")}
        row |= {member.partition(".")[0]: bytes(found[member]).decode() for member in TEXTS if member in found}
        rows.append(row | ({"front": {"bytes": bytes(found[FRONT])}} if FRONT in found else {}))
    text, picture = pyarrow.string(), pyarrow.struct({"bytes": pyarrow.binary(), "path": pyarrow.string()})
    schema = pyarrow.schema({name: picture if name == "front" else text for name in rows[0]})
    kinds = {name: {"_type": "Image"} if name == "front" else {"_type": "Value", "dtype": "string"} for name in rows[0]}
    schema, output = schema.with_metadata({"huggingface": json.dumps({"info": {"features": kinds}})}), io.BytesIO()
    parquet.write_table(pyarrow.Table.from_pylist(rows, schema), output)
    return output.getvalue()


def _require_endpoint(endpoint: str) -> None:
    """Raise ``ConfigError`` for an endpoint other than ``HF_ENDPOINT`` where huggingface_hub cannot publish to it."""
    from huggingface_hub import __version__ as version
    from huggingface_hub import constants

    def number(text: str) -> list[int]:
        return [int(part) for part in text.split(".")[:2]]

    if number(version) < number(ANY_ENDPOINT) and endpoint != constants.ENDPOINT:
        raise ConfigError(
            f"--endpoint {endpoint}: huggingface_hub {version} publishes to HF_ENDPOINT only: set it, or install "
            f"huggingface_hub {ANY_ENDPOINT} or later"
        )


@contextmanager
def _asking_hub(repo: str) -> Iterator[None]:
    """Turn errors of ``huggingface_hub`` into ``RemoteError``."""
    from huggingface_hub.errors import HfHubHTTPError

    clients = [sys.modules[name].HTTPError for name in CLIENTS if name in sys.modules]
    try:
        yield
    except (HfHubHTTPError, OSError, RuntimeError, ValueError, *clients) as error:
        raise RemoteError(
            f"{repo}: cannot be published ({first_line(error)}): check the network, HF_ENDPOINT, the token (hf auth "
            "login) and your rights, then run it again: uploaded files are not sent again"
        ) from error
