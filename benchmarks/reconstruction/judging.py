"""Scores, pictures and files of the answers to a task: one ``Judge`` for each kind of answer."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, astuple, dataclass, fields, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float, UInt8

from benchmarks.reconstruction.derived import CENTRE, FIT
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.tasks import ReconstructionTask
from gcd_dataset.files import make_folder, open_whole, write_whole
from gcd_dataset.generator.drawing import contact_sheet, draw_pattern
from gcd_dataset.generator.lay_plan import PALETTE
from gcd_dataset.measurements import MEASURES
from gcd_dataset.metrics import assigned, bootstrap_means, score_labels, score_measures
from gcd_dataset.scoring.garments import scores_of
from gcd_dataset.scoring.inputs import vertex_order
from gcd_dataset.spec import write_pattern

SHOWN = 8  # garments in pictures
SIDE = 320  # pixels of a picture
BACKWARDS = np.array([-1.0, 1.0, -1.0])  # half a turn about the vertical
WRONG = (0.86, 0.08, 0.08)  # sRGB


class Judge(Protocol):
    """Scores, pictures and files of the answers for garments."""

    def scores(self, answers: Sequence[Any], garments: GarmentSet, *, workers: int = 0) -> list[Any]:
        """One dataclass of numbers for each answer."""

    def picture(self, answers: Sequence[Any], garments: GarmentSet) -> UInt8[np.ndarray, "h w 3"]:
        """Answers beside the truth; of meshes and patterns, the first ``SHOWN``."""

    def write(self, answers: Sequence[Any], garments: GarmentSet, out: Path) -> None:
        """The answers as files in ``out``."""


def judge_of(task: ReconstructionTask, *, watching: bool = False) -> Judge:
    """The judge of a task; ``watching``: without scores that take long, to watch a training."""
    if task.name == "T4":
        return Vertices()
    if task.name == "T5":
        return Numbers(MEASURES, numbers_of, score_measures)
    if task.name == "T7":
        return Numbers(FIT, numbers_of, score_fit)
    return (
        Drapes(crossings=not watching)
        if task.name in ("T6", "T8")
        else Patterns(draped=bool(task.options.get("drape")))
    )


def numbers_of(garments: GarmentSet) -> Float[np.ndarray, "g n"]:
    """The rows of ``FIT`` of garments that have them, else of ``MEASURES``."""
    return garments.ragged["fit"].rows if "fit" in garments.ragged else garments.measures


def means_of(scores: Sequence[Any]) -> dict[str, float]:
    """The mean of each score."""
    means = np.mean([astuple(score) for score in scores], axis=0).tolist()
    return dict(zip(asdict(scores[0]), means, strict=True))


def intervals(scores: Sequence[Any]) -> dict[str, list[float]]:
    """Mean, and lower and upper end of the 95 % bootstrap interval, of each score."""
    values = np.array([astuple(score) for score in scores], float).reshape(len(scores), -1)
    low, high = bootstrap_means(values, np.random.default_rng(0))
    rows = zip(fields(scores[0]), values.mean(axis=0).tolist(), low.tolist(), high.tolist(), strict=True)
    return {field.name: [mean, least, most] for field, mean, least, most in rows}


# --------------------------------------------------------------------------------------------------------- the patterns


@dataclass(frozen=True)
class Patterns:
    """Answers are patterns: specification files, which the evaluator reads, as it does ``inputs`` and ``bodies``."""

    draped: bool = False
    """Whether the points are of drapes, which drapes of the answers should meet; only then they are written."""

    def scores(self, answers: Sequence[Any], garments: GarmentSet, *, workers: int = 0) -> list[Any]:
        return scores_of(answers, [garments.pattern(k) for k in range(len(garments))], workers=workers)

    def picture(self, answers: Sequence[Any], garments: GarmentSet) -> UInt8[np.ndarray, "h w 3"]:
        shown = answers[:SHOWN]
        return beside_truth(shown, [garments.pattern(k) for k in range(len(shown))])

    def write(self, answers: Sequence[Any], garments: GarmentSet, out: Path) -> None:
        truth = [garments.pattern(k) for k in range(len(garments))]
        kinds = dict(zip(garments.keys, garments.kinds, strict=True))
        for folder, patterns in (("predictions", answers), ("truth", truth)):
            make_folder(out / folder)
            for key, pattern in zip(garments.keys, patterns, strict=True):
                named = replace(pattern, name=key, extra={"properties": {"kind": kinds[key]}})
                write_pattern(named, out / folder / f"{key}.json")
        if self.draped and garments.points.shape[1] > 0:
            _write_inputs(garments, make_folder(out / "inputs"))
        if "pose" in garments.ragged:
            _write_bodies(garments, make_folder(out / "bodies"))


def _write_inputs(garments: GarmentSet, folder: Path) -> None:
    """The points of each garment [cm], as ``KEY.npy``."""
    for key, points in zip(garments.keys, garments.points, strict=True):
        with open_whole(folder / f"{key}.npy") as file:
            np.save(file, (points[:, :3].astype(float) + CENTRE).astype(np.float32))


def _write_bodies(garments: GarmentSet, folder: Path) -> None:
    """Shape weights of each wearer as ``KEY.npy``, the angle of the arms in ``KEY.meta.json``."""
    for k, key in enumerate(garments.keys):
        with open_whole(folder / f"{key}.npy") as file:
            np.save(file, garments.shapes[k])
        angle = float(garments.ragged["pose"][k][0, 0])
        write_whole(folder / f"{key}.meta.json", json.dumps({"pose": {"arm_angle": angle}}).encode())


def beside_truth(answers: Sequence[Any], truth: Sequence[Any], *, size: int = SIDE) -> UInt8[np.ndarray, "h w 3"]:
    """A picture of patterns: truth on the left, the answer on its right, two pairs in a row."""
    pictures = [draw_pattern(pattern, size=size) for pair in zip(truth, answers, strict=True) for pattern in pair]
    return contact_sheet(pictures, columns=4)


# --------------------------------------------------------------------------------------------- the labels of vertices


class Vertices:
    """Answers are ``VertexLabels``, written as ``predictions/KEY.npz`` in the order of ``gcd bench inputs``."""

    def scores(self, answers: Sequence[Any], garments: GarmentSet, *, workers: int = 0) -> list[Any]:
        from benchmarks.reconstruction.labelled_surfaces import true_labels

        return [score_labels(answer, true_labels(garments, k)) for k, answer in enumerate(answers)]

    def picture(self, answers: Sequence[Any], garments: GarmentSet) -> UInt8[np.ndarray, "h w 3"]:
        """Front and back with true panels, then with the answer: assigned panels in their colours, others in red."""
        from benchmarks.reconstruction.labelled_surfaces import true_labels

        pictures = []
        for k, answer in enumerate(answers[:SHOWN]):
            faces, panels = garments.ragged["faces"][k], garments.ragged["panel_id"][k]
            found = assigned(answer.panels, true_labels(garments, k).panels)[faces]
            # The label of two corners of a face, or of its first.
            said = np.where(found[:, 1] == found[:, 2], found[:, 1], found[:, 0])
            for numbers in (panels, said):
                pictures += _both_sides(garments.ragged["verts"][k], faces, numbers % len(PALETTE) * (numbers >= 0)
                                        + len(PALETTE) * (numbers < 0))  # fmt: skip
        return contact_sheet(pictures, columns=4)

    def write(self, answers: Sequence[Any], garments: GarmentSet, out: Path) -> None:
        folder = make_folder(out / "predictions")
        for key, answer in zip(garments.keys, answers, strict=True):
            with open_whole(folder / f"{key}.npz") as file:
                order = vertex_order(key, len(answer.panels))
                np.savez_compressed(file, **{name: labels[order] for name, labels in vars(answer).items()})


# --------------------------------------------------------------------------------------- the measures, size and ease


@dataclass(frozen=True)
class Numbers:
    """Answers are rows of numbers, written by name as ``predictions/KEY.json``."""

    names: Sequence[str]
    truth: Callable[[GarmentSet], np.ndarray]
    """The true rows of garments."""
    score: Callable[[np.ndarray, np.ndarray], Any]
    """The scores of an answer, and the truth."""

    def scores(self, answers: Sequence[Any], garments: GarmentSet, *, workers: int = 0) -> list[Any]:
        return [self.score(*pair) for pair in zip(answers, self.truth(garments), strict=True)]

    def picture(self, answers: Sequence[Any], garments: GarmentSet) -> UInt8[np.ndarray, "h w 3"]:
        """A plot for each number: the truth to the right, the answer upwards, and the line where they agree."""
        pairs = np.stack([self.truth(garments), np.stack(answers)], axis=-1)
        return contact_sheet([_plot(name, pairs[:, k]) for k, name in enumerate(self.names)], columns=7)

    def write(self, answers: Sequence[Any], garments: GarmentSet, out: Path) -> None:
        folder = make_folder(out / "predictions")
        for key, answer in zip(garments.keys, answers, strict=True):
            values = dict(zip(self.names, np.asarray(answer, float).round(3).tolist(), strict=True))
            write_whole(folder / f"{key}.json", json.dumps(values, indent=1).encode())


def _plot(name: str, pairs: np.ndarray, size: int = 160) -> UInt8[np.ndarray, "h w 3"]:
    from PIL import Image, ImageDraw

    image = Image.new("RGB", (size, size + 14), (255, 255, 255))
    canvas = ImageDraw.Draw(image)
    known = pairs[np.isfinite(pairs).all(axis=1)]
    low, high = (known.min(), known.max()) if len(known) else (0.0, 1.0)
    places = (known - low) / max(float(high - low), 1e-6) * (size - 12) + 6
    canvas.line([(6, size - 6), (size - 6, 6)], fill=(170, 170, 170))
    for x, y in places.tolist():
        canvas.ellipse([x - 1.5, size - y - 1.5, x + 1.5, size - y + 1.5], fill=(40, 80, 150))
    canvas.text((4, size), f"{name} {low:.0f} to {high:.0f}", fill=(40, 40, 40))
    return np.asarray(image)


# ---------------------------------------------------------------------------------------------------------- the drapes


@dataclass(frozen=True)
class Drapes:
    """Answers are ``DrapedVertices``, of T8 in each frame, written as ``predictions/KEY.npz``."""

    crossings: bool = True
    """Whether crossings are counted."""

    def scores(self, answers: Sequence[Any], garments: GarmentSet, *, workers: int = 0) -> list[Any]:
        from benchmarks.reconstruction.drapes import score_drapes

        return score_drapes(answers, garments, crossings=self.crossings)

    def picture(self, answers: Sequence[Any], garments: GarmentSet) -> UInt8[np.ndarray, "h w 3"]:
        """The drape, or last frame, from the front and from behind, then the answer at the same scale."""
        from benchmarks.reconstruction.drapes import asked, truth_of

        pictures = []
        for k, answer in enumerate(answers[:SHOWN]):
            true, faces = asked(truth_of(garments, k))[-1], garments.ragged["faces"][k]
            for vertices in (true, asked(answer.vertices)[-1]):
                pictures += _both_sides(vertices, faces, garments.ragged["panel_id"][k] % len(PALETTE), frame=true)
        return contact_sheet(pictures, columns=4)

    def write(self, answers: Sequence[Any], garments: GarmentSet, out: Path) -> None:
        folder = make_folder(out / "predictions")
        for key, answer in zip(garments.keys, answers, strict=True):
            with open_whole(folder / f"{key}.npz") as file:
                np.savez_compressed(file, vertices=answer.vertices.astype(np.float32), ms=answer.ms)


def _both_sides(
    vertices: np.ndarray, faces: np.ndarray, colours: np.ndarray, *, frame: np.ndarray | None = None
) -> list[UInt8[np.ndarray, "h w 3"]]:
    """A mesh from the front and from behind; ``frame``: the points that fill a picture, if not the mesh."""
    frame = vertices if frame is None else frame
    return [draw_mesh(vertices * turn, faces, colours, frame=frame * turn) for turn in (np.ones(3), BACKWARDS)]


def draw_mesh(
    vertices: np.ndarray, faces: np.ndarray, colours: np.ndarray, *, frame: np.ndarray, size: int = SIDE
) -> UInt8[np.ndarray, "h w 3"]:
    """A mesh seen along -z, its faces drawn from the farthest to the nearest, and the points ``frame`` in the picture.

    ``colours``: rows of ``PALETTE``, or its length for red.
    """
    from PIL import Image, ImageDraw

    low, high = frame[:, :2].min(axis=0), frame[:, :2].max(axis=0)
    scale = 0.94 * 2 * size / max(float((high - low).max()), 1.0)
    flat = (vertices[:, :2] - 0.5 * (low + high)) * scale * [1, -1] + size
    corner = vertices[faces]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    light = 0.55 + 0.45 * np.abs(across[:, 2]) / np.maximum(np.linalg.norm(across, axis=1), 1e-9)
    palette = np.array([*PALETTE, WRONG])
    fills = (255 * palette[colours] * light[:, None]).astype(int)
    image = Image.new("RGB", (2 * size, 2 * size), (250, 250, 248))
    canvas = ImageDraw.Draw(image)
    for face in np.argsort(corner[:, :, 2].mean(axis=1)).tolist():
        canvas.polygon([tuple(point) for point in flat[faces[face]].tolist()], fill=tuple(fills[face].tolist()))
    return np.asarray(image.resize((size, size), Image.Resampling.LANCZOS))


@dataclass(frozen=True)
class FitScore:
    """Errors of the size and the ease of a garment on its wearer."""

    error_cm: float
    """Mean absolute error of the ease at the rings that the garment has."""
    error_sizes: float
    """Absolute error of the number of sizes between wearer and garment."""


def score_fit(answer: Float[np.ndarray, "4"], true: Float[np.ndarray, "4"]) -> FitScore:
    """The scores of an answer in the order of ``FIT``; NaN in the truth: a ring without cloth.

    Raises ``ValueError`` for an answer that lacks a number.

    >>> score_fit(np.array([1.0, 5.0, 2.0, 40.0]), np.array([-1.0, 3.0, 2.0, np.nan]))
    FitScore(error_cm=1.0, error_sizes=2.0)
    """
    if np.shape(answer) != np.shape(true) or not np.isfinite(answer).all():
        raise ValueError(f"{answer}: give {len(true)} numbers: {', '.join(FIT)}")
    errors = np.abs(np.asarray(answer, float) - true)
    return FitScore(float(np.nanmean(errors[1:])), float(errors[0]))
