"""The paper's experiments as missions, flown under every power model, and on coarse meshes."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum
from functools import cache
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation import Dynamics, Mesh, Solution, SolverOptions, Status
from pyomo_quad.flight import Flight, Plan, Planner, PlanStatus
from pyomo_quad.flight.baselines import baseline_name, fly_baseline
from pyomo_quad.flight.columns import ROTORS
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.flight.steady import battery_shortfalls
from pyomo_quad.flight.verification import fly_controls, verify_controls
from pyomo_quad.model import build_model
from pyomo_quad.scenario import (
    Attitude,
    FrequencyUnit,
    PowerModel,
    Reference,
    Scenario,
    WindCoupling,
    scenario_from_mapping,
)

if TYPE_CHECKING:
    from pyomo.core import ConcreteModel

#: Names of the two batteries in the library.
PAPER_CELL = "paper_cell"
PHANTOM_PACK = "phantom_2_pack"

#: The power models that the paper's vehicle has numbers for: it prints no radius of its rotors.
POWER_MODELS = tuple(model for model in PowerModel if model is not PowerModel.MOMENTUM)

_WIND = {1: "calm", 2: "paper_table_2"}
_NAME = {1: "paper_calm", 2: "paper_wind"}


class Experiment(IntEnum):
    """The tests of the paper's section IV."""

    CALM = 1
    WIND = 2


def paper_scenario(experiment: Experiment, values: Mapping[str, Any] | None = None) -> Scenario:
    """Return an experiment of the paper, with fields changed."""
    scenario = scenario_from_mapping(
        {
            "name": _NAME[experiment],
            "vehicle": {"use": "dji_phantom_2", "attitude": Attitude.PAPER},
            "wind": {"use": _WIND[experiment]},
            "mission": {"duration": 10.0, "goal": {"position": [6.0, 7.0, 8.0], "yaw": 0.0}},
        },
        source=f"experiment {experiment.value} of the paper",
    )
    return scenario.with_values(values) if values else scenario


@dataclass(frozen=True, kw_only=True)
class BaselineCase:
    """One flight under the adaptive controller."""

    experiment: Experiment
    power_model: PowerModel
    reference: Reference

    @property
    def title(self) -> str:
        """What a progress display calls it."""
        return f"experiment {self.experiment.value}, {baseline_name(self.reference)}"


@dataclass(frozen=True, kw_only=True)
class BaselineFlight:
    """A controlled flight with the case that it was flown for."""

    case: BaselineCase
    flight: Flight

    def priced_by(self, optimum: "PaperFlight") -> Flight:
        """Return the flight with what its end owes by the optimum's prices, NaN without any."""
        return self.flight.priced(optimum.end_prices)


def baseline_cases(*, is_quick: bool = False) -> tuple[BaselineCase, ...]:
    """List the controlled flights of the report."""
    references = (Reference.QUINTIC,) if is_quick else (Reference.QUINTIC, Reference.STEP)
    return tuple(
        BaselineCase(experiment=experiment, power_model=model, reference=reference)
        for experiment in Experiment
        for model in (PowerModel.MOTOR, PowerModel.EFFICIENCY)
        for reference in references
    )


def fly_baseline_case(case: BaselineCase) -> BaselineFlight:
    """Fly the adaptive controller through an experiment."""
    scenario = paper_scenario(case.experiment, {"power.model": case.power_model})
    dynamics = Planner().dynamics(scenario)
    return BaselineFlight(
        case=case, flight=fly_baseline(scenario, case.reference, dynamics=dynamics)
    )


@cache
def full_speed_energy(experiment: Experiment) -> float:
    """Return what all rotors steady at their greatest speed take under f_r over an experiment, J.

    To spend more, rotors must speed up and brake all the time.
    """
    scenario = paper_scenario(experiment, {"power.model": PowerModel.EFFICIENCY})
    steady = Planner().steady_flight(scenario)
    return float(steady.power(scenario.limits.rotor_speed_max)) * scenario.mission.fixed_duration


# These powers are flat or kinked in the controls: their solves start from the optimum of the
# motors' power, and some are cut short. Under f_r Ipopt meets no tolerance however long it tries.
_STARTED_FROM_MOTOR: dict[PowerModel, dict[str, Any]] = {
    PowerModel.EFFICIENCY: {"solver.max_refinements": 0, "solver.max_iterations": 20},
    PowerModel.CONSTANT_EFFICIENCY: {"solver.max_iterations": 60},
    PowerModel.SHAFT: {},
}
# The kink of a power at zero is met by more points than the default tolerance asks for.
_TIGHTER: dict[str, Any] = {"solver.tolerance": 3e-7}
_OPTIMA = (PlanStatus.VERIFIED, PlanStatus.SOLVED)
_COARSE: dict[str, Any] = {"solver.elements": 20, "solver.max_refinements": 0}


