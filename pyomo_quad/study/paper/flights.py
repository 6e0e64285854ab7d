"""The paper's experiments flown: the optimum under every power model, and the baseline."""

from dataclasses import dataclass, replace
from typing import Any

from pyomo_quad.flight import Flight, Plan, Planner, PlanStatus
from pyomo_quad.flight.steady import battery_shortfalls
from pyomo_quad.flight.verification import verify_controls
from pyomo_quad.scenario import FrequencyUnit, PowerModel, Scenario, WindCoupling
from pyomo_quad.study.paper.missions import PAPER_CELL, PHANTOM_PACK, Experiment, paper_scenario

__all__ = ["FlightCase", "PaperFlight", "battery_cases", "flight_cases", "fly_case", "wind_cases"]

# These powers are flat or kinked in the controls: their solves start from the optimum of the
# motors' power, and some are cut short. Under f_r Ipopt meets no tolerance however long it tries.
_STARTED_FROM_MOTOR: dict[PowerModel, dict[str, Any]] = {
    PowerModel.EFFICIENCY: {"solver.max_refinements": 0, "solver.max_iterations": 20},
    PowerModel.CONSTANT_EFFICIENCY: {"solver.max_iterations": 60},
    PowerModel.SHAFT: {},
}
# The kink of a power at zero is met by more points than the default tolerance asks for.
_TIGHTER: dict[str, Any] = {"solver.tolerance": 3e-7}
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
    """

    case: FlightCase
    flight: Flight
    status: PlanStatus
    hover_energy_J: float
    cautions: tuple[str, ...]


def flight_cases(*, is_quick: bool = False) -> tuple[FlightCase, ...]:
    """List both experiments under every power model.

    Parameters
    ----------
    is_quick : bool
        On coarse meshes.

    Returns
    -------
    tuple of FlightCase
        By experiment.
    """
    return tuple(
        FlightCase(experiment=experiment, power_model=model, is_quick=is_quick)
        for experiment in Experiment
        for model in PowerModel
    )


def battery_cases(*, is_quick: bool = False) -> tuple[FlightCase, ...]:
    """List the first experiment with both batteries.

    Parameters
    ----------
    is_quick : bool
        On coarse meshes.

    Returns
    -------
    tuple of FlightCase
        Under the motor's electrical power.
    """
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
    """List the second experiment with both couplings and both readings of the frequencies.

    Parameters
    ----------
    is_quick : bool
        On coarse meshes.

    Returns
    -------
    tuple of FlightCase
        Under the motor's electrical power.
    """
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
    """Plan one flight and verify it by flying.

    Parameters
    ----------
    case : FlightCase
        Experiment, power model and wind.

    Returns
    -------
    PaperFlight
        Of a solve that did not converge: the best flight found.
    """
    scenario = case.scenario
    plan = _plan(scenario)
    return PaperFlight(
        case=case,
        flight=_flown(plan),
        status=plan.status,
        hover_energy_J=plan.hover_energy_J,
        cautions=battery_shortfalls(scenario, Planner().steady_flight(scenario)),
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
