"""The drape's kernels, one constraint a file; their NumPy twins are in ``drape.reference``."""
