"""Drape garments on bodies: the only part of the package, with the renderer, that imports Warp."""

from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.device import every_device, load_kernels, resolve_device
from gcd_dataset.generator.drape.drape import drape_all, drape_batch, places_on
from gcd_dataset.generator.drape.fabric import Bending, Fabric, Tensile
from gcd_dataset.generator.drape.fabrics import DEFAULT_FABRIC, FABRICS, fabric_named
from gcd_dataset.generator.drape.loading import kernels_compiled, seconds_per_garment, seconds_to_drape, tell_wait

__all__ = [
    "DEFAULT_FABRIC",
    "FABRICS",
    "Bending",
    "DrapeConfig",
    "DrapeJob",
    "Fabric",
    "Tensile",
    "drape_all",
    "drape_batch",
    "every_device",
    "fabric_named",
    "kernels_compiled",
    "load_kernels",
    "places_on",
    "resolve_device",
    "seconds_per_garment",
    "seconds_to_drape",
    "tell_wait",
]
