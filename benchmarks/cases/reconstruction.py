"""Reconstruction: from surface points of a garment's box mesh to its panels, with a small network and references.

    python -m benchmarks.run reconstruction --smoke

``network`` is the trained network; ``nearest`` answers with the training garment of least chamfer distance; ``typical``
always answers with the same garment, the one with the least mean distance to the others; ``ceiling`` is the ground
truth in the network's output format, the best possible answer. Test garments have other indices of the same seed: other
designs and bodies from the same design space.
"""

from benchmarks.reconstruction.train import add_arguments, run

__all__ = ["add_arguments", "run"]
