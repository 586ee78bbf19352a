"""A program with the options that a campaign gives: it needs no time, fails, waits, or stops at its limit.

Each start adds a line to ``starts.txt`` beside the runs.
"""

import argparse
import json
import sys
import time
from pathlib import Path


def main() -> int:
    """Run the command: ``fails`` fails, ``long`` stops at the limit of its first call, ``endless`` is killed.

    ``beside`` ends once ``b`` has begun.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("model")
    parser.add_argument("--make-only", action="store_true")
    for name in ("task", "train", "minutes", "workers", "limit-minutes"):
        parser.add_argument(f"--{name}", default="")
    for name in ("out", "data", "turns"):
        parser.add_argument(f"--{name}", type=Path)
    args = parser.parse_args()
    with (args.out.parent / "starts.txt").open("a") as file:
        file.write(f"{'make ' if args.make_only else ''}{args.out.name}\n")
    if args.make_only:
        return 0
    if args.model == "fails":
        print("the toy is broken", file=sys.stderr)
        return 1
    while args.model == "beside" and "b" not in (args.out.parent / "starts.txt").read_text().splitlines():
        time.sleep(0.05)
    if args.model == "endless":
        time.sleep(60)
    if args.model == "long" and not (args.out / "checkpoint.pt").exists():
        (args.out / "checkpoint.pt").touch()
        (args.out / "curves.csv").write_text("step,seconds\n1,30\n2,60\n")
        return 3
    part = {"count": int(args.train), "patterns": "ab", "ids": "cd", "recipe": {}}
    report = {
        "task": args.task, "model": args.model, "minutes": 1.0, "scores": {"topology_exact": [0.5, 0.4, 0.6]},
        "scores_of_kinds": {}, "data": {"train": part, "test": part},
    }  # fmt: skip
    (args.out / "report.json").write_text(json.dumps(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
