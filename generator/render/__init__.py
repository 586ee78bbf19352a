"""Pictures of garments on bodies, by ray casting in Warp: no display, no OpenGL, the same code on a CPU and a GPU.

Two looks:

- plain (``render_garment``): front and back in flat panel colours, as stored in data sets;
- for training (``render``): cloth with prints and weaves, people, light, places and cameras, drawn by
  ``draw_*`` functions from a random stream, with truths for every pixel.

::

    scene = scene_of(box_mesh, drape.vertices, body, pattern=pattern)
    rng = np.random.default_rng(0)
    appearance, camera = draw_appearance(rng, scene), draw_camera(rng, scene)
    view = View(0, appearance, camera, draw_lights(rng), draw_environment(rng))
    [picture] = render([scene], [view], size=512, maps=("depth", "panel_id"))

Virtual depth cameras (``scan``) measure partial point clouds of the same scenes; ``sketch`` draws them
in lines. ``control_picture`` and ``pose_picture`` colour maps and key points for picture generators.

Records (``scene``, ``appearance``, ``environment``, ``cameras``, ``pictures``) need NumPy alone. Names are
imported on first use: Warp is loaded by the functions that render.
"""

from typing import TYPE_CHECKING

from gcd_dataset.lazy import lazy_names

if TYPE_CHECKING:
    from gcd_dataset.generator.body.keypoints import COCO_KEYPOINTS
    from gcd_dataset.generator.render.appearance import (
        Appearance,
        ClothLook,
        Hair,
        Print,
        PrintKind,
        Skin,
        Stitching,
        Underwear,
        Weave,
        WeaveKind,
    )
    from gcd_dataset.generator.render.cameras import Camera, CameraRanges, draw_camera, fixed_camera, look_at
    from gcd_dataset.generator.render.casting import PendingPictures, render, start_pictures
    from gcd_dataset.generator.render.control import control_picture, pose_picture
    from gcd_dataset.generator.render.environment import (
        Environment,
        EnvironmentKind,
        EnvironmentRanges,
        LightRanges,
        Lights,
        draw_environment,
        draw_lights,
    )
    from gcd_dataset.generator.render.images import read_image, read_picture
    from gcd_dataset.generator.render.materials import AppearanceRanges, draw_appearance
    from gcd_dataset.generator.render.pictures import MAPS, Picture, Ranges, View, draw_hair, draw_view, draw_views
    from gcd_dataset.generator.render.plain import garment_scene, render_garment, render_view
    from gcd_dataset.generator.render.scans import (
        KINECT,
        NOISELESS,
        DepthNoise,
        PointScan,
        ScanRanges,
        draw_scan_cameras,
        scan,
        scan_cameras,
    )
    from gcd_dataset.generator.render.scene import HairStyle, Scene, scene_of, scene_of_sample
    from gcd_dataset.generator.render.sketches import FLAT, HAND, SketchStyle, sketch, sketch_camera
    from gcd_dataset.generator.render.textures import with_textures

__all__ = [
    "COCO_KEYPOINTS", "FLAT", "HAND", "KINECT", "MAPS", "NOISELESS", "Appearance", "AppearanceRanges", "Camera",
    "CameraRanges", "ClothLook", "DepthNoise", "Environment", "EnvironmentKind", "EnvironmentRanges", "Hair",
    "HairStyle", "LightRanges", "Lights", "PendingPictures", "Picture", "PointScan", "Print", "PrintKind", "Ranges",
    "ScanRanges", "Scene", "SketchStyle", "Skin", "Stitching", "Underwear", "View", "Weave", "WeaveKind",
    "control_picture", "draw_appearance", "draw_camera", "draw_environment", "draw_hair", "draw_lights",
    "draw_scan_cameras", "draw_view", "draw_views", "fixed_camera", "garment_scene", "look_at", "pose_picture",
    "read_image", "read_picture", "render", "render_garment", "render_view", "scan", "scan_cameras", "scene_of",
    "scene_of_sample", "sketch", "sketch_camera", "start_pictures", "with_textures",
]  # fmt: skip

__getattr__, __dir__ = lazy_names(__name__)
