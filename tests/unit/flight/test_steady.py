"""Steady flight read off the compiled equations, against arithmetic done by hand."""

from math import atan2, hypot, sqrt

import numpy as np
import pytest
from pyomo.dae import DerivativeVar
from pyomo.environ import Constraint, Var, units

from pyomo_quad import build_model
from pyomo_quad.collocation import Dynamics, SolveError
from pyomo_quad.flight import Planner
from pyomo_quad.flight.steady import SteadyFlight
from pyomo_quad.scenario.mission import Aim
from pyomo_quad.scenario.tables import Reference
from pyomo_quad.study import run
from tests.declared_model import scenario, steady

WEIGHT, KB, KAPPA = 1.3 * 9.81, 3.8305e-6, 2.2518e-8
HOVER_SPEED = sqrt(WEIGHT / (4 * KB))


def hover_power(thrust=WEIGHT, resistance=0.2, torque_constant=0.0104, voltage_constant=96.342):
    """Four motors, each (R i + w / k_v) i with i = kappa w^2 / k_t."""
    speed = sqrt(thrust / (4 * KB))
    current = KAPPA * speed**2 / torque_constant
    return 4 * (resistance * current + speed / voltage_constant) * current


def with_thrice_the_resistance(told):
    model = build_model(told)
    model.vehicle.motor_resistance.set_value(3 * model.vehicle.motor_resistance.value)
    return model


def with_a_lagging_thrust(told):
    """A state of its own that follows the thrust, and one that counts without end."""
    model = build_model(told)
    model.lag = Var(model.time, units=units.N, initialize=1.0)
    model.dlag_dt = DerivativeVar(model.lag, wrt=model.time, units=units.N / units.s)
    model.follow = Constraint(
        model.time,
        rule=lambda m, t: m.dlag_dt[t] == (m.rotors.total_thrust[t] - m.lag[t]) / (0.2 * units.s),
    )
    return model


def test_hover_of_a_model_of_ones_own_is_that_of_its_equations():
    told = scenario()
    flight = Planner(with_thrice_the_resistance).steady_flight(told)
    assert flight.hover_power == pytest.approx(hover_power(resistance=0.6), rel=1e-10)
    assert 10.0 * flight.hover_power == pytest.approx(760.58, abs=0.005)
    assert steady(told).hover_power == pytest.approx(hover_power(), rel=1e-10)


@pytest.mark.lengthy
def test_a_plan_and_its_certificate_share_the_floor_of_its_own_model():
    solver = {"elements": 10, "degree": 3, "max_refinements": 0}
    mission = {"goal": {"position": [1.0, 0.0, 0.5]}, "duration": 4.0}
    told = scenario(solver=solver, mission=mission)
    plan = Planner(with_thrice_the_resistance).solve(told)
    assert plan.hover_energy_J == pytest.approx(4.0 * hover_power(resistance=0.6), rel=1e-10)
    assert plan.energy > plan.hover_energy_J


def test_an_own_state_that_can_rest_does():
    told = scenario()
    flight = Planner(with_a_lagging_thrust).steady_flight(told)
    assert flight.hover_power == pytest.approx(hover_power(), rel=1e-10)


@pytest.mark.parametrize("wind", ["paper_table_2", "constant", "file"])
def test_the_air_is_still_whatever_wind_blows(wind, tmp_path):
    (tmp_path / "wind.csv").write_text(
        "time_s,wind_x_m_per_s,wind_y_m_per_s\n" + "\n".join(f"{t},3,1" for t in range(12)) + "\n"
    )
    tables = {
        "paper_table_2": {"use": "paper_table_2", "coupling": "drag"},
        "constant": {"use": "constant", "speed": 4.0},
        "file": {"use": "calm", "coupling": "drag", "file": str(tmp_path / "wind.csv")},
    }
    assert steady(scenario(wind=tables[wind])).hover_power == pytest.approx(
        hover_power(), rel=1e-10
    )


def test_steady_flight_at_a_velocity_leans_against_the_drag():
    wind = {"use": "calm", "coupling": "drag"}
    told = scenario(wind=wind, vehicle={"drag_linear": 0.5, "drag_quadratic": 0.0})
    planner = Planner()
    trim = planner.steady_flight(told).trim((6.0, 0.0, 2.0))
    # Drag of 3 N against the flight and 1 N down.
    thrust = hypot(0.5 * 6.0, WEIGHT + 0.5 * 2.0)
    names = planner.dynamics(told).state_names
    at = dict(zip(names, trim.states, strict=True))
    assert trim.power_W == pytest.approx(hover_power(thrust), rel=1e-9)
    assert at["rigid_body.theta"] == pytest.approx(atan2(3.0, WEIGHT + 1.0), rel=1e-9)
    assert (at["rigid_body.vx"], at["rigid_body.vz"]) == pytest.approx((6.0, 2.0))
    np.testing.assert_allclose(trim.controls, 0.0, atol=1e-6)


