"""Draws the pictures of the documentation: of the concept pages, from one sample, and of the design parameters.

python -m docs.tools.pictures            # all, on the CPU in about four minutes
python -m docs.tools.pictures drape      # one of them
"""

import argparse
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from PIL import Image

from docs.tools import parameters as ends
from gcd_dataset.files import write_whole
from gcd_dataset.generator import (
    DrapeConfig,
    DrapeJob,
    MakeConfig,
    build_body,
    build_box_mesh,
    build_pattern,
    drape_batch,
    draw_shape,
    make,
    measure,
)
from gcd_dataset.generator.body import neutral_shape
from gcd_dataset.generator.body.landmarks import model_landmarks
from gcd_dataset.generator.body.measuring import measure_closely
from gcd_dataset.generator.body.section import section
from gcd_dataset.generator.drawing import contact_sheet, draw_pattern, picture_of
from gcd_dataset.generator.garments import design_from_dict
from gcd_dataset.generator.lay_plan import PALETTE
from gcd_dataset.generator.render import (
    CameraRanges,
    Ranges,
    draw_hair,
    draw_views,
    garment_scene,
    render,
    render_garment,
    render_view,
    scene_of_sample,
)
from gcd_dataset.generator.render.scene import figure_scene
from gcd_dataset.measurements import MEASURE
from gcd_dataset.records import Body, BodyPart, BodyShape, BoxMesh, Sample
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards import encode_sample

FOLDER = Path(__file__).resolve().parents[1] / "images"
SEED, SHOWN = 3, 0
"""Seed and index of the garment on all concept pages."""
PEOPLE_SEED, PEOPLE = 7, (4, 5, 2, 19)
"""Seed and indices of the garments on the first page."""
SPACING = 1.5  # cm
QUALITY, SMALL = 86, 75  # of the JPEG files; of the many of the parameters
TILE = 400  # pixels
NARROW = 0.8  # width of a figure in the A-pose over its height, with room at both sides
INK, TAPE = "#282828", "#c0392b"

Picture = UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True)
class Garment:
    """The sample of the pages, with body and box mesh."""

    sample: Sample
    body: Body
    mesh: BoxMesh
    vertices: Float[np.ndarray, "v 3"]
    """At rest [cm]."""


@cache
def garment() -> Garment:
    sample = make(SEED, SHOWN, MakeConfig(resolution=SPACING, device="cpu", picture=768))
    assert sample.shape is not None and sample.box_mesh is not None and sample.drape is not None
    return Garment(sample, build_body(sample.shape), sample.box_mesh, np.asarray(sample.drape.vertices))


# ------------------------------------------------------------------------------------------------------------ pictures


def people() -> Picture:
    """Four dressed persons, each beside the pattern of the garment."""
    parts = []
    for index in PEOPLE:
        worn = make(PEOPLE_SEED, index, MakeConfig(resolution=SPACING, device="cpu", picture=0))
        assert worn.shape is not None
        person = _photographs(worn, build_body(worn.shape), 1, TILE)[0]
        parts += [_narrow(person), draw_pattern(worn.pattern, size=TILE)]
    return np.concatenate([_row(parts[:4]), _row(parts[4:])])


def steps() -> Picture:
    """Body, tapes, pattern, box mesh, drape and picture of one sample, side by side."""
    shown = garment()
    bare = _body_picture(shown.body)
    tape = _plotted(lambda axes: _draw_tapes(axes, shown.body, named=False), TILE, TILE)
    flat = draw_pattern(shown.sample.pattern, size=TILE)
    box = _plotted(lambda axes: _draw_box(axes, shown.mesh, shown.body), TILE, TILE)
    draped, _ = render_garment(shown.vertices, shown.mesh, shown.body, size=TILE, device="cpu")
    return _row([_narrow(bare), _narrow(tape), flat, _narrow(box), _narrow(draped), _narrow(_photograph(TILE)[0])])


def body() -> Picture:
    """The neutral body, two women and two men of the population, and the neutral body with its legs apart."""
    shapes = [
        neutral_shape(),
        draw_shape(rng(7, 0, Stage.BODY), group="female"),
        draw_shape(rng(7, 3, Stage.BODY), group="female"),
        draw_shape(rng(7, 1, Stage.BODY), group="male"),
        draw_shape(rng(7, 5, Stage.BODY), group="male"),
        BodyShape(neutral_shape().weights, legs_apart=True),
    ]
    return contact_sheet([_narrow(_body_picture(build_body(shape)), 0.9) for shape in shapes], columns=6)


