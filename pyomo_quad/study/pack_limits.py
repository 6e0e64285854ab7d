"""Whether the pack can feed the flight within the limits that the scenario sets on it.

The mean power of any flight is at least that of the certificate, and the pack is at its fullest at
the start, so its current, voltage and charge there bound those of every flight.
"""

from collections.abc import Iterator

from pyomo_quad.flight import Planner
from pyomo_quad.flight.steady import SteadyFlight, battery_shortfalls
from pyomo_quad.model.finding import Finding, Severity
from pyomo_quad.scenario import Scenario
from pyomo_quad.study.certificate import certify

__all__ = ["pack_findings"]


def pack_findings(scenario: Scenario, planner: Planner) -> Iterator[Finding]:
    """Yield what the battery cannot give, and which of its limits the flight must break.

    Parameters
    ----------
    scenario : Scenario
        The mission.
    planner : Planner
        Gives its vehicle.

    Yields
    ------
    Finding
        A caution where the pack is too small, since its equations stay finite beyond empty;
        impossible where a limit must be broken.
    """
    steady = planner.steady_flight(scenario)
    for line in battery_shortfalls(scenario, steady):
        yield Finding(severity=Severity.CAUTION, subject="battery.use", message=line)
    yield from _charge_at_start(scenario)
    limits = scenario.limits
    is_limited = any(
        limit is not None
        for limit in (
            limits.state_of_charge_min,
            limits.battery_current_max,
            limits.battery_voltage_min,
        )
    )
    if is_limited:
        bound = certify(scenario, planner=planner).lower_bound_J
        if bound is not None:
            yield from _limits_broken(scenario, steady, bound)


def _impossible(subject: str, message: str) -> Finding:
    return Finding(severity=Severity.IMPOSSIBLE, subject=subject, message=f"{subject} = {message}")


def _charge_at_start(scenario: Scenario) -> Iterator[Finding]:
    lowest, initial = scenario.limits.state_of_charge_min, scenario.battery.initial_state_of_charge
    if lowest is not None and initial < lowest:
        yield _impossible(
            "limits.state_of_charge_min",
            f"{lowest:.4g} percent; must be at most battery.initial_state_of_charge, "
            f"{initial:.4g} percent.",
        )


def _limits_broken(scenario: Scenario, steady: SteadyFlight, bound: float) -> Iterator[Finding]:
    limits, duration = scenario.limits, scenario.mission.duration
    current, voltage, charge_rate = steady.pack_under(bound / duration)
    taken = charge_rate * duration
    drawn = 100.0 * taken / steady.pack_capacity
    left = scenario.battery.initial_state_of_charge - drawn
    lowest = limits.state_of_charge_min
    if lowest is not None and left < lowest <= scenario.battery.initial_state_of_charge:
        yield _impossible(
            "limits.state_of_charge_min",
            f"{lowest:.4g} percent: the flight takes at least {taken:.4g} Ah and leaves at most "
            f"{left:.4g} percent; lower the limit or add cells.",
        )
    if limits.battery_current_max is not None and current > limits.battery_current_max:
        yield _impossible(
            "limits.battery_current_max",
            f"{limits.battery_current_max:.4g} A: the mean current of any flight is at least "
            f"{current:.4g} A; raise the limit or add cells in series.",
        )
    if limits.battery_voltage_min is not None and voltage < limits.battery_voltage_min:
        yield _impossible(
            "limits.battery_voltage_min",
            f"{limits.battery_voltage_min:.4g} V: under the mean current the pack has at most "
            f"{voltage:.4g} V; lower the limit or add cells in series.",
        )
