"""RotorPy's multirotor against the declared one: the same vehicle, written by others."""

from importlib import util
from types import SimpleNamespace

import numpy as np
import pytest

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.flight import outside_plant
from pyomo_quad.flight.baselines import reference_path, start_state
from pyomo_quad.flight.controller import MEASURED_STATES
from pyomo_quad.flight.outside_plant import (
    ACROSS,
    AS_IT_COMES,
    MASSLESS_ROTORS,
    Habits,
    OutsidePlant,
    Pilot,
    fly_outside,
    quad_parameters,
    refuse_pushing_wind,
    rotorpy_module,
    se3_law,
)
from pyomo_quad.scenario import Reference, ScenarioError
from pyomo_quad.study.comparison import has_arrived
from tests import flights
from tests.command import PAPER_CALM, QUICK

EXACT = 'vehicle.attitude="euler"'
HOP = (EXACT, "mission.goal.position=[1.0, 0.5, 0.5]", "mission.duration=2.0")
AIR = (
    "vehicle.rotor_drag_plane=1e-4",
    "vehicle.rotor_drag_axis=2e-4",
    "vehicle.translational_lift=3e-3",
    "vehicle.parasitic_drag=[0.01, 0.02, 0.03]",
)
WIND = (
    "wind.use=constant",
    "wind.speed=4.0",
    "wind.vertical=0.7",
    "wind.profile={law='power', exponent=0.3}",
    "wind.coupling=drag",
    "vehicle.drag_linear=0.0",
    "vehicle.drag_quadratic=0.02",
)
has_rotorpy = pytest.mark.skipif(util.find_spec("rotorpy") is None, reason="no RotorPy")


def random_states(dynamics, count):
    random = np.random.default_rng(5)
    scale = {"phi": 0.6, "theta": 0.6, "psi": 2.0}
    for _ in range(count):
        yield np.array(
            [
                random.uniform(600, 1000) if "omega" in name else
                random.uniform(0, 1) if "charge" in name else
                scale.get(name.rpartition(".")[2], 1.5) * random.uniform(-1, 1)
                for name in dynamics.state_names
            ]
        ), random.uniform(-500, 500, 4)  # fmt: skip


def turned(parameters):
    """Return the same vehicle in the frame of one with two rotors ahead."""
    places = list(parameters["rotor_pos"].values())
    turn = np.array([[np.cos(ACROSS.turn), np.sin(ACROSS.turn), 0.0],
                     [-np.sin(ACROSS.turn), np.cos(ACROSS.turn), 0.0],
                     [0.0, 0.0, 1.0]])  # fmt: skip
    ordered = {f"r{k}": turn @ places[j] for k, j in enumerate(ACROSS.order, start=1)}
    spins = parameters["rotor_directions"][list(ACROSS.order)]
    return parameters | {"rotor_pos": ordered, "rotor_directions": spins}


@has_rotorpy
@pytest.mark.parametrize(("frame", "air"), [(None, ()), (ACROSS, ()), (None, AIR), (None, WIND)])
def test_it_moves_as_the_declared_equations_say(frame, air):
    """At random states, tilted and turning, whichever way its body is named, and in the air."""
    scenario = flights.scenario("paper_calm", EXACT, *air)
    dynamics = flights.vehicle("paper_calm", EXACT, *air)
    parameters = quad_parameters(scenario, dynamics)
    plant = OutsidePlant(
        scenario,
        dynamics,
        parameters=parameters if frame is None else turned(parameters),
        frame=frame,
    )
    step = 1e-6
    for x, alpha in random_states(dynamics, 10):
        joint = plant.started(x, ())
        assert plant.read(joint) == pytest.approx(x, rel=1e-12, abs=1e-12)
        slope = plant.rates(0.0, joint, lambda _t, _x, _own, alpha=alpha: (alpha, ()))
        moved = [plant.read(joint + sign * step * slope) for sign in (-1, 1)]
        declared, power = dynamics.rates_and_integrand(0.0, x, alpha)
        assert (moved[1] - moved[0]) / (2 * step) == pytest.approx(declared, rel=1e-6, abs=1e-6)
        assert slope[-1] == pytest.approx(power, rel=1e-12)


@has_rotorpy
def test_with_exact_attitude_the_plan_ends_micrometres_off_without_feedback():
    scenario, plan = flights.scenario("paper_calm", *HOP), flights.plan("paper_calm", *HOP)
    plant = OutsidePlant(scenario, flights.vehicle("paper_calm", *HOP))
    flight = fly_outside(plant, Pilot.OPEN_LOOP, Reference.PLAN, plan)
    assert flight.name == "rotorpy/open_loop/plan"
    assert flight.terminal_miss_m < 2e-5
    assert flight.energy_J == pytest.approx(plan.energy, rel=1e-6)
    assert flight.is_verified
    bare = OutsidePlant(scenario, flights.vehicle("paper_calm", *HOP), habits=MASSLESS_ROTORS)
    assert fly_outside(bare, Pilot.OPEN_LOOP, Reference.PLAN, plan).terminal_miss_m > 1e-4


@has_rotorpy
def test_se3_is_told_the_heading_of_the_body_that_it_turns():
    """Where the path begins, at rest, it asks for hover, whichever way its body is named."""
    scenario, dynamics = flights.scenario("paper_calm", *HOP), flights.vehicle("paper_calm", *HOP)
    theirs = turned(quad_parameters(scenario, dynamics))
    plant = OutsidePlant(scenario, dynamics, parameters=theirs, frame=ACROSS)
    law = se3_law(plant, reference_path(scenario, Reference.QUINTIC))
    assert law(0.0, start_state(scenario, dynamics), ())[0] == pytest.approx([0.0] * 4, abs=1e-6)


