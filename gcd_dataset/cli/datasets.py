"""The verbs of whole data sets: info, check, index, download, publish."""

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from gcd_dataset.cli.common import (
    SOURCE_HELP,
    Bar,
    add_quiet,
    add_server,
    add_verb,
    names_a_file,
    open_source,
    require_folder,
)
from gcd_dataset.errors import ConfigError, GcdError, ShardError

RECIPE = "recipe:"
HDF5 = (".h5", ".hdf5")


def add_verbs(verbs: Any) -> None:
    """Add these verbs to ``gcd``."""
    info = add_verb(verbs, "info", _info, "counts, shares and plots of a data set")
    info.add_argument(
        "dataset", metavar="DATASET", help=f"{SOURCE_HELP}; recipe: lists the recipes, recipe:NAME describes one"
    )
    add_server(info)

    _add_check(verbs)

    itself = (
        "gcd generate and gcd convert do so themselves when the last shard is made: this is for\n"
        "data sets that stay unfinished, and for lost or damaged files beside the shards."
    )
    index = add_verb(verbs, "index", _index, "gather manifest and index of a data set from its shards", itself)
    index.add_argument("dataset", metavar="DATASET", help="folder of shards, or URL such as s3://BUCKET/PREFIX")

    download = add_verb(verbs, "download", _download, "download a data set from the Hub or a URL; resumes if stopped")
    download.add_argument("repo", metavar="REPO", help="repository ORG/NAME of the Hub, or URL of a data set's folder")
    download.add_argument("--split", nargs="+", metavar="SPLIT", help="some splits (default: all)")
    download.add_argument("--no-views", action="store_true", help="without the pictures")
    download.add_argument(
        "--out", "--root", type=Path, metavar="DIR", help="target folder (default: the name of the repository)"
    )
    download.add_argument("--revision", help="branch, tag or commit (default: main)")
    download.add_argument(
        "--patience", type=float, metavar="SECONDS", help="how long to try a server that does not answer (default: 300)"
    )
    add_quiet(download)
    add_server(download)

    publish = add_verb(verbs, "publish", _publish, "upload a data set to the Hub, with card, Croissant and splits")
    publish.add_argument("dataset", metavar="DATASET", help="folder of shards made by gcd generate")
    publish.add_argument("repo", metavar="REPO", help="repository ORG/NAME; created if missing")
    publish.add_argument("--partial", action="store_true", help="allow a data set whose generation was stopped early")
    publish.add_argument("--dry-run", action="store_true", help="write and list all files, and send nothing")
    publish.add_argument(
        "--shares",
        default="90,5,5",
        metavar="A,B,C",
        help="shares of train, validation and test [%%] (default: 90,5,5)",
    )
    publish.add_argument(
        "--license", default="unknown", help="license identifier of the Hub, such as cc-by-4.0 (default: unknown)"
    )
    publish.add_argument("--private", action="store_true", help="create a private repository")
    publish.add_argument("--out", type=Path, metavar="DIR", help="staging folder (default: DATASET/published)")
    add_server(publish)


def _add_check(verbs: Any) -> None:
    text = "list what is wrong with a data set, or with patterns; exit 1 if it would harm a training or forbid sewing"
    check = add_verb(verbs, "check", _check, text, aliases=("doctor", "validate", "verify"))
    check.add_argument(
        "what",
        nargs="+",
        metavar="DATASET|PUBLISHED|SPEC",
        help=f"{SOURCE_HELP}; an HDF5 file; GarmentCodeData as published: the folder with garments_5000_0; or "
        "specification JSON",
    )
    check.add_argument("--errors", action="store_true", help="list errors alone, no warnings")
    check.add_argument("--strict", action="store_true", help="exit 1 for warnings too")
    check.add_argument("--json", action="store_true", help="print the report as JSON")
    check.add_argument("--quick", action="store_true", help="read 200 garments of each split, evenly spaced")
    check.add_argument("--bytes", "--full", action="store_true", help="also check every byte against the hashes")
    check.add_argument("--recipe", metavar="NAME|FILE.toml", help="also check that it is the data set of this recipe")
    check.add_argument(
        "--cache-dir",
        type=Path,
        metavar="DIR",
        help="folder for data from a server, and for unpacked published archives",
    )
    add_quiet(check)
    add_server(check)


def _info(options: argparse.Namespace) -> int:
    from gcd_dataset.check.summary import info_lines

    if options.dataset.startswith(RECIPE):
        from gcd_dataset.check.recipes import recipe_lines

        print(*recipe_lines(options.dataset.removeprefix(RECIPE)), sep="\n")
        return 0
    for line in info_lines(open_source(options.dataset, options.endpoint)):
        print(line)
    return 0


def _check(options: argparse.Namespace) -> int:
    is_pattern = [names_a_file(what) and Path(what).suffix not in HDF5 for what in options.what]
    if not all(is_pattern):
        if len(options.what) > 1:
            raise ConfigError(f"{len(options.what)} inputs: give one data set, or specification files")
        return _check_set(options)
    for name in ("quick", "bytes", "recipe", "cache_dir", "endpoint"):
        if getattr(options, name):
            raise ConfigError(f"--{name.replace('_', '-')} is for data sets: leave it out")
    return _check_patterns(options)


