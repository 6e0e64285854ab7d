"""Lists of the figures in each kind of report, in order and with captions.

A `Drawing` holds a figure's caption and drawing function. If an argument is a sequence of flights,
the first flight is the plan.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pyomo_quad.flight.columns import Column
from pyomo_quad.report.document import Drawing
from pyomo_quad.report.energy_bars import (
    draw_energy_by_scenario,
    draw_energy_split,
    has_equal_durations,
)
from pyomo_quad.report.ensemble import ensemble_drawings
from pyomo_quad.report.flight_figures import (
    COSTATES,
    coinciding_flights,
    cut_flights,
    draw_adaptation,
    draw_battery,
    draw_column,
    draw_controls,
    draw_costates,
    draw_energy,
    draw_front,
    draw_mesh,
    draw_power,
    draw_rotors,
    draw_states,
    draw_way,
    draw_wind,
    is_calm,
)
from pyomo_quad.report.paths import (
    BEAT_COUNT,
    distinct_paths,
    draw_map,
    draw_path,
    leaving_paths,
    script_json,
    view_data,
)
from pyomo_quad.report.relief import draw_heights
from pyomo_quad.report.render import environment, fixed
from pyomo_quad.report.signals import (
    BATTERY,
    ENERGY,
    MOTOR,
    POSITION,
    POWER,
    ROTOR_ACCELERATION,
    STATE_GRID,
    VELOCITY,
    WIND,
)
from pyomo_quad.report.style import (
    StyledFlight,
    fair_pair,
    have_equal_durations,
    plan_flight,
    styled_flights,
)
from pyomo_quad.study.comparison import ComparisonColumn
from pyomo_quad.study.headline import rival_of

if TYPE_CHECKING:
    from pyomo_quad.flight import Plan
    from pyomo_quad.scenario import Scenario
    from pyomo_quad.study.ensemble import InTurbulence
    from pyomo_quad.study.run import RunResult

PATH_NAME = "path"
#: Title of the figure of paths; the HTML report shows an interactive player of flights above it.
PLAYER_TITLE = "Paths and player"
MAP_NAME, POWER_NAME = "map", "power_over_time"
FRONT_FIGURE = "front"


def plan_drawings(plan: "Plan", flights: Sequence[StyledFlight]) -> tuple[Drawing, ...]:
    """List the figures of a plan, and of flights that are drawn together with it.

    The first of `flights` is the plan. If the scenario has a wind forecast, the second must be a
    flight in the true wind. Figures are left out as in `flight_drawings`.
    """
    has_forecast = plan.scenario.wind.forecast is not None
    blowing = flights[1] if has_forecast and len(flights) > 1 else None
    mission, tolerance = plan.mission_flown, plan.scenario.solver.tolerance
    way = (_way(flights, mission),) if _has_speed_figure(plan.scenario) else ()
    if plan.scenario.airspace.ground is not None:
        way = (_heights(flights, mission), *way)
    mesh = partial(draw_mesh, plan.history, plan.mesh, tolerance, flights[0].duration_s)
    caption = "Left: error estimate on each mesh. Right: elements and degrees of the last mesh."
    return (
        *flight_drawings(flights, plan.hover_energy_J, blowing, mission),
        *(one for one in way if set(one.needs) <= set(flights[0].frame)),
        # Costates need a simulation of the controls; costates and mesh need an optimisation.
        *(_costates(plan) if plan.verification is not None else ()),
        *((Drawing("mesh", "Mesh", caption, mesh),) if plan.is_optimised else ()),
    )


def flight_drawings(
    flights: Sequence[StyledFlight],
    hover_energy_J: float,
    blowing: StyledFlight | None = None,
    mission: "Scenario | None" = None,
) -> tuple[Drawing, ...]:
    """List the figures that need only the tables of flights: paths, motion, energy, wind.

    A figure is left out if a column is missing or not finite for the plan, the first flight.

    Parameters
    ----------
    flights : sequence of StyledFlight
        The plan, and flights that are drawn together with it.
    hover_energy_J : float
        Energy of hovering for the duration of the plan [J].
    blowing : StyledFlight, optional
        If the plan was made for a wind forecast, one of `flights` in the true wind. The figure of
        the wind shows both winds.
    mission : Scenario, optional
        Mission whose zones and waypoints are drawn. Its waypoints need times of passing; see
        `Scenario.lasting`.
    """
    frame = flights[0].frame
    finite = {name for name in frame if np.isfinite(frame[name]).all()}
    drawings = (
        *((_path(flights, mission),) if finite.issuperset(_columns(POSITION)) else ()),
        *_motion(flights),
        *_supply(flights, hover_energy_J),
        *_wind(flights[0], blowing),
    )
    return tuple(drawing for drawing in drawings if finite.issuperset(drawing.needs))


def column_drawing(flight: StyledFlight, column: str) -> Drawing:
    """Return the figure of one column of a flight's table against time.

    Parameters
    ----------
    flight : StyledFlight
        Flight to draw.
    column : str
        Name of the column.
    """
    return Drawing(column, column, "", partial(draw_column, flight, column))


def comparison_drawings(
    flights: Sequence[StyledFlight],
    hover_energy_J: float,
    comparison: pd.DataFrame,
    mission: "Scenario",
) -> tuple[Drawing, ...]:
    """List the figures of a comparison of flights: map, power over time, and energies.

    The result is empty if the plan has no positions. The caller must leave out a figure if the
    plan's table lacks a column of `Drawing.needs`.

    Parameters
    ----------
    flights : sequence of StyledFlight
        Flights to compare, the plan first.
    hover_energy_J : float
        Energy of hovering for the duration of the plan [J].
    comparison : DataFrame
        One row for each flight, with its energy and outcome; columns of `ComparisonColumn`.
    mission : Scenario
        Mission with zones and waypoints to draw.
    """
    # The table of a user's own Pyomo model may have no positions.
    if not set(_columns(POSITION)) <= set(flights[0].frame):
        return ()
    rival = rival_of(comparison)
    pair = [one for one in flights if rival and one.name == rival[ComparisonColumn.FLIGHT]]
    pair.insert(0, flights[0])
    # Only the energies of flights that reached the goal and kept all limits can be compared.
    good = comparison[ComparisonColumn.ARRIVED] & comparison[ComparisonColumn.LIMITS_KEPT]
    names = set(comparison.loc[good.astype(bool), ComparisonColumn.FLIGHT]) | {flights[0].name}
    compared = [flight for flight in flights if flight.name in names]
    beyond = f"energy more than {flights[0].name}"
    if have_equal_durations(compared):
        beyond = "the part above hovering, enlarged"
    course = f"Seen from above, from start (dot) to goal (star).{_course(mission)}"
    split = (
        "Left: total energy of each flight; grey: hovering for the same time."
        f"{_undercut(compared, hover_energy_J)} Right: {beyond}."
        f"{_not_comparable(flights, compared)}"
    )
    power = f"Power over time; dotted: hovering.{_cut(pair)}"
    draw_split = partial(draw_energy_split, compared, hover_energy_J)
    return (
        Drawing(MAP_NAME, "Map", course, partial(draw_map, pair, mission)),
        Drawing(
            POWER_NAME,
            "Power over time",
            power,
            partial(draw_power, pair, hover_energy_J),
            _columns((POWER,)),
        ),
        Drawing("energy_split", "Energy of each flight", split, draw_split),
    )


def _not_comparable(flights: Sequence[StyledFlight], compared: Sequence[StyledFlight]) -> str:
    """Return the caption's sentence that names the flights without a bar in the energy chart.

    The flights `compared` have a bar.
    """
    rest = [flight for flight in flights if flight not in compared]
    return _naming("Without a bar, because they missed the goal or broke a limit", rest)


def adaptation_drawing(study: pd.DataFrame) -> Drawing:
    """Return the figure of the controller's adaptation to the wind.

    The function `adaptation_study` returns the table `study`.
    """
    caption = (
        "The adaptive controller does not know the wind. Left: distance of the vehicle from the "
        "path to follow, with adaptation and without. Right: the force of the wind divided by the "
        "mass, and its estimate by the adaptation."
    )
    return Drawing("adaptation", "Adaptation to the wind", caption, partial(draw_adaptation, study))


def front_drawing(front: pd.DataFrame) -> Drawing:
    """Return the figure of the energy-time front: least energy against duration.

    `front` has one row for each price of time [W]. The enumeration `FrontColumn` names the columns.
    """
    caption = (
        "Flights of least energy for several prices of a second; star: the plan. No flight on the "
        "plan's route is both shorter and cheaper."
    )
    return Drawing(FRONT_FIGURE, "Energy against time", caption, partial(draw_front, front))


def drawings_of_solve(plan: "Plan") -> tuple[Drawing, ...]:
    """List the figures in the report of a plan that is not compared with other flights."""
    return plan_drawings(plan, styled_flights([plan_flight(plan)]))


def drawings_of_run(result: "RunResult") -> tuple[Drawing, ...]:
    """List the figures in the report of a run: a plan with the flights it is compared with.

    Figures of results that the run does not have are left out.
    """
    flights = _styled(result)
    return (
        *_comparison(result, flights),
        *(() if result.adaptation is None else (adaptation_drawing(result.adaptation),)),
        *((front_drawing(result.front),) if len(result.front) > 1 else ()),
        *(() if result.often is None else _in_turbulence(result.often, result.plan)),
        *plan_drawings(result.plan, flights),
    )


def _in_turbulence(often: "InTurbulence", plan: "Plan") -> Iterator[Drawing]:
    """Yield the figures of a plan's simulated flights in turbulence, for the report of a run."""
    margin = plan.margins.get("airspace.clearance", 0.0)
    for drawing in ensemble_drawings(often.flown, often.savings, margin):
        yield replace(drawing, name=f"turbulence_{drawing.name}")


