"""Minimum-energy flight of a quadrotor in wind: planning, verification and comparison.

A scenario describes vehicle, battery, wind and mission. `load_scenario` reads a scenario file.
`solve` returns the minimum-energy `Plan` of a scenario. `run_scenario` returns a `RunResult`: the
plan, and simulated flights of the mission under an adaptive controller for comparison.
`export_plan` writes a plan in the format of an autopilot or simulator. `build_model` returns the
Pyomo model of a scenario.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from pyomo_quad.presentation import Picture, Presenter, register_presenter
from pyomo_quad.version import __version__

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from pyomo_quad.exports import export_plan
    from pyomo_quad.flight import Plan
    from pyomo_quad.model import build_model
    from pyomo_quad.scenario import Scenario, load_scenario
    from pyomo_quad.study.run import RunResult, run_scenario

__all__ = [
    "Picture",
    "Plan",
    "RunResult",
    "Scenario",
    "__version__",
    "build_model",
    "export_plan",
    "load_scenario",
    "run_scenario",
    "solve",
]

# Module that defines each public name. `__getattr__` imports the module on first use of the name,
# because Pyomo, CasADi and SciPy together take over a second to import.
_HOMES = {
    "Plan": "pyomo_quad.flight",
    "RunResult": "pyomo_quad.study.run",
    "Scenario": "pyomo_quad.scenario",
    "build_model": "pyomo_quad.model",
    "export_plan": "pyomo_quad.exports",
    "load_scenario": "pyomo_quad.scenario",
    "run_scenario": "pyomo_quad.study.run",
}


def _presenter() -> Presenter:
    from pyomo_quad.report import presenting  # noqa: PLC0415  matplotlib takes a second

    return presenting


register_presenter(_presenter)


def solve(
    scenario: "Scenario | str | Path | Mapping[str, Any]", *, allow_code: bool = False
) -> "Plan":
    """Plan the minimum-energy flight of a scenario, and verify the plan by simulation.

    A scenario may state a risk, the permitted probability that a flight breaks a limit. The plan
    then keeps a margin to each limit. The default risk is 1 % if the duration is free. It is 100 %,
    without margins, if the duration is given, or if `vehicle.attitude` is "paper" (kinematics of
    Yacef et al.).

    Parameters
    ----------
    scenario : Scenario, str, Path or mapping
        A loaded scenario, the path of a scenario file (TOML), or nested mappings with the same
        keys as a scenario file.
    allow_code : bool, default False
        Whether to run the Python model builder that the scenario names, if it names one.

    Returns
    -------
    Plan
        The planned flight with its `status`. A numerical failure raises no exception: the status
        and the message of the returned plan give the reason.

    Raises
    ------
    ScenarioError
        If the scenario has invalid values; the message has one line per invalid field. Also if the
        scenario names a model builder that is not allowed or cannot be loaded.
    FeasibilityError
        If the rotors cannot lift the vehicle.

    Examples
    --------
    >>> mission = {"goal": {"position": [1.0, 0.0, 0.5]}, "duration": 4.0}
    >>> plan = solve({"name": "hop", "vehicle": {"use": "dji_phantom_2"}, "mission": mission})
    >>> plan.is_verified
    True
    """
    from pyomo_quad.flight import Planner  # noqa: PLC0415
    from pyomo_quad.flight.risk import plan_at_risk  # noqa: PLC0415
    from pyomo_quad.model import model_builder  # noqa: PLC0415
    from pyomo_quad.scenario import Scenario, load_scenario  # noqa: PLC0415

    resolved = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    builder = model_builder(resolved, is_code_allowed=allow_code)
    return plan_at_risk(resolved, Planner(builder))


def __getattr__(name: str) -> Any:  # noqa: ANN401  as wide as the names it serves
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
