"""Maps of a drape: a stretched tube presses as Laplace says, cloth off the skin not at all, and gaps are distances."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from gcd_dataset.generator import make
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.drape import FABRICS, DrapeJob, Fabric, maps_of
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Body, BodyPart, BoxMesh, Drape, Maps, Measurements, Outcome
from gcd_dataset.shards.codec import decode_fields, decode_sample, encode_sample
from tests.generator.drape.test_drape import LYING
from tests.helpers import body_from, patch, tube

AROUND, ALONG = 120, 24
RADIUS = 12.0  # cm
SETTLED = (Outcome.SETTLED, 0, 0, 0, 1.0, 1.0)


def sewn_tube(hoop: float) -> BoxMesh:
    """A tube of one panel, sewn to itself and stretched round by ``hoop`` to ``RADIUS``."""
    return tube(AROUND, ALONG, radius=RADIUS, spacing=2 * np.pi * RADIUS / hoop / AROUND)


def cylinder(radius: float, height: float) -> Body:
    """A closed cylinder of many sides, from 20 cm below the floor to ``height``."""
    ends = [[0.0, -20.0, 0.0], [0.0, height, 0.0]]
    return body_from(trimesh.creation.cylinder(radius=radius, segment=ends, sections=360))


def worn_tube(fabric: Fabric, hoop: float, *, along: float, gap: float) -> Maps:
    mesh = sewn_tube(hoop)
    job = DrapeJob(mesh, cylinder(RADIUS - gap, 60.0), Measurements(), fabric)
    return maps_of(job, Drape(mesh.vertices * [1.0, along, 1.0], *SETTLED))


@pytest.mark.parametrize("along", [1.0, 0.9])
@pytest.mark.parametrize("name", FABRICS)
def test_a_stretched_tube_presses_with_its_tension_over_its_radius(name: str, along: float) -> None:
    """Kept as long as it is, or let narrow: then its tension is the tensile stiffness times its strain."""
    fabric, hoop = FABRICS[name], 1.1
    found = worn_tube(fabric, hoop, along=along, gap=0.35).pressure.reshape(ALONG + 1, AROUND)[2:-2]
    tension = fabric.pull.weft * (hoop - 1.0) / (1 - 1 / 9 if along == 1.0 else 1.0)  # N/m; Poisson's ratio is 1/3
    assert found == pytest.approx(tension / along / (0.01 * RADIUS) / 1000, rel=0.05)


def test_cloth_off_the_skin_and_slack_cloth_press_nothing() -> None:
    hanging = worn_tube(FABRICS["drill"], 1.1, along=1.0, gap=2.0)
    assert not hanging.pressure.any()
    assert worn_tube(FABRICS["drill"], 0.95, along=1.0, gap=0.35).pressure.max() < 0.01
    assert hanging.gap == pytest.approx(2.0, abs=0.01)


def test_cloth_lying_on_top_presses_with_its_weight() -> None:
    """A level sheet of 0.2 kg/m²: 1.96 Pa."""
    sheet = patch(60, 20, place=LYING, origin=(-30.0, 60.35, 10.0))
    found = maps_of(DrapeJob(sheet, cylinder(100.0, 60.0), Measurements()), Drape(sheet.vertices, *SETTLED))
    assert found.gap == pytest.approx(0.35, abs=0.01)
    assert found.pressure == pytest.approx(0.2 * 9.81 / 1000, rel=0.01)


def test_stretches_are_those_of_the_tube() -> None:
    found = worn_tube(FABRICS["default"], 1.2, along=0.9, gap=0.35)
    assert found.stretch == pytest.approx(np.tile([1.2, 0.9], (len(found.stretch), 1)), rel=1e-3)
    assert found.softened == 1.0
    assert worn_tube(FABRICS["drill"], 1.2, along=0.9, gap=0.35).softened == pytest.approx(2030 / 110)


def test_gaps_are_distances_from_the_skin() -> None:
    body = build_body(neutral_shape())
    trunk = np.flatnonzero(body.parts == BodyPart.TRUNK.value)[::50]
    inside = body.vertices[trunk].mean(axis=0)
    points = np.array([[0.0, 300.0, 0.0], inside, [50.0, 3000.0, 0.0]])
    mesh = replace(sewn_tube(1.0), vertices=points, faces=np.array([[0, 1, 2]]), corners=np.array([[0, 1, 2]]))
    out, within, far = maps_of(DrapeJob(mesh, body, measure(body)), Drape(points, *SETTLED)).gap
    assert far == pytest.approx(3000.0 - body.vertices[:, 1].max(), abs=1.0)
    assert out == pytest.approx(300.0 - body.vertices[:, 1].max(), abs=0.2)
    assert within < -3.0


def test_maps_are_stored_as_a_member_and_read_as_fields() -> None:
    config = MakeConfig(bodies="neutral", resolution=6.0, points=64, picture=0, device="cpu", on_fail="keep")
    plain, made = make(7, 10, config), make(7, 10, replace(config, maps=True))
    assert made.maps is not None
    before, members = encode_sample(plain), encode_sample(made)
    assert members.keys() - before.keys() == {"maps.z"}
    assert all(members[name] == data for name, data in before.items() if name != "meta.json")
    assert b"softened" not in before["meta.json"]
    read = decode_sample(members).maps
    assert read is not None
    assert read.gap == pytest.approx(made.maps.gap, rel=1e-3)
    fields = decode_fields(members, ["stretch", "gap", "pressure", "verts"])
    count = len(fields["verts"])
    assert [fields[name].shape for name in ("stretch", "gap", "pressure")] == [(count, 2), (count,), (count,)]
    assert {fields[name].dtype for name in ("stretch", "gap", "pressure")} == {np.dtype(np.float32)}
