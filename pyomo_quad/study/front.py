"""Energy-time front: least energy of a mission of free duration against its duration.

Each point of the front is a flight that minimises energy + price of time [W] * duration. Every
shorter flight takes at least as much energy. The mission sets one price, and this study also uses
other prices.

Where the least energy is convex in the duration, each price selects one flight. The slope of the
front there is minus the price.
"""

from math import isclose, isfinite, nan
from typing import TYPE_CHECKING

from pyomo_quad.collocation import Progress
from pyomo_quad.flight import Plan, Planner
from pyomo_quad.flight.margins import tightened
from pyomo_quad.scenario.mission import Aim
from pyomo_quad.study.tables import TableColumn

if TYPE_CHECKING:
    import pandas as pd

# Prices of time (weights of the duration in the objective), relative to the power of hovering, that
# are solved in addition to the mission's own price.
_PRICES = (0.0, 0.3, 1.0, 3.0)
# Relative difference of durations below which two points of the front count as the same flight,
# such as two at a limit of the duration.
_SAME_TIME = 1e-4
# Relative amount by which an optimum may exceed another flight of its mission in the objective,
# because both are accurate to a tolerance only.
ALIKE = 1e-4


class FrontColumn(TableColumn):
    """Columns of the table of an energy-time front (least energy against duration).

    Each row is an optimal flight for one price of time, the weight of the duration in the
    objective. `IS_PLAN` says whether the flight is the plan of the run.
    """

    PRICE = "price_of_time_W"
    DURATION = "duration_s"
    ENERGY = "energy_J"
    IS_PLAN = "is_plan"


def energy_time_front(
    plan: Plan, *, planner: Planner, progress: Progress | None = None
) -> "pd.DataFrame":
    """Return energy and duration of a free-duration mission for several prices of time.

    The objective is energy + price of time [W] * duration. If the mission's objective is the least
    charge, the charge times a voltage takes the place of the energy. The mesh is that of the plan,
    so the new flights may break limits between mesh points.

    Parameters
    ----------
    plan : Plan
        Plan of the mission, one point of the front.
    planner : Planner
        Solves the mission for the other prices.
    progress : callable, optional
        Called at each Ipopt iteration; returning False stops the solve.

    Returns
    -------
    DataFrame
        Columns of `FrontColumn`, one row for each flight, the shortest flight first. The price of
        the plan is NaN if its objective is the least time. The table is empty if the mission fixes
        the duration, or if simulation did not confirm the plan to the requested accuracy. Only
        successful solves with new durations add rows.
    """
    if not plan.is_verified or not plan.scenario.mission.is_free:
        return FrontColumn.of_rows(())
    mission = plan.scenario.mission
    own = nan if mission.aim is Aim.TIME else mission.price_of_time
    aim = Aim.ENERGY if mission.aim is Aim.TIME else mission.aim
    rows = [(own, plan.duration_s, plan.energy, True)]
    hover_power = plan.hover_energy_J / plan.duration_s
    prices = [share * hover_power for share in _PRICES] if isfinite(hover_power) else []
    for price in prices:
        if isclose(price, own, rel_tol=0.1, abs_tol=0.1 * hover_power):
            continue
        # Each solve starts from the plan, so the flight passes keep-out zones on the same sides.
        # The mesh of the plan is accurate enough for energies.
        found = planned_alike(plan, planner, progress, price_of_time=price, aim=aim)
        is_new = not any(isclose(found.duration_s, row[1], rel_tol=_SAME_TIME) for row in rows)
        # The plan is a flight of the changed mission too, so that an optimum costs no more.
        most = (1.0 + ALIKE) * (plan.energy + price * plan.duration_s)
        if is_optimum(found) and is_new and found.cost <= most:
            rows.append((price, found.duration_s, found.energy, False))
    return FrontColumn.of_rows(rows).sort_values(FrontColumn.DURATION, ignore_index=True)


def is_optimum(found: Plan) -> bool:
    """Return whether a plan is a converged solution that simulation confirms at some accuracy.

    A search that fails may end with a usable plan, such as one along straight lines, which is not
    optimal.
    """
    solution = found.solution
    return found.verification is not None and solution is not None and solution.status.is_solved


def planned_alike(
    plan: Plan, planner: Planner, progress: Progress | None, **changed: object
) -> Plan:
    """Solve a plan's mission with some fields changed, warm-started from the plan and on its mesh.

    Limits that the plan tightened for an allowed risk are tightened by the same margins. The two
    plans are thus comparable.

    Parameters
    ----------
    plan : Plan
        Start of the solve.
    planner : Planner
        Solves the changed mission, without mesh refinement.
    progress : callable or None
        Called at each Ipopt iteration; returning False stops the solve.
    **changed : object
        Fields of the scenario's table `mission` and their new values.

    Returns
    -------
    Plan
        The plan of the changed mission. If the solve failed, its `status` says so.
    """
    once = {"solver": plan.scenario.solver.model_copy(update={"max_refinements": 0})}
    told = tightened(plan.scenario.with_mission(**changed), plan.margins).model_copy(update=once)
    return planner.solve(told, warm_start=plan, progress=progress)