def drawings_of_comparison(comparison: pd.DataFrame) -> tuple[Drawing]:
    """List the figures in the comparison of several scenarios: the energies of all flights.

    Parameters
    ----------
    comparison : DataFrame
        One row for each flight of each scenario. The enumeration `ComparisonColumn` names the
        columns.
    """
    energy = "Energy above hovering for the same time"
    if not has_equal_durations(comparison):
        energy = "Total energy"
    caption = (
        f"{energy}, with the energy to complete each flight; one panel per scenario. Flights that "
        "did not arrive are pale."
    )
    draw = partial(draw_energy_by_scenario, comparison)
    return (Drawing("energy_compared", "Energy of each flight", caption, draw),)


def view_of_paths(result: "RunResult", drawn: Sequence[Drawing]) -> tuple[dict[str, str], str]:
    """Return the interactive player of a run's flights for the HTML report.

    The first result maps the name of the figure of paths to the HTML of the player. The report
    shows the player above this figure. The second result is the flights as JSON. Both are empty if
    `drawn`, the report's figures, lacks the figure of paths.
    """
    if PATH_NAME not in [drawing.name for drawing in drawn]:
        return {}, ""
    scenario = result.plan.scenario
    played = view_data(_styled(result), scenario.airspace, scenario.vehicle.arm_length)
    markup = environment().get_template("report/view.html.j2").render()
    return {PATH_NAME: markup}, script_json(played)


