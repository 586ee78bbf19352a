"""The frozen test inputs of the scoreboard: files that any program reads, made from seeds.

A task folder holds

- ``inputs/NAME…``: what a model is given;
- ``truth/NAME_specification.json`` and ``bodies/NAME.npy`` with ``NAME.meta.json``: what its answers are scored with;
- ``task.json``: the task, its hashes, and the kind of device that draped the garments.

Patterns and bodies are the same on every machine, whose hashes are in this module; drapes of a CPU and of a GPU differ,
so that scores of the two are tabled apart. The few garments whose drape does not settle stay.
"""

import hashlib
import json
import re
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gcd_dataset.errors import ConfigError, SpecError, did_you_mean
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.jsonfile import JsonPath, read_json
from gcd_dataset.making.progress import Progress, ProgressCallback
from gcd_dataset.patternhash import PatternHash, hash_pattern
from gcd_dataset.scoring.bodies import read_weights
from gcd_dataset.scoring.joining import joined
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards.layout import key_of
from gcd_dataset.spec import pattern_from_spec, read_pattern, spec_from_pattern
from gcd_dataset.tensors import encode_pattern

if TYPE_CHECKING:
    from gcd_dataset.loaders.base import Item, Transform

SEED = 1  # of the test garments; ``benchmarks.reconstruction`` trains on other seeds
TESTED, MINI = 2000, 100  # garments of a test set
RESOLUTION = 2.0  # cm: edges of the meshes
POINTS = 8192
SCAN_SIZE = 320  # pixels of the depth camera along each side
PICTURES, PICTURE_SIZE = 4, 128  # of a garment; pixels along each side
PHOTOGRAPHS = (".jpg", ".jpeg", ".png", ".webp")
TASK = "task.json"
WEIGHT_STEP = 1e-4  # weights of bodies are rounded before they are hashed
FROZEN: Mapping[bool, Mapping[str, str]] = {
    False: {
        "patterns": "fbd7b599d1a5d8f16740f84a618b5d2181bbc3311803dddb0a5219d3f9caa9f0",
        "bodies": "38cdefac5428d1c27f94385875334b561fa5377350a4ff6f69e97ed2c314f5a5",
    },
    True: {
        "patterns": "969db4633528ed89d687591a31ef6c9030626db0095a284656a896212f8a6383",
        "bodies": "9187c65b7dda094c6b555b55ce5f11a7ffc29d74b35c9e4ca941d00e40c4ecbe",
    },
}
"""The hashes of the whole test set, and of its first ``MINI`` garments."""
BARE, BARE_EDGE = ("translation", "rotation", "vertices", "edges"), ("endpoints", "curvature")
Write = Callable[["Item", Path], None]


@dataclass(frozen=True)
class BoardTask:
    """A task of the scoreboard whose answers are patterns."""

    name: str
    given: str
    """The files of ``inputs/``."""
    write: Write
    """Writes the input of an item to ``inputs/NAME`` with an ending."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of ``GeneratedGarments``."""
    transform: Callable[[], "Transform"] | None = None
    """Makes the transform that gives items what ``write`` needs."""


def _points(item: "Item", stem: Path) -> None:
    points = item["points"].numpy().astype(np.float32)
    _save(points, stem)


def _scan(item: "Item", stem: Path) -> None:
    points = item["scan"].numpy().astype(np.float32)
    _save(points[np.isfinite(points).all(axis=1)], stem)


def _save(points: np.ndarray, stem: Path) -> None:
    with stem.with_name(f"{stem.name}.npy").open("wb") as file:
        np.save(file, points)


def _pictures(item: "Item", stem: Path) -> None:
    from PIL import Image

    for number, pixels in enumerate(item["views"].numpy()):
        Image.fromarray(pixels).save(stem.with_name(f"{stem.name}_{number}.png"))


def _joined_panels(item: "Item", stem: Path) -> None:
    """The panels with edges joined as a tailor draws them."""
    pattern = pattern_from_spec(item["spec"], stem.name)
    _panels({**item, "spec": {**item["spec"], "pattern": spec_from_pattern(joined(pattern))["pattern"]}}, stem)


