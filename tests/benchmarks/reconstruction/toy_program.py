"""A program with the options that a campaign gives: it needs no time, fails, waits, or stops at its limit.

Each start adds a line to ``starts.txt`` beside the runs: the run, after ``make`` or ``drape``. The end of drapes adds
one, too. ``gpus.txt`` has the GPUs of those that make garments.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path


def main() -> int:
    """Run the command: ``fails`` fails, ``long`` stops at the limit of its first call, ``endless`` is killed.

    ``beside`` ends once ``b`` has begun, ``naps`` after a second, which it notes. ``slow`` takes a second to make
    garments. With ``--drape``, ``hangs`` is killed the first time, and ``breaks`` fails.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("model")
    parser.add_argument("--make-only", action="store_true")
    parser.add_argument("--drape", action="store_true")
    for name in ("task", "train", "minutes", "workers", "limit-minutes", "fresh", "make-device"):
        parser.add_argument(f"--{name}", default="")
    for name in ("out", "data", "turns"):
        parser.add_argument(f"--{name}", type=Path)
    args = parser.parse_args()
    note(args.out, "make " if args.make_only else "drape " if args.drape else "")
    if args.make_only:
        with (args.out.parent / "gpus.txt").open("a") as file:
            file.write(f"{args.out.name} {os.environ.get('CUDA_VISIBLE_DEVICES', '')}\n")
        time.sleep(args.model == "slow")
        return 0
    if args.drape:
        return drape(args.out, args.model)
    if args.model == "fails":
        print("the toy is broken", file=sys.stderr)
        return 1
    while args.model == "beside" and "b" not in (args.out.parent / "starts.txt").read_text().splitlines():
        time.sleep(0.05)
    if args.model == "naps":
        time.sleep(1)
        note(args.out, "ended ")
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


def note(out: Path, what: str) -> None:
    """Add a line on this run."""
    with (out.parent / "starts.txt").open("a") as file:
        file.write(f"{what}{out.name}\n")


def drape(out: Path, model: str) -> int:
    """Add scores of drapes to the report."""
    if model == "breaks":
        print("the drapes are broken", file=sys.stderr)
        return 1
    if model == "hangs" and not (out / "hung").exists():
        (out / "hung").touch()
        time.sleep(60)
    report = json.loads((out / "report.json").read_text())
    report["scores"] |= {name: [0.25, 0.2, 0.3] for name in ("sim_ok", "redrape_cd_cm", "within_1cm")}
    time.sleep(0.3)
    (out / "report.json").write_text(json.dumps(report))
    note(out, "draped ")
    return 0


if __name__ == "__main__":
    sys.exit(main())
