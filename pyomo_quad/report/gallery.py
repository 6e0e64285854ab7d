"""Which figures a report holds, in which order, and what stands under them."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pyomo_quad.report import Figures
from pyomo_quad.report.document import Drawing, wanted_drawings
from pyomo_quad.report.energy_bars import (
    draw_energy_by_scenario,
    draw_energy_split,
    takes_one_time_each,
)
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
    draw_overview,
    draw_rotors,
    draw_states,
    draw_way,
    draw_wind,
    is_calm,
)
from pyomo_quad.report.paths import (
    BEAT_COUNT,
    distinct_paths,
    draw_path,
    leaving_paths,
    script_json,
    view_data,
    view_markup,
)
from pyomo_quad.report.render import fixed
from pyomo_quad.report.style import (
    BATTERY,
    ENERGY,
    MOTOR,
    POSITION,
    POWER,
    ROTOR_ACCELERATION,
    STATE_GRID,
    VELOCITY,
    WIND,
    Signal,
    StyledFlight,
    fair_pair,
    plan_flight,
    styled_flights,
    take_one_time,
)
from pyomo_quad.study.comparison import ComparisonColumn

if TYPE_CHECKING:
    from pyomo_quad.flight import Plan
    from pyomo_quad.scenario import Scenario
    from pyomo_quad.study.run import RunResult

PATH_NAME = "path"
FRONT_FIGURE = "front"


def plan_drawings(plan: "Plan", flights: Sequence[StyledFlight]) -> tuple[Drawing, ...]:
    """List the figures of a plan, whose flight comes first, with what else was flown beside it.

    Left out is what a model of the user's own does not declare, what a failed solve left without a
    number, and a wind that does not blow.
    """
    has_forecast = plan.scenario.wind.forecast is not None
    blowing = flights[1] if has_forecast and len(flights) > 1 else None
    mission = plan.mission_flown
    return (
        *flight_drawings(flights, plan.hover_energy_J, blowing, mission),
        *(_way(flights, mission) if _has_way(plan.scenario) else ()),
        *(_costates(plan) if plan.verification is not None else ()),
        Drawing(
            name="mesh",
            title="Mesh",
            caption="Left: the error estimate on each mesh. Right: the last mesh.",
            draw=lambda: draw_mesh(
                plan.history, plan.mesh, plan.scenario.solver.tolerance, flights[0].duration_s
            ),
        ),
    )


def flight_drawings(
    flights: Sequence[StyledFlight],
    hover_energy_J: float,
    blowing: StyledFlight | None = None,
    mission: "Scenario | None" = None,
) -> tuple[Drawing, ...]:
    """List the figures that the tables of flights hold.

    ``blowing`` met another wind than told; ``mission`` has the passing times of its plan.
    """
    frame = flights[0].frame
    finite = {name for name in frame if np.isfinite(frame[name]).all()}
    drawings = (
        *(_path(flights, mission) if finite.issuperset(_columns(POSITION)) else ()),
        *_motion(flights),
        *_supply(flights, hover_energy_J),
        *_wind(flights[0], blowing),
    )
    return tuple(drawing for drawing in drawings if finite.issuperset(drawing.needs))


def column_drawing(flight: StyledFlight, column: str) -> Drawing:
    """Return the figure of one column of a flight's table against time."""
    return Drawing(name=column, title=column, caption="", draw=lambda: draw_column(flight, column))