def _panels(item: "Item", stem: Path) -> None:
    """The panels in random order under neutral names, without seams and labels."""
    spec = item["spec"]
    order = rng(SEED, int(item["meta"]["index"]), Stage.POINTS).permutation(len(spec["pattern"]["panels"]))
    panels = list(spec["pattern"]["panels"].values())
    bare = {f"panel_{k}": {key: panels[row][key] for key in BARE} for k, row in enumerate(order.tolist())}
    for panel in bare.values():
        panel["edges"] = [{key: edge[key] for key in BARE_EDGE if key in edge} for edge in panel["edges"]]
    tree = {"pattern": {"panels": bare, "stitches": []}, "properties": spec["properties"]}
    stem.with_name(f"{stem.name}.json").write_text(json.dumps(tree))


def _scanned() -> "Transform":
    from gcd_dataset.loaders import Scan

    return Scan(n=1, points=POINTS, size=SCAN_SIZE)


def _pictured() -> "Transform":
    from gcd_dataset.loaders import Views

    return Views(n=PICTURES, size=PICTURE_SIZE)


DRAPED = {"drape": "warp", "points": POINTS}
PATTERN = {"drape": None, "stage": "pattern"}
TASKS: Mapping[str, BoardTask] = {
    task.name: task
    for task in (
        BoardTask("T1", f"NAME.npy: {POINTS} points of the draped garment and normals (n, 6) [cm]", _points, DRAPED),
        BoardTask("T1-scan", "NAME.npy: points that one depth camera measures (n, 6) [cm]", _scan, DRAPED, _scanned),
        BoardTask("T2", f"NAME_0.png to NAME_{PICTURES - 1}.png: rendered pictures", _pictures, DRAPED, _pictured),
        BoardTask("T3", "NAME.json: the panels in random order, edges joined, without seams", _joined_panels, PATTERN),
        BoardTask("T3-subdivided", "NAME.json: the same, edges subdivided where seams end", _panels, PATTERN),
    )
}


INPUT_DRAPES: Mapping[str, bool] = {"T1": False, "T1-scan": True}
"""Tasks whose inputs are points of drapes, and whether these show a part of the garment only."""


def task_named(name: str) -> BoardTask:
    """The task. Raises ``ConfigError`` for an unknown name."""
    if name not in TASKS:
        raise ConfigError(f"no task {name}: give one of {', '.join(TASKS)}{did_you_mean(name, TASKS)}")
    return TASKS[name]


@dataclass(frozen=True)
class TaskFolder:
    """A folder of test inputs."""

    path: Path
    task: str
    mini: bool
    device: str
    """``CPU`` or ``GPU``: where the drapes were made; empty without drapes."""

    @property
    def inputs(self) -> Path:
        """What a model is given."""
        return self.path / "inputs"

    @property
    def truth(self) -> Path:
        """The true patterns, as specification files."""
        return self.path / "truth"

    @property
    def bodies(self) -> Path:
        """The wearers."""
        return self.path / "bodies"

    @property
    def count(self) -> int:
        """Garments of the test set."""
        return MINI if self.mini else TESTED

    def require_frozen(self) -> None:
        """Compare all patterns and bodies with the hashes of the frozen set.

        Raises ``SpecError`` if they differ, ``BodyError`` for a body that cannot be read.
        """
        patterns, bodies = PatternHash(), hashlib.sha256()
        for index in range(self.count):
            name = key_of(index)
            patterns += hash_pattern(index, encode_pattern(read_pattern(self.truth / f"{name}_specification.json")))
            weights = read_weights(self.bodies / f"{name}.npy")
            bodies.update(np.rint(weights / WEIGHT_STEP).astype("<i8").tobytes())
        frozen = FROZEN[self.mini]
        if not patterns.agrees(frozen["patterns"]) or bodies.hexdigest() != frozen["bodies"]:
            raise SpecError(
                f"{self.path}: patterns or bodies differ from the frozen test set: make it again with gcd bench "
                "inputs, in another folder; if it differs again, report it with gcd --version"
            )


def is_task_folder(path: Path) -> bool:
    """Whether ``write_inputs`` began to write this folder."""
    return (path / TASK).is_file()


def read_task(path: Path) -> TaskFolder:
    """The task of a folder. Raises ``SpecError`` for one that is unfinished or was not written by ``write_inputs``."""
    tree = read_json(path / TASK, "description of a task")
    if not isinstance(tree, dict) or str(tree.get("task")) not in TASKS:
        raise SpecError(f"{path / TASK}: no description of a task: make the folder again with gcd bench inputs")
    if not tree.get("finished"):
        raise SpecError(f"{path}: unfinished: the same gcd bench inputs command continues it")
    return TaskFolder(path, str(tree["task"]), bool(tree.get("mini")), str(tree.get("device", "")))


