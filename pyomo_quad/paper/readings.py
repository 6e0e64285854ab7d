"""Two interpretations of the efficiency f_r of Yacef et al., and solves with each of them.

f_r, the efficiency of motor and rotor, is a polynomial of torque and speed. It was recovered from
public re-implementations, and is zero at some braking torques. One interpretation has lower limits
on torque and f_r, the other has none (see `Reading`). If the rotors may reach these torques and f_r
has no lower limit, the optimal control problem has no minimum. The solves use fixed meshes.
"""

from dataclasses import dataclass
from enum import StrEnum
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation import Dynamics, Mesh, Solution, SolverOptions, Status
from pyomo_quad.flight import Planner
from pyomo_quad.flight.columns import ROTORS
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.flight.verification import fly_controls
from pyomo_quad.model import build_model
from pyomo_quad.paper.experiments import Experiment, paper_scenario
from pyomo_quad.scenario import PowerModel, Scenario

if TYPE_CHECKING:
    from pyomo.core import ConcreteModel

# Lower limit that is so far below every torque [N m] and every value of f_r that it has no effect.
_NO_FLOOR = -1e3


class Reading(StrEnum):
    """Interpretation of the efficiency f_r of Yacef et al., where f_r is small or negative.

    `REGULARISED` has lower limits on torque and f_r, and braking returns no energy. `LITERAL` has
    no lower limits, and braking returns energy.
    """

    REGULARISED = "regularised"
    LITERAL = "literal"

    def values(self) -> dict[str, Any]:
        """Return the scenario fields that select this interpretation of the efficiency f_r.

        Returns
        -------
        dict
            Value of each field, by its dotted path.
        """
        return {
            "power.model": PowerModel.EFFICIENCY,
            "power.regeneration": self is Reading.LITERAL,
        }

    def planner(self) -> Planner:
        """Return a planner whose model uses this interpretation of the efficiency f_r."""
        return Planner(literal_model if self is Reading.LITERAL else model_without_battery)


def model_without_battery(scenario: Scenario) -> "ConcreteModel":
    """Build a mission's Pyomo model without the battery.

    The energy of a flight does not depend on the battery, whose current is undefined where f_r is
    zero.
    """
    m = build_model(scenario)
    m.del_component(m.battery)
    return m


def literal_model(scenario: Scenario) -> "ConcreteModel":
    """Build a mission's model in which f_r and its torque have no lower limits, without battery.

    The scenario needs the fields of `Reading.LITERAL.values()`: the power model `efficiency`, which
    uses f_r, and regeneration.
    """
    m = model_without_battery(scenario)
    m.power.torque_floor.set_value(_NO_FLOOR)
    m.power.efficiency_floor.set_value(_NO_FLOOR)
    return m


# Meshes of the trials, and bounds on the rotor acceleration [rad/s²]. Between the first two bounds
# the least energy under the literal f_r equals the paper's optimum; above the second there is none.
_DEGREE, _ELEMENTS = 4, (5, 10, 20)
_BOUNDS = (300.0, 1000.0, 3000.0, 10000.0)
# Samples per element for the energy of a simulated trial, whose power jumps within an element.
_SAMPLES_PER_ELEMENT = 400
# Solver options looser than the planner's, because a problem without a minimum meets no tolerance.
_OPTIONS = SolverOptions(tolerance=1e-6, max_iterations=100)


@dataclass(frozen=True, kw_only=True)
class MeshTrial:
    """Settings of a solve on a fixed mesh, for one interpretation of the efficiency f_r.

    The report compares the energies of the solves on several meshes.

    Attributes
    ----------
    reading : Reading
        Interpretation of f_r.
    bound : float
        Upper bound on the absolute rotor acceleration [rad/s²].
    elements, degree : int
        Number of elements of the mesh, and their polynomial degree.
    """

    reading: Reading
    bound: float
    elements: int
    degree: int = _DEGREE

    @property
    def title(self) -> str:
        """Name of the solve in a progress display."""
        return f"{self.reading.value} f_r, {self.bound:g} rad/s², {self.elements} elements"


@dataclass(frozen=True, kw_only=True)
class TrialOutcome:
    """Result of a solve on a fixed mesh, and of the simulation of its controls.

    Attributes
    ----------
    trial : MeshTrial
        Settings of the solve.
    has_converged : bool
        Whether the solver converged.
    energy_J : float
        Energy by the quadrature on the mesh.
    flown_energy_J : float
        Energy when the controls are simulated; NaN if f_r reaches zero in flight.
    miss_m : float
        Distance from the goal at the end of the simulated flight.
    """

    trial: MeshTrial
    has_converged: bool
    energy_J: float
    flown_energy_J: float
    miss_m: float


def mesh_trials(*, is_quick: bool = False) -> tuple[MeshTrial, ...]:
    """List the settings of all solves on fixed meshes.

    They combine each interpretation of f_r with several bounds on the rotor acceleration and
    several meshes. If `is_quick` is true, only the coarsest mesh is used.
    """
    trials = product(Reading, _BOUNDS, _ELEMENTS[:1] if is_quick else _ELEMENTS)
    return tuple(MeshTrial(reading=r, bound=bound, elements=count) for r, bound, count in trials)


def run_trial(trial: MeshTrial) -> TrialOutcome:
    """Solve the experiment of Yacef et al. in calm air on one mesh, and simulate the controls."""
    scenario = paper_scenario(
        Experiment.CALM,
        trial.reading.values() | {"limits.rotor_acceleration_max": trial.bound},
    )
    planner = trial.reading.planner()
    problem, _ = planner.problem_for(scenario)
    solution = problem.solve(
        mesh=Mesh.uniform(trial.elements, trial.degree),
        parameters=planner.parameters(scenario),
        horizon=(0.0, scenario.mission.fixed_duration),
        options=_OPTIONS,
    )
    flown_energy, miss = _fly(scenario, solution, planner.dynamics(scenario))
    return TrialOutcome(
        trial=trial,
        has_converged=solution.status is Status.CONVERGED,
        energy_J=solution.objective,
        flown_energy_J=flown_energy,
        miss_m=miss,
    )


def _fly(scenario: Scenario, solution: Solution, priced: Dynamics) -> tuple[float, float]:
    """Simulate the controls of a solution, and return energy [J] and distance from the goal [m].

    The power is computed by `priced`, with f_r. If f_r reaches zero in flight, the energy is NaN.
    """
    # The motion is independent of the power model. The power under f_r is infinite where f_r is
    # zero; the motors' power is finite everywhere.
    steerable = scenario.with_values({"power.model": PowerModel.MOTOR, "power.regeneration": True})
    flown = fly_controls(
        Planner(model_without_battery).dynamics(steerable),
        solution.mesh,
        solution.trajectory.algebraics,
        solution.trajectory.states[0],
        solution.horizon,
        samples_per_element=_SAMPLES_PER_ELEMENT,
    )
    efficiencies = tuple(("power.drive_efficiency", rotor) for rotor in ROTORS)
    keys = (("power.total", None), *efficiencies)
    table = priced.table(keys, flown.t, flown.states, flown.controls)
    energy = float(np.trapezoid(table[:, 0], flown.t))
    position = [priced.state_names.index(name) for name in POSITION_STATES]
    miss = flown.states[-1, position] - scenario.mission.goal.position
    is_priced = bool(np.all(table[:, 1:] > 0.0))
    return energy if is_priced else np.nan, float(np.linalg.norm(miss))