def comparison_drawings(
    flights: Sequence[StyledFlight],
    hover_energy_J: float,
    absent: frozenset[str],
    mission: "Scenario",
) -> tuple[Drawing, ...]:
    """List the figures that set flights against each other, the optimum first.

    ``absent`` names those that did not arrive; ``mission`` has the zones. A model of the
    user's own without positions has no such figures.
    """
    if not set(_columns(POSITION)) <= set(flights[0].frame):
        return ()
    is_timed_alike = take_one_time(flights)
    over_time = "the energy that each flight has spent"
    if is_timed_alike:
        over_time += " more than hovering until then"
    return (
        Drawing(
            name="overview",
            title="The run at a glance",
            caption="Left: the paths, from start (dot) to goal (star), to one scale along all "
            f"axes.{_zones(mission)} Right: {over_time}, and below the total energy, with what its "
            "end state owes; the line in a bar is what hovering for as long takes."
            f"{left_out(flights)}"
            f"{_coinciding(flights, hover_energy_J if is_timed_alike else 0.0)}",
            draw=lambda: draw_overview(flights, hover_energy_J, absent, mission),
        ),
        Drawing(
            name="energy_split",
            title="Energy of each flight",
            caption="Left: energy of each flight with what its end state owes, split at what "
            f"hovering for as long takes.{_undercut(flights, hover_energy_J)} Right: "
            + ("what lies above that." if is_timed_alike else f"{_more_than(flights[0])}."),
            draw=lambda: draw_energy_split(flights, hover_energy_J, absent),
        ),
    )


def adaptation_drawing(study: pd.DataFrame) -> Drawing:
    """Return the figure of what adaptation is worth, from an `adaptation_study`."""
    return Drawing(
        name="adaptation",
        title="Adaptation to the wind",
        caption="The adaptive controller is not told the wind. Left: its distance from its "
        "reference, with adaptation and without. Right: the force of the wind over the mass, and "
        "what adaptation made of it.",
        draw=lambda: draw_adaptation(study),
    )


def front_drawing(front: pd.DataFrame) -> Drawing:
    """Return the figure of an energy-time front."""
    return Drawing(
        name=FRONT_FIGURE,
        title="Energy against time",
        caption="The least energy for each price of a second, with the plan marked (star): no "
        "flight on the plan's route is both shorter and cheaper.",
        draw=lambda: draw_front(front),
    )


def drawings_of_solve(plan: "Plan", figures: Figures) -> tuple[Drawing, ...]:
    """List what the report of a plan alone shows."""
    return wanted_drawings(plan_drawings(plan, styled_flights([plan_flight(plan)])), figures)


def drawings_of_run(result: "RunResult", figures: Figures) -> tuple[tuple[Drawing, ...], ...]:
    """List what the report of a run shows.

    That is the flights beside each other, what adaptation and time are worth, and the plan.
    """
    flights = _styled(result)
    return tuple(
        wanted_drawings(part, figures)
        for part in (
            _comparison(result, flights),
            (
                *(() if result.adaptation is None else (adaptation_drawing(result.adaptation),)),
                *((front_drawing(result.front),) if len(result.front) > 1 else ()),
            ),
            plan_drawings(result.plan, flights),
        )
    )


def drawings_of_comparison(comparison: pd.DataFrame, figures: Figures) -> tuple[Drawing, ...]:
    """List what the comparison of many scenarios shows: the energies of their flights."""
    energy = "Energy above hovering for the same time, with what"
    if not takes_one_time_each(comparison):
        energy = "Total energy, with what"
    drawing = Drawing(
        name="energy_compared",
        title="Energy of each flight",
        caption=f"{energy} the end state owes: one panel for each scenario. A flight that did not "
        "arrive is pale.",
        draw=lambda: draw_energy_by_scenario(comparison),
    )
    return wanted_drawings([drawing], figures)


def view_of_paths(result: "RunResult") -> tuple[dict[str, str], str]:
    """Return the player of the flight, by the picture that it stands above, and what it plays."""
    played = view_data(_styled(result), result.plan.scenario.airspace)
    return {PATH_NAME: view_markup()}, script_json(played)


def _styled(result: "RunResult") -> tuple[StyledFlight, ...]:
    return styled_flights(result.flights or [plan_flight(result.plan)])


def _comparison(result: "RunResult", flights: tuple[StyledFlight, ...]) -> tuple[Drawing, ...]:
    comparison = result.comparison
    if comparison.empty:
        return ()
    arrived = comparison[ComparisonColumn.ARRIVED].astype(bool)
    absent = frozenset(comparison.loc[~arrived, ComparisonColumn.FLIGHT])
    mission = result.plan.mission_flown
    return comparison_drawings(flights, result.plan.hover_energy_J, absent, mission)