def test_a_search_begun_nearby_ends_at_the_same_trim_after_few_evaluations(monkeypatch):
    told = scenario(wind={"use": "calm", "coupling": "drag"}, vehicle={"drag_linear": 0.5})
    flown, evaluated = steady(told), []
    rates = Dynamics.rates
    monkeypatch.setattr(Dynamics, "rates", lambda *a: evaluated.append(0) or rates(*a))
    cold, near = flown.trim((6.0, 0.0, 2.0)), flown.trim((6.5, 0.0, 2.0))
    evaluated.clear()
    found = flown.trim((6.0, 0.0, 2.0), near)
    # An evaluation for each of 16 unknowns gives the slopes: no more than five times.
    assert len(evaluated) < 100
    np.testing.assert_allclose(found.states, cold.states, rtol=1e-12, atol=1e-12)


@pytest.mark.lengthy
@pytest.mark.parametrize("power", ["motor", "momentum"])
def test_the_slopes_of_the_rates_are_those_of_differences(power):
    vehicle = {"use": "dji_matrice_100", "attitude": "euler"}
    told = scenario(vehicle=vehicle, power={"model": power}, wind={"coupling": "drag"})
    flight = steady(told)
    trim, rates = flight.trim([3.0, 1.0, 0.5]), flight.dynamics.rates
    t, controls = flight.dynamics.start, trim.controls + np.array([3.0, -2.0, 1.0, 5.0])
    by_state, by_control = flight.dynamics.slopes(t, trim.states, controls)
    for k, step in enumerate(1e-4 * np.eye(trim.states.size)):
        ends = (rates(t, trim.states + side * step, controls) for side in (1, -1))
        assert by_state[:, k] == pytest.approx(np.subtract(*ends) / 2e-4, rel=1e-5, abs=1e-6)
    for k, step in enumerate(np.eye(controls.size)):
        ends = (rates(t, trim.states, controls + side * step) for side in (1, -1))
        assert by_control[:, k] == pytest.approx(np.subtract(*ends) / 2, rel=1e-5, abs=1e-6)


def test_the_wind_of_the_dynamics_given_is_leant_against():
    wind = {"use": "constant", "speed": 3.0, "direction": 0.4}
    told = scenario(wind=wind)
    trim = SteadyFlight(told, Planner().dynamics(told)).trim()
    assert trim.power_W == pytest.approx(hover_power(hypot(WEIGHT, 1.3 * 3.0)), rel=1e-9)


def test_a_vehicle_that_cannot_hold_is_told():
    def without_lift(told):
        model = build_model(told)
        model.vehicle.thrust_coefficient.set_value(0.0)
        return model

    flight = Planner(without_lift).steady_flight(scenario())
    with pytest.raises(SolveError, match=r"steady flight: the model has none at \[0.0, 0.0, 0.0\]"):
        _ = flight.hover_power


def test_charge_and_energy_of_the_pack_by_its_own_equations():
    told = scenario()
    flight = steady(told)
    hover = flight.hover
    assert flight.pack_capacity == pytest.approx(5.2)
    assert hover.charge_rate_Ah_per_s == pytest.approx(hover.battery_current_A / 3600.0)
    current, voltage, charge_rate = flight.pack_under(200.0)
    assert current * voltage == pytest.approx(200.0)
    assert charge_rate == pytest.approx(current / 3600.0)
    # Some 12 V times 5.2 A h.
    assert flight.stored_energy(0.99, 400) == pytest.approx(12.0 * 5.2 * 3600.0, rel=0.1)


@pytest.mark.lengthy
@pytest.mark.parametrize(
    "forecast", [{}, pytest.param({"forecast": {"use": "calm"}}, marks=pytest.mark.slow)]
)
def test_one_run_builds_a_model_once_for_each_objective(monkeypatch, forecast):
    built = []

    def counted(told):
        built.append(told)
        return build_model(told)

    # Counted where models are cached, the model is still the package's own: its wind is data.
    for place in ("flight.problems", "study.check"):
        monkeypatch.setattr(f"pyomo_quad.{place}.build_model", counted)
    solver = {"elements": 10, "degree": 3, "max_refinements": 0}
    mission = {"goal": {"position": [1.0, 0.0, 0.5]}, "duration": 4.0}
    wind = {"use": "constant", "speed": 0.5} | forecast
    told = scenario(solver=solver, mission=mission, wind=wind)
    result = run.run_scenario(told, planner=Planner(counted), baselines=(Reference.QUINTIC,))
    assert len(result.flights) == 3
    assert result.plan.hover_energy_J == pytest.approx(result.certificate.hover_energy_J)
    # The comparison with the plan of least charge has another objective. Compiled problems are
    # shared between tests, so that its model may have been built before.
    aims = [one.mission.aim for one in built]
    assert Aim.ENERGY in aims
    assert len(aims) == len(set(aims))