@has_rotorpy
def test_held_commands_fly_as_the_simulators_own_steps_do():
    """RotorPy's public step, with its own integrator, motors and clock, is the other writing."""
    hop = (*HOP, "mission.duration=0.6")
    scenario, dynamics = flights.scenario("paper_calm", *hop), flights.vehicle("paper_calm", *hop)
    plant = OutsidePlant(scenario, dynamics, habits=AS_IT_COMES)
    path = reference_path(scenario, Reference.QUINTIC)
    rate, start = AS_IT_COMES.command_rate_hz, start_state(scenario, dynamics)
    law = se3_law(plant, path)
    flown = plant.fly(law, start, (), (0.0, 0.6), integrator="RK45", tolerance=1e-3)
    vehicle = rotorpy_module("vehicles.multirotor").Multirotor(plant.parameters)
    state = {name: value.copy() for name, value in plant.seen(start).items()}
    state["wind"] = np.zeros(3)
    lag, limits = plant.parameters["tau_m"], scenario.limits
    for k in range(round(0.6 * rate)):
        x = plant.read(np.concatenate([*(state[n] for n in ("x", "v", "q", "w", "wind")),
                                       state["rotor_speeds"], np.zeros(4)]))  # fmt: skip
        command = state["rotor_speeds"] + lag * np.array(law(k / rate, x, ())[0])
        state = vehicle.step(state, {"cmd_motor_speeds": command}, 1.0 / rate)
    assert limits.rotor_speed_min < state["rotor_speeds"].min()
    place = [dynamics.state_names.index(f"rigid_body.{axis}") for axis in "xyz"]
    # Both integrate to a thousandth.
    way = np.linalg.norm(state["x"])
    assert flown.states[-1, place] == pytest.approx(state["x"], abs=1e-3 * way)
    assert way > 0.1


@has_rotorpy
def test_gravity_of_its_own_is_missed_by_what_falling_gives():
    scenario, dynamics = flights.scenario("paper_calm", *HOP), flights.vehicle("paper_calm", *HOP)
    lighter = OutsidePlant(scenario, dynamics, habits=Habits(gravity=scenario.gravity - 0.1))
    flight = fly_outside(lighter, Pilot.OPEN_LOOP, Reference.PLAN, flights.plan("paper_calm", *HOP))
    assert flight.terminal_miss["rigid_body.z"] == pytest.approx(0.1 * 2.0**2 / 2, rel=1e-3)


@has_rotorpy
@pytest.mark.slow
@pytest.mark.parametrize("pilot", [Pilot.ADAPTIVE, Pilot.SE3])
def test_both_controllers_arrive(pilot):
    slower = (*HOP, "mission.duration=5.0")
    plant = OutsidePlant(
        flights.scenario("paper_calm", *slower), flights.vehicle("paper_calm", *slower)
    )
    flight = fly_outside(plant, pilot, Reference.QUINTIC, flights.plan("paper_calm", *slower))
    assert has_arrived(flight)
    assert flight.is_verified


def test_without_rotorpy_the_extra_is_named_and_nothing_is_written(monkeypatch, tmp_path, capsys):
    def missing(name):
        raise ModuleNotFoundError(name=name.partition(".")[0])

    monkeypatch.setattr(outside_plant, "import_module", missing)
    with pytest.raises(ScenarioError, match=r"pip install 'pyomo_quad\[rotorpy\]'"):
        rotorpy_module("vehicles.multirotor")
    out = tmp_path / "flight"
    command = ["fly", PAPER_CALM, *QUICK, "--plant", "rotorpy", "--out", str(out)]
    assert main(command) == ExitCode.BAD_INPUT
    assert capsys.readouterr().err == (
        "RotorPy is not installed; install it with pip install 'pyomo_quad[rotorpy]'.\n"
    )
    assert not out.exists()


def test_a_wind_that_only_pushes_has_no_counterpart():
    with pytest.raises(ScenarioError, match=r"wind\.coupling = acceleration has no counterpart"):
        refuse_pushing_wind(flights.scenario("paper_wind"))
    refuse_pushing_wind(flights.scenario("paper_calm"))
    with pytest.raises(ScenarioError, match=r"wind\.coupling = acceleration has no counterpart"):
        refuse_pushing_wind(flights.scenario("paper_calm", "wind.vertical=0.5"))
    refuse_pushing_wind(flights.scenario("paper_wind", "wind.coupling='drag'"))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--controller", "se3"], "--controller se3 is RotorPy's; add --plant rotorpy."),
        (["--controller", "mpc", "--plant", "rotorpy"], "is flown by --controller adaptive, se3"),
    ],
)
def test_controllers_that_do_not_fit_the_plant(options, said, capsys):
    assert main(["fly", PAPER_CALM, *options]) == ExitCode.BAD_INPUT
    assert said in capsys.readouterr().err


def test_six_rotors_are_not_handed_over():
    rotors = range(1, 7)
    six = SimpleNamespace(
        state_names=(*MEASURED_STATES, *(f"rotors.omega[{j}]" for j in rotors)),
        control_names=tuple(f"rotors.alpha[{j}]" for j in rotors),
    )
    with pytest.raises(ScenarioError, match="is flown with four rotors, the vehicle has 6"):
        OutsidePlant(flights.scenario("paper_calm"), six)