def measures() -> Picture:
    """The level girths and some lengths on the body, with their values."""
    return _plotted(lambda axes: _draw_tapes(axes, garment().body, named=True), 1000, 700)


def design() -> Picture:
    """One design with another number of suns in its circle skirt: pattern above, drape below."""
    body = build_body(neutral_shape())
    size = measure(body)
    patterns = [
        build_pattern(size, design_from_dict({**DRESS, "flare-skirt": {"suns": suns, "length": 0.35}}))
        for suns in (0.4, 0.7, 1.0, 1.4)
    ]
    meshes = [build_box_mesh(pattern, spacing=SPACING) for pattern in patterns]
    drapes = drape_batch([DrapeJob(mesh, body, size) for mesh in meshes], device="cpu")
    flat = [draw_pattern(pattern, size=TILE) for pattern in patterns]
    worn = [
        render_garment(np.asarray(drape.vertices), mesh, body, size=TILE, device="cpu")[0]
        for mesh, drape in zip(meshes, drapes, strict=True)
    ]
    return contact_sheet([*flat, *worn], columns=len(flat))


DRESS: Mapping[str, Any] = {
    "meta": {"upper": "FittedShirt", "bottom": "SkirtCircle"},
    "sleeve": {"sleeveless": True},
}


def pattern() -> Picture:
    """The flat pattern: edges sewn together share a colour."""
    return draw_pattern(garment().sample.pattern, size=900)


def box_mesh() -> Picture:
    """The panels as triangles: flat, and placed round the body."""
    shown = garment()
    flat = _plotted(lambda axes: _draw_panel(axes, shown.mesh), 700, 700)
    placed = _plotted(lambda axes: _draw_box(axes, shown.mesh, shown.body), 700, 700)
    return contact_sheet([flat, placed], columns=2)


def drape() -> Picture:
    """The garment after some frames of the drape; the seams close during the first."""
    shown = garment()
    job = DrapeJob(shown.mesh, shown.body, shown.sample.measurements)
    frames = (1, 4, 10, 20, 40, 300)
    pictures = []
    for limit in frames:
        config = DrapeConfig(max_frames=limit, coarse_start=False, most_drapes=1)
        (result,) = drape_batch([job], config, device="cpu")
        scene = garment_scene(np.asarray(result.vertices), shown.mesh, shown.body)
        pictures.append(_narrow(render_view(scene, size=TILE, device="cpu")))
        print(f"{result.frames} frames: {result.outcome.name}")
    return contact_sheet(pictures, columns=6)


def sample() -> Picture:
    """Front, back and two drawn views; then the size of each member."""
    shown = garment()
    stored = [shown.sample.front, shown.sample.back]
    sides = [picture_of(jpeg, TILE) for jpeg in stored if jpeg]
    sheet = contact_sheet([*sides, *_photograph(TILE)[:2]], columns=4)
    sizes = {name: len(content) for name, content in encode_sample(shown.sample).items()}
    bars = _plotted(lambda axes: _draw_sizes(axes, sizes), sheet.shape[1], 460)
    return np.concatenate([sheet, bars])


def parameters(section: str) -> Picture:
    """The parameters of a section of the design: patterns at both ends, or with each option."""
    width, height = ends.TILE
    picture = _plotted(lambda axes: ends.draw_parameters(axes, section), width * ends.COLUMNS, height * ends.ROWS)
    return picture[: np.flatnonzero((picture < 255).any(axis=(1, 2)))[-1] + 6]


PICTURES: Mapping[str, Callable[[], Picture]] = {
    "people": people,
    "steps": steps,
    "body": body,
    "measures": measures,
    "design": design,
    "pattern": pattern,
    "box_mesh": box_mesh,
    "drape": drape,
    "sample": sample,
    **{f"parameters/{entry.key}": partial(parameters, entry.key) for entry in ends.SPACE.entries},
}


# ------------------------------------------------------------------------------------------------------------- drawing


def _body_picture(body: Body, size: int = TILE) -> Picture:
    return render_view(figure_scene(body), size=size, device="cpu")


