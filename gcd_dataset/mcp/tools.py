"""The tools of ``gcd-mcp``: verbs of ``gcd`` and functions behind them, on files below a root folder.

``python -m gcd_dataset.mcp.tools ROOT TOOL`` reads arguments from stdin and prints the answer, both as JSON: the server
runs each call in such a process, which it can end.
"""

import base64
import contextlib
import io
import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from gcd_dataset.errors import ConfigError, GcdError, OutputError, SpecError, shown
from gcd_dataset.faults import check_pattern
from gcd_dataset.files import safe_name
from gcd_dataset.generator.drawing import captioned, contact_sheet, draw_body, draw_pattern, picture_of, png_bytes
from gcd_dataset.release.published_names import ENDINGS
from gcd_dataset.spec import read_pattern

TOOLS = ("parameters", "draw", "check", "drape", "measure", "score", "export")
MOST_GARMENTS = 8  # of a drape
FINEST = 1.0  # cm, of the mesh edges of a drape
PICTURE = 512  # pixels
FORMATS = ("dxf", "pdf", "svg", "glb", "obj", "ply", "usd")


class Answer(NamedTuple):
    """What a tool answers."""

    text: str
    picture: UInt8[np.ndarray, "h w 3"] | None = None


class Refused(Exception):  # noqa: N818 -- an answer
    """What a verb printed before it failed; of several lines, unlike the messages of ``GcdError``."""


