"""Import of an exported garment into Blender: one sewn mesh with a material for each panel, on its body.

For files of ``gcd export --glb``. The script needs Blender 4.2 or newer, or ``pip install bpy``, and nothing of this
package: copy it to any machine.

.. code-block:: sh

    blender --python blender_import.py -- garment.glb --texture check.png --cloth
    blender --background --python blender_import.py -- garment.glb --save garment.blend --render garment.png

Installed as an add-on (Preferences, Add-ons, Install from Disk) it adds *File, Import, Garment (.glb)*.
"""

import argparse
import json
import struct
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

bl_info = {
    "name": "Import garments of gcd_dataset",
    "blender": (4, 2, 0),
    "version": (1, 0, 0),
    "category": "Import-Export",
    "location": "File > Import > Garment (.glb)",
    "description": "A sewn garment with a material for each panel, on its body",
}

PANEL, BODY, FACTS = "gcd_panel", "gcd_body", "gcd"  # keys in the file, as in ``exports.meshes``
WELD = 1e-7  # m: copies of a seam vertex have the same coordinates
THICKNESS = 0.002  # m, of cloth against body and cloth
JSON_CHUNK = b"JSON"
FILE_HEADER, CHUNK_HEADER = struct.Struct("<4sII"), struct.Struct("<I4s")


def read_facts(path: Path | str) -> dict[str, Any]:
    """Names of garment and panels, and ``tile_cm``, in a GLB file. Raises ``ValueError`` for other files."""
    content = Path(path).read_bytes()
    start = FILE_HEADER.size
    if len(content) < start + CHUNK_HEADER.size or content[:4] != b"glTF":
        raise ValueError(f"{path}: not a GLB file: write one with gcd export --glb")
    length, kind = CHUNK_HEADER.unpack_from(content, start)
    start += CHUNK_HEADER.size
    tree = json.loads(content[start : start + length]) if kind == JSON_CHUNK else {}
    for scene in tree.get("scenes", ()):
        if FACTS in scene.get("extras", {}):
            return dict(scene["extras"][FACTS])
    raise ValueError(f"{path}: no garment of gcd_dataset: write one with gcd export --glb")


def import_garment(
    path: Path | str, *, texture: Path | str | None = None, cloth: bool = False
) -> tuple[Any, Any | None]:
    """The garment and its body (``None`` if the file has none) as objects of the open scene.

    Seams are welded; the garment has a material for each panel and the properties ``tile_cm`` and ``panels``.
    ``texture``: a picture that covers ``tile_cm`` centimetres, on all panels. ``cloth``: a cloth modifier on the
    garment, a collision modifier on the body. Raises ``ValueError`` for a file of another origin.
    """
    import bpy

    facts = read_facts(path)
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=str(path))
    found = [thing for thing in bpy.data.objects if thing not in before and thing.type == "MESH"]
    panels = {thing.data[PANEL]: thing for thing in found if PANEL in thing.data}
    body = next((thing for thing in found if BODY in thing.data), None)
    garment = _sew([panels[name] for name in facts["panels"] if name in panels])
    garment.name = garment.data.name = facts["garment"]
    garment["tile_cm"], garment["panels"] = facts["tile_cm"], facts["panels"]
    if texture is not None:
        _paint(garment, Path(texture))
    if cloth:
        _simulate(garment, body)
    return garment, body


def _sew(panels: Sequence[Any]) -> Any:
    """The panels as one object, their seams welded, smooth."""
    import bmesh
    import bpy

    bpy.ops.object.select_all(action="DESELECT")
    for panel in panels:
        panel.select_set(True)
    garment = panels[0]
    bpy.context.view_layer.objects.active = garment
    if len(panels) > 1:
        bpy.ops.object.join()
    if garment.data.has_custom_normals:
        bpy.ops.mesh.customdata_custom_splitnormals_clear()
    mesh = bmesh.new()
    mesh.from_mesh(garment.data)
    bmesh.ops.remove_doubles(mesh, verts=mesh.verts[:], dist=WELD)
    for face in mesh.faces:
        face.smooth = True
    mesh.to_mesh(garment.data)
    mesh.free()
    return garment


def _paint(garment: Any, picture: Path) -> None:
    """Give all materials of the garment a picture, repeated."""
    import bpy

    image = bpy.data.images.load(str(picture.resolve()))
    for material in garment.data.materials:
        nodes, links = material.node_tree.nodes, material.node_tree.links
        surface = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
        node = nodes.new("ShaderNodeTexImage")
        node.image, node.extension = image, "REPEAT"
        links.new(node.outputs["Color"], surface.inputs["Base Color"])