def _row(pictures: Sequence[Picture], gap: int = 6) -> Picture:
    """Pictures of one height side by side."""
    space = np.full((pictures[0].shape[0], gap, 3), 255, np.uint8)
    return np.concatenate([part for picture in pictures for part in (picture, space)][:-1], axis=1)


def _narrow(picture: Picture, share: float = NARROW) -> Picture:
    """The middle of a square picture."""
    width = picture.shape[1]
    margin = round(0.5 * (1.0 - share) * width)
    return picture[:, margin : width - margin]


@cache
def _photograph(size: int) -> tuple[Picture, ...]:
    """Drawn views of the sample: cloth, person, light and place."""
    return _photographs(garment().sample, garment().body, 4, size)


def _photographs(sample: Sample, body: Body, count: int, size: int) -> tuple[Picture, ...]:
    """The first drawn views of any sample."""
    seed, index = sample.provenance.seed, sample.provenance.index
    scene = scene_of_sample(sample, body, hair=draw_hair(seed, index))
    ranges = Ranges(camera=CameraRanges(yaw=(-40.0, 40.0), crop=0.0))
    views = draw_views(seed, index, scene, count, ranges=ranges)
    return tuple(np.asarray(picture.rgb) for picture in render([scene], views, size=size, device="cpu"))


def _plotted(draw: Callable[[Axes], None], width: int, height: int) -> Picture:
    """What ``draw`` draws, without axes, ``width`` x ``height`` pixels."""
    figure = Figure(figsize=(width / 100, height / 100), dpi=200)
    axes = figure.add_axes((0.02, 0.02, 0.96, 0.96))
    axes.set_axis_off()
    draw(axes)
    file = io.BytesIO()
    figure.savefig(file, format="png", facecolor="white")
    image = Image.open(file).convert("RGB").resize((width, height), Image.Resampling.LANCZOS)
    return np.asarray(image)


