"""Bodies from mesh files: read as they are, made to stand, measured where nobody gave their measures."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from gcd_dataset.bodyfiles import read_body_parts, read_measurements
from gcd_dataset.generator.body.arms import turn_off_a_pose
from gcd_dataset.generator.body.asset import body_model, landmark_table
from gcd_dataset.generator.body.closing import ClosedSkin
from gcd_dataset.generator.body.landmarks import read_landmarks
from gcd_dataset.generator.body.measuring import FoundBody, find_body, measure_model_mesh
from gcd_dataset.generator.body.meshfile import read_mesh
from gcd_dataset.generator.body.pose import stand
from gcd_dataset.generator.body.tailor import USUAL_HEIGHT, MeasureResult
from gcd_dataset.generator.body.upright import UNITS, unit_of
from gcd_dataset.measurements import MEASURE
from gcd_dataset.records import Body, Measurements, Record

__all__ = ["measure_file", "read_body"]

log = logging.getLogger(__name__)

ADULT = (120.0, 230.0)  # cm; outside it the unit may be one that is not known, such as inches
UNLIKE = 0.6  # cm of misfit, over which a body is told to be unusual; the published means have 0.3 to 0.4
SURE = 0.96  # of a shoulder's confidence, over which arms laid down are as good as arms held so; 0.99 on most bodies
BESIDE_ARMS = ("shoulder_left", "shoulder_right", "underarm_right")
HANGING_ON_ARMS = tuple(name for name, known in MEASURE.items() if known.on_arms)
UNDERBUST_OFF = 0.5  # cm
COARSE = 0.8  # cm that a girth may be off, over which a mesh is told to be coarse; 6,890 vertices make 0.7
GIRTH_OFF = 18.0  # times the sagitta; a tape drawn over flat triangles is 2 pi short, and of a merged mesh more
WRIST_OFF = 3 * GIRTH_OFF  # the wrist is more bent than the rest of the skin
DEGREES_OFF = 1.0  # a centimetre of edge, on the shoulder's slope
UNSURE = 0.5  # of a landmark's confidence, under which it is named


@dataclass(frozen=True, eq=False)
class _Mesh(Record):
    """A file's mesh in its own coordinates."""

    path: Path
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    unit: float
    """[cm]"""

    @property
    def is_upright_model_mesh(self) -> bool:
        """Whether it is a body of our own mesh, upright and facing +z."""
        if not np.array_equal(self.faces, body_model().faces):
            return False
        at = {name: self.vertices[vertex] for name, vertex in landmark_table().points.items()}
        tall = np.ptp(self.vertices, axis=0)[1]
        return bool(
            at["nape_of_neck"][1] - at["crotch_point"][1] > 0.25 * tall
            and at["shoulder_left"][0] - at["shoulder_right"][0] > 0.1 * tall
            and at["bust_left"][2] > at["nape_of_neck"][2]
        )


def read_body(
    mesh: Path | str,
    measurements: Path | str | None = None,
    segmentation: Path | str | None = None,
    given: Path | str | None = None,
) -> tuple[Body, Measurements]:
    """The body in a mesh file and its measures.

    The mesh is in metres, centimetres or millimetres. Its vertices keep their order; the middles of holes that were
    closed (see ``closing.WIDEST_HOLE``) come after them. Where ``measurements`` (YAML) or
    ``segmentation`` (JSON: part name to vertex ids) is left out, the body is found in the mesh: turned upright and to
    +z where it was not, and measured; ``given`` (JSON, see ``marks``) says where landmarks are. Raises ``BodyError``
    with the file and a remedy.
    """
    raw = _read_mesh(Path(mesh))
    parts = None if segmentation is None else read_body_parts(Path(segmentation), len(raw.vertices), raw.path)
    if measurements is not None and parts is not None:
        unit_of(float(np.ptp(raw.vertices[:, 1])), f"{raw.path}: along y")
        return _closed(raw, stand(raw.vertices * raw.unit), parts), read_measurements(measurements)
    if raw.is_upright_model_mesh:
        vertices = stand(raw.vertices * raw.unit)
        taken, find_parts = measure_model_mesh(vertices), body_model().parts
    else:
        fitted = _fitted(raw, given, parts)
        for remark in _remarks(raw, fitted):
            log.info("%s: %s", raw.path, remark)
        vertices, taken, find_parts = fitted.placing.apply(raw.vertices * raw.unit), fitted.taken, fitted.parts
    body = _closed(raw, vertices, find_parts if parts is None else parts)
    return body, taken.measurements if measurements is None else read_measurements(measurements)


