"""Quadratic curves with given end tangents, and cubic curves fitted to end tangents and a length.

A side seam from the hem at (0, 0) to the hip at (2, 20), vertical at the hip:

>>> side = tangent_quadratic((0.0, 0.0), (2.0, 20.0), end_tangent=(0.0, 1.0), at=0.75)
>>> along, across = side.control  # in the edge frame
>>> round(along, 2), round(across, 4)
(0.75, -0.0249)
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import atan2, cos, degrees, hypot, sin
from typing import ClassVar, TypeAlias

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import QUADRATURE_NODES, QUADRATURE_WEIGHTS, Point, Quadratic
from gcd_dataset.errors import FitError, PatternError
from gcd_dataset.generator.pattern.stroke import Stroke

SLIDE_WEIGHT = 1e-3  # cm⁻⁴: weight of the end's squared slide against squared curvature, GarmentCode
EXACT_TANGENT_SLIDE_WEIGHT = 8e-4  # the same for exact tangents: GarmentCode's are soft, so its ends slide more
CURVATURE_NORM = 16  # exponent of the power mean that replaces the peak curvature: it is differentiable
S_SHAPED_NORM = 48  # the same for an S, whose peaks are narrower
FIRST_GUESS = (0.5, 0.35, 0.08)  # chords: arms and slide for a typical sleeve opening
S_SHAPED_GUESS = (0.45, 0.0, 0.03)  # chords: arm, deviation and slide for a typical hood's neckline
SHORTEST_ARM = 0.02  # least distance of a control point from its end, as a fraction of the chord
NEWTON_STEPS = 40
STEP_TOLERANCE = 1e-4  # as a fraction of the chord
LENGTH_TOLERANCE = 1e-6  # as a fraction of the chord
STEP_SHARES = 0.5 ** np.arange(11)  # shares of a Newton step tried in the line search, in this order
LEAST_EIGENVALUE = 1e-2  # lower bound of the Hessian's eigenvalues in absolute value
PROBE = 1e-3  # step of the finite differences, as a fraction of the chord

SAMPLES = np.linspace(0.0, 1.0, 49)
LENGTH_WEIGHTS = 0.5 * QUADRATURE_WEIGHTS
FIRST = len(LENGTH_WEIGHTS)  # the first sample of the nodes
NODES = np.concatenate(
    [0.5 * (QUADRATURE_NODES + 1), SAMPLES]
)  # curve parameters, for the length and for the curvature
BASIS = ((1 - NODES) ** 2, 2 * NODES * (1 - NODES), NODES**2)  # the quadratic Bernstein polynomials
PAIRS = ((0, 1), (0, 2), (1, 2))
AXES = np.eye(3)
STENCIL = np.array([0 * AXES[0], *AXES, *-AXES, *(AXES[i] + AXES[j] for i, j in PAIRS)])
PROBES = PROBE * STENCIL

Batch: TypeAlias = Float[np.ndarray, "n 2"]


def smooth_cubic(start: Point, end: Point, *, start_tangent: Point, end_tangent: Point, length: float) -> Stroke:
    """The smoothest cubic with these unit tangents and this length [cm]; its end may slide along the chord.

    Minimises ``peak curvature² + EXACT_TANGENT_SLIDE_WEIGHT · slide²``, as GarmentCode does for the opening of a
    sleeve. The unknowns are the lengths of the two control arms and the slide; the length is a constraint. Solved by
    damped Newton steps on the Lagrangian, with finite differences; about seven steps suffice.

    Raises ``FitError`` with the residual if the steps do not converge.
    """
    return _solved(_CubicFit(start, end, start_tangent, end_tangent, length), FIRST_GUESS)


def s_shaped_cubic(start: Point, end: Point, *, tangent: Point, length: float) -> Stroke:
    """The smoothest S-shaped cubic of this length [cm] that starts and ends nearly along a unit tangent.

    The curve has point symmetry, and its end may slide along the chord. Minimises ``peak curvature² + SLIDE_WEIGHT ·
    slide²`` as ``smooth_cubic`` does, plus the squared deviation of each end from the tangent, as GarmentCode does for
    the neckline of a hood. The unknowns are the length of a control arm, its deviation and the slide.

    Raises ``FitError`` with the residual if the steps do not converge.
    """
    return _solved(_SShapedFit(start, end, tangent, tangent, length), S_SHAPED_GUESS)


def _solved(fit: "_CubicFit", guess: tuple[float, float, float]) -> Stroke:
    """The curve of least cost among the curves of the given length, by damped Newton steps from a guess."""
    unknowns, multiplier = np.array(guess), 0.0
    for _ in range(NEWTON_STEPS):
        step, multiplier = fit.newton_step(unknowns, multiplier)
        step = fit.damped(unknowns, step, multiplier)
        unknowns = unknowns + step
        if np.abs(step).max() < STEP_TOLERANCE:
            break
    fitted = fit.stroke(unknowns)
    missing = fit.length - fitted.length
    if abs(missing) > LENGTH_TOLERANCE * fit.chord:
        raise FitError(
            f"a smooth curve of {fit.length:.2f} cm over {fit.chord:.2f} cm: {missing:+.3g} cm are missing after "
            f"{NEWTON_STEPS} steps: bring length or tangents nearer to the chord"
        )
    return fitted


@dataclass(frozen=True)
class _CubicFit:
    """The optimisation problem in units of the chord, for batches of unknowns (start arm, end arm, slide)."""

    start: Point
    end: Point
    start_tangent: Point
    end_tangent: Point
    length: float
    least: ClassVar[tuple[float, float, float]] = (SHORTEST_ARM, SHORTEST_ARM, -np.inf)  # lower bounds of the unknowns
    norm: ClassVar[int] = CURVATURE_NORM
    slide_weight: ClassVar[float] = EXACT_TANGENT_SLIDE_WEIGHT

    @cached_property
    def chord(self) -> float:
        """Distance from start to end [cm]."""
        return hypot(self.end[0] - self.start[0], self.end[1] - self.start[1])

    @cached_property
    def along(self) -> Float[np.ndarray, "2"]:
        """The chord [chords]."""
        return (np.array(self.end) - np.array(self.start)) / self.chord

    @cached_property
    def tangents(self) -> Float[np.ndarray, "2 2"]:
        """The tangents at start and end."""
        return np.array([self.start_tangent, self.end_tangent])

    def controls(self, unknowns: Float[np.ndarray, "n 3"]) -> tuple[Batch, Batch, Batch]:
        """The legs of the control polygon [chords]."""
        first, last = unknowns[:, :1] * self.tangents[0], unknowns[:, 1:2] * self.tangents[1]
        return first, (1 + unknowns[:, 2:]) * self.along - first - last, last

    def evaluate(self, unknowns: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Cost [chord⁻²] and excess length [chords]."""
        legs = self.controls(unknowns)
        (dx, ddx), (dy, ddy) = (_derivatives_along(*(leg[:, axis, None] for leg in legs)) for axis in (0, 1))
        speed = np.sqrt(dx * dx + dy * dy)
        curvature = np.abs(dx[:, FIRST:] * ddy - dy[:, FIRST:] * ddx) / speed[:, FIRST:] ** 3
        peak = ((curvature**self.norm).sum(axis=1) / len(SAMPLES)) ** (1 / self.norm)
        slide = unknowns[:, 2]
        length = np.ascontiguousarray(speed[:, :FIRST]) @ LENGTH_WEIGHTS
        return peak**2 + self.slide_weight * self.chord**4 * slide**2, length - self.length / self.chord

    def newton_step(self, unknowns: Float[np.ndarray, "3"], multiplier: float) -> tuple[Float[np.ndarray, "3"], float]:
        """Newton step towards a stationary point of the Lagrangian, and the multiplier there."""
        cost, excess = self.evaluate(unknowns + PROBES)
        (cost_slope, cost_bend), (excess_slope, excess_bend) = _derivatives(cost), _derivatives(excess)
        values, axes = np.linalg.eigh(cost_bend + multiplier * excess_bend)
        system = np.zeros((4, 4))
        # Made positive definite, so that the step descends even where the Hessian is indefinite.
        system[:3, :3] = axes * np.maximum(np.abs(values), LEAST_EIGENVALUE) @ axes.T
        system[:3, 3] = system[3, :3] = excess_slope
        solved = np.linalg.solve(system, -np.array([*cost_slope, excess[0]]))
        return solved[:3], float(solved[3])

    def damped(
        self, unknowns: Float[np.ndarray, "3"], step: Float[np.ndarray, "3"], multiplier: float
    ) -> Float[np.ndarray, "3"]:
        """The step, halved until the merit (cost plus weighted excess) falls and the unknowns keep their bounds."""
        trials = unknowns + np.outer([0.0, *STEP_SHARES], step)
        cost, excess = self.evaluate(np.maximum(trials, self.least))
        merit = cost + (2 * abs(multiplier) + 1) * np.abs(excess)
        better = (merit[1:] < merit[0] + 1e-12) & (trials[1:] > self.least).all(axis=1)
        return step * STEP_SHARES[int(np.argmax(better)) if better.any() else -1]

    def stroke(self, unknowns: Float[np.ndarray, "3"]) -> Stroke:
        """The curve of these unknowns, in the plane [cm]."""
        legs = [leg[0] * self.chord for leg in self.controls(unknowns[None])]
        points = np.array(self.start) + np.cumsum([np.zeros(2), *legs], axis=0)
        return Stroke(self.start, self.end).through([(float(x), float(y)) for x, y in points])