@dataclass(frozen=True, kw_only=True)
class FlightCase:
    """One optimal flight of the report."""

    experiment: Experiment
    power_model: PowerModel
    coupling: WindCoupling = WindCoupling.ACCELERATION
    frequency_unit: FrequencyUnit = FrequencyUnit.RADIAN_PER_SECOND
    battery: str = PHANTOM_PACK
    is_quick: bool = False

    @property
    def title(self) -> str:
        """What a progress display calls it."""
        return f"experiment {self.experiment.value}, {self.power_model.value}"

    @property
    def scenario(self) -> Scenario:
        """The mission with this case's choices."""
        return paper_scenario(
            self.experiment,
            {
                "power.model": self.power_model,
                "battery.use": self.battery,
                "wind.coupling": self.coupling,
                "wind.frequency_unit": self.frequency_unit,
            }
            | (_COARSE if self.is_quick else {}),
        )


@dataclass(frozen=True, kw_only=True)
class PaperFlight:
    """An optimal flight of the report with what it is measured against.

    Attributes
    ----------
    status : PlanStatus
        Of the solve; a flight under f_r may be verified as a flight though no optimum is proven.
    hover_energy_J : float
        Of hovering for the same time under the same power model.
    cautions : tuple of str
        What the pack lacks.
    end_prices : mapping
        `Plan.end_prices` of a solve that found an optimum; empty of one that did not.
    """

    case: FlightCase
    flight: Flight
    status: PlanStatus
    hover_energy_J: float
    cautions: tuple[str, ...]
    end_prices: Mapping[str, float]


def flight_cases(*, is_quick: bool = False) -> tuple[FlightCase, ...]:
    """List both experiments under every power model."""
    return tuple(
        FlightCase(experiment=experiment, power_model=model, is_quick=is_quick)
        for experiment in Experiment
        for model in POWER_MODELS
    )


def battery_cases(*, is_quick: bool = False) -> tuple[FlightCase, ...]:
    """List the first experiment with both batteries."""
    return tuple(
        FlightCase(
            experiment=Experiment.CALM,
            power_model=PowerModel.MOTOR,
            battery=battery,
            is_quick=is_quick,
        )
        for battery in (PHANTOM_PACK, PAPER_CELL)
    )


def wind_cases(*, is_quick: bool = False) -> tuple[FlightCase, ...]:
    """List the second experiment with both couplings and both readings of the frequencies."""
    return tuple(
        FlightCase(
            experiment=Experiment.WIND,
            power_model=PowerModel.MOTOR,
            coupling=coupling,
            frequency_unit=unit,
            is_quick=is_quick,
        )
        for coupling in WindCoupling
        for unit in FrequencyUnit
    )


def fly_case(case: FlightCase) -> PaperFlight:
    """Plan one flight and verify it by flying."""
    scenario = case.scenario
    plan = _plan(scenario)
    return PaperFlight(
        case=case,
        flight=_flown(plan),
        status=plan.status,
        hover_energy_J=plan.hover_energy_J,
        cautions=battery_shortfalls(scenario, Planner().steady_flight(scenario)),
        end_prices=plan.end_prices if plan.status in _OPTIMA else {},
    )


def _plan(scenario: Scenario) -> Plan:
    model = scenario.power.model
    if model not in _STARTED_FROM_MOTOR:
        return Planner().solve(scenario)
    start = Planner().solve(scenario.with_values({"power.model": PowerModel.MOTOR}))
    bounded = scenario.with_values(_STARTED_FROM_MOTOR[model])
    plan = Planner().solve(bounded, warm_start=start)
    if plan.is_verified or model is PowerModel.EFFICIENCY:
        return plan
    anew = Planner().solve(scenario.with_values(_TIGHTER))
    return anew if anew.is_verified else plan


def _flown(plan: Plan) -> Flight:
    """Return the flight of a plan, with a verdict even where the solve proved no optimum."""
    if plan.verification is not None:
        return plan.flight()
    held = plan.trajectories
    verification, _ = verify_controls(
        plan.dynamics, held.mesh, held.states, held.controls, held.horizon, plan.energy
    )
    flight = replace(plan, verification=verification).flight()
    return replace(flight, is_verified=verification.is_verified)


# So far below every torque [N m] and every value of f_r that the rounded floor changes nothing.
_NO_FLOOR = -1e3


