"""The drape's Warp kernels; ``tests.generator.drape.reference`` computes elastic energies and intersection tests in NumPy."""
