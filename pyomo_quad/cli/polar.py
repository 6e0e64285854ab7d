"""`pyomo-quad polar`: what steady flight of a scenario's vehicle costs."""

from pathlib import Path

from pyomo_quad.cli.endings import ExitCode, raise_on_interrupt
from pyomo_quad.cli.terminal import FigureChoice, Output, Overrides, Quiet, ScenarioFile
from pyomo_quad.report import Figures
from pyomo_quad.report.folder import output_folder, refuse_output_folder
from pyomo_quad.scenario import ScenarioError, load_scenario


def polar(
    scenario: ScenarioFile,
    *,
    out: Output = None,
    overrides: Overrides = None,
    figures: FigureChoice = Figures.ALL,
    quiet: Quiet = False,
) -> int:
    """Solve steady flight over airspeed, payload and wind: best speeds, range, endurance, reach."""
    resolved = load_scenario(scenario, overrides or ())
    folder = out or Path("reports") / f"{resolved.name}_polar"
    if resolved.model is not None:
        raise ScenarioError(f"{scenario}: model = {resolved.model!r}; polar reads declared models.")
    refuse_output_folder(folder)
    from pyomo_quad.polar.polar import find_polar  # noqa: PLC0415  takes a second
    from pyomo_quad.polar.report import write_polar  # noqa: PLC0415

    with raise_on_interrupt(), output_folder(folder) as aside:
        found = find_polar(resolved)
        write_polar(aside, found, figures)
    if not quiet:
        own = found.own
        slow, best = own.speed_of_least_power, own.best_over_ground()
        minutes = float(own.endurance(slow)) / 60.0
        print(
            f"hover {own.powers[0]:.1f} W; least power {float(own.power(slow)):.1f} W at "
            f"{slow:.2f} m/s ({minutes:.1f} min); least energy per metre "
            f"{best.energy_per_metre:.2f} J/m at {best.ground_speed:.2f} m/s "
            f"({best.range_m / 1e3:.2f} km)"
        )
        print(f"Written to {folder}.")
    return ExitCode.VERIFIED
