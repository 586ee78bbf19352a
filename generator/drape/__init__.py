"""Drape garments on bodies: batched cloth simulation in Warp."""

from gcd_dataset.generator.device import every_device, load_kernels, resolve_device
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.drape import batch_capacity, drape_all, drape_batch, drape_motion, drape_outfit
from gcd_dataset.generator.drape.fabrics import (
    DEFAULT_FABRIC,
    FABRICS,
    RANDOM_FABRIC,
    Bending,
    Fabric,
    Tensile,
    draw_fabric,
    fabric_named,
)
from gcd_dataset.generator.drape.layers import layers_of
from gcd_dataset.generator.drape.loading import log_drape_time, seconds_per_garment
from gcd_dataset.generator.drape.maps import maps_of

__all__ = [
    "DEFAULT_FABRIC", "FABRICS", "RANDOM_FABRIC", "Bending", "DrapeConfig", "DrapeJob", "Fabric", "Tensile",
    "batch_capacity", "drape_all", "drape_batch", "drape_motion", "drape_outfit", "draw_fabric", "every_device",
    "fabric_named", "layers_of", "load_kernels", "log_drape_time", "maps_of", "resolve_device", "seconds_per_garment",
]  # fmt: skip
