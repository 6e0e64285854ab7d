"""The paper's experiments as missions, and their optimal and controlled flights."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cache
from itertools import product
from typing import Any

from pyomo_quad.flight import Flight, Plan, Planner, PlanStatus
from pyomo_quad.flight.baselines import baseline_name, fly_baseline
from pyomo_quad.flight.verification import verify_controls
from pyomo_quad.scenario import (
    Attitude,
    FrequencyUnit,
    PowerModel,
    Reference,
    Scenario,
    WindCoupling,
    scenario_from_mapping,
)
from pyomo_quad.scenario.accuracy import Accuracy

#: Names of the two batteries in the library.
PAPER_CELL = "paper_cell"
PHANTOM_PACK = "phantom_2_pack"

#: The power models for which the paper gives the vehicle's numbers; it gives no rotor radius.
POWER_MODELS = tuple(model for model in PowerModel if model is not PowerModel.MOMENTUM)

# Name and wind of each experiment's scenario.
_NAMED = {1: ("paper_calm", "calm"), 2: ("paper_wind", "paper_table_2")}


class Experiment(IntEnum):
    """Tests of the paper's section IV."""

    CALM = 1
    WIND = 2


def paper_scenario(experiment: Experiment, values: Mapping[str, Any] | None = None) -> Scenario:
    """Return an experiment of the paper, with fields changed."""
    name, wind = _NAMED[experiment]
    scenario = scenario_from_mapping(
        {
            "name": name,
            "vehicle": {"use": "dji_phantom_2", "attitude": Attitude.PAPER},
            "wind": {"use": wind, "coupling": WindCoupling.ACCELERATION},
            "mission": {"duration": 10.0, "goal": {"position": [6.0, 7.0, 8.0], "yaw": 0.0}},
            "solver": {"accuracy": Accuracy.PROOF},
        },
        source=f"experiment {experiment.value} of the paper",
    )
    return scenario.with_values(values) if values else scenario


@dataclass(frozen=True, kw_only=True)
class BaselineCase:
    """Case of a flight under the adaptive controller: experiment, power model, reference."""

    experiment: Experiment
    power_model: PowerModel
    reference: Reference

    @property
    def title(self) -> str:
        """Name of the flight in a progress display."""
        return f"experiment {self.experiment.value}, {baseline_name(self.reference)}"


@dataclass(frozen=True, kw_only=True)
class BaselineFlight:
    """Flight under the adaptive controller, with its case."""

    case: BaselineCase
    flight: Flight


def baseline_cases(*, is_quick: bool = False) -> tuple[BaselineCase, ...]:
    """List the controlled flights of the report."""
    references = (Reference.QUINTIC,) if is_quick else (Reference.QUINTIC, Reference.STEP)
    cases = product(Experiment, (PowerModel.MOTOR, PowerModel.EFFICIENCY), references)
    return tuple(
        BaselineCase(experiment=experiment, power_model=model, reference=reference)
        for experiment, model, reference in cases
    )


def fly_baseline_case(case: BaselineCase) -> BaselineFlight:
    """Simulate the adaptive controller in an experiment."""
    scenario = paper_scenario(case.experiment, {"power.model": case.power_model})
    dynamics = Planner().dynamics(scenario)
    return BaselineFlight(
        case=case, flight=fly_baseline(scenario, case.reference, dynamics=dynamics)
    )


@cache
def full_speed_energy(experiment: Experiment) -> float:
    """Return the energy under f_r of all rotors at full speed throughout an experiment [J].

    To spend more, the rotors would have to accelerate and brake all the time.
    """
    scenario = paper_scenario(experiment, {"power.model": PowerModel.EFFICIENCY})
    steady = Planner().steady_flight(scenario)
    return float(steady.power(scenario.limits.rotor_speed_max)) * scenario.mission.fixed_duration


# These powers are flat or kinked in the controls: their solves start from the optimum under the
# motors' power, and two of them stop after few iterations. Under f_r, Ipopt meets no tolerance,
# however many iterations it takes.
_STARTED_FROM_MOTOR: dict[PowerModel, dict[str, Any]] = {
    PowerModel.EFFICIENCY: {"solver.max_refinements": 0, "solver.max_iterations": 20},
    PowerModel.CONSTANT_EFFICIENCY: {"solver.max_iterations": 60},
    PowerModel.SHAFT: {},
}
# A power with a kink at zero needs more points than the default tolerance requires.
_TIGHTER: dict[str, Any] = {"solver.tolerance": 3e-7}
_OPTIMA = (PlanStatus.VERIFIED, PlanStatus.SOLVED)
_COARSE: dict[str, Any] = {"solver.elements": 20, "solver.max_refinements": 0}


