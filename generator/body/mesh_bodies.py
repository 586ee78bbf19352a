"""Bodies from mesh files (OBJ, PLY, STL, GLB): read, set upright, and measured unless the measures are given."""

import contextlib
import io
import logging
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from jaxtyping import Float, Int, UInt8

from gcd_dataset.bodyfiles import obj_lines, read_body_parts, read_measurements, require_same_body
from gcd_dataset.errors import BodyError
from gcd_dataset.files import read_whole
from gcd_dataset.generator.body.arms import A_POSE_ANGLE
from gcd_dataset.generator.body.landmarks import read_landmarks
from gcd_dataset.generator.body.measuring import FoundBody, find_body
from gcd_dataset.generator.body.register import UNITS, unit_of
from gcd_dataset.generator.body.repair import ClosedSkin, is_convex, kept_mesh
from gcd_dataset.generator.body.shape import stand
from gcd_dataset.generator.body.smpl import Betas, ModelBody, read_model
from gcd_dataset.generator.body.tailor import USUAL_HEIGHT, MeasureResult
from gcd_dataset.measurements import MEASURE
from gcd_dataset.records import Body, Measurements, Pose, Record

if TYPE_CHECKING:
    from trimesh import Trimesh


COMPRESSED = (b"KHR_draco_mesh_compression", b"EXT_meshopt_compression")  # of glTF
MODEL_PREFIX, MODEL_FILES = "smplx:", (".npz", ".pkl")  # the second is refused, with the way out
REMEDY = "export the mesh again"
MAX_BYTES = 512 << 20  # a scan of a million triangles has 100 MB as OBJ text
MAX_FACES = 2_000_000  # scans have up to a million; larger ones take minutes and 10 GB
MAIN_SHARE = 0.8  # share of the total area above which one of several meshes is taken for the body

_Mesh = tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]


def read_mesh(path: Path) -> _Mesh:
    """Vertices (v, 3) and triangles (f, 3) of a mesh file, in its order and unit; polygons are triangulated.

    Vertices of OBJ and PLY are kept one to one. STL stores triangles without shared vertices: coincident corners are
    merged, in order of appearance. GLB is read with the transforms of its nodes. Raises ``BodyError``.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise BodyError(f"{path}: not a readable mesh format: convert it to {', '.join(READERS)}")
    content = read_whole(path, "mesh", limit=MAX_BYTES, error=BodyError)
    try:
        with _trimesh_silent():
            vertices, faces = reader(content, path)
    except BodyError:
        raise
    except Exception as error:  # trimesh raises any exception for malformed files
        kind, text = path.suffix[1:].upper(), " ".join(str(error).split())
        reason = ascii(text[:80])[1:-1] or type(error).__name__
        raise BodyError(f"{path}: cannot be read as {kind} ({reason}): {REMEDY}") from error
    if not len(faces):
        raise BodyError(f"{path}: holds no triangles: {REMEDY}")
    if len(faces) > MAX_FACES:
        raise BodyError(f"{path}: {len(faces)} triangles, more than {MAX_FACES}: decimate the mesh")
    if faces.min() < 0 or faces.max() >= len(vertices):
        odd = faces.min() if faces.min() < 0 else faces.max()
        raise BodyError(f"{path}: a face names vertex {odd} of {len(vertices)}, numbered from 0: {REMEDY}")
    if not np.isfinite(vertices).all():
        odd = int(np.flatnonzero(~np.isfinite(vertices).all(axis=1))[0])
        raise BodyError(f"{path}: the position of vertex {odd} is not a number: {REMEDY}")
    return vertices, faces


def _read_obj(content: bytes, path: Path) -> _Mesh:
    """Reads positions and faces only: trimesh renumbers vertices by texture seams, materials and groups."""
    plain = re.sub(rb"/\S*", b"", b"\n".join(obj_lines(content)))
    if odd := re.search(rb"^f.*\s(-\d+|\+?0+)(?!\S)", plain, re.MULTILINE):
        raise ValueError(f"a face names vertex {odd[1].decode()}, but OBJ counts from 1")
    return _arrays(_loaded(io.StringIO(plain.decode("ascii", errors="replace")), "obj"))


def _read_stl(content: bytes, path: Path) -> _Mesh:
    corners = np.asarray(_loaded(io.BytesIO(content), "stl").triangles, float)
    _, first, number = np.unique(corners.reshape(-1, 3), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    faces = np.argsort(order)[number.ravel()].reshape(-1, 3)
    return corners.reshape(-1, 3)[first[order]], faces


def _read_glb(content: bytes, path: Path) -> _Mesh:
    import trimesh

    if compression := next((name for name in COMPRESSED if name in content), None):
        raise BodyError(f"{path}: is compressed by {compression.decode()}: export it without compression")
    scene = trimesh.load(io.BytesIO(content), file_type="glb", force="scene", process=False, skip_materials=True)
    meshes = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh)]  # with transforms
    areas = [mesh.area for mesh in meshes if not is_convex(np.asarray(mesh.vertices))]  # leaves out a floor
    if len(areas) > 1 and not max(areas) > MAIN_SHARE * sum(areas):
        names = ", ".join(ascii(name)[1:-1] for name in list(scene.geometry)[:9])
        raise BodyError(f"{path}: holds {len(meshes)} meshes ({names}), none of them clearly the body: export it alone")
    return _arrays(trimesh.util.concatenate(meshes) if meshes else trimesh.Trimesh())


def _loaded(stream: io.StringIO | io.BytesIO, kind: str) -> "Trimesh":
    import trimesh  # here, not above: drawn patterns need no trimesh, which takes 0.4 s

    return trimesh.load(stream, file_type=kind, force="mesh", process=False, maintain_order=True)


def _arrays(mesh: "Trimesh") -> _Mesh:
    return np.array(mesh.vertices, float).reshape(-1, 3), np.array(mesh.faces, int).reshape(-1, 3)


@contextlib.contextmanager
def _trimesh_silent() -> Iterator[None]:
    """Suppress trimesh's logged tracebacks of malformed files: the caller raises a one-line error."""
    logger = logging.getLogger("trimesh")
    previous, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = previous


