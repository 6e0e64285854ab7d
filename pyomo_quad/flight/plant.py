"""Flying given controls through the declared equations with SciPy.

The integrator shares nothing with the collocation: it reads the equations solved for their
slopes, steps adaptively with DOP853 and integrates the power alongside the states.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from pyomo_quad.collocation import Dynamics, Mesh, SolveError, control_polynomial
from pyomo_quad.flight.flight import Flown

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ABSOLUTE_TOLERANCE", "RELATIVE_TOLERANCE", "fly_controls"]

FloatArray = NDArray[np.float64]

RELATIVE_TOLERANCE = 1e-12
ABSOLUTE_TOLERANCE = 1e-12


def fly_controls(
    dynamics: Dynamics,
    mesh: Mesh,
    controls: FloatArray,
    start: FloatArray,
    horizon: tuple[float, float],
    *,
    samples_per_element: int = 8,
    method: str = "DOP853",
) -> Flown:
    """Fly piecewise polynomial controls open loop.

    Parameters
    ----------
    dynamics : Dynamics
        Right-hand side of the vehicle in its wind.
    mesh : Mesh
        Elements of the control polynomials; the integration restarts at their boundaries,
        where controls may jump.
    controls : ndarray, shape (n_points, n_controls)
        Controls at the collocation points.
    start : ndarray, shape (n_states,)
    horizon : (float, float)
        Start and end time [s].
    samples_per_element : int, default 8
        Samples kept of each element besides its start.
    method : str, default "DOP853"
        SciPy's name of the integrator.

    Returns
    -------
    Flown

    Raises
    ------
    SolveError
        If the integrator gives up.
    """
    times = horizon[0] + (horizon[1] - horizon[0]) * np.asarray(mesh.breakpoints)
    state = np.append(start, 0.0)
    parts_t, parts_y, parts_u = [times[:1]], [state[:, None]], []
    for element in range(mesh.elements):
        first, last = times[element], times[element + 1]
        polynomial = control_polynomial(mesh, controls, element, first, last)
        samples = np.linspace(first, last, samples_per_element + 1)[1:]
        flown = _integrate(dynamics, polynomial, state, first, samples, method)
        state = flown[:, -1]
        if element == 0:
            parts_u.append(polynomial(first)[None, :])
        parts_t.append(samples)
        parts_y.append(flown)
        parts_u.append(np.array([polynomial(t) for t in samples]))
    values = np.hstack(parts_y)
    return Flown(
        t=np.concatenate(parts_t),
        states=values[:-1].T,
        controls=np.vstack(parts_u),
        energy=values[-1],
    )


def _integrate(
    dynamics: Dynamics,
    control: Callable[[float], FloatArray],
    state: FloatArray,
    first: float,
    samples: FloatArray,
    method: str,
) -> FloatArray:
    """Return states, the energy last, at the samples of one element that starts at `first`."""
    inside = dynamics.just_after(first)

    def slope(t: float, y: FloatArray) -> FloatArray:
        rates, power = dynamics.rates_and_integrand(max(t, inside), y[:-1], control(t))
        return np.append(rates, power)

    flown = solve_ivp(
        slope,
        (first, samples[-1]),
        state,
        method=method,
        t_eval=samples,
        rtol=RELATIVE_TOLERANCE,
        atol=ABSOLUTE_TOLERANCE,
    )
    if not flown.success:
        raise SolveError(
            f"flight: the integration stopped at {flown.t[-1] if flown.t.size else first:.4g} "
            f"s: {flown.message} Look at the plan's controls there."
        )
    return np.asarray(flown.y)
