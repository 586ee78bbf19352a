"""The frozen test inputs of the scoreboard: files that any program reads, made from seeds.

A task folder holds

- ``inputs/NAME…``: what a model is given; of T2 also ``cut_outs/NAME/``, the same pictures with the garment cut out and
  their cameras, for ``gcd reconstruct``: no input of the task;
- ``truth/NAME_specification.json`` and ``bodies/NAME.npy`` with ``NAME.meta.json``: what its answers are scored with,
  and ``truth/NAME.npz`` for answers that are no patterns;
- ``task.json``: the task, its hashes, and the kind of device that draped the garments.

Patterns and bodies are the same on every machine, whose hashes are in this module; drapes of a CPU and of a GPU differ,
so that scores of the two are tabled apart. The few garments whose drape does not settle stay.
"""

import hashlib
import json
import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.errors import ConfigError, SpecError, did_you_mean
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.jsonfile import JsonPath, read_json
from gcd_dataset.making.progress import Progress, ProgressCallback
from gcd_dataset.measurements import MEASURES
from gcd_dataset.metrics.answers import PANEL_CLASSES, panel_class, true_labels
from gcd_dataset.patternhash import PatternHash, hash_pattern
from gcd_dataset.records import BONES, FPS, POSITION_STEP, Pose, as_stored
from gcd_dataset.scoring.bodies import read_weights
from gcd_dataset.scoring.joining import joined
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards.layout import key_of
from gcd_dataset.shards.meta import shape_of
from gcd_dataset.spec import pattern_from_spec, read_pattern, spec_from_pattern
from gcd_dataset.tensors import EDGE_LABELS, encode_pattern

if TYPE_CHECKING:
    from PIL import Image

    from gcd_dataset.loaders.base import Item, Transform
    from gcd_dataset.loaders.scenes import BodyOf

SEED = 1  # of the test garments; ``benchmarks.reconstruction`` trains on other seeds
TESTED, MINI = 2000, 100  # garments of a test set
RESOLUTION = 2.0  # cm: edges of the meshes
POINTS = 8192
SCAN_SIZE = 320  # pixels of the depth camera along each side
PERSON_CAMERAS, PERSON_POINTS, PERSON_SIZE = 4, 4096, 200  # of T5, without noise
PICTURES, PICTURE_SIZE = 4, 256  # of a garment; pixels along each side
PHOTOGRAPHS = (".jpg", ".jpeg", ".png", ".webp")
MOVING_TESTED, MOVING_MINI = 200, 20  # of T8: a garment in motion takes a minute of a CPU core
EVERY = 2  # frames of a motion to one of T8: 15 a second
TASK = "task.json"
WEIGHT_STEP = 1e-4  # weights of bodies are rounded before they are hashed
FROZEN: Mapping[int, Mapping[str, str]] = {
    TESTED: {
        "patterns": "fbd7b599d1a5d8f16740f84a618b5d2181bbc3311803dddb0a5219d3f9caa9f0",
        "bodies": "38cdefac5428d1c27f94385875334b561fa5377350a4ff6f69e97ed2c314f5a5",
    },
    MOVING_TESTED: {
        "patterns": "6813c2565f0c53118f71d6764fa20ca6a984b1bc5a6ee1321f334f6859f3b0c6",
        "bodies": "a7da958838d94b8d77b04cfe936880d529c1f0cb8352b30083cf9e0eae9ef901",
    },
    MINI: {
        "patterns": "969db4633528ed89d687591a31ef6c9030626db0095a284656a896212f8a6383",
        "bodies": "9187c65b7dda094c6b555b55ce5f11a7ffc29d74b35c9e4ca941d00e40c4ecbe",
    },
    MOVING_MINI: {
        "patterns": "4b3d4373d963c970b5547b90f2a1f351fc3cc37f7db9777bc9111aa8062141be",
        "bodies": "0b3f9bf166e9e11cf1a8ceb3cdc90d0482a9a1a87fe1e5aff62aa86e3ef44a4e",
    },
}
"""The hashes of the whole test set, and of its first garments, by their number."""
BARE, BARE_EDGE = ("translation", "rotation", "vertices", "edges"), ("endpoints", "curvature")
Write = Callable[["Item", Path], None]