@dataclass(frozen=True)
class Tools:
    """The tools, as methods; their docstrings are what agents read. Each raises ``GcdError`` or ``Refused``."""

    root: Path
    """The folder of all files, resolved."""

    def parameters(self, upper: str | None = None, bottom: str | None = None) -> Answer:
        """The design parameters of a garment, each with its range, default and meaning, and a picture of the defaults.

        upper, bottom: kinds of garment, at least one of them; call without them for the list of kinds. Numbers whose
        text names no unit are fractions or counts.
        """
        from gcd_dataset.generator.body import named_body
        from gcd_dataset.generator.garments import DrawnGarment, GarmentDesign, design_from_dict
        from gcd_dataset.generator.garments.space import DesignSpace, parameter_lines

        design = design_from_dict({"meta": {"upper": upper, "bottom": bottom}})
        used = {"front"} if design.halves() else set()  # sewn fronts leave it unused
        used |= {name.replace("_", "-") for name in design.sections_used()}
        space = DesignSpace.declared(GarmentDesign)
        lines = [line for line in parameter_lines(space) if line.partition(".")[0] in used]
        if upper is None and bottom is None:
            return Answer("\n".join([*lines, "give upper or bottom for the parameters of a garment"]))
        drawn = DrawnGarment.of(named_body("neutral")[1], design, name="defaults")
        return Answer("\n".join(lines), draw_pattern(drawn.pattern, size=PICTURE))

    def draw(
        self,
        out: str,
        seed: int | None = None,
        design: dict[str, Any] | str | None = None,
        body: str = "neutral",
        height: float | None = None,
        overwrite: bool = False,
    ) -> Answer:
        """Draw a garment to measure: writes specification, pattern (SVG), design parameters and measures to a folder.

        out: the folder; its name becomes the garment's. seed: draws a random design. design: parameters instead, such
        as {"meta": {"upper": "Shirt"}, "sleeve": {"length": 0.5}} (see the tool parameters; others take their
        defaults), or the path of a design_params.yaml. body: neutral, female, male, random:SEED, female:SEED,
        male:SEED, or a mesh file; height [cm]: of a mesh file in another unit than m, cm or mm.
        """
        from gcd_dataset.cli.common import design_in
        from gcd_dataset.generator import named_body, sample_design
        from gcd_dataset.generator.fitting import garment_name, write_drawn
        from gcd_dataset.generator.garments.design import design_from_dict, write_design

        if (seed is None) == (design is None) or (seed or 0) < 0:
            raise ConfigError("give a seed of 0 or more, or a design, one of them")
        folder, size = self._new(out, overwrite), named_body(self._body(body), height=height)[1]
        if isinstance(design, str):
            chosen = design_in(self._inside(design))
        elif design is not None:
            chosen = design_from_dict(design)
        else:
            chosen = sample_design(np.random.default_rng(seed), [size])
        spec, rejects = write_drawn(chosen, size, folder, source=folder)
        write_design(chosen, folder / f"{garment_name(folder)}{ENDINGS['design']}")
        pattern = read_pattern(spec)
        parts = [str(part.value) for part in (chosen.meta.upper, chosen.meta.wb, chosen.meta.bottom) if part]
        lines = [f"{spec}: {', '.join(parts)}: {len(pattern.panels)} panels, {len(pattern.seams)} seams"]
        lines += [*(f"on this body, {reject}" for reject in rejects), f"{folder}: SVG, design parameters and measures"]
        return Answer("\n".join(lines), draw_pattern(pattern, size=PICTURE))

    def check(self, spec: str) -> Answer:
        """The faults of a specification file that forbid or hinder sewing, one a line."""
        pattern = read_pattern(self._inside(spec))
        lines = list(map(str, check_pattern(pattern))) or ["1 pattern: no fault found"]
        return Answer("\n".join(lines), draw_pattern(pattern, size=PICTURE))

    def drape(
        self,
        specs: list[str],
        out: str,
        body: str = "neutral",
        height: float | None = None,
        resolution: float = 2.0,
        fabric: str = "default",
        overwrite: bool = False,
    ) -> Answer:
        """Drape specification files, each alone, on a body: writes OBJ, PLY, GLB, pictures and report.json to a folder.

        specs: 1 to 8 files. body, height: as for draw. resolution: length of mesh edges, 1 to 10 cm; 4 is quick, each
        garment takes seconds there and several times as long at 2. fabric: denim, cotton, interlock, …; an unknown
        name lists them all.
        """
        if not 1 <= len(specs) <= MOST_GARMENTS:
            raise ConfigError(f"{len(specs)} specifications: give 1 to {MOST_GARMENTS} for one drape")
        if not resolution >= FINEST:
            raise ConfigError(f"resolution {resolution:g}: give {FINEST:g} to 10 centimetres")
        files, folder = [str(self._inside(spec)) for spec in specs], self._new(out, overwrite)
        options = [f"--out={folder}", f"--body={self._body(body)}", f"--resolution={resolution}", f"--fabric={fabric}"]
        options += [] if height is None else [f"--height={height}"]
        text = _gcd("drape", *files, *options, "--glb", "--allow-unsettled", "--quiet")
        names = [row["pattern"] for row in json.loads((folder / "report.json").read_text())["garments"]]
        size = PICTURE if len(names) <= 2 else PICTURE // 2
        pictures = [
            captioned(picture_of((folder / f"{safe_name(name)}_{side}.png").read_bytes(), size), f"{name}: {side}")
            for name in names
            for side in ("front", "back")
        ]
        return Answer(text, contact_sheet(pictures, columns=2 if len(names) == 1 else 4))

    def measure(self, body: str, height: float | None = None) -> Answer:
        """The tailor's measures of a body as YAML [cm, degrees]. body, height: as for draw."""
        from gcd_dataset.cli.garment import measured_text
        from gcd_dataset.generator import named_body

        name = self._body(body)
        person = named_body(name, height=height)[0]
        return Answer(measured_text(name, height=height), draw_body(person.vertices, person.faces, height=PICTURE))

    def score(self, answer: str, truth: str) -> Answer:
        """Compare a predicted pattern with the true one: a table of all scores, and both patterns side by side.

        answer: a specification, or another file that gcd score reads. truth: a specification.
        """
        from gcd_dataset.scoring.answers import AnswerReader
        from gcd_dataset.scoring.folders import Scores
        from gcd_dataset.scoring.garments import garment_name, read_true, score_garment

        path, true = self._inside(answer), read_true(file := self._inside(truth))
        read = AnswerReader().read_file(path)
        if read.pattern is None:
            raise SpecError(f"{path}: {read.failure}")
        scored = score_garment(garment_name(file), read.pattern, true)
        both = [captioned(draw_pattern(p, size=PICTURE), t) for p, t in ((read.pattern, "answer"), (true, "truth"))]
        return Answer("\n".join(Scores((scored,)).lines()), contact_sheet(both, columns=2))

    def export(self, spec: str, out: str, seam_allowance: float | None = None, overwrite: bool = False) -> Answer:
        """Write a specification file in another format, which the ending of out names.

        .dxf, .pdf (true scale, on A4), .svg: the pattern. .glb, .obj, .ply, .usd: the garment draped on the neutral
        body at 1 cm, which takes up to minutes; the tool drape writes the first three coarser, or on another body.
        seam_allowance [cm]: of .dxf and .pdf (default: 1).
        """
        form = Path(out).suffix.lower().removeprefix(".")
        if form not in FORMATS:
            raise ConfigError(f"{shown(out)}: end the name in .{', .'.join(FORMATS)}")
        path, file = self._inside(spec), self._new(out, overwrite)
        if form == "obj":
            self._new(str(file.with_suffix(".mtl")), overwrite)
        picture = draw_pattern(read_pattern(path), size=PICTURE)
        options = [] if seam_allowance is None else [f"--seam-allowance={seam_allowance}"]
        verb = ["show"] if form == "svg" else ["export", "--quiet"]
        return Answer(_gcd(*verb, str(path), f"--{form}={file}", *options), picture)

    def _inside(self, path: str) -> Path:
        """The path without links, absolute. Raises ``ConfigError`` for a path out of the root folder.

        Absolute paths also keep ``gcd`` from taking a name for an option, a home folder, a URL or a repository.
        """
        try:
            found = (self.root / path).resolve()
        except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a null byte
            raise ConfigError(f"{shown(path)}: names no file: give a path below the root folder") from error
        if not found.is_relative_to(self.root):
            raise ConfigError(f"{shown(path)}: leads out of the root folder: give a path below it")
        return found

    def _new(self, path: str, overwrite: bool) -> Path:
        """The path of an output. Raises ``ConfigError`` as ``_inside``, ``OutputError`` if something is there."""
        found = self._inside(path)
        if found.exists() and not overwrite:
            raise OutputError(f"{shown(path)}: is there already: give another name, or overwrite=true")
        return found

    def _body(self, name: str) -> str:
        """The name of a generated body, or the path of a mesh file. Raises ``BodyError`` for an unknown name."""
        from gcd_dataset.generator.body.by_name import shape_by_name

        return str(self._inside(name)) if shape_by_name(name, legs_apart=False) is None else name


def _gcd(*words: str) -> str:
    """What ``gcd`` prints, on both streams. Raises ``Refused`` with it if the verb fails."""
    from gcd_dataset.cli import main

    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        try:
            code = main(words)
        except SystemExit as error:  # of argparse
            code = int(error.code or 0)
    if code:
        raise Refused(printed.getvalue().strip())
    return printed.getvalue().strip()


def main() -> None:
    """Answer one call, as text, picture (PNG, base64) and whether it was refused; paths are relative to the root."""
    root, name = sys.argv[1:]
    wire = os.dup(1)
    os.dup2(2, 1)  # what libraries print is no part of the answer
    try:
        answer, refused = getattr(Tools(Path(root)), name)(**json.load(sys.stdin)), False
    except (GcdError, Refused) as error:
        answer, refused = Answer(str(error)), True
    picture = None if answer.picture is None else base64.b64encode(png_bytes(answer.picture)).decode()
    with os.fdopen(wire, "w") as out:
        json.dump({"text": answer.text.replace(f"{root}{os.sep}", ""), "picture": picture, "refused": refused}, out)


if __name__ == "__main__":
    main()
