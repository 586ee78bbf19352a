"""The tables of measured figures, read from the reports of the benchmarks.

A figure is looked up in its report; a report that no longer holds it raises ``StaleError``. So no figure in the
documents can differ from the report that it cites.
"""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

REPORTS = Path(__file__).resolve().parents[2] / "benchmarks" / "reports"
FIGURE = re.compile(r"^\| ([a-z_]+\.[\w.]+) \| (\S+) \|", re.MULTILINE)
OTHERS = ("mosaicml streaming", "litdata", "webdataset")  # loaders; the report has more
FACT = r"^- {}: (.*(?:\n  .*)*)$"


class StaleError(Exception):
    """A report lacks a figure that a table shows."""


@dataclass(frozen=True)
class Report:
    """A report of a benchmark."""

    name: str
    text: str

    def value(self, figure: str) -> float:
        """A figure of its table; the first of that name. Raises ``StaleError``."""
        for name, value in FIGURE.findall(self.text):
            if name == figure:
                return float(value)
        raise StaleError(f"benchmarks/reports/{self.name}.md has no figure {figure}: change docs/tools/figures.py")

    def cells(self, *start: str) -> list[str]:
        """The cells of the first table row that starts with these. Raises ``StaleError``."""
        for line in self.text.splitlines():
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            if line.startswith("|") and start == tuple(cells[: len(start)]):
                return cells
        raise StaleError(
            f"benchmarks/reports/{self.name}.md has no row {' | '.join(start)}: change docs/tools/figures.py"
        )

    def fact(self, name: str) -> str:
        """An entry of the list at its end, such as ``hardware``; empty without one."""
        match = re.search(FACT.format(name), self.text, re.MULTILINE)
        return " ".join(match[1].split()) if match else ""


@cache
def read_report(name: str) -> Report:
    """The report of that name. Raises ``StaleError``."""
    path = REPORTS / f"{name}.md"
    if not path.exists():
        raise StaleError(f"benchmarks/reports/{name}.md is missing: change docs/tools/figures.py")
    return Report(name, path.read_text())


@dataclass(frozen=True)
class Figure:
    """A row of the tables."""

    what: str
    report: str
    value: Callable[[Report], str]
    beside: Callable[[Report], str] = lambda report: ""
    """The same of another program, or a bound, with the ratio."""
    on: str = ""
    """Hardware, for a report that does not state it; the default is the report's."""
    command: str = ""
    """Command, for a report that does not state it."""
    short: bool = False
    """Whether the README shows it, too."""


def _share(figure: str) -> Callable[[Report], str]:
    return lambda report: f"{100 * report.value(figure):.1f} %"


def _clean_and_time(report: Report) -> str:
    clean, seconds = report.value("drape.clean"), report.value("drape.s_per_garment")
    return f"{100 * clean:.1f} % without a crossing edge; {seconds:.4f} s each"


def _of_grade_clean(report: Report) -> str:
    clean, count = report.value("drape.grade_clean"), report.value("drape.garments")
    return f"{100 * clean:.1f} % of {count:.0f} of grade `clean`"


def _newton(report: Report) -> str:
    ours = report.value("drape.ours_setup_s_batch_50") + report.value("drape.ours_solve_s_batch_50")
    newton = report.value("drape.newton_setup_s_batch_50") + report.value("drape.newton_solve_s_batch_50")
    clean = float(report.cells("newton", "50")[4])
    return f"Newton 1.8 Style3D: {newton:.2f} s, **{newton / ours:.0f} ×**; {100 * clean:.0f} % without a crossing edge"


def _other_loaders(fields: str) -> Callable[[Report], str]:
    def beside(report: Report) -> str:
        ratio = report.value(f"loaders.{fields}_over_memmap")
        others = ", ".join(f"{name} {float(report.cells(fields, name)[3]):.1f} ×" for name in OTHERS)
        return f"memory map {1 / ratio:.2f} ×, {others}"

    return beside


def _remote_pass(report: Report, reader: str) -> str:
    _, _, spent, requests, _, size = report.cells(reader, "epoch")
    return f"{float(spent):.1f} CPU-ms a garment, {requests} requests, {int(size) / 1000:.0f} kB a garment"


def _loading(fields: str) -> Callable[[Report], str]:
    return lambda report: f"{float(report.cells(fields, 'ours')[2]):.3f} CPU-ms a garment"


