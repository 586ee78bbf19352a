"""Patterns as triangle meshes: sampled edges, meshed panels, merged seams."""

from gcd_dataset.generator.mesh.box_mesh import build_box_mesh

__all__ = ["build_box_mesh"]
