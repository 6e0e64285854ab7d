"""The parts of the paper's study against closed forms and against each other."""

import importlib

import numpy as np
import pytest

from pyomo_quad.model.typeset import EQUATION_TABLE
from pyomo_quad.paper.experiments import Experiment, paper_scenario
from pyomo_quad.paper.readings import MeshTrial, Reading, run_trial
from pyomo_quad.paper.rotor_map import (
    chattering_floors,
    critical_acceleration,
    envelope_at,
    floor_energy,
    rotor_map,
)
from pyomo_quad.paper.study import pack_facts
from pyomo_quad.paper.tables import SAVING, implied_wind_optimum
from pyomo_quad.scenario import load_scenario
from tests.flights import PLANNER

# f_r as recovered, written again from its source: rows are powers of the torque.
CUBIC, QUADRATIC = (-1.72e-5, 0.014, -0.8796), (1.95e-5, -0.0157, 0.3385)
LINEAR, CONSTANT = (-6.98e-6, 5.656e-3, 0.2890), (4.09e-7, -3.908e-4, 0.1626)
INERTIA, DRAG = 4.1904e-5, 2.2518e-8


def efficiency(torque, speed):
    rows = (CUBIC, QUADRATIC, LINEAR, CONSTANT)
    return np.polyval([np.polyval(row, speed) for row in rows], torque)


@pytest.mark.parametrize("experiment", Experiment)
def test_the_papers_missions_are_those_of_the_scenario_files(experiment):
    named = {Experiment.CALM: "paper_calm", Experiment.WIND: "paper_wind"}[experiment]
    from_file = load_scenario(f"scenarios/{named}.toml")
    # Which controllers fly it beside the plan is the file's own affair.
    chosen = {"title": from_file.title, "baseline": from_file.baseline}
    assert paper_scenario(experiment).model_copy(update=chosen) == from_file


def test_every_equation_of_the_paper_is_declared_by_a_function_that_exists():
    assert sorted(EQUATION_TABLE) == list(range(1, 13))
    for functions in EQUATION_TABLE.values():
        for path in functions:
            module, _, name = path.rpartition(".")
            assert callable(getattr(importlib.import_module(module), name))


def test_the_envelope_of_a_parabola_is_itself_and_of_a_cap_its_chord():
    x = np.linspace(-1.0, 3.0, 401)
    assert envelope_at(x, x**2, 0.5) == pytest.approx(0.25, abs=1e-4)
    assert envelope_at(x, -(x**2), 0.0) == pytest.approx(-3.0)
    assert envelope_at(x, np.stack([x, 2 * x]), 1.0) == pytest.approx([1.0, 2.0])


def test_the_floor_of_a_convex_power_is_hover():
    scenario = paper_scenario(Experiment.CALM)
    acceleration = np.linspace(-3000.0, 3000.0, 61)
    hover = scenario.vehicle.hover_speed(scenario.gravity)
    speed = np.sort(np.append(np.linspace(0.0, scenario.limits.rotor_speed_max, 61), hover))
    sampled = rotor_map(PLANNER.dynamics(scenario), speed, acceleration, None)
    floor = floor_energy(scenario, sampled, 3000.0)
    assert floor == pytest.approx(
        PLANNER.steady_flight(scenario).hover_power * scenario.mission.duration, rel=1e-9
    )


def test_the_literal_reading_is_the_polynomial():
    scenario = paper_scenario(Experiment.CALM, Reading.LITERAL.values())
    speed, acceleration = np.array([400.0, 912.0]), np.array([-2000.0, 0.0, 4000.0])
    dynamics = Reading.LITERAL.planner().dynamics(scenario)
    sampled = rotor_map(dynamics, speed, acceleration, "power.drive_efficiency")
    for i, one in enumerate(speed):
        torque = INERTIA * acceleration + DRAG * one**2
        assert sampled.torque[i] == pytest.approx(torque)
        assert sampled.efficiency[i] == pytest.approx(efficiency(torque, one), abs=1e-9)
        expected = torque * one / efficiency(torque, one)
        assert sampled.power[i] == pytest.approx(expected, rel=1e-6)


def test_f_r_first_passes_zero_where_the_polynomial_does():
    bound, speed = critical_acceleration()
    torque = -INERTIA * bound + DRAG * speed**2
    assert efficiency(torque, speed) == pytest.approx(0.0, abs=1e-4)
    speeds = np.linspace(0.0, 1047.0, 800)[:, None]
    braking = np.linspace(-bound * 0.99, 0.0, 200)[None, :]
    allowed = INERTIA * braking + DRAG * speeds**2
    smallest = min(efficiency(row, one[0]).min() for row, one in zip(allowed, speeds, strict=True))
    assert smallest > 0.0


@pytest.mark.lengthy
def test_a_literal_floor_is_infinite_beyond_the_zero_and_both_fall_with_the_bound():
    critical, _ = critical_acceleration()
    bounds = (30.0, 300.0, 1000.0, critical + 50.0)
    for reading in Reading:
        energies = chattering_floors(reading, bounds)[:, 1]
        assert np.all(np.diff(energies) < 0.0)
        assert np.isinf(energies[-1]) == (reading is Reading.LITERAL)


@pytest.mark.slow
def test_a_coarse_optimum_of_the_literal_problem_does_not_survive_a_flight():
    outcome = run_trial(MeshTrial(reading=Reading.LITERAL, bound=300.0, elements=5))
    floor = chattering_floors(Reading.LITERAL, (300.0,))[0, 1]
    assert outcome.energy_J > floor
    assert outcome.miss_m > 0.1


def test_the_papers_cell_alone_cannot_carry_its_vehicle():
    packs = pack_facts()
    alone = packs[0]
    assert alone.shortfalls
    # U^2 / 4 R of a full cell, with the digits of Table 1.
    assert alone.greatest_power_W == pytest.approx((1.24 - 2.92e-3 + 0.156) ** 2 / (4 * 0.02))
    drawn = np.linspace(0.0, 0.99 * 1.55, 20001)
    voltage = 1.24 - 2.92e-3 * 1.55 / (1.55 - drawn) + 0.156 * np.exp(-2.35 * drawn)
    assert alone.stored_energy_J == pytest.approx(np.trapezoid(voltage, drawn) * 3600, rel=1e-4)
    assert not packs[2].shortfalls


def test_the_percentage_in_wind_implies_the_optimum_that_is_not_printed():
    assert implied_wind_optimum() == pytest.approx(2060.0, abs=1.0)
    reduction = 100 * (1 - 1.89 / 5.77)
    assert reduction == pytest.approx(SAVING[1], abs=0.01)