class Reading(StrEnum):
    """How f_r is read where it is small or negative."""

    REGULARISED = "regularised"
    LITERAL = "literal"

    def values(self) -> dict[str, Any]:
        """Return the fields of a scenario that choose this reading."""
        return {
            "power.model": PowerModel.EFFICIENCY,
            "power.regeneration": self is Reading.LITERAL,
        }

    def planner(self) -> Planner:
        """Return a planner whose model reads f_r in this way."""
        return Planner(literal_model if self is Reading.LITERAL else model_without_battery)


def model_without_battery(scenario: Scenario) -> "ConcreteModel":
    """Declare a mission without its battery, for which some powers of f_r have no current."""
    m = build_model(scenario)
    m.del_component(m.battery)
    return m


def literal_model(scenario: Scenario) -> "ConcreteModel":
    """Declare a mission whose f_r is read everywhere as the polynomial stands.

    Parameters
    ----------
    scenario : Scenario
        With `Reading.LITERAL.values`.
    """
    m = model_without_battery(scenario)
    m.power.torque_floor.set_value(_NO_FLOOR)
    m.power.efficiency_floor.set_value(_NO_FLOOR)
    return m


_DEGREE = 4
_ELEMENTS = (5, 10, 20)
_BOUNDS = (300.0, 1000.0, 3000.0, 10000.0)
_SAMPLES_PER_ELEMENT = 400
# Looser than the planner's: a problem without a minimum meets no tolerance for long.
_OPTIONS = SolverOptions(tolerance=1e-6, max_iterations=100)


@dataclass(frozen=True, kw_only=True)
class MeshTrial:
    """A reading of f_r, a bound on the rotor acceleration [rad/s²], and a mesh."""

    reading: Reading
    bound: float
    elements: int
    degree: int = _DEGREE

    @property
    def title(self) -> str:
        """What a progress display calls it."""
        return f"{self.reading.value} f_r, {self.bound:g} rad/s², {self.elements} elements"


@dataclass(frozen=True, kw_only=True)
class TrialOutcome:
    """What the solver reported, and what its controls did when flown.

    Attributes
    ----------
    energy_J : float
        By the quadrature on the mesh.
    flown_energy_J : float
        Energy when the controls are flown; not a number where f_r passes zero on the way.
    miss_m : float
        Distance from the goal when the controls are flown.
    """

    trial: MeshTrial
    has_converged: bool
    energy_J: float
    flown_energy_J: float
    miss_m: float


def mesh_trials(*, is_quick: bool = False) -> tuple[MeshTrial, ...]:
    """List the solves of the study."""
    elements = _ELEMENTS[:1] if is_quick else _ELEMENTS
    return tuple(
        MeshTrial(reading=reading, bound=bound, elements=count)
        for reading, bound, count in product(Reading, _BOUNDS, elements)
    )


def run_trial(trial: MeshTrial) -> TrialOutcome:
    """Solve on one mesh, without refinement, and fly what comes out."""
    scenario = paper_scenario(
        Experiment.CALM,
        trial.reading.values() | {"limits.rotor_acceleration_max": trial.bound},
    )
    planner = trial.reading.planner()
    problem, _ = planner.problem_for(scenario)
    horizon = (0.0, scenario.mission.fixed_duration)
    solution = problem.solve(
        mesh=Mesh.uniform(trial.elements, trial.degree),
        parameters=planner.parameters(scenario),
        horizon=horizon,
        options=_OPTIONS,
    )
    flown_energy, miss = _fly(scenario, solution, planner.dynamics(scenario))
    return TrialOutcome(
        trial=trial,
        has_converged=solution.status is Status.CONVERGED,
        energy_J=solution.objective,
        flown_energy_J=flown_energy,
        miss_m=miss,
    )


def _fly(scenario: Scenario, solution: Solution, priced: Dynamics) -> tuple[float, float]:
    """Return energy and miss of the solution's controls when flown."""
    # The motion does not depend on the power model, and this one has a finite power everywhere.
    steerable = scenario.with_values({"power.model": PowerModel.MOTOR, "power.regeneration": True})
    flown = fly_controls(
        Planner(model_without_battery).dynamics(steerable),
        solution.mesh,
        solution.trajectory.algebraics,
        solution.trajectory.states[0],
        solution.horizon,
        samples_per_element=_SAMPLES_PER_ELEMENT,
    )
    efficiencies = tuple(("power.drive_efficiency", rotor) for rotor in ROTORS)
    keys = (("power.total", None), *efficiencies)
    table = priced.table(keys, flown.t, flown.states, flown.controls)
    energy = float(np.trapezoid(table[:, 0], flown.t))
    position = [priced.state_names.index(name) for name in POSITION_STATES]
    miss = flown.states[-1, position] - scenario.mission.goal.position
    is_priced = bool(np.all(table[:, 1:] > 0.0))
    return energy if is_priced else np.nan, float(np.linalg.norm(miss))
