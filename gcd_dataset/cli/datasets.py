"""The verbs of whole data sets: info, verify, index, download, publish."""

import argparse
import sys
from itertools import chain
from pathlib import Path
from typing import Any

from gcd_dataset.cli.verb import ANYWHERE, add_quiet, add_server, add_verb, open_anywhere, require_folder
from gcd_dataset.errors import ConfigError, ShardError, did_you_mean

__all__ = ["add_verbs"]

RECIPE = "recipe:"


def add_verbs(verbs: Any) -> None:
    """Give ``gcd`` these verbs."""
    info = add_verb(verbs, "info", _info, "counts, shares and plots of a data set")
    info.add_argument(
        "dataset", metavar="DATASET", help=f"{ANYWHERE}; recipe: lists the recipes, recipe:NAME tells of one"
    )
    add_server(info)

    verify = add_verb(verbs, "verify", _verify, "whether a data set is whole; exit 1 if not")
    verify.add_argument("dataset", metavar="DATASET", help="folder of shards")
    verify.add_argument("--full", action="store_true", help="every byte of it, not only headers and lengths")
    verify.add_argument(
        "--recipe", metavar="NAME|FILE.toml", help="whether it is the data set of that name, pattern by pattern"
    )

    index = add_verb(verbs, "index", _index, "the index of a data set, made anew from its tars")
    index.add_argument("dataset", metavar="DATASET", help="folder of shards, ours or webdataset's")
    index.add_argument("--split", help="one split (default: all)")

    download = add_verb(verbs, "download", _download, "a data set from the Hub or a URL; broken off, it goes on")
    download.add_argument("repo", metavar="REPO", help="repository ORG/NAME of the Hub, or URL of a data set's folder")
    download.add_argument("--split", help="one split (default: all)")
    download.add_argument(
        "--fields", nargs="+", metavar="FIELD", help="of each garment, such as points panels edges (default: all)"
    )
    download.add_argument(
        "--out", "--root", type=Path, metavar="DIR", help="folder for it (default: the name of the repository)"
    )
    download.add_argument("--revision", help="branch, tag or commit (default: main)")
    download.add_argument(
        "--patience", type=float, metavar="SECONDS", help="how long to wait for a server that is gone (default: 30)"
    )
    add_quiet(download)
    add_server(download)

    publish = add_verb(verbs, "publish", _publish, "a data set to the Hub, with card, Croissant and splits")
    publish.add_argument("dataset", metavar="DATASET", help="folder of shards that gcd generate has made")
    publish.add_argument("repo", metavar="REPO", help="repository ORG/NAME; made if it is not there")
    publish.add_argument("--partial", action="store_true", help="though the making of it was stopped before its end")
    publish.add_argument("--dry-run", action="store_true", help="write everything, list it, and send nothing")
    publish.add_argument(
        "--shares", default="90,5,5", metavar="A,B,C", help="of train, validation, test [%%] (default: 90,5,5)"
    )
    publish.add_argument(
        "--license", default="unknown", help="identifier of the Hub, such as cc-by-4.0 (default: unknown)"
    )
    publish.add_argument("--private", action="store_true", help="a repository that only you see")
    publish.add_argument("--out", type=Path, metavar="DIR", help="folder for what goes up (default: DATASET/published)")
    add_server(publish)


def _info(options: argparse.Namespace) -> int:
    from gcd_dataset.cli.inspect import info_lines

    if options.dataset.startswith(RECIPE):
        from gcd_dataset.verbs.recipes import recipe_lines

        print(*recipe_lines(options.dataset.removeprefix(RECIPE)), sep="\n")
        return 0
    for line in info_lines(open_anywhere(options.dataset, options.endpoint)):
        print(line)
    return 0


def _verify(options: argparse.Namespace) -> int:
    from gcd_dataset.cli.inspect import faults

    folder, found, named = require_folder(options.dataset), 0, ""
    told = faults(folder, full=options.full)
    if options.recipe is not None:
        from gcd_dataset.generator.recipes import find_recipe
        from gcd_dataset.verbs.recipes import recipe_faults

        recipe = find_recipe(options.recipe)
        named, told = f": this is {recipe.name}", chain(told, recipe_faults(folder, recipe))
    for fault in told:
        print(fault)
        found += 1
    if not found:
        print(f"{folder}: no fault found{named}{'' if options.full else '; --full reads every byte'}")
    return 1 if found else 0


def _index(options: argparse.Namespace) -> int:
    from gcd_dataset.shards import rebuild_index
    from gcd_dataset.shards.contents import layout_in, require_splits

    folder = require_folder(options.dataset)
    splits = require_splits(folder)
    if options.split not in (None, *splits):
        there = f"there is {', '.join(splits)}{did_you_mean(options.split, splits)}"
        raise ShardError(f"{folder}: no shards of split {options.split}: {there}")
    for split in splits if options.split is None else [options.split]:
        index = rebuild_index(folder, split, layout_in(folder, split))
        print(f"{folder}: {split}: {len(index)} samples in {len(index.shards)} shards")
    return 0


def _download(options: argparse.Namespace) -> int:
    from tqdm import tqdm

    from gcd_dataset.hub.download import download, remote_splits
    from gcd_dataset.hub.site import Remote
    from gcd_dataset.hub.source import Folder, Repo, parse_source
    from gcd_dataset.names import safe_name
    from gcd_dataset.shards.layout import select_fields

    place = parse_source(options.repo, options.revision)
    if isinstance(place, Folder):
        raise ConfigError(f"{options.repo}: a folder of this machine: there is nothing to download")
    remote = Remote(endpoint=options.endpoint, patience=options.patience)
    name = place.name if isinstance(place, Repo) else place.url
    out = options.out or Path(safe_name(name.rpartition("/")[2]))
    fields = None if options.fields is None else [f for entry in options.fields for f in entry.split(",") if f]
    select_fields(fields)
    place, splits = remote_splits(place, remote)
    for split in splits if options.split is None else [options.split]:
        with tqdm(desc=split, unit="B", unit_scale=True, disable=options.quiet, file=sys.stderr) as bar:

            def tell(come: int, total: int, bar: tqdm = bar) -> None:
                bar.total = total
                bar.update(come - bar.n)

            note = download(place, out, remote, split=split, fields=fields, progress=tell)
        members = ", ".join(member.split(".")[0] for member in note.splits[split].members)
        print(f"{out}: {split} of {note.source}: {members}")
    return 0


def _publish(options: argparse.Namespace) -> int:
    from gcd_dataset.hub.partition import parse_shares
    from gcd_dataset.hub.publish import Staged
    from gcd_dataset.verbs import publish

    def told(staged: Staged) -> None:
        for name, split in staged.manifest.splits.items():
            print(f"{name}: {sum(shard.count for shard in split.shards)} garments in {len(split.shards)} shards")
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
        told=told,
    )
    files = len(done.staged.files)
    if done.commit is None:
        print(f"{done.staged.folder}: {files} files would go up to {options.repo}; nothing was sent")
    else:
        print(f"{options.repo}@{done.commit}: {files} files are up")
    return 0