def device_class(device: str) -> str:
    """``CPU`` or ``GPU``. Raises ``ConfigError`` for a missing device."""
    from gcd_dataset.generator.device import resolve_device

    return "CPU" if resolve_device(device) == "cpu" else "GPU"


def write_inputs(
    task: str,
    out: Path,
    *,
    mini: bool = False,
    device: str = "auto",
    workers: int = 0,
    on_progress: ProgressCallback | None = None,
) -> TaskFolder:
    """Write the test inputs of a task; go on where an earlier call stopped.

    ``mini``: the first hundred, for a laptop. ``workers``: processes that make garments. Raises ``ConfigError`` for an
    unknown task or a folder of other inputs, ``SpecError`` where the garments are not those of the frozen hashes.
    """
    from gcd_dataset.loaders import VIEW_FIELDS, FreshGarments, GeneratedGarments

    made = task_named(task)
    kind = device_class(device) if made.options["drape"] else ""
    folder = TaskFolder(out, task, mini, kind)
    tree: dict[str, Any] = {"task": task, "given": made.given, "mini": mini, "seed": SEED, "device": kind}
    if is_task_folder(out):
        old = dict(JsonPath(str(out / TASK)).mapping(read_json(out / TASK, "description of a task"), ""))
        if {**old, "finished": None, "hashes": None} != {**tree, "finished": None, "hashes": None}:
            raise ConfigError(f"{out}: holds inputs of task {old.get('task')} made in another way: give another folder")
    for part in (folder.inputs, folder.truth, folder.bodies):
        make_folder(part)
    _write_json(out / TASK, {**tree, "finished": False})
    first = len(list(folder.truth.glob("*.json")))  # written in order, each after its input
    fields = (*VIEW_FIELDS, "points", "measures") if made.options["drape"] else ("meta", "spec", "body")
    garments = GeneratedGarments(
        folder.count, SEED, **made.options, fields=fields, device=device, resolution=RESOLUTION, picture=0,
        on_fail="keep", transform=made.transform and made.transform(),
    )  # fmt: skip
    progress = Progress(folder.count, first)
    fresh = FreshGarments(garments.select(range(first, folder.count)), workers=workers, room=1)
    for index, item in enumerate(fresh, first):
        name = key_of(index)
        made.write(item, folder.inputs / name)
        _save(item["body"].numpy(), folder.bodies / name)
        _write_json(folder.bodies / f"{name}.meta.json", {"pose": item["meta"]["pose"]})
        _write_json(folder.truth / f"{name}_specification.json", item["spec"])
        progress = replace(progress, made=progress.made + 1)
        if on_progress:
            on_progress(progress)
    folder.require_frozen()
    _write_json(out / TASK, {**tree, "finished": True, "hashes": FROZEN[mini]})
    return folder


def lay_out_pictures(photographs: Path, out: Path) -> list[str]:
    """Lay out a folder of photographs as inputs of T2; the names of the garments. There is no truth to score with.

    ``NAME_0.jpg`` to ``NAME_3.jpg`` show one garment, any other picture, such as ``IMG_0412.jpg``, one alone. The whole
    picture is kept, in a white square; fewer than ``PICTURES`` are repeated. Raises ``ConfigError`` for a folder
    without pictures, or one that cannot be read.
    """
    from PIL import Image, ImageOps

    found = defaultdict[str, list[Path]](list)
    for path in sorted(photographs.glob("*")):
        if path.suffix.lower() in PHOTOGRAPHS:
            found[re.sub(rf"_[0-{PICTURES - 1}]$", "", path.stem)].append(path)
    if not found:
        raise ConfigError(f"{photographs}: no pictures: give a folder of {', '.join(PHOTOGRAPHS)} files")
    inputs = make_folder(out / "inputs")
    for name, paths in found.items():
        for number, path in zip(range(PICTURES), cycle(paths), strict=False):
            try:
                with Image.open(path) as image:
                    upright = ImageOps.exif_transpose(image).convert("RGB")
            except (OSError, Image.DecompressionBombError) as error:
                raise ConfigError(f"{path}: cannot be read ({error}): give another picture") from error
            square = ImageOps.pad(upright, (PICTURE_SIZE, PICTURE_SIZE), color="white")
            square.save(inputs / f"{name}_{number}.png")
    return list(found)


def _write_json(path: Path, tree: Any) -> None:
    write_whole(path, (json.dumps(tree) + "\n").encode())