FIGURES = (
    Figure(
        "sampled garments of all kinds that settle without a single crossing edge, at 1 cm",
        "drape_sampled",
        lambda r: f"{100 * r.value('drape.clean'):.1f} % of {r.value('drape.garments'):,.0f}",
    ),
    Figure("the same, of grade `clean`: no panel overstretched either", "drape_sampled", _share("drape.grade_clean")),
    Figure(
        "crossing edges of these garments at 50, 80, 95 and 99 %: cloth through cloth; cloth through the body",
        "drape_sampled",
        lambda r: "; ".join(
            ", ".join(f"{r.value(f'drape.{kind}_p{share}'):g}" for share in (50, 80, 95, 99))
            for kind in ("self", "body")
        ),
    ),
    Figure(
        "sampled garments with meshes of 2 cm",
        "drape_2cm",
        _clean_and_time,
    ),
    Figure(
        "sampled garments with meshes of 3 cm",
        "drape_3cm",
        _clean_and_time,
    ),
    Figure("sampled garments draped on a CPU, at 1 cm", "drape_cpu", _of_grade_clean),
    Figure("the same, at 2 cm", "drape_cpu_2cm", _of_grade_clean),
    Figure("the same, at 3 cm", "drape_cpu_3cm", _of_grade_clean),
    Figure(
        "distance between the drapes of a GPU and of a CPU, over garments: mean; median",
        "drape_noise_floor",
        lambda r: f"{r.value('drape.floor_mean'):.2f}; {r.value('drape.floor_median'):.2f} cm",
    ),
    Figure(
        "time of a drape, sampled garments in batches of 128",
        "drape_sampled",
        lambda r: (
            f"{r.value('drape.s_per_garment'):.4f} s, and "
            f"{r.value('drape.coarse_mesh_s_per_garment'):.3f} CPU-s for the coarse mesh"
        ),
    ),
    Figure(
        "draping 50 sampled garments in one batch, set-up and coarse meshes included",
        "drape_peer",
        lambda r: (
            f"{r.value('drape.ours_setup_s_batch_50') + r.value('drape.ours_solve_s_batch_50'):.3f} s each; "
            f"{100 * float(r.cells('ours', '50')[4]):.0f} % without a crossing edge"
        ),
        _newton,
        short=True,
    ),
    Figure(
        "designs drawn and selected like GarmentCode's, on its mean body",
        "drape_reference_designs",
        lambda r: (
            f"{100 * r.value('drape.passed_paper'):.1f} % of {r.value('drape.garments'):.0f} pass its limits; "
            f"{100 * r.value('drape.clean'):.1f} % settle without a crossing edge"
        ),
        lambda r: "GarmentCodeData's own drapes: 72 % pass its limits (Korosteleva et al., ECCV 2024)",
    ),
    Figure(
        "GarmentCode's 12 patterns for its mean body, at 1 cm, that settle",
        "drape_reference_patterns",
        lambda r: f"{100 * r.value('drape.passed'):.0f} %, on CPU and GPU",
    ),
    Figure(
        "finished garments with rendered pictures written into shards, on two bodies",
        "scale",
        lambda r: (
            f"{r.value('scale.garments_per_s'):.1f} a second, {r.value('scale.joules'):.1f} J each: "
            f"{round(3.6 * r.value('scale.garments_per_s'))},000 an hour"
        ),
        lambda r: (
            f"one draping process without pictures: {r.value('scale.own_per_s'):.1f} a second; "
            f"GPU idle {100 * r.value('scale.gpu_waits'):.0f} % of the time"
        ),
        short=True,
    ),
    Figure(
        "garments cut three sizes too small to three too large, with rendered pictures, ease and maps, in shards",
        "fits",
        lambda r: (
            f"{r.value('fits.garments_per_s'):.0f} a second; {100 * r.value('fits.right'):.1f} % settle or say how "
            f"they do not fit; {100 * r.value('fits.clean'):.1f} % of those put on are free of crossings"
        ),
    ),
    Figure(
        "fresh garments, draped at 1 cm, that a training loop receives",
        "fresh_garments",
        lambda r: (
            f"{r.value('generated.per_second'):.1f} a second; {r.value('generated.small_fresh_per_second'):.1f} while "
            "a small network trains on that GPU"
        ),
        lambda r: f"one draping process: {r.value('generated.own_per_second'):.1f} a second",
    ),
    Figure(
        "rendered pictures with materials, soft shadows and all truths, 4 views of each garment",
        "render",
        lambda r: (
            f"{r.value('render.images_per_s'):.0f} a second of 256², {r.value('render.images_per_s_512'):.0f} of 512²"
        ),
        lambda r: f"Embree, silhouettes: {100 * r.value('render.mask_agreement'):.0f} % of pixels agree",
    ),
    Figure(
        "sampling a design that fits two bodies, both patterns drawn and checked",
        "patterns",
        lambda r: f"{r.value('patterns.cpu_ms_mean'):.0f} CPU-ms; {100 * r.value('patterns.accepted'):.1f} % accepted",
        lambda r: (
            f"GarmentCode's sampler: {100 * read_report('design_space').value('design_space.reference_accepted'):.0f} "
            "% accepted ([report](../benchmarks/reports/design_space.md))"
        ),
    ),
    Figure(
        "our patterns against GarmentCode's, from the same designs and measures",
        "parity",
        lambda r: (
            f"{100 * r.value('parity.outline'):.0f} % of {r.value('parity.designs'):.0f} agree: panels, seams, "
            "outlines, placements"
        ),
    ),
    Figure(
        "drawing and building a body; taking its 26 measures",
        "bodies",
        lambda r: f"{r.value('bodies.mesh_cpu_ms'):.1f}; {r.value('bodies.measure_cpu_ms'):.1f} CPU-ms",
    ),
    Figure(
        "sampled bodies in two poses that intersect themselves",
        "bodies",
        lambda r: f"{r.value('bodies.crossing'):.0f} of {r.value('bodies.bodies'):.0f}",
    ),
    Figure(
        "measures of GarmentCode's mean bodies within tolerance, from their meshes alone", "measures",
        _share("measures.published"),
    ),
    Figure(
        "loading 8,192 points with the pattern, batches of 16, random order",
        "loaders", _loading("points"), _other_loaders("points"), short=True,
    ),
    Figure(
        "loading geometry of 11,500 vertices, batches of 16, random order",
        "loaders", _loading("geometry"), _other_loaders("geometry"),
    ),
    Figure(
        "first pass in random order over geometry in S3, empty cache", "remote",
        lambda r: _remote_pass(r, "ours"),
        lambda r: "; ".join(f"{name}: {_remote_pass(r, name)}" for name in ("litdata", "mosaicml streaming")),
    ),
    Figure(
        "100 garments each on other bodies, without a crossing edge: T-pose; arms forward; legs wide; a scan of "
        "3,000 vertices; arms 25° and 40° down, which crosses the body itself",
        "bodies_draped",
        lambda r: "; ".join(
            f"{100 * r.value(f'bodies_draped.{name}_clean'):.0f} %"
            for name in ("t_pose", "arms_forward", "legs_wide", "scan_3000", "arms_down_25", "arms_down")
        ),
    ),
)  # fmt: skip
"""The rows, in order."""
T3 = json.loads((REPORTS.parent / "reconstruction" / "weights" / "T3.json").read_text())
RIGHT = [100 * each for each in T3["trainings"]["stitch_nm_perfect"]]
BOARD = (
    "| seams of patterns whose panels are given (T3): garments with all seams right | "
    f"{100 * T3['test']['stitch_nm_perfect']:.1f} % of {T3['test']['garments']} unseen ones by the kept weights, "
    f"{sum(RIGHT) / len(RIGHT):.1f} % in the mean of {len(RIGHT)} trainings ([task](docs/reconstruction.md)) | "
    "AutoSew: 73.3 % of its own test set |"
)
"""The row of the scoreboard."""