READERS: Mapping[str, Callable[[bytes, Path], _Mesh]] = {
    ".obj": _read_obj,
    ".ply": lambda content, path: _arrays(_loaded(io.BytesIO(content), "ply")),
    ".stl": _read_stl,
    ".glb": _read_glb,
}


log = logging.getLogger(__name__)

NEAR_A_POSE, SLIDES = 8.0, 0.15  # degrees; cm of ``shoulder_w`` for each
HAIR = 2.0  # cm above the model's head or below its soles; bodies of our shape space have up to 0.8
UNUSUAL_MISFIT = 0.6  # cm; more is reported as an unusual body; GarmentCode's mean bodies have 0.3 to 0.4
SURE_SHOULDER = 0.96  # confidence of the shoulders above which moving the arms costs no accuracy; usually 0.99
ARM_LANDMARKS = ("shoulder_left", "shoulder_right", "underarm_right")
ARM_MEASURES = tuple(name for name, known in MEASURE.items() if known.on_arms)
UNDERBUST_ERROR = 0.5  # cm; a larger possible error is reported
COARSE_ERROR = 0.8  # cm; a larger possible error of girths is reported; a mesh of 6,890 vertices has 0.7
GIRTH_ERROR = 18.0  # sagittas: a tape over flat triangles is 2 pi sagittas short, on a decimated mesh even shorter
WRIST_ERROR = 3 * GIRTH_ERROR  # the wrist is more curved than the rest of the skin
ANGLE_ERROR = 1.0  # degrees for each centimetre of edge length, for the slope of the shoulder
UNSURE = 0.5  # confidence below which a landmark is reported


