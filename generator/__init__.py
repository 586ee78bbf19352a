"""Make garments: body, measures, design, pattern, box mesh, drape; step by step, or all steps at once with ``make``.

Names are imported on first use: drawing a pattern does not import the simulator.
"""

from typing import TYPE_CHECKING

from gcd_dataset.lazy import lazy_names

if TYPE_CHECKING:
    from gcd_dataset.generator.body import (
        build_body,
        draw_shape,
        fit_shape,
        measure,
        named_body,
        named_pose,
        pose_body,
        read_motion,
        walk,
    )
    from gcd_dataset.generator.body.by_name import make_person
    from gcd_dataset.generator.body.sizes import SizeChart, read_chart
    from gcd_dataset.generator.drape import (
        DrapeConfig,
        DrapeJob,
        Fabric,
        drape_all,
        drape_batch,
        drape_motion,
        drape_outfit,
        fabric_named,
        layers_of,
        maps_of,
    )
    from gcd_dataset.generator.ease import ease_of
    from gcd_dataset.generator.garments import GarmentDesign, read_design, sample_design
    from gcd_dataset.generator.garments.overlay import Overlay, read_overlay
    from gcd_dataset.generator.jacobian import DrapeJacobian, Fitting, drape_jacobian, real_parameters
    from gcd_dataset.generator.maker import make, produce
    from gcd_dataset.generator.mesh import build_box_mesh, coarse_start
    from gcd_dataset.generator.pipeline import build_pattern, fit, grade
    from gcd_dataset.generator.recipe import MakeConfig
    from gcd_dataset.generator.standing import draw_pose

__all__ = [
    "DrapeConfig", "DrapeJacobian", "DrapeJob", "Fabric", "Fitting", "GarmentDesign", "MakeConfig", "Overlay",
    "SizeChart", "build_body", "build_box_mesh", "build_pattern", "coarse_start", "drape_all", "drape_batch",
    "drape_jacobian", "drape_motion", "drape_outfit", "draw_pose", "draw_shape", "ease_of", "fabric_named", "fit",
    "fit_shape", "grade", "layers_of", "make", "make_person", "maps_of", "measure", "named_body", "named_pose",
    "pose_body", "produce", "read_chart", "read_design", "read_motion", "read_overlay", "real_parameters",
    "sample_design", "walk",
]  # fmt: skip

__getattr__, __dir__ = lazy_names(__name__)
