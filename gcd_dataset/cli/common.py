"""Shared by the commands of ``gcd``: parser, examples, option types, signals, opening data sets, progress bar."""

import argparse
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn

from gcd_dataset import files
from gcd_dataset.errors import ConfigError, ShardError, SpecError, did_you_mean, shown
from gcd_dataset.making.progress import SETTLED, Progress

if TYPE_CHECKING:
    from tqdm import tqdm

    from gcd_dataset.bodies import Wearer
    from gcd_dataset.generator.garments import GarmentDesign
    from gcd_dataset.records import Body, Measurements, Pattern, Sample
    from gcd_dataset.shards import ShardReader
    from gcd_dataset.shards.store import Store

SIGNALLED = 128  # added by shells to the number of the signal that ended a program
USUAL: Mapping[int, Any] = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
"""The signals that end a verb in good order, and Python's handlers of them."""
MOST_RULES = 3  # rules named in the bar
RETRY = 0.005  # s between checks whether a signal may be raised
WRONG_USAGE = 2
SOURCE_HELP = "folder, URL, or repository ORG/NAME of the Hub"
MEAN, RANDOM = ("neutral", "female", "male"), ("random", "female", "male", "pooled")
BODY_NAMES = ", ".join((*MEAN, *(f"{kind}:SEED" for kind in RANDOM)))
"""Names of generated bodies, for messages and help."""


class Stopped(KeyboardInterrupt):
    """A verb was stopped by a signal; the message says how far it got, and how to go on."""

    last: ClassVar[int] = signal.SIGINT
    """The last signal: libraries such as Ray raise another ``KeyboardInterrupt`` in place of ours."""

    def __init__(self, number: int = signal.SIGINT, message: str = ": finished files are kept: run it again") -> None:
        super().__init__(f"stopped{message}")
        self.exit_code = SIGNALLED + number
        self.number = number

    @classmethod
    def of(cls, error: KeyboardInterrupt) -> "Stopped":
        """The error itself, or that of the last signal."""
        return error if isinstance(error, cls) else cls(cls.last)


class Parser(argparse.ArgumentParser):
    """A parser with one-line errors that suggest the most similar known word."""

    add_slow_options: Callable[[], None] | None = None
    """Adds options that need slow imports; called when this parser first parses."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As in ``argparse``, after adding the slow options."""
        if self.add_slow_options is not None:
            self.add_slow_options()
            self.add_slow_options = None
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Print a one-line message and exit 2."""
        self.exit(WRONG_USAGE, f"{self.prog}: {message} ({self.prog} --help lists the options)\n")

    def unknown(self, words: Sequence[str]) -> NoReturn:
        """Exit 2 for arguments that no option or positional takes."""
        options = [option for action in self._actions for option in action.option_strings]
        fault = "no option" if words[0].startswith("-") else "unexpected argument"
        self.error(f"{fault} {shown(words[0])}{did_you_mean(words[0].partition('=')[0], options)}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            known = list(map(str, action.choices))
            message = f"no {shown(str(value))}: choose from {', '.join(known)}{did_you_mean(str(value), known)}"
            raise argparse.ArgumentError(action, message)


def body_name(text: str) -> str:
    """Option type: the name of a generated body, or a mesh file."""
    kind, colon, seed = text.partition(":")
    if colon and kind in RANDOM and not seed.isdecimal():
        raise argparse.ArgumentTypeError(
            f"{shown(text)}: the seed is {shown(seed) or 'nothing'}: give a whole number of 0 or more, such as {kind}:7"
        )
    if (colon and kind in RANDOM) or text in MEAN or Path(text).suffix or Path(text).exists():
        return text
    nearest = did_you_mean(kind, RANDOM if colon else {*MEAN, *RANDOM})
    raise argparse.ArgumentTypeError(f"no body named {shown(text)}: there are {BODY_NAMES}, or a mesh file{nearest}")


def add_verb(
    verbs: Any,
    name: str,
    run: Callable[[argparse.Namespace], int],
    text: str,
    more: str = "",
    *,
    aliases: Sequence[str] = (),
) -> Parser:
    """Add a verb to ``verbs`` and return its parser; ``run`` returns the exit code, ``more`` is for its own help."""
    parser: Parser = verbs.add_parser(
        name,
        aliases=aliases,
        help=text,
        description=f"{text[0].upper()}{text[1:]}.\n{more}".rstrip(),
        epilog="\n  ".join(["examples:", *EXAMPLES[name]]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    return parser


def add_texture(parser: argparse.ArgumentParser, *, form: str) -> None:
    """Add ``--texture``, for a format, as a map from panel to file."""
    parser.add_argument(
        "--texture",
        type=_texture,
        action="append",
        metavar="PANEL=FILE",
        help=f"for {form}: an image over the box round a panel, upright along the grain; once for each panel",
    )


def textures_of(options: argparse.Namespace) -> dict[str, Path]:
    """Panel to file, of ``--texture``. Raises ``ConfigError`` for a panel with two files."""
    textures = dict(options.texture or ())
    for number, (panel, file) in enumerate(options.texture or ()):
        if textures[panel] != file:
            raise ConfigError(f"--texture {panel} is given twice, first as {options.texture[number][1]}: give one file")
    return textures


def _texture(text: str) -> tuple[str, Path]:
    panel, _, file = text.partition("=")
    if not panel or not file:
        raise argparse.ArgumentTypeError(f"{text}: give PANEL=FILE, such as skirt_front=print.png")
    return panel, Path(file)


def add_body(parser: argparse.ArgumentParser, default: str | None = "neutral") -> None:
    """Add ``--body`` and the options that describe its mesh file; ``wearer_of`` reads the body."""
    parser.add_argument(
        "--body",
        type=body_name,
        default=default,
        help=f"{BODY_NAMES}, a mesh file, or smplx:MODEL.npz (default: neutral)",
    )
    parser.add_argument("--measurements", type=Path, metavar="YAML", help="of a mesh file [cm] (default: measured)")
    parser.add_argument("--segmentation", type=Path, metavar="JSON", help="of a mesh file, vertex ids (default: found)")
    add_height(parser)
    add_betas(parser)


def add_betas(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--betas`` to a verb that takes a model file."""
    parser.add_argument(
        "--betas",
        metavar="A,B,…",
        help="shape of a model file: numbers, such as --betas=-1,0.5, or an NPZ file of AMASS (default: the mean body)",
    )