@dataclass(frozen=True)
class BoardTask:
    """A task of the scoreboard."""

    name: str
    given: str
    """The files of ``inputs/``."""
    write: Write
    """Writes the input of an item to ``inputs/NAME`` with an ending."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of ``GeneratedGarments``."""
    transform: Callable[[], "Transform"] | None = None
    """Makes the transform that gives items what ``write`` needs."""
    truth: Callable[["Item", str], Mapping[str, np.ndarray]] | None = None
    """The true arrays of an item named so, with which answers are compared that are no patterns."""
    fields: tuple[str, ...] = ()
    """Further fields of an item."""
    asks: Callable[["Item"], bool] = lambda item: True
    """Whether an item is asked; of others only pattern and body are written."""
    counts: tuple[int, int] = (TESTED, MINI)
    """Garments of the test set, and of the one for a laptop."""


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
    """The pictures; and besides the inputs, in ``cut_outs``, what ``gcd reconstruct`` compares drapes with."""
    from PIL import Image

    from gcd_dataset.generator.silhouettes import write_cut_outs

    views, on_garment, *cameras = (item[name].numpy() for name in ("views", "panel_id_map", "camera_k", "camera_rt"))
    for number, pixels in enumerate(views):
        Image.fromarray(pixels).save(stem.with_name(f"{stem.name}_{number}.png"))
    write_cut_outs(stem.parents[1] / "cut_outs" / stem.name, views, on_garment >= 0, *cameras)


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


def vertex_order(name: str, count: int) -> Int[np.ndarray, " v"]:
    """The vertices of a garment's mesh in the order of T4: that of our files tells seams and panels."""
    return np.random.default_rng([SEED, *name.encode()]).permutation(count)


