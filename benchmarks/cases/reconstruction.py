"""From points of a garment's box mesh to its panels: a small network, beside what a look into the training set gives.

    python -m benchmarks.run reconstruction --smoke

``network`` is the network; ``nearest`` answers with the training garment that is nearest by chamfer distance of the
points; ``typical`` with one and the same garment always, the one that the others are nearest to; ``ceiling`` is the
truth in the network's form of answer, the best that it could say. Test garments are other indices of the seed that the
training garments come from: other designs on other bodies, out of the same wardrobe.
"""

from benchmarks.reconstruction.train import add_arguments, run

__all__ = ["add_arguments", "run"]