def add_height(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--height`` to a verb that takes a mesh file."""
    parser.add_argument(
        "--height",
        type=float,
        metavar="CM",
        help="height of a mesh file's body, which is scaled to it (default: the mesh is in m, cm or mm)",
    )


def wearer_of(options: argparse.Namespace) -> "Wearer":
    """The function that reads ``--body`` when called: body and measures, with legs straight or apart."""
    from gcd_dataset.generator.body.by_name import named_body, shape_by_name

    @cache
    def wearer(legs_apart: bool) -> "tuple[Body, Measurements]":
        if legs_apart and shape_by_name(options.body, legs_apart=True) is None:
            return wearer(False)  # a mesh file has its own pose
        return named_body(
            options.body,
            measurements=options.measurements,
            segmentation=options.segmentation,
            legs_apart=legs_apart,
            height=options.height,
            betas=options.betas,
        )[:2]

    return wearer


def add_quiet(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--quiet`` to a verb with a progress bar."""
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def add_server(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--endpoint`` to a verb that reads or writes repositories."""
    parser.add_argument("--endpoint", metavar="URL", help="server of the Hub (default: HF_ENDPOINT, or huggingface.co)")


def process_count(text: str) -> int | None:
    """Option type: a number of processes; ``None`` for ``auto``."""
    return None if text == "auto" else natural_number(text)


def natural_number(text: str) -> int:
    """Option type: a whole number of 0 or more."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text} is not a whole number of 0 or more")
    return int(text)


@contextlib.contextmanager
def interrupts_after_imports(process_ends: bool = False) -> Iterator[None]:
    """Raise ``Stopped`` for Ctrl-C and SIGTERM, but not during an import, where trimesh would take it for a missing
    package, nor where it would leave a draft behind.

    A further SIGTERM is ignored, since ``timeout`` and Slurm send two: until the end, or, where the process ends after
    it, for good. Does nothing outside the main thread, and leaves signals for which Python's usual handler is not
    installed.
    """
    is_main = threading.current_thread() is threading.main_thread()
    taken = [number for number, usual in USUAL.items() if is_main and signal.getsignal(number) == usual]
    later: dict[int, threading.Timer] = {}
    Stopped.last = signal.SIGINT

    def interrupted(number: int, frame: FrameType | None) -> None:
        if (timer := later.pop(number, None)) is not None:
            timer.cancel()
        if not _must_wait(frame):
            if number == signal.SIGTERM:
                signal.signal(number, signal.SIG_IGN)
            Stopped.last = number
            raise Stopped(number)
        later[number] = threading.Timer(RETRY, os.kill, (os.getpid(), number))
        later[number].daemon = True
        later[number].start()

    for number in taken:
        signal.signal(number, interrupted)
    try:
        yield
    finally:
        for timer in later.values():
            timer.cancel()
        for number in taken:
            if not process_ends or signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, USUAL[number])


