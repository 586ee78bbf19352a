"""The drape's Warp kernels; ``drape.reference`` computes elastic energies and intersection tests in NumPy."""
