"""Silhouettes: a garment cut out of pictures of known cameras, and drapes as these cameras see them.

A folder shows one garment. ``NAME.png`` is transparent off the garment; ``camera`` in ``NAME.json`` has ``k`` and
``rt``, as in the ``view_0.json`` of data sets. Conventions are those of ``render.pictures``.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image
from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter, minimum_filter
from scipy.spatial import cKDTree

from gcd_dataset.errors import ConfigError, DrapeError
from gcd_dataset.files import make_folder, open_regular, write_whole
from gcd_dataset.generator.drawing import png_bytes
from gcd_dataset.generator.jacobian import Draped, DrapeJacobian
from gcd_dataset.generator.render import Camera, Lights, render, scene_of
from gcd_dataset.generator.render.plain import plain_view
from gcd_dataset.generator.render.scans import RangeImage, Ranger
from gcd_dataset.generator.search import Mapped, Residuals, gauss_newton
from gcd_dataset.jsonfile import JsonPath, read_json
from gcd_dataset.records import Body, BoxMesh

SIZE = 256  # pixels along each side of the pictures that are compared
SOFT = 1.5  # pixels: the normals of an outline are those of the smoothed silhouette
HIDES = 2.0  # cm: an outline beside a nearer surface is where that surface hides the garment
INK = (210, 30, 30)


class Outline(NamedTuple):
    """The border of a silhouette."""

    pixels: Float[np.ndarray, "m 2"]
    """Columns and rows of the pixels inside it."""
    normals: Float[np.ndarray, "m 2"]
    """Outward."""

    @staticmethod
    def of(mask: Bool[np.ndarray, "h w"], shown: Bool[np.ndarray, "h w"]) -> "Outline":
        """Where a mask ends; not where the picture does, which shows the pixels ``shown``."""
        mask = mask | ~shown
        row, column = np.nonzero(mask & shown & ~binary_erosion(mask, border_value=1))
        slope = [gaussian_filter(mask.astype(float), SOFT, order=order)[row, column] for order in ((0, 1), (1, 0))]
        away = -np.stack(slope, axis=1)
        return Outline(
            np.stack([column, row], axis=1).astype(float),
            away / np.maximum(np.linalg.norm(away, axis=1), 1e-9)[:, None],
        )


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """Pictures of one garment, its silhouettes in these, and their cameras; ``device`` sees the drapes."""

    pictures: UInt8[np.ndarray, "n h w 3"]
    masks: Bool[np.ndarray, "n h w"]
    shown: Bool[np.ndarray, "n h w"]
    """False beside a picture that is no square."""
    cameras: tuple[Camera, ...]
    device: str = "auto"

    @staticmethod
    def read(folder: Path, *, device: str = "auto") -> "Silhouettes":
        """The pictures of a folder. Raises ``ConfigError`` and ``SpecError`` with the file."""
        paths = sorted(folder.glob("*.png"))
        if not paths:
            raise ConfigError(f"{folder}: no pictures: give NAME.png, transparent off the garment, and NAME.json")
        pictures, masks, shown, cameras = zip(*map(_read, paths), strict=True)
        return Silhouettes(np.stack(pictures), np.stack(masks), np.stack(shown), cameras, device)

    def overlaps(self, mesh: BoxMesh, vertices: Float[np.ndarray, "v 3"], body: Body) -> Float[np.ndarray, " n"]:
        """IoU of the garment in each picture and its drape, seen by the same camera."""
        seen = np.stack([image.garment for image in self._images(mesh, vertices, body)]) & self.shown
        return (seen & self.masks).sum(axis=(1, 2)) / (seen | self.masks).sum(axis=(1, 2))

    def distances(self, drapes: Sequence[Draped], mapped: Mapped) -> list[float]:
        """1 - mean IoU of each drape. Raises ``DrapeError`` if the cameras see all of them beside the garment."""
        jobs = [(each.worn.job, each.drape.vertices) for each in drapes]  # not in workers, which have no GPU
        apart = [1.0 - float(self.overlaps(job.box_mesh, places, job.body).mean()) for job, places in jobs]
        if min(apart, default=0.0) == 1.0:
            raise DrapeError(
                "the cameras see no drape where the pictures show the garment: give rt in centimetres, y up, the "
                "wearer's soles at y = 0, facing z"
            )
        return apart

    def change(self, jacobian: DrapeJacobian, step: float, offset: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
        """The change of the parameters that brings the outlines of the linear map onto those of the pictures."""
        job, derivatives = jacobian.worn.job, jacobian.derivatives

        def rows(change: Float[np.ndarray, " d"]) -> Iterator[Residuals]:
            place = jacobian.positions + np.tensordot(change, derivatives, 1)
            for row, image in enumerate(self._images(job.box_mesh, place, job.body)):
                yield from _residuals(image, derivatives, self.shown[row], *self._outlines[row])

        return gauss_newton(rows, step, offset)

    def beside(self, mesh: BoxMesh, vertices: Float[np.ndarray, "v 3"], body: Body) -> UInt8[np.ndarray, "h w 3"]:
        """The pictures; below each the drape, seen by its camera, with the outline of the picture's garment."""
        scene = scene_of(mesh, vertices, body)
        views = [replace(plain_view(scene), camera=one, lights=Lights(-one.rotation[2])) for one in self.cameras]
        drawn = np.stack([picture.rgb for picture in render([scene], views, size=SIZE, device=self.device)])
        drawn[[binary_dilation(mask) & ~mask for mask in self.masks]] = INK
        return np.concatenate([np.concatenate(list(row), axis=1) for row in (self.pictures, drawn)])

    @cached_property
    def _outlines(self) -> list[tuple[Outline, cKDTree]]:
        return [(outline, cKDTree(outline.pixels)) for outline in map(Outline.of, self.masks, self.shown)]

    def _images(self, mesh: BoxMesh, vertices: Float[np.ndarray, "v 3"], body: Body) -> list[RangeImage]:
        with Ranger(scene_of(mesh, vertices, body), device=self.device) as ranger:
            return ranger.images(self.cameras, SIZE)


