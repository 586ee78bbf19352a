"""The tasks T0 to T8: what is given, what is asked, the garments, and the score that heads the table.

The garments are functions of a seed: the training set of seed 0, of which each size holds the smaller ones; the test
set, garments of the frozen inputs of ``gcd bench``, the same designs in every task and for every size of the training
set; and a few garments of ``CHECK_SEED`` to watch a training. ``Split`` checks that they share no design and no body.
Weights, options and records are chosen on the validation set, ``VALIDATION``, never on the test set.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.reconstruction.garments import GarmentSet, Split, generated, read_folder, split_off
from gcd_dataset.errors import ConfigError
from gcd_dataset.filekinds import is_published
from gcd_dataset.scoring.inputs import MOVING, MOVING_TESTED, SEED

CHECK_SEED, FRESH_SEED = 2, 1000
CHECKED = 32  # garments that watch a training
GENERATED = "generated"  # the test source of the task's own garments
SHIRTS = {"options": ["FittedShirt", "Shirt"]}
VALIDATION: Sequence[tuple[int, int, Mapping[str, Any]]] = (
    (3, 500, {}),
    (4, 70, {"meta": {"upper": "none", "bottom": "Pants"}}),
    (5, 70, {"meta": {"upper": SHIRTS, "bottom": "Pants"}}),
    (
        6,
        70,
        {"meta": {"upper": SHIRTS}, "collar": {"component": {"style": "Hood2Panels"}}, "left": {"enable_asym": False}},
    ),
)
"""Seed, number and design of the parts of the validation set: as sampled, trousers, jumpsuits, hoods. At least 60 of
each kind are left where some drapes do not settle."""
MESH: Mapping[str, Any] = {"drape": None, "resolution": 2.0}
PATTERN: Mapping[str, Any] = {"stage": "pattern", "drape": None}
DRAPE: Mapping[str, Any] = {"drape": "warp", "resolution": 2.0}
MISFIT: Mapping[str, Any] = {**DRAPE, "bodies": "female", "sizes": "women", "misfit": "-3:3", "ease": True}
OF_BODIES = ("T5", "T6", "T8")
"""Tasks that need the shape weights of the wearers."""
POSE = ("pose",)
"""Fields of T0, T1 and T2: the bodies on which answers can be draped."""
NAMED = (*POSE, "panel_names", "design")
"""Fields of T0 and T1: also panel names and design parameters, targets of some models."""
SURFACES = (
    "verts", "faces", "panel_id", "seams", "corners", "uv", "uv_vertex", "box",
    "labels", "panel_classes", "pose",
)  # fmt: skip
"""Arrays of T4 and T6, which share their garments and so their cache; and of T8."""


@dataclass(frozen=True)
class ReconstructionTask:
    """A task."""

    name: str
    given: str
    """The input."""
    asked: str
    """The answer."""
    headline: str
    """The score by which models are compared; a field of ``PatternScore``, or of the task's own score."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of ``GeneratedGarments`` besides seed and count."""
    points: int = 0
    """Surface points of a garment."""
    extra: tuple[str, ...] = ()
    """Further item fields."""
    sizes: tuple[int, ...] = (1000, 4000, 24_000)
    """Usual sizes of the training set."""
    tested: int = 500
    """Garments of the test set."""

    @property
    def answers_patterns(self) -> bool:
        """Whether an answer is a ``Pattern``."""
        return self.asked == "pattern"

    @property
    def stage(self) -> str:
        """Last stage of the garments: ``pattern``, ``mesh`` or ``drape``."""
        return "drape" if self.options.get("drape") else str(self.options.get("stage", "mesh"))

    @property
    def lower_is_better(self) -> bool:
        """Whether the headline is an error."""
        return self.headline.startswith("error")

    def load(
        self,
        count: int,
        *,
        source: str = "",
        test_source: str = "",
        data: Path | None = None,
        workers: int = 0,
        tested: int = 0,
        checked: int = 0,
        share: tuple[int, int] = (0, 1),
        seed: int = 0,
        **changes: Any,
    ) -> Split:
        """The garments: generated, or those of a folder or repository ``source``, split by design and body, or by the
        official split if it is GarmentCodeData as published.

        ``test_source``: another source of those that test: ``generated``, a task with the same answers, or as
        ``source``. ``data``: folder that caches generated ones. ``tested``, ``checked``: garments that test and that
        watch a training, 0 for the usual number. ``share``: (r, n) for the training garments r, r + n … alone.
        ``seed``: of generated training garments. ``changes``: other ``options``. Raises ``ConfigError`` for garments of
        another stage.
        """
        make, checked = self._making(data, workers, **changes), checked or min(CHECKED, count)
        tests: Callable[[str], GarmentSet] = partial(self._tests, tested=tested, data=data, workers=workers, **changes)
        if not source:
            train = generated(count, seed, share=share, **make)
            return Split(train, generated(checked, CHECK_SEED, **make), tests(test_source))
        if is_published(Path(source)):
            train = self._read(source, data, workers, "train", count)
            check = self._read(source, data, workers, "validation", checked)
            split = Split(train, check, tests(test_source or source), apart=("designs",))
        else:
            split = split_off(self._read(source, data, workers), tested or self.tested, checked=checked)
            split = replace(split, test=tests(test_source)) if test_source else split
        return split.first(count, *share)

    def _tests(self, source: str, tested: int, **making: Any) -> GarmentSet:
        """The garments that test: generated ones, perhaps of another task, or those of a folder or repository."""
        if source in ("", GENERATED, *TASKS):
            other = TASKS.get(source, self)
            if (other.asked, other.points) != (self.asked, self.points):
                raise ConfigError(f"--test-source {source}: {self.name} has other inputs or answers: give a folder")
            return generated(tested or other.tested, SEED, **other._making(**making))
        return self._read(source, making["data"], making["workers"], "test", tested or self.tested)

    def _read(
        self, source: str, data: Path | None, workers: int, split: str = "", most: int | None = None
    ) -> GarmentSet:
        """The garments of a folder or repository, at most ``most``; ``split``: of the official split, if it has one."""
        split = split if is_published(Path(source)) else ""
        if split and self.name in OF_BODIES:
            raise ConfigError(f"{source}: no shape weights of the wearers, which {self.name} needs: give others")
        make: dict[str, Any] = {"points": self.points, "extra": self.extra, "workers": workers, "cache": data}
        return read_folder(source, stage=self.stage, split=split, most=most, **make)

    def validation(self, most: int, *, data: Path | None = None, workers: int = 0, **changes: Any) -> GarmentSet:
        """The garments on which weights, options and records are chosen, at most ``most`` of each part.

        Other arguments as in ``load``; a ``design`` among ``changes`` replaces the kinds of garments.
        """
        make = self._making(data, workers, **changes)
        parts = VALIDATION[:1] if "design" in changes else VALIDATION
        return GarmentSet.join(
            [
                generated(min(count, most), seed, **(make | ({"design": design} if design else {})))
                for seed, count, design in parts
            ]
        )

    def _making(self, data: Path | None, workers: int, **changes: Any) -> dict[str, Any]:
        """The arguments of ``generated``."""
        options = {**self.options, **changes}
        return {"points": self.points, "extra": self.extra, "cache": data, "workers": workers, **options}


