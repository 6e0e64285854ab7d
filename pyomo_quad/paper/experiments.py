"""The two experiments of Yacef et al.: optimal flights, and flights under adaptive control.

One of the power models of these flights divides the shaft power by f_r, the efficiency of motor and
rotor in the paper of Yacef et al. f_r is a polynomial of torque and speed. Its coefficients were
recovered from public re-implementations, because the paper does not print them.
"""

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

#: Power models for which the paper gives the vehicle's numbers: all except the momentum model,
#: which needs the rotor radius.
POWER_MODELS = tuple(model for model in PowerModel if model is not PowerModel.MOMENTUM)

# Name of the scenario, and library name of the wind, for each experiment.
_NAMED = {1: ("paper_calm", "calm"), 2: ("paper_wind", "paper_table_2")}


class Experiment(IntEnum):
    """Experiment of Yacef et al., section IV: a flight in calm air, or the same flight in wind."""

    CALM = 1
    WIND = 2


def paper_scenario(experiment: Experiment, values: Mapping[str, Any] | None = None) -> Scenario:
    """Return the scenario of one of the experiments of Yacef et al.

    `values` has new values of fields by dotted path, such as "mission.duration".
    """
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
    """Settings of a flight of an experiment of Yacef et al. under the adaptive controller.

    The settings are the experiment (calm air or wind), the power model and the reference
    trajectory.
    """

    experiment: Experiment
    power_model: PowerModel
    reference: Reference

    @property
    def title(self) -> str:
        """Experiment and reference as a text for a progress display, without the power model."""
        return f"experiment {self.experiment.value}, {baseline_name(self.reference)}"


@dataclass(frozen=True, kw_only=True)
class BaselineFlight:
    """Simulated flight of an experiment of Yacef et al. under the adaptive controller.

    `case` has the settings of the flight: experiment, power model and reference trajectory.
    `flight` is the simulated flight.
    """

    case: BaselineCase
    flight: Flight


def baseline_cases(*, is_quick: bool = False) -> tuple[BaselineCase, ...]:
    """List the settings of the report's flights under the adaptive controller.

    The power models are `motor` and `efficiency`. The reference trajectories are a polynomial of
    time (`Reference.QUINTIC`) and the constant goal (`Reference.STEP`). If `is_quick` is true,
    flights with the constant goal as reference are left out.
    """
    references = (Reference.QUINTIC,) if is_quick else (Reference.QUINTIC, Reference.STEP)
    cases = product(Experiment, (PowerModel.MOTOR, PowerModel.EFFICIENCY), references)
    return tuple(
        BaselineCase(experiment=experiment, power_model=model, reference=reference)
        for experiment, model, reference in cases
    )


def fly_baseline_case(case: BaselineCase) -> BaselineFlight:
    """Simulate a flight of an experiment of Yacef et al. under the adaptive controller.

    `case` gives the experiment, the power model and the reference trajectory.
    """
    scenario = paper_scenario(case.experiment, {"power.model": case.power_model})
    dynamics = Planner().dynamics(scenario)
    return BaselineFlight(
        case=case, flight=fly_baseline(scenario, case.reference, dynamics=dynamics)
    )


@cache
def full_speed_energy(experiment: Experiment) -> float:
    """Return the energy of an experiment with all rotors at full speed throughout [J].

    The power is computed with the efficiency f_r. The report compares the result with the energy
    that Yacef et al. print for adaptive control.
    """
    scenario = paper_scenario(experiment, {"power.model": PowerModel.EFFICIENCY})
    steady = Planner().steady_flight(scenario)
    # Only a flight whose rotors accelerate and brake all the time takes more energy.
    return float(steady.power(scenario.limits.rotor_speed_max)) * scenario.mission.fixed_duration


# Solver settings for power models whose power is flat or has a kink as a function of the controls.
# Their solves start from the optimum under the motors' electrical power, and two are stopped after
# few iterations: under f_r, Ipopt meets no tolerance, however many iterations it takes.
_STARTED_FROM_MOTOR: dict[PowerModel, dict[str, Any]] = {
    PowerModel.EFFICIENCY: {"solver.max_refinements": 0, "solver.max_iterations": 20},
    PowerModel.CONSTANT_EFFICIENCY: {"solver.max_iterations": 60},
    PowerModel.SHAFT: {},
}
# Settings for a power with a kink at zero, which needs a finer mesh than by the default tolerance.
_TIGHTER: dict[str, Any] = {"solver.tolerance": 3e-7}
_OPTIMA = (PlanStatus.VERIFIED, PlanStatus.SOLVED)
_COARSE: dict[str, Any] = {"solver.elements": 20, "solver.max_refinements": 0}


