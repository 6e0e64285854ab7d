"""Energy-time front: least energy of a mission of free duration against its duration.

Each point of the front is a flight that minimises energy + price of time [W] * duration. No price
is negative, so no shorter flight of the mission takes less energy than the flight of the point. The
mission sets one price; others are tried.

Where the least energy is convex in the duration, each price selects one flight. There the slope is
minus the price.
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

    The columns are `FrontColumn`; the shortest flight is first. The table is empty if the duration
    is fixed or the plan is not verified. Flights other than the plan may break limits between mesh
    points.
    """
    if not plan.is_verified or not plan.scenario.mission.is_free:
        return FrontColumn.of_rows(())
    mission = plan.scenario.mission
    # The objective of least time has no price of time.
    own = nan if mission.aim is Aim.TIME else mission.price_of_time
    aim = Aim.ENERGY if mission.aim is Aim.TIME else mission.aim
    rows = [(own, plan.duration_s, plan.energy, True)]
    hover_power = plan.hover_energy_J / plan.duration_s
    prices = [share * hover_power for share in _PRICES] if isfinite(hover_power) else []
    for price in prices:
        if isclose(price, own, rel_tol=0.1, abs_tol=0.1 * hover_power):
            continue
        # Each solve starts from the plan, so the flight passes keep-out zones on the same sides.
        # The mesh of the plan is accurate enough for energies. For the objective of least charge,
        # the charge times a voltage takes the place of the energy.
        found = planned_alike(plan, planner, progress, price_of_time=price, aim=aim)
        is_new = not any(isclose(found.duration_s, row[1], rel_tol=_SAME_TIME) for row in rows)
        # The plan is a flight of the changed mission too, so that an optimum costs no more.
        most = (1.0 + ALIKE) * (plan.energy + price * plan.duration_s)
        if is_optimum(found) and is_new and found.cost <= most:
            rows.append((price, found.duration_s, found.energy, False))
    return FrontColumn.of_rows(rows).sort_values(FrontColumn.DURATION, ignore_index=True)


def is_optimum(found: Plan) -> bool:
    """Return whether a plan is a converged solution whose controls could be simulated.

    The simulated flight may deviate from the plan. A search that fails may end with a usable plan,
    such as one along straight lines, which is not optimal.
    """
    solution = found.solution
    return found.verification is not None and solution is not None and solution.status.is_solved


def planned_alike(
    plan: Plan, planner: Planner, progress: Progress | None, **changed: object
) -> Plan:
    """Solve a plan's mission again with changed fields of the table `mission`.

    The solve starts from the plan and keeps its mesh. If it fails, the `status` of the result says
    so.
    """
    once = {"solver": plan.scenario.solver.model_copy(update={"max_refinements": 0})}
    # Margins for an allowed risk tightened limits of the plan. The same margins make both plans
    # comparable.
    told = tightened(plan.scenario.with_mission(**changed), plan.margins).model_copy(update=once)
    return planner.solve(told, warm_start=plan, progress=progress)