def _path(flights: Sequence[StyledFlight], mission: "Scenario | None") -> tuple[Drawing]:
    optimum, distinct = flights[0], distinct_paths(flights)
    beat = optimum.duration_s / BEAT_COUNT
    course = "" if mission is None else _course(mission)
    return (
        Drawing(
            name=PATH_NAME,
            title="Path",
            caption="Paths from start (dot) to goal (star), to one scale along all axes of a view, "
            f"with a mark every {beat:.3g} s."
            f"{course}{left_out(flights)}",
            draw=lambda: draw_path(distinct, mission),
        ),
    )


def _course(mission: "Scenario") -> str:
    """Say what of a mission stands in the picture of its paths, and what lies beyond."""
    airspace, said = mission.airspace, ""
    if mission.mission.waypoints:
        said += " Crosses: the waypoints, with the times at which the plan passes them."
    said += _zones(mission)
    if airspace.keep_out and airspace.clearance:
        said += " Dashed around them, seen along an axis: their clearance."
    limits = (("floor", airspace.floor), ("ceiling", airspace.ceiling))
    told = [f"{name} at {height:g} m" for name, height in limits if height is not None]
    return f"{said} {' and '.join(told).capitalize()}." if told else said


def _zones(mission: "Scenario") -> str:
    """Name the keep-outs of a picture in space; empty where there are none."""
    named = ", ".join(zone.name for zone in mission.airspace.keep_out)
    return f" Red: the keep-outs ({named})." if named else ""


def _has_way(scenario: "Scenario") -> bool:
    """Say whether a mission asks for more than to get from start to goal in a given time."""
    mission, airspace = scenario.mission, scenario.airspace
    has_more = mission.is_free or mission.waypoints or airspace.keep_out
    return bool(has_more or scenario.limits.speed_max)


def _way(flights: Sequence[StyledFlight], mission: "Scenario") -> tuple[Drawing, ...]:
    if not set(_columns(POSITION, VELOCITY, (ENERGY,))) <= set(flights[0].frame):
        return ()
    waypoints = mission.mission.waypoints
    legs = " Right: what each leg of the optimal flight takes." if waypoints else ""
    marks = " Dotted: where the optimal flight passes the waypoints." if waypoints else ""
    return (
        Drawing(
            name="way",
            title="Speed and energy over the way",
            caption=f"{'Left: s' if waypoints else 'S'}peed over the way flown.{marks}{legs}"
            f"{left_out(flights)}",
            draw=lambda: draw_way(distinct_paths(flights), mission),
        ),
    )


def left_out(flights: Sequence[StyledFlight]) -> str:
    """Say under a picture of paths which of them are not, or not all, in it; empty if all are."""
    said = ""
    distinct, astray = distinct_paths(flights), leaving_paths(flights)
    near = [flight for flight in flights if flight not in distinct]
    if near:
        said += f" Too near to {flights[0].name} to be drawn apart: {_listed(near)}."
    if astray:
        said += f" Leaves the picture: {_listed(astray)}."
    return said


def _motion(flights: Sequence[StyledFlight]) -> tuple[Drawing, ...]:
    pair = fair_pair(flights)
    optimum = flights[0]
    return (
        Drawing(
            name="states",
            title="States",
            caption=f"The sixteen states: {_listed(pair)}.{_not_drawn(flights, pair)}",
            needs=_columns(*STATE_GRID),
            draw=lambda: draw_states(pair),
        ),
        Drawing(
            name="controls",
            title="Controls",
            caption=f"The four controls, accelerations of the rotors: {optimum.name}."
            f"{_not_drawn(flights, flights[:1])}",
            needs=_columns(ROTOR_ACCELERATION),
            draw=lambda: draw_controls([optimum]),
        ),
    )