@dataclass(frozen=True, kw_only=True)
class FlightCase:
    """Settings of an optimal flight of Yacef et al.: experiment, power model, wind and battery.

    The paper leaves open how the wind acts, in which unit its frequencies are, and which battery is
    meant. The fields `coupling`, `frequency_unit` and `battery` choose one possibility each. If
    `is_quick` is true, the mesh is coarse and not refined.
    """

    experiment: Experiment
    power_model: PowerModel
    coupling: WindCoupling = WindCoupling.ACCELERATION
    frequency_unit: FrequencyUnit = FrequencyUnit.RADIAN_PER_SECOND
    battery: str = PHANTOM_PACK
    is_quick: bool = False

    @property
    def title(self) -> str:
        """Experiment and power model as a text for a progress display, without wind and battery."""
        return f"experiment {self.experiment.value}, {self.power_model.value}"

    @property
    def scenario(self) -> Scenario:
        """Scenario of the experiment with these settings."""
        chosen = {
            "power.model": self.power_model,
            "battery.use": self.battery,
            "wind.coupling": self.coupling,
            "wind.frequency_unit": self.frequency_unit,
        }
        return paper_scenario(self.experiment, chosen | (_COARSE if self.is_quick else {}))


@dataclass(frozen=True, kw_only=True)
class PaperFlight:
    """Optimal flight of an experiment of Yacef et al.

    Attributes
    ----------
    case : FlightCase
        Experiment, power model, wind and battery.
    flight : Flight
        The planned flight.
    status : PlanStatus
        Status of the solve. If the solve did not converge, as is possible with f_r, the flight is
        not proven optimal. `flight.is_verified` tells whether a simulation confirms the flight.
    hover_energy_J : float
        Energy of a hover of equal duration, under the same power model [J].
    end_prices : mapping
        Costates at the end, by the state's name; empty without an optimum.
    """

    case: FlightCase
    flight: Flight
    status: PlanStatus
    hover_energy_J: float
    end_prices: Mapping[str, float]


def flight_cases(*, is_quick: bool = False) -> tuple[FlightCase, ...]:
    """List the settings of both experiments of Yacef et al. with each of five power models.

    The model `momentum` is left out, because the paper does not give the rotor radius. If
    `is_quick` is true, the mesh is coarse and not refined.
    """
    return tuple(
        FlightCase(experiment=experiment, power_model=model, is_quick=is_quick)
        for experiment, model in product(Experiment, POWER_MODELS)
    )


def battery_cases(*, is_quick: bool = False) -> tuple[FlightCase, ...]:
    """List the settings of the flight in calm air with each of two batteries.

    They are the pack of the vehicle's maker and the cell of Yacef et al. If `is_quick` is true, the
    mesh is coarse and not refined.
    """
    calm = FlightCase(experiment=Experiment.CALM, power_model=PowerModel.MOTOR, is_quick=is_quick)
    return tuple(replace(calm, battery=battery) for battery in (PHANTOM_PACK, PAPER_CELL))


def wind_cases(*, is_quick: bool = False) -> tuple[FlightCase, ...]:
    """List the settings of the flight in wind with each of four interpretations of the wind.

    The wind acts as an acceleration or by drag, and its frequencies are in rad/s or in Hz. If
    `is_quick` is true, the mesh is coarse and not refined.
    """
    windy = FlightCase(experiment=Experiment.WIND, power_model=PowerModel.MOTOR, is_quick=is_quick)
    readings = product(WindCoupling, FrequencyUnit)
    return tuple(replace(windy, coupling=c, frequency_unit=unit) for c, unit in readings)


def fly_case(case: FlightCase) -> PaperFlight:
    """Plan a flight of an experiment of Yacef et al., and verify it by simulation.

    `case` gives experiment, power model, wind and battery. Under the models `efficiency`,
    `constant_efficiency` and `shaft`, the solve starts from the optimum of the model `motor`.
    """
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
    """Return the flight of a plan, with the result of a simulation of the plan's controls."""
    if plan.verification is not None:
        return plan.flight()
    # The planner simulates the controls of a converged solve only. The report shows a flight even
    # if no optimum was found.
    held = plan.trajectories
    verification, _ = verify_controls(
        plan.dynamics, held.mesh, held.states, held.controls, held.horizon, plan.energy
    )
    flight = replace(plan, verification=verification).flight()
    return replace(flight, is_verified=verification.is_verified)
