"""The controller's plant against the optimiser, and against a second, flat writing of it.

The flat writing is not compiled, and the controller's law is evaluated there in plain numbers.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pyomo_quad.collocation import ClosedLoop
from pyomo_quad.flight.baselines import fly_open_loop, start_state
from pyomo_quad.flight.controller import (
    COMMAND_SIZE,
    CONTROLLER_STATES,
    AdaptiveController,
    feedback_law,
    mixer_matrix,
)
from pyomo_quad.flight.references import quintic
from pyomo_quad.scenario.tables import Reference
from tests import flights
from tests.unit.flight.flat_dynamics import FlatDynamics, table_2_wind


@pytest.mark.lengthy
@pytest.mark.parametrize("name", ["paper_calm", "paper_wind"])
def test_the_plans_controls_cost_in_the_controllers_plant_what_the_optimiser_says(name):
    plan = flights.plan(name)
    flight = fly_open_loop(flights.scenario(name), plan, flights.vehicle(name))
    assert flight.energy_J == pytest.approx(plan.energy, rel=1e-6)
    assert flight.terminal_miss_m < 1e-6
    assert flight.is_verified


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("name", "wind"), [("paper_calm", lambda _t: np.zeros(3)), ("paper_wind", table_2_wind)]
)
def test_a_controlled_flight_costs_the_same_through_a_second_writing_of_the_vehicle(name, wind):
    scenario = flights.scenario(name)
    plain = FlatDynamics(scenario, wind)
    controller = AdaptiveController(scenario, mixer_matrix(plain))
    law, path = feedback_law(controller, plain), quintic(scenario.mission)

    def rates(t, joint):
        command = np.array(controller.command(path, t))
        return in_numbers(plain, law, t, joint, command)[0]

    own = controller.started(path(0.0), plain.start[:12].tolist())
    flight = solve_ivp(
        rates,
        (0.0, scenario.mission.duration),
        np.array([*plain.start, *own, 0.0]),
        t_eval=np.linspace(0.0, scenario.mission.duration, 11),
        rtol=1e-7,
        atol=1e-7,
        max_step=0.1,
    )
    declared = flights.baseline(name, Reference.QUINTIC)
    place = declared.frame[["x_m", "y_m", "z_m"]].to_numpy()[::100]
    assert np.abs(flight.y[:3].T - place).max() < 1e-6
    assert flight.y[-1, -1] == pytest.approx(declared.energy_J, rel=1e-6)


def looped(name):
    """Return a vehicle, the controller's law of it, and both compiled together."""
    dynamics = flights.vehicle(name)
    controller = AdaptiveController(flights.scenario(name), mixer_matrix(dynamics))
    law = feedback_law(controller, dynamics)
    loop = ClosedLoop(dynamics, law, n_command=COMMAND_SIZE, n_own=len(CONTROLLER_STATES))
    return dynamics, law, loop


def in_numbers(dynamics, law, t, joint, command):
    n = len(dynamics.state_names)
    alpha, own_rates = law(command.tolist(), joint[:n].tolist(), joint[n:-1].tolist())
    rates, power = dynamics.rates_and_integrand(t, joint[:n], np.array(alpha))
    return np.array([*rates, *own_rates, power]), np.array(alpha)


# From hover without any error, where divisors vanish, to errors that saturate every limit.
@pytest.mark.parametrize("size", [0.0, 1e-3, 0.1, 1.0, 10.0])
@pytest.mark.parametrize("name", ["paper_calm", "paper_wind"])
def test_the_law_compiled_is_the_law_in_numbers(name, size):
    dynamics, law, loop = looped(name)
    hover = start_state(flights.scenario(name), dynamics)
    rotors = [k for k, state in enumerate(dynamics.state_names) if "omega" in state]
    rng = np.random.default_rng(3)
    for t in np.linspace(0.0, 10.0, 21):
        joint = np.concatenate([hover, np.zeros(len(CONTROLLER_STATES) + 1)])
        joint += size * rng.uniform(-1.0, 1.0, joint.size)
        joint[rotors] += 30.0 * size * rng.uniform(-1.0, 1.0, len(rotors))
        command = size * rng.uniform(-1.0, 1.0, COMMAND_SIZE)
        expected, alpha = in_numbers(dynamics, law, t, joint, command)
        found = loop.rates(t, joint, command)
        assert np.isfinite(found).all()
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)
        applied = loop.controls(np.array([t]), joint[None, :], command[None, :])[0]
        assert applied == pytest.approx(alpha, rel=1e-9, abs=1e-9)


def test_the_law_is_called_once_to_be_compiled_and_never_in_flight():
    dynamics, law, _ = looped("paper_wind")
    calls = []

    def counted(*arguments):
        calls.append(arguments)
        return law(*arguments)

    loop = ClosedLoop(dynamics, counted, n_command=COMMAND_SIZE, n_own=len(CONTROLLER_STATES))
    hover = start_state(flights.scenario("paper_wind"), dynamics)
    joint = np.concatenate([hover, np.ones(len(CONTROLLER_STATES) + 1)])
    for t in np.linspace(0.0, 10.0, 5):
        loop.rates(t, joint, np.ones(COMMAND_SIZE))
        loop.controls(np.array([t]), joint[None, :], np.ones((1, COMMAND_SIZE)))
    assert len(calls) == 1