def read_body(
    mesh: Path | str,
    measurements: Path | str | None = None,
    segmentation: Path | str | None = None,
    *,
    height: float | None = None,
    betas: Betas | None = None,
) -> tuple[Body, Measurements]:
    """The body in a mesh file, or of a model file (see ``smpl.read_model``) in the A-pose, and its measures.

    The body is found in the mesh, turned upright to face +z, and measured. Its ``height`` [cm] gives the unit; without
    it the mesh must be in metres, centimetres or millimetres. The vertices keep their order; unused ones, and other
    objects that are not connected to the body, are left out, and the centres of closed holes (see
    ``repair.WIDEST_HOLE``) follow. ``measurements`` (YAML) and ``segmentation`` (JSON: part name to vertex ids)
    override what is found; measures far from those of the mesh are reported.

    Raises ``BodyError`` with the file and a remedy, also for a height that no adult has; ``ConfigError`` for such a
    ``height``.
    """
    file = _MeshFile.read(mesh, segmentation, betas)
    size = None if measurements is None else read_measurements(measurements)
    try:
        found = _find_body(file, None, height)
    except BodyError as error:
        if size is None or file.parts is None:
            raise
        log.warning("%s; taken as it stands, y up and facing +z, with the given measures and parts", error)
        # No body is found, for example in a dress form.
        tall = float(np.ptp(file.vertices[:, 1]))
        unit = unit_of(tall, str(file.path), height)
        body, ours = (
            _closed(file, stand(file.vertices * unit), file.faces, file.parts),
            Measurements(height=tall * unit),
        )
    else:
        for remark in _remarks(file, found):
            log.info("%s: %s", file.path, remark)
        kept = ~found.upright.scan.outside
        unit = found.upright.transform.unit
        upright = stand(file.vertices * unit) if file.model else found.upright.transform.apply(file.vertices)
        vertices, faces = kept_mesh(upright, file.faces, kept)
        body = _closed(file, vertices, faces, found.parts[kept])
        if file.model:
            body = replace(body, posed=file.model.closed(kept, body.faces, len(body.vertices), unit))
        if size is None:
            return body, found.result.measurements
        unsure = ARM_MEASURES if found.arm_turn and not found.by_vertex else ()  # uncertain: the arms were moved
        ours = replace(found.result.measurements, **dict.fromkeys(unsure, np.nan))
    require_same_body(size, ours, str(measurements), file.path)
    return body, size


def measure_file(
    mesh: Path | str,
    given: Path | str | None = None,
    segmentation: Path | str | None = None,
    *,
    height: float | None = None,
    betas: Betas | None = None,
) -> tuple[MeasureResult, list[str]]:
    """The measures of the body in a mesh file, and remarks on how they were found and on their accuracy.

    The skin may have holes: see ``measuring.find_body``; arguments and errors: see ``read_body``.
    """
    file = _MeshFile.read(mesh, segmentation, betas)
    found = _find_body(file, given, height)
    return found.result, _remarks(file, found)


@dataclass(frozen=True, eq=False)
class _MeshFile(Record):
    """The mesh of a file in its own coordinates and unit."""

    path: Path
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    parts: UInt8[np.ndarray, " v"] | None  # of the segmentation file
    model: ModelBody | None

    @classmethod
    def read(cls, mesh: Path | str, segmentation: Path | str | None, betas: Betas | None) -> Self:
        path = Path(str(mesh).removeprefix(MODEL_PREFIX))
        model = read_model(path, betas) if path.suffix.lower() in MODEL_FILES else None
        if model is None and betas is not None:
            raise BodyError(f"{path}: a mesh has one shape: leave betas out, or give a model file")
        vertices, faces = (model(Pose({})), model.faces) if model else read_mesh(path)
        parts = None if segmentation is None else read_body_parts(Path(segmentation), len(vertices), path)
        return cls(path, vertices, faces, parts, model)


def _find_body(file: _MeshFile, given: Path | str | None, height: float | None) -> FoundBody:
    marks = None if given is None else read_landmarks(Path(given), file.vertices)
    return find_body(
        file.vertices, file.faces, str(file.path), given=marks, parts=file.parts, in_cm=False, height=height
    )