def figures_table() -> str:
    """All figures, for a document in ``docs/``."""
    lines = ["| what | figure | beside | on | command |", "|---|---|---|---|---|"]
    for figure in FIGURES:
        report = read_report(figure.report)
        command = figure.command or report.fact("command").strip("`")
        where = f"{_hardware(figure)}, [report](../benchmarks/reports/{figure.report}.md)"
        cells = [figure.what, figure.value(report), figure.beside(report), where]
        lines.append(f"| {' | '.join(cells)} | `{_shortened(command)}` |")
    return "\n".join(lines)


def short_figures() -> str:
    """Some figures, for the README, and the scoreboard's."""
    lines = ["| what | figure | beside |", "|---|---|---|"]
    for figure in FIGURES:
        if figure.short:
            report = read_report(figure.report)
            where = f"{_hardware(figure)}, [report](benchmarks/reports/{figure.report}.md)"
            lines.append(f"| {figure.what} | {figure.value(report)} ({where}) | {figure.beside(report)} |")
    return "\n".join([*lines, BOARD])


def _hardware(figure: Figure) -> str:
    named = figure.on or read_report(figure.report).fact("hardware").replace("1 CPU threads (x86_64)", "one CPU core")
    return named.removeprefix("one CPU core, ").replace(" (x86_64)", "").replace(", 1 threads of torch", "")


def _shortened(command: str) -> str:
    """The command without options for its report, and with ``…`` in place of the files of a body.

    >>> _shortened("python -m benchmarks.run parity EXAMPLES/patterns --keep")
    'python -m benchmarks.run parity EXAMPLES/patterns'
    >>> _shortened("run drape --body mean.obj --measurements mean.yaml --seed 1 --report out.md")
    'run drape --body … --seed 1'
    """
    words, kept = iter(command.split()), []
    for word in words:
        if word in ("--report", "--plot", "--sheet", "--body-apart", "--measurements", "--segmentation"):
            next(words)
        elif word == "--body":
            next(words)
            kept += [word, "…"]
        elif word != "--keep":
            kept.append(re.sub(r"^(\.\./)?shared/examples", "EXAMPLES", word))
    return " ".join(kept)


def report_list() -> str:
    """A line for each report, with its title and date."""
    lines = []
    for path in sorted(REPORTS.glob("*.md")):
        report = read_report(path.stem)
        title = report.text.splitlines()[0].removeprefix("# ")
        facts = ", ".join(part for part in (report.fact("date"), report.fact("hardware")) if part)
        lines.append(f"- [{path.stem}](../benchmarks/reports/{path.name}): {title}{f' ({facts})' if facts else ''}")
    return "\n".join(lines)