def measure_file(
    mesh: Path | str, given: Path | str | None = None, segmentation: Path | str | None = None
) -> tuple[MeasureResult, list[str]]:
    """The measures of the body in a mesh file, and remarks on how they were found.

    The skin need not be closed: see ``measuring.find_body``. Raises ``BodyError`` with the file and a remedy.
    """
    raw = _read_mesh(Path(mesh))
    if raw.is_upright_model_mesh and given is None and segmentation is None:
        vertices = stand(raw.vertices * raw.unit)
        taken = measure_model_mesh(vertices)
        return taken, [
            "our own mesh: landmarks known by vertex",
            *_arms(turn_off_a_pose(taken.measurements.arm_pose_angle)),
        ]
    parts = None if segmentation is None else read_body_parts(Path(segmentation), len(raw.vertices), raw.path)
    fitted = _fitted(raw, given, parts)
    return fitted.taken, _remarks(raw, fitted)


def _fitted(raw: _Mesh, given: Path | str | None, parts: UInt8[np.ndarray, " v"] | None) -> FoundBody:
    marks = None if given is None else read_landmarks(Path(given), raw.vertices, raw.unit)
    return find_body(raw.vertices * raw.unit, raw.faces, str(raw.path), given=marks, parts=parts)


def _closed(raw: _Mesh, vertices: Float[np.ndarray, "v 3"], parts: UInt8[np.ndarray, " v"]) -> Body:
    """The body in a mesh that stands [cm], its skin closed. Raises ``BodyError``."""
    skin = ClosedSkin.of(vertices, raw.faces, parts, str(raw.path))
    if skin.turned:
        log.info("%s: its faces look inwards and were turned", raw.path)
    if len(skin.closed):
        log.warning(
            "%s: doubtful: %d holes in the skin, up to %.1f cm across, were closed with flat patches, on which cloth "
            "lies flatter than on a body",
            raw.path,
            len(skin.closed),
            skin.closed.max(),
        )
    return Body(skin.vertices, skin.faces, skin.parts, raw.path.stem)


def _remarks(raw: _Mesh, fitted: FoundBody) -> list[str]:
    """What a user must know about how a body was found and measured, in lines."""
    height = fitted.taken.measurements.height
    unit = next(name for name, factor in UNITS.items() if factor == raw.unit)
    remarks = [f"taken to be in {unit}, {height:.1f} cm tall"]
    if not ADULT[0] < height < ADULT[1]:
        remarks.append(f"doubtful: {height:.1f} cm is no adult's height: a doll, a giant, or another unit")
    if fitted.placing.turned:
        remarks.append("did not stand upright facing +z and was turned")
    remarks += _arms(fitted.arms)
    if fitted.arms:
        unsure = [name for name in BESIDE_ARMS if fitted.marks.confidence[name] < SURE]
        if unsure:
            remarks.append(
                f"doubtful: {', '.join(unsure)} were found less surely than arms held like this ask for: check "
                f"{', '.join(HANGING_ON_ARMS)}, or scan with the arms 45° down"
            )
    if len(fitted.holes):
        remarks.append(
            f"{len(fitted.holes)} holes in the skin, up to {fitted.holes.max():.1f} cm across, bridged where a tape "
            "runs over less than 3 cm of them"
        )
    remarks += _coarse(fitted)
    remarks.append(f"landmarks found {fitted.misfit:.2f} cm from the nearest body of our shape space on average")
    if fitted.misfit > UNLIKE:
        remarks.append("doubtful: unlike any adult of our shape space: check the measures")
    if fitted.underbust_error > UNDERBUST_OFF:
        remarks.append(
            f"doubtful: underbust may be up to {fitted.underbust_error:.1f} cm off: it changes much with its level"
        )
    unsure = [f"{name} {sure:.2f}" for name, sure in fitted.marks.confidence.items() if sure < UNSURE]
    if unsure:
        remarks.append(
            f"doubtful: unsure landmarks (1 is sure): {', '.join(unsure)}: check the measures that hang on them"
        )
    return remarks


def _coarse(fitted: FoundBody) -> list[str]:
    """By how much the measures of a coarse mesh may be off: figures that decimated bodies stay within."""
    girth = GIRTH_OFF * fitted.sagitta
    if girth < COARSE * fitted.taken.measurements.height / USUAL_HEIGHT:
        return []
    return [
        f"doubtful: a coarse mesh, its edges {fitted.edge:.1f} cm long on average: height and girths may be up to "
        f"{girth:.1f} cm off, wrist and leg_circ {WRIST_OFF * fitted.sagitta:.1f} cm, what lies between landmarks "
        f"{fitted.edge:.1f} cm and {DEGREES_OFF * fitted.edge:.0f}°: give a finer mesh"
    ]


def _arms(turn: float) -> list[str]:
    return [f"arms held {np.degrees(turn):.0f}° off the A-pose and laid there to be measured"] if turn else []


# ---------------------------------------------------------------------------------------------------------------- mesh


def _read_mesh(path: Path) -> _Mesh:
    vertices, faces = read_mesh(path)
    unit, factor = unit_of(float(np.ptp(vertices, axis=0).max()), str(path))
    log.info("%s: taken to be in %s", path, unit)
    return _Mesh(path, vertices, faces, factor)
