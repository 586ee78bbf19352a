"""Patterns as triangle meshes: sample the edges, triangulate the panels, merge the seams; and coarsen the result."""

from gcd_dataset.generator.mesh.box_mesh import build_box_mesh, turned_panels
from gcd_dataset.generator.mesh.coarse import CoarseMesh, coarse_start, coarsen

__all__ = ["CoarseMesh", "build_box_mesh", "coarse_start", "coarsen", "turned_panels"]
