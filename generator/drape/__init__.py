"""Drape garments on bodies: the only part of the package, with the renderer, that imports Warp."""

from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob, Fabric
from gcd_dataset.generator.drape.device import load_kernels, resolve_device
from gcd_dataset.generator.drape.drape import drape_batch

__all__ = ["DrapeConfig", "DrapeJob", "Fabric", "drape_batch", "load_kernels", "resolve_device"]