def _closed(
    file: _MeshFile, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], parts: UInt8[np.ndarray, " v"]
) -> Body:
    """The body in an upright mesh [cm], with its skin closed. Raises ``BodyError``."""
    skin = ClosedSkin.of(vertices, faces, parts, str(file.path))
    if not len(skin.faces):
        raise BodyError(f"{file.path}: no triangle with an area: export the mesh again")
    if skin.flipped:
        log.info("%s: some faces pointed inwards and were flipped", file.path)
    if len(skin.hole_widths):
        log.warning(
            "%s: doubtful: %d holes in the skin, up to %.1f cm across, were closed with flat patches, on which cloth "
            "lies flatter than on a body",
            file.path,
            len(skin.hole_widths),
            skin.hole_widths.max(),
        )
    return Body(skin.vertices, skin.faces, skin.parts, file.path.stem)


def _remarks(file: _MeshFile, found: FoundBody) -> list[str]:
    """Remarks for the user, a line each: assumptions about the mesh, and doubts about measures."""
    height, scan, transform = found.result.measurements.height, found.upright.scan, found.upright.transform
    unit = next((name for name, factor in UNITS.items() if factor == transform.unit), None)
    remarks = [f"taken to be in {unit}, {height:.1f} cm tall" if unit else f"scaled to {height:.1f} cm"]
    if transform.turned:
        remarks.append("did not stand upright facing +z and was turned")
    if others := int(scan.outside[file.faces].any(axis=1).sum()):
        remarks.append(f"left out: {others} triangles not connected to the body, such as a floor")
    if found.arm_turn:
        remarks.append(f"arms {np.degrees(found.arm_turn):.0f}° off the A-pose, moved there to be measured")
    elif (off := np.degrees(abs(found.result.measurements.arm_pose_angle - A_POSE_ANGLE))) > NEAR_A_POSE:
        remarks.append(
            f"arms {off:.0f}° off the A-pose, measured as they are: shoulder_w may be {SLIDES * off:.0f} cm off"
        )
    for words, excess in found.beyond.items():
        if excess > HAIR:
            remarks.append(
                f"doubtful: the mesh reaches {excess:.0f} cm {words}, as hair and heels do: check height and head_l, "
                "and all measures of a mesh that was scaled to a height, or remove it"
            )
    if found.by_vertex:
        return [*remarks, "mesh of the body model: landmarks known by vertex"]
    if found.arm_turn:
        unsure = [name for name in ARM_LANDMARKS if found.marks.confidence[name] < SURE_SHOULDER]
        if unsure:
            remarks.append(
                f"doubtful: {', '.join(unsure)} were found with less confidence than arms in this pose require: check "
                f"{', '.join(ARM_MEASURES)}, or scan with the arms 45° down"
            )
    if len(scan.holes):
        remarks.append(
            f"{len(scan.holes)} holes in the skin, up to {scan.holes.max():.1f} cm across, bridged where a tape "
            "crosses less than 3 cm of them"
        )
    remarks += _coarse_mesh_remark(found)
    remarks.append(f"mean distance of the skin from the nearest body of our shape space: {found.misfit:.2f} cm")
    if found.misfit > UNUSUAL_MISFIT:
        remarks.append("doubtful: unlike any adult of our shape space: check the measures")
    if found.underbust_error > UNDERBUST_ERROR:
        remarks.append(
            f"doubtful: underbust may be up to {found.underbust_error:.1f} cm off: it depends strongly on its level"
        )
    unsure = [f"{name} {confidence:.2f}" for name, confidence in found.marks.confidence.items() if confidence < UNSURE]
    if unsure:
        remarks.append(
            f"doubtful: unsure landmarks (1 is sure): {', '.join(unsure)}: check the measures that depend on them"
        )
    return remarks


def _coarse_mesh_remark(found: FoundBody) -> list[str]:
    """Error bounds for a coarse mesh, as found on decimated bodies."""
    scan = found.upright.scan
    girth = GIRTH_ERROR * scan.sagitta
    if girth < COARSE_ERROR * found.result.measurements.height / USUAL_HEIGHT:
        return []
    return [
        f"doubtful: a coarse mesh, its edges {scan.mean_edge:.1f} cm long on average: height and girths may be up to "
        f"{girth:.1f} cm off, wrist and leg_circ {WRIST_ERROR * scan.sagitta:.1f} cm, distances between landmarks "
        f"{scan.mean_edge:.1f} cm and {ANGLE_ERROR * scan.mean_edge:.0f}°: give a finer mesh"
    ]