def _simulate(garment: Any, body: Any | None) -> None:
    """Modifiers that let the garment fall on, from its rest."""
    modifier = garment.modifiers.new("Cloth", "CLOTH")
    modifier.settings.quality = 8
    modifier.collision_settings.distance_min = THICKNESS
    modifier.collision_settings.use_self_collision = True
    modifier.collision_settings.self_distance_min = THICKNESS
    if body is not None:
        body.modifiers.new("Collision", "COLLISION")
        body.collision.thickness_outer = THICKNESS


def render(garment: Any, path: Path | str, *, size: int = 800, samples: int = 16) -> None:
    """Render the open scene from the garment's front to a PNG file, by Cycles on the CPU."""
    import bpy
    from mathutils import Vector

    corners = [garment.matrix_world @ Vector(corner) for corner in garment.bound_box]
    centre = sum(corners, Vector()) / len(corners)
    radius = max((corner - centre).length for corner in corners)
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = centre + Vector((0.0, -3.4 * radius, 0.3 * radius))
    camera.rotation_euler = (centre - camera.location).to_track_quat("-Z", "Y").to_euler()
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.rotation_euler = 3.0, (0.9, 0.2, 0.5)
    for thing in (camera, sun):
        scene.collection.objects.link(thing)
    scene.world = bpy.data.worlds.new("world")
    scene.world.color = (0.6, 0.6, 0.6)
    scene.camera, scene.render.engine = camera, "CYCLES"
    scene.cycles.samples, scene.cycles.device = samples, "CPU"
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.filepath = str(Path(path).resolve())
    bpy.ops.render.render(write_still=True)


# -------------------------------------------------------------------------------------------------- add-on and command


def register() -> None:
    """Add the entry to Blender's import menu."""
    import bpy

    bpy.utils.register_class(_operator())
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister() -> None:
    """Remove the entry."""
    import bpy

    bpy.types.TOPBAR_MT_file_import.remove(_menu)
    bpy.utils.unregister_class(bpy.types.IMPORT_SCENE_OT_gcd_garment)


def _menu(menu: Any, context: Any) -> None:
    menu.layout.operator("import_scene.gcd_garment", text="Garment (.glb)")


def _operator() -> Any:
    """The class of the menu entry: its bases exist in Blender only."""
    import bpy
    from bpy_extras.io_utils import ImportHelper

    def execute(self: Any, context: Any) -> set[str]:
        try:
            import_garment(self.filepath, cloth=self.cloth)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}

    entries = {
        "bl_idname": "import_scene.gcd_garment",
        "bl_label": "Import garment",
        "__annotations__": {
            "filter_glob": bpy.props.StringProperty(default="*.glb", options={"HIDDEN"}),
            "cloth": bpy.props.BoolProperty(name="Cloth and collision modifiers", default=False),
        },
        "execute": execute,
    }
    return type("IMPORT_SCENE_OT_gcd_garment", (bpy.types.Operator, ImportHelper), entries)


def main(arguments: Sequence[str] | None = None) -> None:
    """Import a garment, save and render it. ``arguments``: by default those after ``--``, as Blender passes them."""
    parser = argparse.ArgumentParser(prog="blender_import.py", description="Import a garment of gcd export --glb.")
    parser.add_argument("glb", type=Path, help="file of gcd export --glb")
    parser.add_argument("--texture", type=Path, help="picture that covers the texture tile of the file, on all panels")
    parser.add_argument("--cloth", action="store_true", help="add cloth and collision modifiers")
    parser.add_argument("--save", type=Path, metavar="FILE.blend", help="save the scene")
    parser.add_argument("--render", type=Path, metavar="FILE.png", help="render the front")
    parser.add_argument("--size", type=int, default=800, metavar="PIXELS", help="side of the rendered picture (800)")
    if arguments is None:
        arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    options = parser.parse_args(arguments)
    import bpy

    for name in ("Cube", "Camera", "Light"):  # of the default scene
        if name in bpy.data.objects:
            bpy.data.objects.remove(bpy.data.objects[name])
    try:
        garment, _ = import_garment(options.glb, texture=options.texture, cloth=options.cloth)
    except (ValueError, OSError) as error:
        parser.exit(1, f"{parser.prog}: {error}\n")
    if options.render is not None:
        render(garment, options.render, size=options.size)
    if options.save is not None:
        bpy.ops.wm.save_as_mainfile(filepath=str(options.save.resolve()))


if __name__ == "__main__":
    main()
