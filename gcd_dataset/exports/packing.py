"""Packing pieces on a sheet: rectangles on shelves, from the top down, tallest first."""

import numpy as np
from jaxtyping import Float

ROUNDING = 1e-9  # cm


def pack(sizes: Float[np.ndarray, "p 2"], *, width: float, gap: float) -> tuple[Float[np.ndarray, "p 2"], float]:
    """Lower left corners of rectangles on a sheet of ``width``, ``gap`` apart [cm], and the height of the sheet.

    y points up from the lower left corner of the sheet. Each rectangle takes the first shelf with room for it; one
    wider than the sheet takes a shelf of its own.
    """
    shelves: list[tuple[float, float, float]] = []  # top, height, used width
    corners = np.zeros_like(sizes)
    for number in np.argsort(-sizes[:, 1], kind="stable"):
        w, h = sizes[number].tolist()
        row = next((i for i, (_, _, used) in enumerate(shelves) if used + gap + w <= width + ROUNDING), None)
        if row is None:
            top = shelves[-1][0] - shelves[-1][1] - gap if shelves else 0.0
            corners[number] = (0.0, top - h)
            shelves.append((top, h, w))
        else:
            top, height, used = shelves[row]
            corners[number] = (used + gap, top - h)
            shelves[row] = (top, height, used + gap + w)
    height = shelves[-1][1] - shelves[-1][0] if shelves else 0.0
    return corners + [0.0, height], height