@dataclass(frozen=True, kw_only=True)
class FlightCase:
    """Case of an optimal flight: experiment, power model and readings."""

    experiment: Experiment
    power_model: PowerModel
    coupling: WindCoupling = WindCoupling.ACCELERATION
    frequency_unit: FrequencyUnit = FrequencyUnit.RADIAN_PER_SECOND
    battery: str = PHANTOM_PACK
    is_quick: bool = False

    @property
    def title(self) -> str:
        """Name of the flight in a progress display."""
        return f"experiment {self.experiment.value}, {self.power_model.value}"

    @property
    def scenario(self) -> Scenario:
        """The mission with the settings of this case."""
        chosen = {
            "power.model": self.power_model,
            "battery.use": self.battery,
            "wind.coupling": self.coupling,
            "wind.frequency_unit": self.frequency_unit,
        }
        return paper_scenario(self.experiment, chosen | (_COARSE if self.is_quick else {}))


@dataclass(frozen=True, kw_only=True)
class PaperFlight:
    """Optimal flight of a case, with the energy of hovering for the same time.

    Attributes
    ----------
    status : PlanStatus
        Status of the solve; a flight under f_r may be verified although its solve proves no
        optimum.
    hover_energy_J : float
        Energy of hovering for the same time under the same power model.
    end_prices : mapping
        `Plan.end_prices` of a solve that found an optimum, else empty.
    """

    case: FlightCase
    flight: Flight
    status: PlanStatus
    hover_energy_J: float
    end_prices: Mapping[str, float]


def flight_cases(*, is_quick: bool = False) -> tuple[FlightCase, ...]:
    """List both experiments under every power model."""
    return tuple(
        FlightCase(experiment=experiment, power_model=model, is_quick=is_quick)
        for experiment, model in product(Experiment, POWER_MODELS)
    )


def battery_cases(*, is_quick: bool = False) -> tuple[FlightCase, ...]:
    """List the first experiment with both batteries."""
    calm = FlightCase(experiment=Experiment.CALM, power_model=PowerModel.MOTOR, is_quick=is_quick)
    return tuple(replace(calm, battery=battery) for battery in (PHANTOM_PACK, PAPER_CELL))


def wind_cases(*, is_quick: bool = False) -> tuple[FlightCase, ...]:
    """List the second experiment with both couplings and both readings of the frequencies."""
    windy = FlightCase(experiment=Experiment.WIND, power_model=PowerModel.MOTOR, is_quick=is_quick)
    readings = product(WindCoupling, FrequencyUnit)
    return tuple(replace(windy, coupling=c, frequency_unit=unit) for c, unit in readings)


def fly_case(case: FlightCase) -> PaperFlight:
    """Plan the flight of a case and verify it by simulation."""
    plan = _plan(case.scenario, Planner())
    return PaperFlight(
        case=case,
        flight=_flown(plan),
        status=plan.status,
        hover_energy_J=plan.hover_energy_J,
        end_prices=plan.end_prices if plan.status in _OPTIMA else {},
    )


def _plan(scenario: Scenario, planner: Planner) -> Plan:
    model = scenario.power.model
    if model not in _STARTED_FROM_MOTOR:
        return planner.solve(scenario)
    start = planner.solve(scenario.with_values({"power.model": PowerModel.MOTOR}))
    bounded = scenario.with_values(_STARTED_FROM_MOTOR[model])
    plan = planner.solve(bounded, warm_start=start)
    if plan.is_verified or model is PowerModel.EFFICIENCY:
        return plan
    anew = planner.solve(scenario.with_values(_TIGHTER))
    return anew if anew.is_verified else plan


def _flown(plan: Plan) -> Flight:
    """Verify the flight of a plan even if the solve did not prove it optimal."""
    if plan.verification is not None:
        return plan.flight()
    held = plan.trajectories
    verification, _ = verify_controls(
        plan.dynamics, held.mesh, held.states, held.controls, held.horizon, plan.energy
    )
    flight = replace(plan, verification=verification).flight()
    return replace(flight, is_verified=verification.is_verified)