def _styled(result: "RunResult") -> tuple[StyledFlight, ...]:
    return styled_flights(result.flights or [plan_flight(result.plan)])


def _comparison(result: "RunResult", flights: tuple[StyledFlight, ...]) -> tuple[Drawing, ...]:
    comparison = result.comparison
    if comparison.empty:
        return ()
    drawn = comparison_drawings(
        flights, result.plan.hover_energy_J, comparison, result.plan.mission_flown
    )
    return tuple(one for one in drawn if set(one.needs) <= set(flights[0].frame))


def _path(flights: Sequence[StyledFlight], mission: "Scenario | None") -> Drawing:
    distinct, beat = distinct_paths(flights), flights[0].duration_s / BEAT_COUNT
    caption = (
        f"Paths from start (dot) to goal (star), with a mark every {beat:.3g} s; each view has one "
        f"scale.{'' if mission is None else _course(mission)}{left_out(flights)}"
    )
    draw = partial(draw_path, distinct, mission)
    return Drawing(PATH_NAME, PLAYER_TITLE, caption, draw, _columns(POSITION))


def _course(mission: "Scenario") -> str:
    """Return a map caption's sentences on waypoints, zones, terrain, floor and ceiling."""
    airspace, said = mission.airspace, ""
    if mission.mission.waypoints:
        said += " Crosses: waypoints, with the times at which the plan passes them."
    said += _zones(mission)
    if airspace.keep_out and airspace.clearance:
        said += " Dashed: their clearance."
    limits = (("floor", airspace.floor), ("ceiling", airspace.ceiling))
    over = "" if airspace.ground is None else " above the ground"
    said += "" if airspace.ground is None else " Brown: the terrain."
    told = [f"{name} at {height:g} m{over}" for name, height in limits if height is not None]
    return f"{said} {' and '.join(told).capitalize()}." if told else said


