"""Dymos (`pip install dymos`), Radau points; SciPy's SLSQP, the optimiser that pip installs for it.

The integral is a state more; derivatives of the equations are by complex step.
"""

import contextlib
import io
import os
import tempfile

import dymos
import numpy as np
import openmdao.api as om

from tests.benchmarks.peers.problems import FREE

RUNGS = (5, 10, 20, 40)
DEGREE = 4


class Equations(om.ExplicitComponent):
    """Rates, integrand and path limit of a problem at all nodes."""

    def initialize(self):
        self.options.declare("num_nodes", types=int)
        self.options.declare("problem")

    def setup(self):
        n, problem = self.options["num_nodes"], self.options["problem"]
        for name in (*problem.states, *problem.controls):
            self.add_input(name, shape=n)
        outputs = [f"rate_{name}" for name in problem.states] + ["running"]
        for name in outputs + ["outside"] * (problem.path is not None):
            self.add_output(name, shape=n)
            # Each node's outputs depend on that node alone.
            self.declare_partials(name, "*", rows=np.arange(n), cols=np.arange(n), method="cs")

    def compute(self, inputs, outputs):
        problem = self.options["problem"]
        states = [inputs[name] for name in problem.states]
        controls = [inputs[name] for name in problem.controls]
        rates = problem.rates(np, states, controls)
        for name, rate in zip(problem.states, rates, strict=True):
            outputs[f"rate_{name}"] = rate
        outputs["running"] = problem.running(np, states, controls)
        if problem.path is not None:
            outputs["outside"] = problem.path(np, states, controls)[0]


class Cost(om.ExplicitComponent):
    """The objective of the final states, the duration and the integral."""

    def initialize(self):
        self.options.declare("problem")

    def setup(self):
        for name in (*self.options["problem"].states, "T", "spent"):
            self.add_input(name, shape=1)
        self.add_output("cost")
        self.declare_partials("*", "*", method="cs")

    def compute(self, inputs, outputs):
        problem = self.options["problem"]
        final = [inputs[name] for name in problem.states]
        outputs["cost"] = problem.objective(final, inputs["T"], inputs["spent"])


def solve(problem, elements):
    """Return duration, pieces of control, and iterations; see `tests.benchmarks.peers`."""
    os.chdir(tempfile.mkdtemp())  # it leaves a folder of reports where it works
    low, high, first = problem.duration
    transcription = dymos.Radau(num_segments=elements, order=DEGREE, compressed=True)
    phase = dymos.Phase(
        ode_class=Equations, ode_init_kwargs={"problem": problem}, transcription=transcription
    )
    fixed = {"fix_duration": True} if not problem.is_free else {"duration_bounds": (low, high)}
    phase.set_time_options(fix_initial=True, units=None, **fixed)
    for name, (_, end, floor, ceiling) in problem.states.items():
        phase.add_state(
            name,
            rate_source=f"rate_{name}",
            fix_initial=True,
            fix_final=end is not FREE,
            lower=floor,
            upper=ceiling,
            ref=problem.scale(name),
        )
    phase.add_state("spent", rate_source="running", fix_initial=True)
    for name, (floor, ceiling, _) in problem.controls.items():
        phase.add_control(name, lower=floor, upper=ceiling, continuity=False, rate_continuity=False)
    if problem.path is not None:
        phase.add_path_constraint("outside", lower=0.0)
    trajectory = dymos.Trajectory()
    trajectory.add_phase("phase", phase)
    declared = om.Problem(reports=False)
    declared.model.add_subsystem("trajectory", trajectory)
    declared.model.add_subsystem("cost", Cost(problem=problem))
    ended = "trajectory.phase.timeseries"
    for name in (*problem.states, "spent"):
        declared.model.connect(f"{ended}.{name}", f"cost.{name}", src_indices=[-1])
    declared.model.connect(f"{ended}.time", "cost.T", src_indices=[-1])
    declared.model.add_objective("cost.cost")
    declared.driver = om.ScipyOptimizeDriver(optimizer="SLSQP", maxiter=1000, tol=1e-6)
    declared.driver.options["disp"] = False
    declared.driver.declare_coloring(show_summary=False)
    with contextlib.redirect_stdout(io.StringIO()):
        declared.setup()
        phase.set_time_val(initial=0.0, duration=first)
        shares = np.linspace(0.0, 1.0, 21)
        for k, name in enumerate(problem.states):
            phase.set_state_val(name, [problem.guess(s)[k] for s in shares], shares)
        phase.set_state_val("spent", [0.0, 1.0])
        for name, (_, _, value) in problem.controls.items():
            phase.set_control_val(name, [value, value])
        ended_well = declared.run_driver().success
    if not ended_well:
        raise RuntimeError(f"SLSQP: {declared.driver._scipy_optimize_result.message}")
    times = declared.get_val(f"{ended}.time").ravel()
    values = [declared.get_val(f"{ended}.{name}").ravel() for name in problem.controls]
    held, end = np.column_stack(values), float(times[-1])
    pieces, size = [], DEGREE + 1
    for e in range(elements):
        part = slice(e * size, (e + 1) * size - 1)
        pieces.append(
            (e / elements, (e + 1) / elements, (times[part] / end).tolist(), held[part].tolist())
        )
    return end, pieces, 0
