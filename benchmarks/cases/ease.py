"""Accuracy of ease as worn: girths of ``ease_of`` against a ruler on the flat pattern, and against the drape's stretch.

    python -m benchmarks.run ease --device cpu --resolution 2 --keep

One garment of each design of the recipe ``fits``, cut up to three sizes too small or too large; those that
settle count. In the plane of each landmark the case looks for the shortest ring of the drape round the body, apart from
``ease_of``, and uses nothing of cloth as cut.

``loose``: rings with 2 cm more cloth than body or more, of which the girth as worn is compared with that of the pattern
at this level. A ruler lies on the flat panel from the point where the ring enters it, or leaves a dart, to the point
where it meets a dart or leaves the panel; in skirts and bands it is bent along the upper edge. Within 2 cm of a seam
between parts the ring with less cloth counts.
``tight``: rings with less cloth than body, of which the girth as worn, times the mean stretch of the triangles along
the ring, is compared with the length of the ring in space.
"""

import argparse
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Float

from benchmarks.cases import CaseResult, Figure
from gcd_dataset.curves import sample_curve
from gcd_dataset.generator.body.section import Plane, loops, section
from gcd_dataset.generator.drape import drape_batch
from gcd_dataset.generator.ease import NEAR, ease_of, planes_of
from gcd_dataset.generator.pipeline import DressedWearer, drape_jobs, prepare
from gcd_dataset.generator.recipes import find_recipe
from gcd_dataset.records import GIRTHS, BoxMesh, Drape, Outcome, Panel, PanelRole, Pattern
from gcd_dataset.spec import is_bodice, is_trouser_leg

LOOSE = 2.0  # cm of ease
CLOSE, SHARE = 0.5, 0.01  # targets: cm of a loose girth, share of a tight one


class Ring(NamedTuple):
    """A girth as worn [cm], and its error: in cm if the cloth is loose, as a share if it is tight."""

    garment: int
    name: str
    worn: float
    body: float
    error: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=64, help="designs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="auto", help="where cloth is draped")
    parser.add_argument("--resolution", type=float, default=1.0, help="[cm]")


def run(options: argparse.Namespace) -> CaseResult:
    """Drape the garments, and measure their rings."""
    recipe = find_recipe("fits").config
    config = replace(recipe, bodies_each=1, device=options.device, resolution=options.resolution)
    made = [prepare(options.seed, number, config) for number in range(options.count)]
    worn = [(design, job) for design in made for job in drape_jobs(design, config)]
    drapes = drape_batch([job for _, job in worn], device=options.device)
    settled = [
        (design.number, design.dressed[0], drape)
        for (design, _), drape in zip(worn, drapes, strict=True)
        if drape.outcome is Outcome.SETTLED
    ]
    rings = [ring for number, wearer, drape in settled for ring in measured(number, wearer, drape)]
    loose, tight = defaultdict[str, list[float]](list), defaultdict[str, list[float]](list)
    for ring in rings:
        (loose if ring.worn > ring.body else tight)[ring.name].append(ring.error)
    all_loose, all_tight = (sum(found.values(), list[float]()) for found in (loose, tight))
    figures = [
        Figure("garments", len(settled), "that settled"),
        Figure("loose_median", float(np.median(all_loose)), f"cm, of {len(all_loose)} rings"),
        Figure("loose_p90", float(np.percentile(all_loose, 90)), "cm"),
        Figure("loose_close", _within(all_loose, CLOSE), "share within 0.5 cm"),
        Figure("tight_close", _within(all_tight, SHARE), f"share within 1 %, of {len(all_tight)} rings"),
    ]
    rows = [
        {
            "ring": name,
            "loose": len(loose[name]),
            "median [cm]": float(np.median(loose[name] or np.nan)),
            "p90 [cm]": float(np.percentile(loose[name] or np.nan, 90)),
            "within 0.5 cm": _within(loose[name], CLOSE),
            "tight": len(tight[name]),
            "within 1 %": _within(tight[name], SHARE),
        }
        for name in GIRTHS
        if loose[name] or tight[name]
    ]
    return CaseResult(figures, rows)


def _within(errors: list[float], limit: float) -> float:
    return float(np.mean(np.less_equal(errors, limit))) if errors else np.nan