def _must_wait(frame: FrameType | None) -> bool:
    """Whether an import, or the start or end of a file's draft, is on the call stack."""
    while frame is not None:
        if frame.f_code.co_filename.startswith(("<frozen importlib", str(files.__file__))):
            return True
        frame = frame.f_back
    return False


def require_folder(source: str) -> Path:
    """The folder of a data set. Raises ``ShardError`` if it is missing, ``ConfigError`` for a remote data set."""
    from gcd_dataset.hub.source import Folder, parse_source
    from gcd_dataset.shards.access import reading

    if "://" in source:
        parsed = parse_source(source)
        if isinstance(parsed, Folder):
            return parsed.path
        raise ConfigError(
            f"{source}: not on this machine: run gcd download {source} first, then give the downloaded folder"
        )
    with reading(Path(source)):
        if Path(source).is_dir():
            return Path(source)
        fault = "a file, not a folder of shards" if Path(source).exists() else "no such folder"
    raise ShardError(
        f"{shown(source)}: {fault}: give a folder of shards; for a repository of the Hub, run gcd download first"
    )


def open_source(source: str, endpoint: str | None) -> "Store":
    """The data set in a folder, at a URL, or in a repository at ``endpoint``. Raises ``ShardError``."""
    from gcd_dataset.hub.remote import Remote, open_store
    from gcd_dataset.hub.source import Repo, parse_source

    try:
        parsed = parse_source(source)
    except ConfigError as error:  # every verb treats a bad path as bad input, not as wrong usage
        raise ShardError(str(error)) from error
    return open_store(source, Remote(endpoint=endpoint if isinstance(parsed, Repo) else None))


EXAMPLES: Mapping[str, tuple[str, str]] = {
    "generate": ("gcd generate shards --count 1000 --bodies both --resolution 2 --workers 8",
                 "gcd generate smoke --recipe smoke-64"),
    "drape": ("gcd drape shirt_specification.json --out draped",
              "gcd drape *_specification.json --body female:7 --fabric denim --out draped --resolution 2"),
    "fit": ("gcd fit design_params.yaml --body scan.obj --out fitted",
            "gcd fit design_params.yaml --body female:7 --out fitted --resolution 2 --fabric denim"),
    "grade": ("gcd grade design_params.yaml --chart women --out graded",
              "gcd grade design_params.yaml --chart sizes.toml --out graded --seam-allowance 1.5 --paper a0"),
    "reconstruct": ("gcd reconstruct scan.ply --body female:7 --out found",
                    "gcd reconstruct t1/inputs/*.npy --proposals proposed --workers 16 --out answers"),
    "measure": ("gcd measure scan.obj --out measures.yaml", "gcd measure --shape random:7"),
    "show": ("gcd show shards --index 3 --html garment.html", "gcd show shirt_specification.json --svg pattern.svg"),
    "score": ("gcd score answers truth --json scores.json", "gcd score answers t1 --drape --workers 8"),
    "bench": ("gcd bench inputs T1 t1 --mini", "gcd bench submit answers t1 --card model.toml --out result.json"),
    "info": ("gcd info shards", "gcd info org/garments"),
    "check": ("gcd check shards --bytes", "gcd check *_specification.json --errors"),
    "index": ("gcd index shards", "gcd index s3://bucket/shards"),
    "download": ("gcd download org/garments --split test", "gcd download org/garments --no-views --out garments"),
    "publish": ("gcd publish shards org/garments --dry-run",
                "gcd publish shards org/garments --shares 90,5,5 --license cc-by-4.0"),
    "convert": ("gcd convert GarmentCodeData_v2 shards",
                "gcd convert GarmentCodeData_v2 shards --bodies default --workers 8"),
    "export": ("gcd export shards --hdf5 train.h5",
               "gcd export shirt_specification.json --pdf shirt.pdf --seam-allowance 1.5"),
}  # fmt: skip
"""Verb to two commands."""


def names_a_file(source: str) -> bool:
    """Whether ``source`` names a file, existing or not, and no data set, which is a folder or on a server."""
    return "://" not in source and not _is_folder(Path(source)) and (source.endswith(".json") or Path(source).exists())