TASKS = {
    task.name: task
    for task in (
        ReconstructionTask(
            "T0", "points of the box mesh", "pattern", "combinatorial", MESH,
            points=8192, extra=(*NAMED, "box_labels"),
        ),
        ReconstructionTask(
            "T1", "points of the draped garment", "pattern", "combinatorial", DRAPE,
            points=8192, extra=(*NAMED, "draped_labels"),
        ),
        ReconstructionTask(
            "T1-scan", "points that one depth camera measures", "pattern", "combinatorial", DRAPE,
            points=8192, extra=(*NAMED, "scan", "scan_labels"),
        ),
        ReconstructionTask(
            "T2", "pictures of the draped garment", "pattern", "combinatorial", DRAPE,
            points=512,  # no input: the reference ``typical`` compares training garments by them
            extra=(*POSE, "design", "pictures", "shown"), sizes=(1000, 4000),
        ),
        ReconstructionTask("T3", "panels, in any order, without seams", "pattern", "stitch_nm_perfect", PATTERN),
        ReconstructionTask(
            "T4", "draped mesh", "panel and seam of each vertex", "panel_label", DRAPE,
            points=2048, extra=SURFACES, sizes=(1000, 4000),
        ),
        ReconstructionTask(
            "T5", "points of garment and visible body", "measures", "error_cm", DRAPE,
            points=2048, extra=(*POSE, "person"), sizes=(1000, 4000),
        ),
        ReconstructionTask(
            "T6", "pattern, box mesh and body", "positions of the drape", "error_cm", DRAPE,
            points=2048, extra=SURFACES, sizes=(1000, 4000),
        ),
        ReconstructionTask(
            "T7", "pictures of a garment of another size than the wearer's", "size and ease", "error_cm", MISFIT,
            extra=("pictures", "shown", "fit"), sizes=(1000, 4000),
        ),
        ReconstructionTask(
            "T8", "motion of the body, mesh, and the first frame", "positions in motion", "error_cm", MOVING,
            extra=(*SURFACES, "motion", "turns"), sizes=(200, 1000), tested=MOVING_TESTED,
        ),
    )
}  # fmt: skip


def task_named(name: str) -> ReconstructionTask:
    """The task. Raises ``ConfigError`` for an unknown name."""
    if name not in TASKS:
        raise ConfigError(f"no task {name!r:.99}: choose one of {', '.join(TASKS)}")
    return TASKS[name]