def measured(number: int, wearer: DressedWearer, drape: Drape) -> Iterator[Ring]:
    """The loose and the tight rings of a drape, but for the neck: the neckline is not measured on the drape."""
    mesh, pattern = wearer.box_mesh, wearer.pattern
    assert mesh is not None
    found = ease_of(pattern, mesh, wearer.body, wearer.size, drape.vertices)
    for name, planes in planes_of(wearer.body, wearer.size).items():
        worn, body = found[name].worn, found[name].body
        near = next((near for plane in planes if (near := rings_near(mesh, drape.vertices, plane))), None)
        if name == "neck" or near is None or not np.isfinite(worn):
            continue
        ring = min(near, key=lambda ring: on_paper(ring, pattern))
        if worn >= body + LOOSE:
            yield Ring(number, name, worn, body, abs(worn - on_paper(ring, pattern)))
        elif worn < body:
            flat, spatial = (np.linalg.norm(np.diff(ring[:, :, at], axis=1), axis=2) for at in (FLAT, SPACE))
            stretch = np.average(spatial / np.maximum(flat, 1e-9), weights=flat)
            yield Ring(number, name, worn, body, abs(worn * stretch / spatial.sum() - 1.0))


SPACE, FLAT, PANEL = slice(0, 3), slice(3, 5), 5  # columns of a ring's points: in the plane's frame, and in the panel


def rings_near(mesh: BoxMesh, vertices: Float[np.ndarray, "v 3"], plane: Plane) -> list[Float[np.ndarray, "s 2 6"]]:
    """The rings in a plane and ``NEAR`` from it, one for each set of panels; without any, those within its reach."""
    for away in (0.0, *plane.reach):
        rings = [_ring(mesh, vertices, plane.moved(away + by)) for by in (0.0, NEAR, -NEAR)]
        if near := {frozenset(ring[:, 0, PANEL]): ring for ring in rings[::-1] if ring is not None}:
            return list(near.values())[::-1]
    return []


def _ring(mesh: BoxMesh, vertices: Float[np.ndarray, "v 3"], plane: Plane) -> Float[np.ndarray, "s 2 6"] | None:
    """The shortest closed section of the drape round a plane's centre, along the panels; ``None`` without one."""
    on_arms = np.isin(mesh.panel_id, [row for row, role in enumerate(mesh.panel_labels) if role == PanelRole.ARM])
    places = (np.asarray(vertices, float)[mesh.uv_vertex] - plane.centre) @ plane.frame
    cut = section(np.column_stack([places, mesh.uv, mesh.panel_of_row]), mesh.corners[on_arms == plane.on_arm], 0, 0.0)
    number = loops(cut[:, :, SPACE])
    centres = [np.zeros(3)] + ([] if plane.beside is None else [(plane.beside - plane.centre) @ plane.frame])
    found = []
    for ring in (cut[number == row] for row in range(number.max(initial=-1) + 1)):
        turns = [_turns(ring[:, :, 1:3] - centre[1:]) for centre in centres]
        if turns[0] > 0.995 and not any(turn > 0.5 for turn in turns[1:]):
            found.append(ring)
    return min(found, key=lambda ring: np.linalg.norm(np.diff(ring[:, :, FLAT], axis=1), axis=2).sum(), default=None)


def _turns(ring: Float[np.ndarray, "s 2 2"]) -> float:
    """How often a ring goes round the origin."""
    at = ring[:, :, 0] + 1j * ring[:, :, 1]
    return abs(np.angle(at[:, 1] / at[:, 0]).sum()) / (2 * np.pi)


def on_paper(ring: Float[np.ndarray, "s 2 6"], pattern: Pattern) -> float:
    """Length of a ring on the flat pattern [cm], with a ruler between the seams and darts that it crosses."""
    step, away = np.diff(ring[:, :, FLAT], axis=1)[:, 0], np.tile([0.0, -1.0], (len(ring), 1))
    for number in np.unique(ring[:, 0, PANEL]):
        own = ring[:, 0, PANEL] == number
        if edge := _upper_edge(pattern.panels[int(number)]):
            middle = shapely.points(ring[own].mean(axis=1)[:, FLAT])
            ways = np.diff(shapely.get_coordinates(shapely.shortest_line(edge, middle)).reshape(-1, 2, 2), axis=1)[:, 0]
            away[own] = ways / np.maximum(np.linalg.norm(ways, axis=1), 1e-9)[:, None]
    stretch = loops(ring[:, :, 3:])
    across = np.bincount(stretch, step[:, 0] * away[:, 1] - step[:, 1] * away[:, 0])
    return float(np.hypot(across, np.bincount(stretch, (step * away).sum(axis=1))).sum())


def _upper_edge(panel: Panel) -> shapely.Geometry | None:
    """The upper edge of a skirt, waistband or cuff, or the tip of an insert; ``None`` for other panels."""
    if is_bodice(panel.name) or is_trouser_leg(panel.name):
        return None
    lines = [
        sample_curve(*panel.edge_ends(row), edge.curve, 33)
        for row, edge in enumerate(panel.edges)
        if edge.name == "top"
    ]
    if not lines and panel.label == PanelRole.LEG:
        return shapely.Point(max(panel.vertices, key=lambda corner: corner[1]))
    return shapely.MultiLineString(lines) if lines else None
