"""Kernels of the renderer, and the functions that they call, one module per concern."""