def _check_set(options: argparse.Namespace) -> int:
    from gcd_dataset.check import Harm, examine

    [source] = options.what
    bar = Bar("garment", options.quiet, verb="check", again="nothing was changed")
    work = partial(examine, source, quick=options.quick, every_byte=options.bytes, recipe=options.recipe)
    report = bar.run(partial(work, endpoint=options.endpoint, cache_dir=options.cache_dir))
    if options.errors:
        report = replace(report, findings=report.harmful)
    is_good = not report.harmful and not report.faults
    if options.strict:
        is_good = is_good and not any(finding.harm is Harm.WARNING for finding in report.findings)
    if options.json:
        print(json.dumps(report.to_json(), indent=1, ensure_ascii=False))
    else:
        print(*report.lines(), sep="\n")
        if is_good and options.recipe is not None:
            from gcd_dataset.generator.recipes import find_recipe

            print(f"{source}: this is {find_recipe(options.recipe).name}")
    return int(not is_good)


def _check_patterns(options: argparse.Namespace) -> int:
    from gcd_dataset.faults import Severity, check_pattern
    from gcd_dataset.spec import read_pattern

    found: list[Severity] = []
    texts: dict[str, list[str]] = {}
    for path in dict.fromkeys(map(str, map(Path, options.what))):
        try:
            faults = check_pattern(read_pattern(path))
        except GcdError as error:
            print(f"gcd {options.verb}: {error}", file=sys.stderr)
            found.append(Severity.ERROR)
            if options.json:
                texts[path] = [str(error)]
            continue
        listed = [fault for fault in faults if fault.severity is Severity.ERROR or not options.errors]
        texts[path] = list(map(str, listed))
        found += [fault.severity for fault in listed]
    if options.json:
        print(json.dumps(texts, indent=1, ensure_ascii=False))
    else:
        for path, lines in texts.items():
            if lines:
                print(f"{path}:", *lines, sep="\n  ")
        if not found:
            print(f"{len(texts)} pattern{'s' if len(texts) > 1 else ''}: no fault found")
    return int(Severity.ERROR in found or bool(found and options.strict))


def _index(options: argparse.Namespace) -> int:
    from gcd_dataset import index
    from gcd_dataset.making.store import place_for

    if "://" not in options.dataset:
        require_folder(options.dataset)
    manifest = index(place_for(options.dataset)).manifest
    for split, record in manifest.splits.items():
        print(f"{options.dataset}: {split}: {record.count} samples in {len(record.shards)} shards")
    for line in summary_lines(options.dataset, counts=False):
        print(f"  {line}")
    return 0


def summary_lines(out: str | Path, *, counts: bool = True) -> Iterator[str]:
    """Lines about the data set in a folder: its samples by split if there are several, and what it lacks."""
    from gcd_dataset.shards.store import FolderStore

    if "://" in str(out):
        return
    try:
        store = FolderStore(out)
        manifest = store.manifest()
    except ShardError:  # no shard is finished
        return
    if counts and len(manifest.splits) > 1:
        yield ", ".join(f"{split} {count}" for split, count in sorted(manifest.counts.items(), reverse=True))
    if (fault := store.unfinished(next(iter(manifest.splits)))) is not None:
        yield fault


def _download(options: argparse.Namespace) -> int:
    from tqdm.auto import tqdm

    from gcd_dataset.files import safe_name
    from gcd_dataset.hub.download import download
    from gcd_dataset.hub.remote import Remote
    from gcd_dataset.hub.source import Folder, Repo, parse_source
    from gcd_dataset.shards.store import downloaded_from

    source = parse_source(options.repo, options.revision)
    if isinstance(source, Folder):
        raise ConfigError(f"{options.repo}: a local folder: there is nothing to download")
    remote = Remote(endpoint=options.endpoint, patience=options.patience)
    name = source.name if isinstance(source, Repo) else source.url
    out = options.out or Path(safe_name(name.rpartition("/")[2]))
    with tqdm(desc=out.name, unit="B", unit_scale=True, delay=0.5, disable=options.quiet, file=sys.stderr) as bar:

        def update(received: int, total: int) -> None:
            bar.total = total
            bar.update(received - bar.n)

        manifest = download(
            source, out, remote, splits=options.split or (), views=not options.no_views, on_progress=update
        )
    for split in options.split or manifest.splits:
        print(f"{out}: {split} of {downloaded_from(out)}: {manifest.splits[split].count} samples")
    return 0


def _publish(options: argparse.Namespace) -> int:
    from gcd_dataset import publish
    from gcd_dataset.hub.partition import parse_shares
    from gcd_dataset.hub.publish import Staged

    def list_files(staged: Staged) -> None:
        for name, split in staged.manifest.splits.items():
            print(f"{name}: {split.count} garments in {len(split.shards)} shards")
        for path, size in staged.files.items():
            print(f"  {path}  {size} bytes", flush=True)

    done = publish(
        require_folder(options.dataset),
        options.repo,
        out=options.out,
        shares=parse_shares(options.shares),
        license=options.license,
        partial=options.partial,
        private=options.private,
        dry_run=options.dry_run,
        endpoint=options.endpoint,
        on_staged=list_files,
    )
    files = len(done.files)
    if done.commit is None:
        print(f"{done.folder}: {files} files would be uploaded to {options.repo}; nothing was sent")
    else:
        print(f"{options.repo}@{done.commit}: {files} files uploaded")
    return 0
