"""The drape's Warp kernels; the tests compute elastic energies and intersection tests again in NumPy."""