def _shuffled_mesh(item: "Item", stem: Path) -> None:
    """Faces begin with their least vertex and are sorted."""
    order = vertex_order(stem.name, len(item["verts"]))
    faces = np.argsort(order)[item["faces"].numpy()]
    faces = np.take_along_axis(faces, (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    faces = faces[np.lexsort(faces.T[::-1])].astype(np.int32)
    _save_arrays(stem, {"vertices": item["verts"].numpy()[order].astype(np.float32), "faces": faces})


def _vertex_labels(item: "Item", name: str) -> Mapping[str, np.ndarray]:
    mesh = {key: item[key].numpy() for key in ("faces", "panel_id", "seams", "labels")}
    classes = np.array([panel_class(panel) for panel in item["meta"]["panel_names"]])
    count = len(item["verts"])
    true = true_labels(count, **mesh, classes=classes, stitches=len(item["stitches"]))
    return {key: table[vertex_order(name, count)] for key, table in vars(true).items()}


def person_points(item: "Item") -> Float[np.ndarray, "n 7"]:
    """Points of garment and visible body [cm], normals, 1 on cloth, of an item that ``seen_all_round`` scanned."""
    return np.column_stack([item["scan"].numpy(), item["scan_panel_id"].numpy() >= 0]).astype(np.float32)


def _person(item: "Item", stem: Path) -> None:
    points = person_points(item)
    _save(points[np.isfinite(points).all(axis=1)], stem)


def _measures(item: "Item", name: str) -> Mapping[str, np.ndarray]:
    return {"measures": np.array([item["measures"][measure] for measure in MEASURES])}


def _box_mesh(item: "Item", stem: Path) -> None:
    """The mesh before the drape, the wearer, and the pattern."""
    from gcd_dataset.generator.views import stored_body

    body = stored_body(shape_of(item["body"].numpy().astype(float), item["meta"]["pose"]))
    _save_mesh(item, stem, body.faces, body_vertices=body.vertices.astype(np.float32))


def _save_mesh(item: "Item", stem: Path, body_faces: Int[np.ndarray, "f 3"], **arrays: np.ndarray) -> None:
    mesh = {name: item[name].numpy() for name in MESH} | {"vertices": item["box"].numpy().astype(np.float32)}
    _save_arrays(stem, {**mesh, **arrays, "body_faces": body_faces.astype(np.int32)})
    _write_json(stem.with_name(f"{stem.name}_specification.json"), item["spec"])


def moves(item: "Item") -> bool:
    """Whether the garment comes to rest, and stays on the body to the end of the motion."""
    motion = item["meta"]["motion"]
    return bool(motion["frames"] == motion["asked"])


def poses_of(turns: Float[np.ndarray, "t 21 3"]) -> list[Pose]:
    """The poses of angles of ``BONES`` [rad]."""
    return [Pose(dict(zip(BONES, map(tuple, rows), strict=True)), f"{k}") for k, rows in enumerate(turns.tolist())]


def _motion(item: "Item", stem: Path) -> None:
    """The mesh before the drape, the garment at rest, the pattern, and the wearer in each frame."""
    from gcd_dataset.generator.body.pose import pose_body
    from gcd_dataset.generator.views import stored_body

    turns, first = item["motion_pose"][::EVERY].numpy().astype(float), item["motion_verts"][0].numpy()
    home = stored_body(replace(shape_of(item["body"].numpy().astype(float), item["meta"]["pose"]), pose=None))
    skin = as_stored(np.stack([pose_body(home, pose).vertices for pose in poses_of(turns)]), POSITION_STEP)
    moving = {"pose": turns.astype(np.float32), "body_vertices": skin.astype(np.float32)}
    _save_mesh(item, stem, home.faces, first=first.astype(np.float32), **moving)


def _positions(item: "Item", name: str) -> Mapping[str, np.ndarray]:
    return {"vertices": item["verts"].numpy(), "legs_apart": np.array(item["meta"]["pose"]["legs_apart"])}


def _motion_positions(item: "Item", name: str) -> Mapping[str, np.ndarray]:
    return {**_positions(item, name), "vertices": item["motion_verts"][::EVERY].numpy().astype(np.float32)}


def _save_arrays(stem: Path, arrays: Mapping[str, Any]) -> None:
    with stem.with_name(f"{stem.name}.npz").open("wb") as file:
        np.savez_compressed(file, **arrays)


def seen_all_round(bodies: "BodyOf | None" = None) -> "Transform":
    """Scans a person with four cameras, without noise: the error of a measure is that of the model."""
    from gcd_dataset.generator.render.scans import NOISELESS
    from gcd_dataset.loaders import Scan

    return Scan(n=PERSON_CAMERAS, points=PERSON_POINTS, noise=NOISELESS, body=True, size=PERSON_SIZE, bodies=bodies)


def _scanned() -> "Transform":
    from gcd_dataset.loaders import Scan

    return Scan(n=1, points=POINTS, size=SCAN_SIZE)


def _pictured() -> "Transform":
    from gcd_dataset.loaders import Views

    return Views(n=PICTURES, size=PICTURE_SIZE)


DRAPED = {"drape": "warp", "points": POINTS}
PATTERN = {"drape": None, "stage": "pattern"}
MOVING = {"drape": "warp", "resolution": 3.0, "poses": "walk-cycle"}
MESH = ("faces", "uv", "corners", "uv_vertex", "panel_id", "seams", "labels")
"""Fields of a box mesh besides its vertices."""
WORDS: Mapping[str, Mapping[str, Sequence[str]]] = {
    "T4": {"classes": PANEL_CLASSES, "edges": EDGE_LABELS}, "T5": {"measures": MEASURES}
}  # fmt: skip
"""Words that ``task.json`` lists: those whose numbers are answered, and the names of measures."""
TASKS: Mapping[str, BoardTask] = {
    task.name: task
    for task in (
        BoardTask("T1", f"NAME.npy: {POINTS} points of the draped garment and normals (n, 6) [cm]", _points, DRAPED),
        BoardTask("T1-scan", "NAME.npy: points that one depth camera measures (n, 6) [cm]", _scan, DRAPED, _scanned),
        BoardTask("T2", f"NAME_0.png to NAME_{PICTURES - 1}.png: rendered pictures", _pictures, DRAPED, _pictured),
        BoardTask("T3", "NAME.json: the panels in random order, edges joined, without seams", _joined_panels, PATTERN),
        BoardTask("T3-subdivided", "NAME.json: the same, edges subdivided where seams end", _panels, PATTERN),
        BoardTask(
            "T4", "NAME.npz: vertices [cm] and faces of the draped mesh, in random order", _shuffled_mesh, DRAPED,
            truth=_vertex_labels,
        ),
        BoardTask(
            "T5", "NAME.npy: points of garment and visible body, normals, 1 on cloth (n, 7) [cm]", _person, DRAPED,
            seen_all_round, _measures,
        ),
        BoardTask(
            "T6", f"NAME.npz: vertices [cm], {', '.join(MESH)} of the box mesh; body_vertices [cm], body_faces; "
            "NAME_specification.json: the pattern", _box_mesh, DRAPED, truth=_positions,
        ),
        BoardTask(
            "T8", f"NAME.npz: vertices [cm], {', '.join(MESH)} of the box mesh; first (v, 3) [cm], the cloth in the "
            f"first of t frames, {FPS / EVERY:g} a second; pose (t, 21, 3) [rad]; body_vertices (t, b, 3) [cm], "
            "body_faces; NAME_specification.json: the pattern", _motion, MOVING, truth=_motion_positions,
            fields=("motion_verts", "motion_pose"), asks=moves, counts=(MOVING_TESTED, MOVING_MINI),
        ),
    )
}  # fmt: skip


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
        """The true patterns, as specification files, and arrays."""
        return self.path / "truth"

    @property
    def bodies(self) -> Path:
        """The wearers."""
        return self.path / "bodies"

    @property
    def count(self) -> int:
        """Garments of the test set."""
        return TASKS[self.task].counts[self.mini]

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
        frozen = FROZEN[self.count]
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

    ``mini``: the first hundred, of T8 twenty, for a laptop. ``workers``: processes that make garments. Raises
    ``ConfigError`` for an unknown task or a folder of other inputs, ``SpecError`` where the garments are not those of
    the frozen hashes.
    """
    from gcd_dataset.loaders import VIEW_FIELDS, FreshGarments, GeneratedGarments

    made = task_named(task)
    kind = device_class(device) if made.options["drape"] else ""
    folder = TaskFolder(out, task, mini, kind)
    tree: dict[str, Any] = {"task": task, "given": made.given, "mini": mini, "seed": SEED, "device": kind}
    tree |= {name: list(words) for name, words in WORDS.get(task, {}).items()}
    if is_task_folder(out):
        old = dict(JsonPath(str(out / TASK)).mapping(read_json(out / TASK, "description of a task"), ""))
        if {**old, "finished": None, "hashes": None} != {**tree, "finished": None, "hashes": None}:
            raise ConfigError(f"{out}: holds inputs of task {old.get('task')} made in another way: give another folder")
    for part in (folder.inputs, folder.truth, folder.bodies):
        make_folder(part)
    _write_json(out / TASK, {**tree, "finished": False})
    first = len(list(folder.truth.glob("*.json")))  # written in order, each after its input
    fields = (
        (*VIEW_FIELDS, "points", "measures", "box", "labels", *made.fields)
        if made.options["drape"]
        else ("meta", "spec", "body")
    )
    options = {"resolution": RESOLUTION, "picture": 0, "on_fail": "keep", "device": device, **made.options}
    transform = made.transform and made.transform()
    garments = GeneratedGarments(folder.count, SEED, **options, fields=fields, transform=transform)
    progress = Progress(folder.count, first)
    fresh = FreshGarments(garments.select(range(first, folder.count)), workers=workers, room=1)
    for index, item in enumerate(fresh, first):
        name = key_of(index)
        if made.asks(item):
            made.write(item, folder.inputs / name)
        _save(item["body"].numpy(), folder.bodies / name)
        _write_json(folder.bodies / f"{name}.meta.json", {"pose": item["meta"]["pose"]})
        if made.truth and made.asks(item):
            _save_arrays(folder.truth / name, made.truth(item, name))
        _write_json(folder.truth / f"{name}_specification.json", item["spec"])
        progress = replace(progress, made=progress.made + 1)
        if on_progress:
            on_progress(progress)
    folder.require_frozen()
    _write_json(out / TASK, {**tree, "finished": True, "hashes": FROZEN[folder.count]})
    return folder


def lay_out_pictures(photographs: Path, out: Path) -> list[str]:
    """Lay out a folder of photographs as inputs of T2; the names of the garments. There is no truth to score with.

    ``NAME_0.jpg`` to ``NAME_3.jpg`` show one garment, any other picture, such as ``IMG_0412.jpg``, one alone. The whole
    picture is kept, in a white square; fewer than ``PICTURES`` are repeated. Raises ``ConfigError`` for a folder
    without pictures, or one that cannot be read.
    """
    found = defaultdict[str, list[Path]](list)
    for path in photographs_in(photographs):
        found[re.sub(rf"_[0-{PICTURES - 1}]$", "", path.stem)].append(path)
    inputs = make_folder(out / "inputs")
    for name, paths in found.items():
        for number, path in zip(range(PICTURES), cycle(paths), strict=False):
            square_picture(path).save(inputs / f"{name}_{number}.png")
    return list(found)


def photographs_in(folder: Path) -> list[Path]:
    """The pictures of a folder, by name. Raises ``ConfigError`` if it has none."""
    found = [path for path in sorted(folder.glob("*")) if path.suffix.lower() in PHOTOGRAPHS]
    if not found:
        raise ConfigError(f"{folder}: no pictures: give a folder of {', '.join(PHOTOGRAPHS)} files")
    return found


def square_picture(path: Path) -> "Image.Image":
    """The whole picture in a white square of ``PICTURE_SIZE`` pixels. Raises ``ConfigError``."""
    from PIL import Image, ImageOps

    try:
        with Image.open(path) as image:
            upright = ImageOps.exif_transpose(image).convert("RGB")
    except (OSError, Image.DecompressionBombError) as error:
        raise ConfigError(f"{path}: cannot be read ({error}): give another picture") from error
    return ImageOps.pad(upright, (PICTURE_SIZE, PICTURE_SIZE), color="white")


def _write_json(path: Path, tree: Any) -> None:
    write_whole(path, (json.dumps(tree) + "\n").encode())
