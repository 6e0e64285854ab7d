"""Least energy against least charge: solves of the same mission for each aim, on one mesh."""

from typing import TYPE_CHECKING

from pyomo_quad.collocation import Progress
from pyomo_quad.flight import Plan, Planner
from pyomo_quad.flight.deadline import Deadline
from pyomo_quad.model.battery import CHARGE_STATE
from pyomo_quad.scenario import Attitude
from pyomo_quad.scenario.mission import Aim
from pyomo_quad.study.front import planned_alike
from pyomo_quad.study.tables import TableColumn

if TYPE_CHECKING:
    import pandas as pd

_AIMS = (Aim.ENERGY, Aim.CHARGE)
# Share of the charge by which the two optima may differ without a warning.
DISAGREEMENT = 0.005
# Processor time after which the other aim is given up [s].
_LONGEST_S = 10.0


class AimColumn(TableColumn):
    """Columns of `energy_and_charge`, in order."""

    AIM = "aim"
    ENERGY = "energy_J"
    CHARGE = "charge_Ah"
    IS_PLAN = "is_plan"


def charge_drawn(plan: Plan) -> float:
    """Return the charge that a plan draws from its battery [A h].

    Raises
    ------
    ValueError
        If the plan's model has no pack.
    """
    held = plan.trajectories
    charge = held.states[:, held.state_names.index(CHARGE_STATE)]
    return float(charge[-1] - charge[0])


def energy_and_charge(
    plan: Plan, *, planner: Planner, progress: Progress | None = None
) -> "pd.DataFrame":
    """Return energy and charge of the plan and of a plan for the other aim.

    The other is solved from the plan on its mesh, without refinement, and flown like it; a search
    that takes long is given up.

    Returns
    -------
    DataFrame
        Columns of `AimColumn`, least energy first; empty if the plan is not verified, for the least
        time, of the paper's own equations or of a user's own model, and if the other fails.
    """
    scenario = plan.scenario
    is_of_paper = scenario.vehicle.attitude is Attitude.PAPER
    if not plan.is_verified or scenario.model is not None or is_of_paper:
        return AimColumn.of_rows(())
    if scenario.mission.aim not in _AIMS:
        return AimColumn.of_rows(())
    other = next(aim for aim in _AIMS if aim is not scenario.mission.aim)
    with Deadline(scenario, progress, longest_s=_LONGEST_S) as brief:
        found = planned_alike(plan, planner, brief, aim=other)
    if found.verification is None:
        return AimColumn.of_rows(())
    rows = [
        (one.scenario.mission.aim.value, one.energy, charge_drawn(one), one is plan)
        for one in sorted((plan, found), key=lambda one: _AIMS.index(one.scenario.mission.aim))
    ]
    return AimColumn.of_rows(rows)


def charge_beyond_least(aims: "pd.DataFrame") -> float:
    """Return the relative excess of charge of the plan of least energy."""
    of_energy, of_charge = aims[AimColumn.CHARGE]
    return float(of_energy / of_charge - 1.0)


def disagreement(aims: "pd.DataFrame") -> tuple[str, ...]:
    """Return a warning if least energy and least charge differ much, or an empty text."""
    if aims.empty or charge_beyond_least(aims) <= DISAGREEMENT:
        return ()
    energy, least = aims[AimColumn.ENERGY]
    line = (
        f"mission.aim: the flight of least energy draws {100.0 * charge_beyond_least(aims):.2g} % "
        "more charge than need be, by swings of power that the pack pays for; "
        f'mission.aim = "charge" draws the least, for {least - energy:.3g} J more energy.'
    )
    return (line,)