def _supply(flights: Sequence[StyledFlight], hover_energy_J: float) -> tuple[Drawing, ...]:
    optimum, pair = flights[0], fair_pair(flights)
    return (
        Drawing(
            name="energy",
            title="Power and energy",
            caption="Power, energy, and energy above what hovering until then would have taken."
            f"{_own_floors(flights)}{_cut(flights)}{_coinciding(flights, hover_energy_J)}",
            needs=_columns((POWER, ENERGY)),
            draw=lambda: draw_energy(flights, hover_energy_J),
        ),
        Drawing(
            name="motors",
            title="Motors",
            caption=f"The four motors: {optimum.name}.{_not_drawn(flights, flights[:1])}",
            needs=_columns(*MOTOR),
            draw=lambda: draw_rotors(optimum),
        ),
        Drawing(
            name="battery",
            title="Battery",
            caption=f"The battery: {_listed(pair)}.{_not_drawn(flights, pair)}",
            needs=_columns(BATTERY),
            draw=lambda: draw_battery(pair),
        ),
    )


def _wind(optimum: StyledFlight, blowing: StyledFlight | None) -> tuple[Drawing, ...]:
    shown = [flight for flight in (optimum, blowing) if flight is not None]
    is_declared = all(set(_columns(WIND)) <= set(flight.frame) for flight in shown)
    if not is_declared or is_calm(*shown):
        return ()
    return (
        Drawing(
            name="wind",
            title="Wind",
            caption="The wind over the flight, in world axes.",
            needs=_columns(WIND),
            draw=lambda: draw_wind(optimum, blowing),
        ),
    )


def _own_floors(flights: Sequence[StyledFlight]) -> str:
    """Warn of comparing the ends of curves above hovering where they lie at different times."""
    if take_one_time(flights):
        return ""
    return (
        " Flights that take other times end above other hover floors: only their total energies "
        "compare."
    )


def _more_than(flight: StyledFlight) -> str:
    return f"how much more each takes than {flight.name}, whatever their times"


def _cut(flights: Sequence[StyledFlight]) -> str:
    """Say whose peaks the panel of the power leaves out, and how far they go."""
    if POWER.column not in flights[0].frame:
        return ""
    peaks = [
        f"{flight.name} ({fixed(power.min(), 1)} to {fixed(power.max(), 1)} W)"
        for flight in cut_flights(flights)
        for power in (POWER.of(flight.frame),)
    ]
    return f" Short peaks leave the first panel: {', '.join(peaks)}." if peaks else ""


def _coinciding(flights: Sequence[StyledFlight], hover_energy_J: float) -> str:
    """Say whose energy cannot be told from the optimum's."""
    if ENERGY.column not in flights[0].frame:
        return ""
    same = coinciding_flights(flights, hover_energy_J / flights[0].duration_s)
    if not same:
        return ""
    return f" The energy of {flights[0].name} hides that of {_listed(same)}."


def _undercut(flights: Sequence[StyledFlight], hover_energy_J: float) -> str:
    """Say what the bars show of flights below the hover floor, where there are any."""
    hover_power = hover_energy_J / flights[0].duration_s
    is_below = any(flight.energy_J < hover_power * flight.duration_s for flight in flights)
    return " Colour within the grey is what a flight takes less." if is_below else ""


def _not_drawn(flights: Sequence[StyledFlight], drawn: Sequence[StyledFlight]) -> str:
    """Say which flights of a run a figure leaves to the table."""
    rest = [flight for flight in flights if flight not in drawn]
    return f" Not drawn: {_listed(rest)}." if rest else ""


def _costates(plan: "Plan") -> tuple[Drawing, ...]:
    costates = plan.costate_frame()
    if not set(COSTATES) <= set(costates):
        return ()
    return (
        Drawing(
            name="costates",
            title="Costates and Hamiltonian",
            caption="Costates: what a small change of each state would cost from there on. The "
            "Hamiltonian varies only as the wind does; in calm air it is constant.",
            draw=lambda: draw_costates(costates, plan.duration_s),
        ),
    )


def _columns(*groups: Iterable[Signal]) -> tuple[str, ...]:
    return tuple(signal.column for group in groups for signal in group)


def _listed(flights: Sequence[StyledFlight]) -> str:
    *first, last = (flight.name for flight in flights)
    return f"{', '.join(first)} and {last}" if first else last