def _residuals(
    image: RangeImage,
    derivatives: Float[np.ndarray, "d v 3"],
    shown: Bool[np.ndarray, "h w"],
    given: Outline,
    tree: cKDTree,
) -> Iterator[Residuals]:
    """From an outline of the drape to the given one, and back: distances along the given normals [cm]."""
    outline, camera = Outline.of(image.garment, shown).pixels, image.camera
    if not len(outline):
        return
    K, (column, row) = camera.intrinsics(image.size), outline.astype(int).T
    depth, shares = image.depth[row, column], image.weights[row, column]
    corners = image.scene.faces[image.face[row, column]]
    shares = np.column_stack([shares, 1.0 - shares.sum(axis=1)])
    moves = np.einsum("dnci,nc->dni", derivatives[:, corners], shares) @ camera.rotation.T
    across = moves[..., :2] - (outline - K[:2, 2]) / K[0, 0] * moves[..., 2:]  # of the projection, at its depth
    other = minimum_filter(np.where(image.covered & ~image.garment, image.depth, np.inf), 3)
    across[:, other[row, column] < depth - HIDES] = 0.0
    there, back = np.arange(len(outline)), np.arange(len(given.pixels))
    for own, near in ((there, tree.query(outline)[1]), (cKDTree(outline).query(given.pixels)[1], back)):
        apart = (outline[own] - given.pixels[near]) * (depth / K[0, 0])[own, None]
        normals = given.normals[near]
        yield np.einsum("ni,ni->n", apart, normals), np.einsum("dni,ni->dn", across[:, own], normals), 1.0


def write_cut_outs(
    folder: Path,
    pictures: UInt8[np.ndarray, "n h w 3"],
    masks: Bool[np.ndarray, "n h w"],
    intrinsics: Float[np.ndarray, "n 3 3"],
    extrinsics: Float[np.ndarray, "n 3 4"],
) -> None:
    """Write pictures as ``Silhouettes.read`` takes them; their colours stay off the garment, too."""
    make_folder(folder)
    for number, (rgb, mask, k, rt) in enumerate(zip(pictures, masks, intrinsics, extrinsics, strict=True)):
        write_whole(folder / f"{number}.png", png_bytes(np.dstack([rgb, np.where(mask, 255, 0).astype(np.uint8)])))
        camera = {"camera": {"k": k.tolist(), "rt": rt.tolist()}}
        write_whole(folder / f"{number}.json", json.dumps(camera).encode())


def _read(path: Path) -> tuple[UInt8[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"], Camera]:
    try:
        with open_regular(path) as file, Image.open(file) as image:
            whole = image.convert("RGBA")
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise ConfigError(f"{path}: cannot be read ({error}): give another picture") from error
    side = max(whole.size)
    parts = whole.convert("RGB"), whole.getchannel("A"), Image.new("L", whole.size, 255)
    # Filled up at the right or below to a square, which leaves the camera as it is.
    rgb, alpha, shown = (np.asarray(part.crop((0, 0, side, side)).resize((SIZE, SIZE))) for part in parts)
    mask, within = alpha >= 128, shown >= 128
    if not mask.any() or mask[within].all():
        raise ConfigError(f"{path}: no garment cut out: make the picture transparent off the garment, and only there")
    return rgb, mask & within, within, _camera(path.with_suffix(".json"), side)


def _camera(path: Path, size: int) -> Camera:
    if not path.is_file():
        raise ConfigError(
            f"{path}: missing: drapes are compared as the camera of a picture sees them: give its k and rt, in "
            "centimetres, the wearer's soles at y = 0, facing z"
        )
    at = JsonPath(str(path))
    camera = at.mapping(at.mapping(read_json(path, "description of a camera"), "").get("camera"), "camera")
    rows = [at.list_of(camera, name) for name in ("k", "rt")]
    if [len(part) for part in rows] != [3, 3]:
        raise at.error("k and rt must have 3 rows each")
    k, rt = (
        np.array([at.numbers(row, count, "a row") for row in part]) for part, count in zip(rows, (3, 4), strict=True)
    )
    try:
        return Camera.of(k, rt, size)
    except ConfigError as error:
        raise at.error(str(error)) from error
