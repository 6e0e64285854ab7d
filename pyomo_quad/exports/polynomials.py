"""Pieces of degree 7, as Crazyflie swarms read them, and as an object that RotorPy follows."""

from collections.abc import Iterator
from math import factorial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PPoly, make_interp_spline

from pyomo_quad.exports.motion import ATTITUDE_STATES, Motion
from pyomo_quad.flight.flight import POSITION_STATES, VELOCITY_STATES
from pyomo_quad.scenario import ScenarioError

FloatArray = NDArray[np.float64]

DEGREE = 7
_FIRST_PIECES = 4
# Of the flight: over it the jerk at an end is taken.
_END_STEP = 1e-3
_CHECKED_PER_PIECE = 16
_MOST_CHECKED = 20_001


class PolynomialTrajectory:
    """A trajectory in pieces of polynomials, for RotorPy and whoever asks for flat outputs.

    Parameters
    ----------
    durations : array, shape (n_pieces,)
        Of the pieces [s].
    coefficients : array, shape (n_pieces, 4, n_coefficients)
        Of x, y, z [m] and yaw [rad] as polynomials of the time since the piece began [s], the
        constant first.
    """

    def __init__(self, durations: ArrayLike, coefficients: ArrayLike) -> None:
        self.ends = np.cumsum(np.asarray(durations, dtype=float))
        self.starts = self.ends - np.asarray(durations, dtype=float)
        self.coefficients = np.asarray(coefficients, dtype=float)

    def derivative(self, t: float, order: int) -> np.ndarray:
        """Return a derivative of x, y, z and yaw; before the start and after the end it hovers."""
        inside = min(max(float(t), 0.0), float(self.ends[-1]))
        if order > 0 and inside != t:
            return np.zeros(4)
        piece = min(int(np.searchsorted(self.ends, inside)), len(self.ends) - 1)
        slopes = np.polynomial.polynomial.polyder(self.coefficients[piece], order, axis=1)
        held = np.polynomial.polynomial.polyval(inside - self.starts[piece], slopes.T)
        return np.asarray(held)

    def update(self, t: float) -> dict[str, np.ndarray | float]:
        """Return the flat outputs of one time as RotorPy's controllers read them."""
        place, speed, acceleration, jerk, snap = (self.derivative(t, k) for k in range(5))
        return {
            "x": place[:3],
            "x_dot": speed[:3],
            "x_ddot": acceleration[:3],
            "x_dddot": jerk[:3],
            "x_ddddot": snap[:3],
            "yaw": float(place[3]),
            "yaw_dot": float(speed[3]),
            "yaw_ddot": float(acceleration[3]),
        }


def fit(motion: Motion, path_error_m: float, most_pieces: int) -> tuple[FloatArray, FloatArray]:
    """Return durations and coefficients of the fewest equal pieces that keep to a plan.

    The pieces are those of a spline of degree 7 through the plan, which has the plan's velocity,
    acceleration and jerk at both ends; all but its last derivative are continuous.

    Raises
    ------
    ScenarioError
        If so many pieces do not suffice.
    """
    motion.require((*POSITION_STATES, *VELOCITY_STATES, ATTITUDE_STATES[2]), "a polynomial")
    found = 0.0
    for pieces in _counts(most_pieces):
        durations, coefficients = _pieces(motion, pieces)
        found, yaw = deviation(motion, durations, coefficients)
        if max(found, yaw) <= path_error_m:
            return durations, coefficients
    raise ScenarioError(
        f"{motion.name}: {most_pieces} pieces of degree {DEGREE}, the most that the format holds, "
        f"come within {found:.2g} m of the plan and not within {path_error_m:g} m; give a larger "
        "--path-error."
    )


def deviation(
    motion: Motion, durations: FloatArray, coefficients: FloatArray
) -> tuple[float, float]:
    """Return how far pieces leave a plan at any time: place [m] and yaw [rad]."""
    t = np.linspace(
        0.0, motion.duration, min(_MOST_CHECKED, _CHECKED_PER_PIECE * len(motion.times))
    )
    ends = np.cumsum(durations)
    breaks = np.concatenate(([0.0], ends))
    held = PPoly(np.moveaxis(coefficients[:, :, ::-1], 2, 0), breaks)(np.minimum(t, ends[-1]))
    place = np.linalg.norm(held[:, :3] - motion.position(t), axis=1)
    return float(place.max()), float(np.abs(held[:, 3] - motion.yaw(t)).max())


def _counts(most: int) -> Iterator[int]:
    """Yield numbers of pieces to try, each a little above the one before."""
    pieces = _FIRST_PIECES
    while pieces < most:
        yield pieces
        pieces += max(1, pieces // 8)
    yield most


def _pieces(motion: Motion, pieces: int) -> tuple[FloatArray, FloatArray]:
    t = np.linspace(0.0, motion.duration, pieces + 1)
    outputs = np.column_stack([motion.position(t), motion.yaw(t)])
    spline = make_interp_spline(t, outputs, k=DEGREE, bc_type=_end_slopes(motion))
    # A piece is the Taylor polynomial of its start.
    held = [spline(t[:-1], order) / factorial(order) for order in range(DEGREE + 1)]
    return np.diff(t), np.stack(held, axis=2)


def _end_slopes(motion: Motion) -> tuple[list[tuple[int, FloatArray]], ...]:
    step = _END_STEP * motion.duration

    def slopes(t: float, inside: float) -> list[tuple[int, FloatArray]]:
        at = np.array([t, t + inside])
        speed = np.column_stack([motion.velocity(at), motion.yaw_rate(at)])
        acceleration = np.column_stack([motion.acceleration(at), np.gradient(speed[:, 3], at)])
        jerk = np.append((acceleration[1, :3] - acceleration[0, :3]) / inside, 0.0)
        return [(1, speed[0]), (2, acceleration[0]), (3, jerk)]

    return slopes(0.0, step), slopes(motion.duration, -step)
