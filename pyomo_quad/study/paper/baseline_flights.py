"""The stand-in for the paper's adaptive controller, in both experiments."""

from dataclasses import dataclass

from pyomo_quad.flight import Flight, Planner
from pyomo_quad.flight.baselines import baseline_name, fly_baseline
from pyomo_quad.scenario import PowerModel, Reference
from pyomo_quad.study.paper.missions import Experiment, paper_scenario

__all__ = [
    "BaselineCase",
    "BaselineFlight",
    "baseline_cases",
    "fly_baseline_case",
    "full_speed_energy",
]


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


def baseline_cases(*, is_quick: bool = False) -> tuple[BaselineCase, ...]:
    """List the controlled flights of the report.

    Parameters
    ----------
    is_quick : bool
        Only the smooth reference.

    Returns
    -------
    tuple of BaselineCase
        By experiment, power model and reference.
    """
    references = (Reference.QUINTIC,) if is_quick else (Reference.QUINTIC, Reference.STEP)
    return tuple(
        BaselineCase(experiment=experiment, power_model=model, reference=reference)
        for experiment in Experiment
        for model in (PowerModel.MOTOR, PowerModel.EFFICIENCY)
        for reference in references
    )


def fly_baseline_case(case: BaselineCase) -> BaselineFlight:
    """Fly the adaptive controller through an experiment.

    Parameters
    ----------
    case : BaselineCase
        Experiment, power model and reference.

    Returns
    -------
    BaselineFlight
        Through the same declared equations as the optimum.
    """
    scenario = paper_scenario(case.experiment, {"power.model": case.power_model})
    dynamics = Planner().dynamics(scenario)
    return BaselineFlight(
        case=case, flight=fly_baseline(scenario, case.reference, dynamics=dynamics)
    )


def full_speed_energy(experiment: Experiment) -> float:
    """Return what all rotors steady at their greatest speed take under f_r over an experiment, J.

    To spend more, rotors must speed up and brake all the time.
    """
    scenario = paper_scenario(experiment, {"power.model": PowerModel.EFFICIENCY})
    steady = Planner().steady_flight(scenario)
    return float(steady.power(scenario.limits.rotor_speed_max)) * scenario.mission.duration