@dataclass(frozen=True)
class _SShapedFit(_CubicFit):
    """The same problem for unknowns (arm, deviation, slide), the deviation as the tangent of its angle."""

    least: ClassVar[tuple[float, float, float]] = (SHORTEST_ARM, -np.inf, -np.inf)
    norm: ClassVar[int] = S_SHAPED_NORM
    slide_weight: ClassVar[float] = SLIDE_WEIGHT

    def controls(self, unknowns: Float[np.ndarray, "n 3"]) -> tuple[Batch, Batch, Batch]:
        """The legs of the control polygon [chords]; the last equals the first."""
        arm = unknowns[:, :1] * (self.tangents[0] + unknowns[:, 1:2] * self.across)
        return arm, (1 + unknowns[:, 2:]) * self.along - 2 * arm, arm

    @cached_property
    def across(self) -> Float[np.ndarray, "2"]:
        """The tangent turned to the left."""
        x, y = self.start_tangent
        return np.array([-y, x])

    def evaluate(self, unknowns: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Cost with both deviations [chord⁻²] and excess length [chords]."""
        cost, excess = _CubicFit.evaluate(self, unknowns)
        return cost + 4 * self.chord**2 * (1 - 1 / np.sqrt(1 + unknowns[:, 1] ** 2)), excess


def _derivatives_along(
    first: Float[np.ndarray, "n 1"], middle: Float[np.ndarray, "n 1"], last: Float[np.ndarray, "n 1"]
) -> tuple[Float[np.ndarray, "n k"], Float[np.ndarray, "n s"]]:
    """A coordinate of the first derivative at ``NODES`` and of the second at ``SAMPLES``, from the legs'."""
    change = (1 - SAMPLES) * (middle - first) + SAMPLES * (last - middle)
    return 3 * (BASIS[0] * first + BASIS[1] * middle + BASIS[2] * last), 6 * change


def _derivatives(values: Float[np.ndarray, "10"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Gradient and Hessian from values at the points of ``STENCIL``."""
    middle, up, down, pairs = values[0], values[1:4], values[4:7], values[7:]
    hessian = np.diag(up + down - 2 * middle)
    for (i, j), both in zip(PAIRS, pairs, strict=True):
        hessian[i, j] = hessian[j, i] = both - up[i] - up[j] + middle
    return (up - down) / (2 * PROBE), hessian / PROBE**2


ARMS: Mapping[float, tuple[tuple[float, ...], tuple[float, ...]]] = {
    0.5: (
        (0, 6, 8, 10, 12, 16, 20, 31.5, 32, 32.5, 33.5, 37.5, 47.5, 55.5, 63.5, 71, 79, 86.5, 93.5, 100),
        (0.5, 0.5, 0.505, 0.518, 0.543, 0.609, 0.638, 0.686, 1.27, 1.225, 1.425, 1.62, 1.353, 1.209, 1.128, 1.1, 1.118,
         1.176, 1.272, 1.408),
    ),
    0.25: (
        (0, 10, 16, 22, 22.5, 23, 24, 29.5, 32.5, 38, 38.5, 39, 40.5, 46.5, 53.5, 59.5, 66, 72.5, 79.5, 87, 92.5, 100),
        (0.25, 0.251, 0.259, 0.274, 0.402, 0.367, 0.456, 0.659, 0.719, 0.785, 1.503, 1.35, 1.474, 1.517, 1.324, 1.202,
         1.113, 1.059, 1.031, 1.031, 1.054, 1.114),
    ),
    0.7: (
        (0, 6, 10, 16, 27.5, 28, 28.5, 29.5, 31.5, 50, 60, 70, 79, 85, 90.5, 95.5, 100),
        (0.7, 0.702, 0.708, 0.732, 0.821, 1.385, 1.269, 1.4, 1.522, 1.276, 1.204, 1.211, 1.285, 1.376, 1.495, 1.642,
         1.815),
    ),
}  # fmt: skip
"""Start of the control point on the chord [chords] to (angles between tangent and chord [degrees], arms [chords]).

GarmentCode prescribes only the tangent: its minimiser starts with the control point on the chord and moves it along
the tangent. The table holds the control arm where the minimiser stops, for the three starts that garments use. At small
angles the point hardly moves; at some larger angles the arm jumps.
"""


def tangent_quadratic(
    start: Point, end: Point, *, start_tangent: Point | None = None, end_tangent: Point | None = None, at: float = 0.5
) -> Quadratic:
    """The curve between two points [cm] with a given tangent at its start, at its end, or at both.

    With two tangents the control point is their intersection. With one tangent the control point lies on the tangent,
    about as far from its end as the point at the share ``at`` of the chord: 0.5 for a tangent at the start, 0.75 or 0.3
    for a tangent at the end (the shares in ``ARMS``).
    Raises ``PatternError`` for tangents that do not cross between the ends.
    """
    leaves, reaches = (_from_chord(start, end, tangent) for tangent in (start_tangent, end_tangent))
    if leaves is not None and reaches is not None:
        return Quadratic(_crossing(leaves, reaches))
    if leaves is not None:
        arm = _arm(at, leaves)
        return Quadratic((arm * cos(leaves), arm * sin(leaves)))
    if reaches is not None:
        arm = _arm(1 - at, reaches)
        return Quadratic((1 - arm * cos(reaches), -arm * sin(reaches)))
    raise PatternError("a curve with given tangents needs one: give start_tangent or end_tangent")


def _from_chord(start: Point, end: Point, tangent: Point | None) -> float | None:
    """The angle from the chord to a direction [rad]."""
    if tangent is None:
        return None
    x, y = end[0] - start[0], end[1] - start[1]
    if hypot(x, y) == 0.0:
        raise PatternError("a curve with given tangents needs two ends, not one point twice")
    return atan2(x * tangent[1] - y * tangent[0], x * tangent[0] + y * tangent[1])


def _arm(start: float, angle: float) -> float:
    """Length of the control arm [chords] for a tangent at an angle to the chord [rad]; ``start``: key of ``ARMS``."""
    angles, arms = ARMS[round(start, 2)]
    return float(np.interp(abs(degrees(angle)), angles, arms))


def _crossing(leaves: float, reaches: float) -> Point:
    """Intersection of the two tangents in the edge frame: ahead of the start and behind the end."""
    bend = sin(leaves - reaches)
    if bend == 0.0 or -sin(reaches) / bend <= 0.0 or sin(leaves) / bend <= 0.0:
        raise PatternError(
            f"tangents at {degrees(leaves):.0f} and {degrees(reaches):.0f} degrees to the chord do not cross between "
            "the ends of a curve: make its ends further apart"
        )
    arm = -sin(reaches) / bend
    return (arm * cos(leaves), arm * sin(leaves))
