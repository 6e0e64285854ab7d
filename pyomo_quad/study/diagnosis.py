"""What is wrong or doubtful about a mission, told before it is solved.

Found by bounds and by reading the declarations, in a second and without a solve; what only a
solve can find out, such as a detour that a limit forces, is left to its own diagnosis.
"""

from collections.abc import Iterator
from math import pi, radians

from pyomo_quad.flight import Planner
from pyomo_quad.model import build_model
from pyomo_quad.model.custom import Builder
from pyomo_quad.model.finding import Finding, Severity
from pyomo_quad.model.screening import screen_model
from pyomo_quad.scenario import Scenario, describe_fields
from pyomo_quad.scenario.fields import unit_of
from pyomo_quad.scenario.limits import derived_limits
from pyomo_quad.study.pack_limits import pack_findings
from pyomo_quad.study.power_range import power_findings
from pyomo_quad.study.reach import reach_findings

__all__ = ["diagnose"]

_ROUNDING = 1e-9


def diagnose(
    scenario: Scenario, *, builder: Builder = build_model, planner: Planner | None = None
) -> tuple[Finding, ...]:
    """List what the mission must break and what deserves a second look.

    Parameters
    ----------
    scenario : Scenario
        The mission; judged in the wind that the optimiser is told.
    builder : callable, optional
        Makes the Pyomo model. Of a model of the user's own the declarations alone are looked at:
        what its vehicle can do is not known.
    planner : Planner, optional
        One that may hold the compiled equations already, with a builder of its own.

    Returns
    -------
    tuple of Finding
        The impossible first; empty when nothing was found, which proves nothing.
    """
    told = scenario.as_forecast()
    findings = list(_angles_in_degrees(scenario))
    planner = planner or Planner(builder)
    if planner.builder is build_model:
        findings += reach_findings(told, planner)
        findings += pack_findings(told, planner)
        findings += power_findings(told, planner.steady_flight(told))
        findings += _idle_limits(told)
    findings += screen_model(planner.model(told))
    return tuple(sorted(findings, key=lambda f: f.severity is not Severity.IMPOSSIBLE))


def _angles_in_degrees(scenario: Scenario) -> Iterator[Finding]:
    """Yield angles of more than a turn."""
    for field in describe_fields(scenario):
        if field.unit == "rad" and isinstance(field.value, float) and abs(field.value) > 2 * pi:
            degrees = field.value
            yield Finding(
                severity=Severity.CAUTION,
                subject=field.path,
                message=f"{field.path} = {degrees:g} rad is {abs(degrees) / (2 * pi):.3g} turns; "
                f"were degrees meant? {degrees:g} degrees are {radians(degrees):.4g} rad.",
            )


def _idle_limits(scenario: Scenario) -> Iterator[Finding]:
    """Yield limits that the rotors cannot reach."""
    limits = scenario.limits
    reachable = derived_limits(scenario.vehicle, limits.rotor_speed_max)
    for name, greatest in reachable.items():
        limit = getattr(limits, name)
        if limit > greatest * (1 + _ROUNDING):
            unit = unit_of(type(limits), name).replace("*", " ")
            yield Finding(
                severity=Severity.CAUTION,
                subject=f"limits.{name}",
                message=f"limits.{name} = {limit:.4g} {unit}: never reached, rotors at "
                f"limits.rotor_speed_max give {greatest:.4g} {unit}; leave it out.",
            )
