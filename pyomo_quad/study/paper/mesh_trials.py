"""The first experiment under f_r, solved on coarse meshes: optima that do not survive a flight."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from pyomo_quad.collocation import Dynamics, Mesh, Solution, SolverOptions, Status
from pyomo_quad.flight import Planner
from pyomo_quad.flight.columns import ROTORS
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.flight.plant import fly_controls
from pyomo_quad.scenario import PowerModel, Scenario
from pyomo_quad.study.paper.missions import Experiment, paper_scenario
from pyomo_quad.study.paper.readings import Reading, model_without_battery

__all__ = ["MeshTrial", "TrialOutcome", "mesh_trials", "run_trial"]

_DEGREE = 4
_ELEMENTS = (5, 10, 20)
_BOUNDS = (300.0, 1000.0, 3000.0, 10000.0)
_SAMPLES_PER_ELEMENT = 400
# Looser than the planner's: a problem without a minimum meets no tolerance for long.
_OPTIONS = SolverOptions(tolerance=1e-6, max_iterations=100)


@dataclass(frozen=True, kw_only=True)
class MeshTrial:
    """A reading of f_r, a bound on the rotor acceleration [rad/s²], and a mesh."""

    reading: Reading
    bound: float
    elements: int
    degree: int = _DEGREE

    @property
    def title(self) -> str:
        """What a progress display calls it."""
        return f"{self.reading.value} f_r, {self.bound:g} rad/s², {self.elements} elements"


@dataclass(frozen=True, kw_only=True)
class TrialOutcome:
    """What the solver reported, and what its controls did when flown.

    Attributes
    ----------
    energy_J : float
        By the quadrature on the mesh.
    flown_energy_J : float
        Energy when the controls are flown; not a number where f_r passes zero on the way.
    miss_m : float
        Distance from the goal when the controls are flown.
    """

    trial: MeshTrial
    has_converged: bool
    energy_J: float
    flown_energy_J: float
    miss_m: float


def mesh_trials(*, is_quick: bool = False) -> tuple[MeshTrial, ...]:
    """List the solves of the study.

    Parameters
    ----------
    is_quick : bool
        Only the coarsest meshes.

    Returns
    -------
    tuple of MeshTrial
        By reading, bound and mesh.
    """
    elements = _ELEMENTS[:1] if is_quick else _ELEMENTS
    return tuple(
        MeshTrial(reading=reading, bound=bound, elements=count)
        for reading, bound, count in product(Reading, _BOUNDS, elements)
    )


def run_trial(trial: MeshTrial) -> TrialOutcome:
    """Solve on one mesh, without refinement, and fly what comes out.

    Parameters
    ----------
    trial : MeshTrial
        What to solve.

    Returns
    -------
    TrialOutcome
        Also of a solve that failed: of its best iterate.
    """
    scenario = paper_scenario(
        Experiment.CALM,
        trial.reading.values() | {"limits.rotor_acceleration_max": trial.bound},
    )
    planner = trial.reading.planner()
    problem, _ = planner.problem_for(scenario)
    horizon = (0.0, scenario.mission.duration)
    solution = problem.solve(
        mesh=Mesh.uniform(trial.elements, trial.degree),
        parameters=planner.parameters(scenario),
        horizon=horizon,
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
    """Return energy and miss of the solution's controls when flown."""
    # The motion does not depend on the power model, and this one has a finite power everywhere.
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
