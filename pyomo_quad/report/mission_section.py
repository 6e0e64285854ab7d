"""What a report says of the mission that was asked for."""

from pyomo_quad.report.document import Block, Code, Heading, Paragraph, Table
from pyomo_quad.report.wording import COUPLING_WORDS, POWER_WORDS, hover_place, seconds
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.wind import Wind

__all__ = ["mission_blocks"]


def mission_blocks(scenario: Scenario) -> tuple[Block, ...]:
    """Say what was asked.

    Parameters
    ----------
    scenario : Scenario
        The mission.

    Returns
    -------
    tuple of Block
        A heading and a table.
    """
    vehicle, mission = scenario.vehicle, scenario.mission
    forecast = scenario.wind.forecast
    rows = [
        ("From", hover_place(mission.start)),
        ("To", hover_place(mission.goal)),
        ("Duration", f"{seconds(mission.duration)}, hover to hover"),
        ("Vehicle", f"{vehicle.title or vehicle.use}, {vehicle.total_mass:.6g} kg"),
        ("Battery", scenario.battery.title or scenario.battery.use),
        ("Power", POWER_WORDS[scenario.power.model]),
        ("Wind", _wind(scenario.wind)),
    ]
    if forecast is not None:
        rows.append(("Wind told to the optimiser", _wind(forecast)))
    if scenario.model is not None:
        rows.append(("Equations", f"the user's own, {scenario.model}"))
    return (
        Heading("Mission"),
        Table(caption="What was asked", header=("", "Scenario"), rows=rows),
        Paragraph(
            (
                "Every number of the scenario, with where it comes from: ",
                Code("pyomo-quad check"),
                ".",
            )
        ),
    )


def _wind(wind: Wind) -> str:
    source = f"measured, {wind.file}" if wind.file is not None else wind.title or wind.use
    return f"{source}; {COUPLING_WORDS[wind.coupling]}"
