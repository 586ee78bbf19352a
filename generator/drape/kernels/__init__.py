"""The drape's Warp kernels; ``drape.reference`` computes their energies and intersection tests in NumPy."""