def design_in(path: Path | str) -> "GarmentDesign":
    """The design in a file. Raises ``SpecError``: a bad file is bad input, not wrong usage."""
    from gcd_dataset.generator.garments import read_design

    try:
        return read_design(path)
    except ConfigError as error:
        raise SpecError(str(error)) from error


def pattern_of(options: argparse.Namespace) -> "Pattern":
    """The pattern in the specification file ``what``."""
    from gcd_dataset.faults import require_valid
    from gcd_dataset.spec import read_pattern

    return require_valid(read_pattern(Path(options.what)), source=options.what)


def sample_of(options: argparse.Namespace) -> "Sample":
    """The sample at ``index`` of the data set ``what``, local or remote; of the split ``train`` without ``split``."""
    reader = reader_of(options.what, options)
    return reader.sample(position_of(options, len(reader)))


def reader_of(source: str, options: argparse.Namespace) -> "ShardReader":
    """The reader of a data set, local or remote; of the split ``train`` without ``split``."""
    from gcd_dataset.shards import ShardReader

    return ShardReader(open_source(source, options.endpoint), options.split or "train")


def position_of(options: argparse.Namespace, count: int) -> int:
    """``--index``. Raises ``ShardError`` beyond the last garment."""
    if options.index >= count:
        known = f"give one from 0 to {count - 1}" if count > 1 else "leave --index out"
        raise ShardError(f"{options.what}: garment {options.index} of {count}: {known}")
    return int(options.index)


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError as error:
        raise SpecError(f"{path}: cannot be read ({error.strerror}): choose a file that you may read") from error


class Bar:
    """A progress bar on stderr, a new one for each split; keeps the latest progress.

    ``verb``: the verb named in lines about skipped samples; ``again``: how to go on after a signal.
    """

    def __init__(
        self, unit: str, quiet: bool, *, verb: str = "generate", again: str = "the same command continues from there"
    ) -> None:
        self._unit, self._quiet, self._verb, self._again = unit, quiet, verb, again
        self._bar: tqdm[Any] | None = None
        self.progress = Progress(0, 0)
        """The latest progress."""

    def run(self, work: Callable[..., Any]) -> Any:
        """The result of ``work(on_progress=…)``. Raises ``Stopped``, with the latest progress, after a signal."""
        try:
            return work(on_progress=self._show)
        except KeyboardInterrupt as error:
            done = self.progress
            split = "" if done.split == "train" else f" of {done.split}"
            so_far = f" at {done.done} of {done.count}{split}" if done.count else ""
            raise Stopped(Stopped.of(error).number, f"{so_far}: {self._again}") from None
        finally:
            if self._bar is not None:
                self._bar.close()

    def _show(self, progress: Progress) -> None:
        """Update the bar; a ``ProgressCallback``."""
        if self._bar is None or progress.split != self.progress.split:
            self._begin(progress)
        assert self._bar is not None
        for fault in progress.skipped[len(self.progress.skipped) :]:
            self._bar.write(f"gcd {self._verb}: left out: {fault}", file=sys.stderr)
        self.progress = progress
        self._bar.set_postfix_str(postfix(progress), refresh=False)
        self._bar.update(progress.done + len(progress.skipped) - self._bar.n)

    def _begin(self, progress: Progress) -> None:
        from tqdm.auto import tqdm

        bar = self

        class Paced(tqdm):
            """A bar with the rate of the last minute and the time left at that rate, if measured."""

            @property
            def format_dict(self) -> dict[str, Any]:
                return {**super().format_dict, **({} if bar.progress.rate is None else {"rate": bar.progress.rate})}

        if self._bar is not None:
            self._bar.close()
        self.progress = Progress(progress.count, progress.existing, split=progress.split)
        self._bar = Paced(
            total=progress.count,
            initial=progress.existing,
            unit=self._unit,
            desc=None if progress.split == "train" else progress.split,
            disable=self._quiet,
        )


def postfix(progress: Progress) -> str:
    """Text after the bar: outcomes other than settled, and rejected attempts by rule.

    >>> postfix(Progress(9, 0).with_made(["too_heavy: 3 kg"], "SETTLED"))
    'rejected 1 (too_heavy 1)'
    """
    parts = [f"{name.lower()} {count}" for name, count in progress.outcomes.most_common() if name != SETTLED]
    if rejected := progress.rejects.total():
        rules = [f"{rule} {count}" for rule, count in progress.rejects.most_common(MOST_RULES)]
        more = ["…"] if len(progress.rejects) > MOST_RULES else []
        parts.append(f"rejected {rejected} ({', '.join(rules + more)})")
    return ", ".join(parts)