def _zones(mission: "Scenario") -> str:
    """Return the caption's sentence that names the keep-out zones of a scenario, `mission`.

    The sentence is empty if the scenario has no keep-out zones.
    """
    named = ", ".join(zone.name for zone in mission.airspace.keep_out)
    return f" Red: keep-out zones ({named})." if named else ""


def _has_speed_figure(scenario: "Scenario") -> bool:
    """Return whether a report has the figure of speed over path length."""
    mission, airspace = scenario.mission, scenario.airspace
    has_more = mission.is_free or mission.waypoints or airspace.keep_out
    return bool(has_more or scenario.limits.speed_max)


def _way(flights: Sequence[StyledFlight], mission: "Scenario") -> Drawing:
    caption = "Speed over the path length."
    if mission.mission.waypoints:
        caption = (
            "Left: speed over the path length; dotted: places where the plan passes the "
            "waypoints. Right: energy of each leg of the plan."
        )
    needs = _columns(POSITION, VELOCITY, (ENERGY,))
    draw = partial(draw_way, distinct_paths(flights), mission)
    title = "Speed along the path"
    return Drawing("way", title, f"{caption}{left_out(flights)}", draw, needs)


def _heights(flights: Sequence[StyledFlight], mission: "Scenario") -> Drawing:
    airspace = mission.airspace
    ground = airspace.ground
    excess = 0.0 if ground is None else ground.surface(1).excess
    caption = (
        f"Brown: the ground under {flights[0].name}, as its limits see it: a smooth surface that "
        f"is nowhere below the terrain, and above it by at most {excess:.2g} m."
    )
    if airspace.floor is not None or airspace.ceiling is not None:
        caption += " Dashed: the least and the largest height above the ground."
    draw = partial(draw_heights, distinct_paths(flights), airspace)
    title = "Height above the ground"
    return Drawing("heights", title, f"{caption}{left_out(flights)}", draw, _columns(POSITION))


def left_out(flights: Sequence[StyledFlight]) -> str:
    """Return the caption's sentences on paths that are not drawn or extend beyond the figure.

    A path is not drawn if it looks the same as the plan's path. The text may be empty.
    """
    distinct = distinct_paths(flights)
    near = [flight for flight in flights if flight not in distinct]
    return _naming(f"Not drawn, because they follow the path of {flights[0].name}", near) + _naming(
        "Extends beyond the figure", leaving_paths(flights)
    )


def _motion(flights: Sequence[StyledFlight]) -> tuple[Drawing, ...]:
    pair = fair_pair(flights)
    states = f"The sixteen states of the vehicle: {_listed(pair)}.{_not_drawn(flights, pair)}"
    controls = f"The four controls, which are the rotor accelerations: {_optimum_alone(flights)}"
    return (
        Drawing("states", "States", states, partial(draw_states, pair), _columns(*STATE_GRID)),
        Drawing(
            "controls",
            "Controls",
            controls,
            partial(draw_controls, flights[:1]),
            _columns(ROTOR_ACCELERATION),
        ),
    )


def _supply(flights: Sequence[StyledFlight], hover_energy_J: float) -> tuple[Drawing, ...]:
    pair = fair_pair(flights)
    energy = (
        "From above: power, energy spent, and energy spent less the energy of hovering until then; "
        "dotted: hovering."
        f"{_unequal_durations(flights)}{_cut(flights)}{_coinciding(flights, hover_energy_J)}"
    )
    motors = f"The four motors: {_optimum_alone(flights)}"
    battery = f"The battery: {_listed(pair)}.{_not_drawn(flights, pair)}"
    draw_energies = partial(draw_energy, flights, hover_energy_J)
    return (
        Drawing("energy", "Power and energy", energy, draw_energies, _columns((POWER, ENERGY))),
        Drawing("motors", "Motors", motors, partial(draw_rotors, flights[0]), _columns(*MOTOR)),
        Drawing("battery", "Battery", battery, partial(draw_battery, pair), _columns(BATTERY)),
    )


