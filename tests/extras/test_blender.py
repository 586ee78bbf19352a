"""The import script in Blender's Python module, ``bpy``, of ``.venv-blender``, which ``make test-extras`` makes."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from gcd_dataset import exports
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Sample
from tests.exports.test_meshes import areas

SCRIPT = Path(__file__).resolve().parents[2] / "tools" / "blender_import.py"
OWN = Path(__file__).resolve().parents[2] / ".venv-blender/bin/python"  # bpy wants a NumPy of its own
PYTHON = OWN if OWN.exists() else Path(sys.executable)
HAS_BLENDER = not subprocess.run([PYTHON, "-c", "import bpy"], capture_output=True, check=False).returncode
pytestmark = pytest.mark.skipif(not HAS_BLENDER, reason="bpy is not installed: make test-extras")


@pytest.fixture(scope="module")
def worn() -> Sample:
    return make(3, 0, MakeConfig(bodies="neutral", resolution=7.0, points=16, on_fail="keep"))


def in_blender(program: str, *arguments: object) -> str:
    """Output of a program in a process of its own: Blender's module ends with its process."""
    command = [str(PYTHON), "-c", program, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


CHECK = """
import sys, numpy
sys.path.insert(0, sys.argv[1])
import blender_import, bpy
garment, body = blender_import.import_garment(sys.argv[2], texture=sys.argv[3], cloth=True)
mesh = garment.data
points = numpy.empty(3 * len(mesh.vertices)); mesh.vertices.foreach_get("co", points)
uv = numpy.empty(2 * len(mesh.loops)); mesh.uv_layers[0].uv.foreach_get("vector", uv)
panel = numpy.empty(len(mesh.polygons), int); mesh.polygons.foreach_get("material_index", panel)
loops = numpy.empty(len(mesh.loops), int); mesh.loops.foreach_get("vertex_index", loops)
numpy.savez(sys.argv[4], points=points.reshape(-1, 3), uv=uv.reshape(-1, 3, 2), panel=panel, faces=loops.reshape(-1, 3),
            materials=[m.name for m in mesh.materials], body=len(body.data.vertices), tile=garment["tile_cm"],
            modifiers=[m.type for m in garment.modifiers] + [m.type for m in body.modifiers])
"""


def test_the_garment_is_sewn_with_a_material_for_each_panel(worn: Sample, tmp_path: Path) -> None:
    exports.glb(worn, tmp_path / "a.glb", tile=5.0)
    Image.new("RGB", (8, 8), (200, 80, 60)).save(tmp_path / "check.png")
    in_blender(CHECK, SCRIPT.parent, tmp_path / "a.glb", tmp_path / "check.png", tmp_path / "found.npz")
    found, mesh, drape = np.load(tmp_path / "found.npz"), worn.box_mesh, worn.drape
    assert mesh is not None
    assert drape is not None
    assert len(found["points"]) == len(drape.vertices)  # welded
    apart, partner = cKDTree(upright(drape.vertices)).query(found["points"])
    assert apart.max() < 1e-4
    assert len(np.unique(partner)) == len(partner)
    assert list(found["materials"]) == list(mesh.panel_names)
    assert np.bincount(found["panel"]).tolist() == np.bincount(mesh.panel_id).tolist()
    cloth = sum(abs(areas(mesh.uv[corners[None]])) for corners in mesh.corners)
    assert areas(found["uv"]) == pytest.approx(cloth / 25.0, rel=1e-3)
    assert found["body"] > 1000
    assert float(found["tile"]) == 5.0
    assert list(found["modifiers"]) == ["CLOTH", "COLLISION"]


def upright(points: np.ndarray) -> np.ndarray:
    """Centimetres with y up as Blender's metres with z up."""
    return 0.01 * np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)


def test_the_script_saves_and_renders(worn: Sample, tmp_path: Path) -> None:
    exports.glb(worn, tmp_path / "a.glb")
    program = "import runpy, sys; sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
    written = ["--save", tmp_path / "a.blend", "--render", tmp_path / "a.png", "--size", 160]
    in_blender(program, SCRIPT, "--", tmp_path / "a.glb", *written)
    assert (tmp_path / "a.blend").stat().st_size > 10_000
    pixels = np.asarray(Image.open(tmp_path / "a.png").convert("RGB"), float)
    assert pixels.shape == (160, 160, 3)
    assert pixels[60:100, 60:100].std() > 1.0  # the garment is in the middle


def test_the_add_on_registers(tmp_path: Path) -> None:
    program = (
        "import sys; sys.path.insert(0, sys.argv[1]); import blender_import as b, bpy; b.register(); "
        "print(bpy.ops.import_scene.gcd_garment.get_rna_type().name); b.unregister()"
    )
    assert in_blender(program, SCRIPT.parent).splitlines()[-1] == "Import garment"


def test_a_file_of_another_origin_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(b"solid")
    done = subprocess.run([PYTHON, SCRIPT, tmp_path / "a.glb"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "not a GLB file: write one with gcd export --glb" in done.stderr
