"""Drape garments on bodies: the only part of the package, with the renderer, that imports Warp."""

from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.device import load_kernels, resolve_device
from gcd_dataset.generator.drape.drape import drape_all, drape_batch
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
    "fabric_named",
    "kernels_compiled",
    "load_kernels",
    "resolve_device",
    "seconds_per_garment",
    "seconds_to_drape",
    "tell_wait",
]
