"""Least energy compared with least charge: the same mission solved for each of the two objectives.

The energy is measured at the terminals of the battery. The charge also covers the loss in the
internal resistance, which is larger for a varying power than for a constant power of the same mean.
The two optima may therefore differ. The field `mission.aim` selects the objective of a plan.
"""

from typing import TYPE_CHECKING

from pyomo_quad.collocation import Progress
from pyomo_quad.flight import Plan, Planner
from pyomo_quad.flight.deadline import Deadline
from pyomo_quad.model.battery import CHARGE_STATE
from pyomo_quad.scenario import Attitude
from pyomo_quad.scenario.mission import Aim
from pyomo_quad.study.front import ALIKE, is_optimum, planned_alike
from pyomo_quad.study.tables import TableColumn

if TYPE_CHECKING:
    import pandas as pd

_AIMS = (Aim.ENERGY, Aim.CHARGE)
# Relative difference in charge of the two optima above which a run warns.
DISAGREEMENT = 0.005
# Processor time after which the solve for the other aim is stopped [s].
_LONGEST_S = 90.0


class AimColumn(TableColumn):
    """Columns of the table that compares the plans of least energy and least charge.

    Each row is one of the two plans, with its objective, energy and charge. `IS_PLAN` says whether
    it is the plan of the run; the other plan was solved only for the comparison.
    """

    AIM = "aim"
    ENERGY = "energy_J"
    CHARGE = "charge_Ah"
    IS_PLAN = "is_plan"


def charge_drawn(plan: Plan) -> float:
    """Return the charge that a plan draws from its battery [A h].

    Raises
    ------
    ValueError
        If the plan's model has no battery.
    """
    held = plan.trajectories
    charge = held.states[:, held.state_names.index(CHARGE_STATE)]
    return float(charge[-1] - charge[0])


def energy_and_charge(
    plan: Plan, *, planner: Planner, progress: Progress | None = None
) -> "pd.DataFrame":
    """Return energy and charge of a plan and of the plan for the other objective.

    The rows have the columns `AimColumn`, the plan of least energy first. The table is empty if the
    solve for the other objective fails or is stopped. It is empty if this solve finds a plan that
    is worse than `plan` in the other objective. It is also empty if `plan` is not verified by
    simulation, or has a third objective, such as least time. The same holds for a user's own
    vehicle model, and for the attitude equations of Yacef et al.
    """
    scenario = plan.scenario
    is_of_paper = scenario.vehicle.attitude is Attitude.PAPER
    # No comparison for a plan that is not confirmed by simulation, for a user's own vehicle model,
    # or for the attitude equations of Yacef et al.
    if not plan.is_verified or scenario.model is not None or is_of_paper:
        return AimColumn.of_rows(())
    # No comparison for a plan of least time.
    if scenario.mission.aim not in _AIMS:
        return AimColumn.of_rows(())
    other = next(aim for aim in _AIMS if aim is not scenario.mission.aim)
    with Deadline(scenario, progress, longest_s=_LONGEST_S) as brief:
        # The solve starts from the given plan and keeps its mesh.
        found = planned_alike(plan, planner, brief, aim=other)
    # A local optimum may be worse in its own objective than the given plan.
    if not is_optimum(found) or not _is_better(found, plan):
        return AimColumn.of_rows(())
    rows = [
        (one.scenario.mission.aim.value, one.energy, charge_drawn(one), one is plan)
        for one in sorted((plan, found), key=lambda one: _AIMS.index(one.scenario.mission.aim))
    ]
    return AimColumn.of_rows(rows)


def _is_better(found: Plan, plan: Plan) -> bool:
    """Return whether `found` is at least as good as `plan` in the objective of `found`.

    The objectives of the two plans differ.
    """
    price = found.scenario.mission.price_of_time
    if found.scenario.mission.aim is Aim.ENERGY or found.solution is None:
        return found.cost <= (1.0 + ALIKE) * plan.cost
    # The objective of least charge is the charge times a voltage, plus the price of the duration.
    # The voltage (`worth`) is the same for both plans; see docs/theory/battery.md, eq. (12).
    objective = found.solution.objective
    worth = (objective - price * found.duration_s) / charge_drawn(found)
    return objective <= (1.0 + ALIKE) * (worth * charge_drawn(plan) + price * plan.duration_s)


def charge_beyond_least(aims: "pd.DataFrame") -> float:
    """Return the excess charge of the plan of least energy, as a fraction of the least charge.

    `aims` is a table from `energy_and_charge` that is not empty.
    """
    of_energy, of_charge = aims[AimColumn.CHARGE]
    return float(of_energy / of_charge - 1.0)


def disagreement(aims: "pd.DataFrame") -> tuple[str, ...]:
    """Return a warning if the plan of least energy draws clearly more charge than necessary.

    `aims` is a table from `energy_and_charge`. The result is empty if the table is empty, or if
    `charge_beyond_least` is at most `DISAGREEMENT`.
    """
    if aims.empty or charge_beyond_least(aims) <= DISAGREEMENT:
        return ()
    energy, least = aims[AimColumn.ENERGY]
    line = (
        f"mission.aim: the flight of least energy draws {100.0 * charge_beyond_least(aims):.2g} % "
        "more charge than necessary, because changes of power increase the losses in the pack; "
        f'mission.aim = "charge" draws the least and spends {least - energy:.3g} J more energy.'
    )
    return (line,)