def _draw_body(axes: Axes, body: Body, *, across: int = 0, shift: float = 0.0) -> None:
    """The body's silhouette with shading, projected on the axes ``across`` and y."""
    towards = 2 - across
    corners = body.vertices[body.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    facing = normal[:, towards] > 0
    order = np.flatnonzero(facing)[np.argsort(corners[facing][:, :, towards].mean(axis=1))]
    shade = 0.70 + 0.22 * normal[order, towards]
    flat = corners[order][:, :, [across, 1]] + np.array([shift, 0.0])
    colours = shade[:, None] * np.array([[1.0, 0.97, 0.94]])
    axes.add_collection(PolyCollection(list(flat), facecolors=colours, edgecolors=colours, linewidths=0.3))


def _draw_tapes(axes: Axes, body: Body, *, named: bool) -> None:
    """The body from the front with its girths, and their values if ``named``."""
    found = measure_closely(body)
    size = found.measurements
    _draw_body(axes, body)
    trunk = np.isin(body.parts[body.faces], [BodyPart.TRUNK.value]).all(axis=1)
    girths = {"bust": "bust", "underbust": "underbust", "waist": "waist", "hips": "hips", "leg_circ": "leg_circ"}
    height = float(body.vertices[:, 1].max())
    for number, (name, level) in enumerate((name, found.levels[name]) for name in girths):
        faces = body.faces if name == "leg_circ" else body.faces[trunk]
        cut = section(body.vertices, faces, 1, level)
        if name == "leg_circ":
            cut = cut[(cut[:, :, 0] < 0).all(axis=1) & (np.abs(cut[:, :, 0]) < 30).all(axis=1)]
        axes.add_collection(LineCollection(list(cut[:, :, :2]), colors=TAPE, linewidths=2.0))
        if named:
            _note(axes, f"{name}  {getattr(size, name):.1f} cm", (float(cut[:, :, 0].max()), level), 1, number, height)
    if named:
        _draw_lengths(axes, body, height)
    _frame(axes, body, wide=named)


def _draw_lengths(axes: Axes, body: Body, height: float) -> None:
    """Lengths between landmarks, on the wearer's right."""
    size, at = measure(body), model_landmarks(body.vertices).points
    lines = {
        "shoulder_w": ("shoulder_right", "shoulder_left"),
        "armscye_depth": ("shoulder_right", "underarm_right"),
        "bust_points": ("bust_right", "bust_left"),
        "hips_line": ("waist_side_right", "hips_side_right"),
        "crotch_hip_diff": ("hips_side_right", "crotch_point"),
    }
    for number, (name, (start, end)) in enumerate(lines.items()):
        ends = np.stack([at[start], at[end]])[:, :2]
        axes.plot(*ends.T, color="#2c5f9e", linewidth=1.8, marker="o", markersize=3)
        _note(axes, f"{name}  {getattr(size, name):.1f} {MEASURE[name].unit}", ends[0], -1, number, height)


def _note(axes: Axes, text: str, at: Sequence[float] | np.ndarray, side: int, number: int, height: float) -> None:
    """A text beside the body with a thin line to a point."""
    axes.annotate(
        text,
        (float(at[0]), float(at[1])),
        (side * 78.0, height * (0.86 - 0.1 * number)),
        fontsize=9,
        color=INK,
        va="center",
        ha="left" if side > 0 else "right",
        arrowprops={"arrowstyle": "-", "color": "#909090", "linewidth": 0.8},
    )


def _frame(axes: Axes, body: Body, *, wide: bool = False) -> None:
    height = float(body.vertices[:, 1].max())
    axes.set_aspect("equal")
    axes.set_ylim(-3, height + 3)
    reach = 0.62 * height * (1.22 if wide else 0.82)
    axes.set_xlim(-reach, reach)


def _draw_triangles(axes: Axes, corners: Float[np.ndarray, "f 3 2"], panels: Int[np.ndarray, " f"]) -> None:
    colours = np.array(PALETTE)[panels % len(PALETTE)]
    axes.add_collection(
        PolyCollection(list(corners), facecolors=0.55 + 0.45 * colours, edgecolors="k", linewidths=0.25)
    )


def _draw_panel(axes: Axes, mesh: BoxMesh) -> None:
    """A panel with darts in its plane; vertices on seams in red."""
    number = mesh.panel_names.index("left_ftorso")
    chosen = mesh.panel_id == number
    corners = mesh.uv[mesh.corners[chosen]]
    _draw_triangles(axes, corners, mesh.panel_id[chosen])
    rows = np.unique(mesh.corners[chosen])
    sewn = rows[mesh.uv_vertex[rows] < mesh.n_seam_vertices]
    axes.plot(*mesh.uv[sewn].T, ".", color=TAPE, markersize=3.5)
    axes.set_aspect("equal")
    axes.autoscale_view()


def _draw_box(axes: Axes, mesh: BoxMesh, body: Body) -> None:
    """The placed panels in front of the body, and the body."""
    _draw_body(axes, body)
    corners = mesh.vertices[mesh.faces]
    front = corners[:, :, 2].mean(axis=1) > 0
    order = np.flatnonzero(front)[np.argsort(corners[front][:, :, 2].mean(axis=1))]
    _draw_triangles(axes, corners[order][:, :, :2], mesh.panel_id[order])
    _frame(axes, body)


def _draw_sizes(axes: Axes, sizes: Mapping[str, int]) -> None:
    """A bar for the bytes of each member."""
    axes.set_axis_on()
    names = list(sizes)
    axes.barh(range(len(names)), [sizes[name] / 1024 for name in names], color="#5478a8")
    for row, name in enumerate(names):
        axes.text(sizes[name] / 1024 + 1.0, row, f"{sizes[name] / 1024:,.1f} KiB", va="center", fontsize=7, color=INK)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    axes.invert_yaxis()
    axes.set_xlim(0, 1.1 * max(sizes.values()) / 1024)
    axes.set_position((0.12, 0.1, 0.86, 0.86))
    axes.set_xlabel("KiB in the shard", fontsize=7)
    axes.tick_params(axis="x", labelsize=7)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[*PICTURES, []], help="pictures to draw (default: all)")
    (FOLDER / "parameters").mkdir(parents=True, exist_ok=True)
    for name in parser.parse_args().names or PICTURES:
        file = io.BytesIO()
        quality = SMALL if "/" in name else QUALITY
        Image.fromarray(PICTURES[name]()).save(file, format="JPEG", quality=quality, optimize=True)
        write_whole(FOLDER / f"{name}.jpg", file.getvalue())
        print(f"{name}.jpg: {len(file.getvalue()) / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