def _optimum_alone(flights: Sequence[StyledFlight]) -> str:
    return f"{flights[0].name}.{_not_drawn(flights, flights[:1])}"


def _wind(optimum: StyledFlight, blowing: StyledFlight | None) -> tuple[Drawing, ...]:
    shown = [flight for flight in (optimum, blowing) if flight is not None]
    is_declared = all(set(_columns(WIND)) <= set(flight.frame) for flight in shown)
    if not is_declared or is_calm(*shown):
        return ()
    caption = "The wind over the flight, in world axes."
    return (Drawing("wind", "Wind", caption, partial(draw_wind, optimum, blowing), _columns(WIND)),)


def _unequal_durations(flights: Sequence[StyledFlight]) -> str:
    """Return a warning for a caption if the flights of an energy figure differ in duration.

    The text is empty if the durations are equal (see `have_equal_durations`).
    """
    if have_equal_durations(flights):
        return ""
    return (
        " The durations differ, so only total energies can be compared, not energies above "
        "hovering."
    )


def _cut(flights: Sequence[StyledFlight]) -> str:
    """Return the caption's sentence on flights with power peaks beyond the figure's vertical axis.

    The sentence names these flights and their ranges of power. It is empty if there are none.
    """
    if POWER.name not in flights[0].frame:
        return ""
    peaks = [
        f"{flight.name} ({fixed(power.min(), 1)} to {fixed(power.max(), 1)} W)"
        for flight in cut_flights(flights)
        for power in (POWER.of(flight.frame),)
    ]
    return f" Short peaks are cut off: {', '.join(peaks)}." if peaks else ""


def _coinciding(flights: Sequence[StyledFlight], hover_energy_J: float) -> str:
    """Return the caption's sentence on flights whose energy curve the plan's curve hides.

    The curves show energy above hovering. `hover_energy_J` is the energy of hovering for the
    duration of the plan, the first flight. Without such flights the result is empty.
    """
    if ENERGY.name not in flights[0].frame:
        return ""
    same = coinciding_flights(flights, hover_energy_J / flights[0].duration_s)
    return _naming(f"The curve of {flights[0].name} covers that of", same, sign="")


def _undercut(flights: Sequence[StyledFlight], hover_energy_J: float) -> str:
    """Return the caption's sentence on flights that use less energy than hovering, if any.

    `hover_energy_J` is the energy of hovering for the duration of the plan, the first flight.
    """
    hover_power = hover_energy_J / flights[0].duration_s
    # A flight can use less energy than hovering, for example in descent or in forward flight. Its
    # bar then ends inside the grey bar of the hover energy.
    is_below = any(flight.energy_J < hover_power * flight.duration_s for flight in flights)
    return " Colour inside the grey: energy saved compared with hovering." if is_below else ""


def _not_drawn(flights: Sequence[StyledFlight], drawn: Sequence[StyledFlight]) -> str:
    """Return the caption's sentence that names the flights missing from a figure.

    `drawn` are the flights that the figure shows. The sentence is empty if no flight is missing.
    """
    return _naming("Not drawn", [flight for flight in flights if flight not in drawn])


def _costates(plan: "Plan") -> tuple[Drawing, ...]:
    costates = plan.costate_frame()
    if not plan.is_optimised or not set(COSTATES) <= set(costates):
        return ()
    caption = (
        "Costates: derivatives of the least remaining energy by each state. "
        "Without waypoints the Hamiltonian is constant unless the wind changes with time."
    )
    draw = partial(draw_costates, costates, plan.duration_s)
    return (Drawing("costates", "Costates and Hamiltonian", caption, draw),)


def _columns(*groups: Iterable[Column]) -> tuple[str, ...]:
    return tuple(signal.name for group in groups for signal in group)


def _naming(words: str, flights: Sequence[StyledFlight], sign: str = ":") -> str:
    """Return a caption's sentence that ends with the names of `flights`; empty without flights.

    For example, `words` "Not drawn" gives " Not drawn: A and B."
    """
    return f" {words}{sign} {_listed(flights)}." if flights else ""


def _listed(flights: Sequence[StyledFlight]) -> str:
    *first, last = (flight.name for flight in flights)
    return f"{', '.join(first)} and {last}" if first else last
