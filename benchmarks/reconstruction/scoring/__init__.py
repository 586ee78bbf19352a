"""Scores of predicted patterns that are files, or that need the generator: box meshes, drapes, tables."""
