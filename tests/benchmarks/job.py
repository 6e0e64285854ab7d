"""One job of `jobs`, by the package that PYTHONPATH names: of this checkout or of an older one.

    python tests/benchmarks/job.py NAME CHECKOUT SCENARIO JSON

Nothing but the public API of any age is used, and only this file is read from the newer checkout.
JSON has the changes of a scenario and, as "accuracy", the one asked for, which older packages do
not know.  The last line printed is the result, with the seconds of Ipopt, of its callbacks and of
SciPy's integrator, which are timed wherever a package calls them.
"""

import inspect
import json
import resource
import sys
import time
from pathlib import Path

import cyipopt
import numpy as np
import scipy.integrate

#: Processor seconds [s] of parts of the job, and numbers of solves and iterations.
SPENT = dict.fromkeys(("ipopt_s", "callbacks_s", "flights_s"), 0.0) | {"solves": 0, "iterations": 0}


def timed(function, part):
    """Return a function whose processor seconds are added to a part of the job."""

    def run(*given, **named):
        began = time.process_time()
        try:
            return function(*given, **named)
        finally:
            SPENT[part] += time.process_time() - began

    return run


class TimedCallbacks:
    """The callbacks that Ipopt is given, with the time that they take."""

    def __init__(self, own):
        self.own = own

    def __getattr__(self, name):
        return timed(getattr(self.own, name), "callbacks_s")

    def intermediate(self, *given):
        SPENT["iterations"] += given[1] > 0
        return timed(self.own.intermediate, "callbacks_s")(*given)


class TimedProblem(cyipopt.Problem):
    """A problem that tells the time of its solves."""

    def __new__(cls, *given, problem_obj=None, **named):
        return super().__new__(cls, *given, problem_obj=TimedCallbacks(problem_obj), **named)

    def __init__(self, *given, problem_obj=None, **named):
        super().__init__(*given, problem_obj=TimedCallbacks(problem_obj), **named)

    def solve(self, *given, **named):
        SPENT["solves"] += 1
        return timed(super().solve, "ipopt_s")(*given, **named)


def scenario_of(file, told):
    """Return a scenario with its changes, and its accuracy where the package knows any."""
    from pyomo_quad.scenario import load_scenario

    settings = told.get("settings", ())
    scenario = load_scenario(file, settings)
    changes = dict(told.get("changes", {}))
    if "accuracy" in told and "accuracy" in type(scenario.solver).model_fields:
        changes["solver.accuracy"] = told["accuracy"]
    return scenario.with_values(changes) if changes else scenario


def plan(file, told):
    """Solve a scenario to its verified plan."""
    from pyomo_quad.flight import Planner

    scenario = scenario_of(file, told)
    started = time.process_time()
    found = Planner().solve(scenario)
    spent = time.process_time() - started
    return {"s": spent, "ended": found.status.value, "energy_J": found.energy}


def usable(file, told):
    """Solve a scenario to its first usable plan; to its end where a package knows of none."""
    from pyomo_quad.flight import Planner

    scenario, states, watched = scenario_of(file, told), [], {}
    if "show" in inspect.signature(Planner.solve).parameters:
        watched["show"] = states.append
        watched["progress"] = lambda _line: not (states and states[-1].has_usable)
    started = time.process_time()
    found = Planner().solve(scenario, **watched)
    spent = time.process_time() - started
    return {"s": spent, "ended": found.status.value, "energy_J": found.energy}


def ducted_fan(_file, _told):
    """Turn a planar ducted fan 1 m aside at a price of time, refined to 1e-6.

    Graichen and Petit, "Incorporating a class of constraints into the dynamics of optimal control
    problems", Optimal Control Applications and Methods 30 (2009).
    """
    from pyomo.dae import ContinuousSet, DerivativeVar, Integral
    from pyomo.environ import ConcreteModel, Constraint, Objective, Var, cos, sin

    from pyomo_quad.collocation import compile

    radius, inertia, mass, weight, price = 0.2, 0.05, 2.2, 4.0, 1000.0
    started = time.process_time()
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.T = Var(bounds=(0.1, 10), initialize=1.0)
    bounds = {"alpha": (-np.pi / 6, np.pi / 6)}
    rates = {
        "x": lambda t: m.vx[t],
        "y": lambda t: m.vy[t],
        "alpha": lambda t: m.w[t],
        "vx": lambda t: (m.u1[t] * cos(m.alpha[t]) - m.u2[t] * sin(m.alpha[t])) / mass,
        "vy": lambda t: (m.u1[t] * sin(m.alpha[t]) + m.u2[t] * cos(m.alpha[t]) - weight) / mass,
        "w": lambda t: radius * m.u1[t] / inertia,
    }
    m.u1, m.u2 = Var(m.t, bounds=(-5, 5)), Var(m.t, bounds=(0, 17))
    for name in rates:
        m.add_component(name, Var(m.t, bounds=bounds.get(name)))
        state = m.component(name)
        m.add_component(f"d{name}", DerivativeVar(state, wrt=m.t))
        state[0].fix(0)
        state[1].fix(1 if name == "x" else 0)
    for name, rate in rates.items():

        def law(m, t, name=name, rate=rate):
            return m.component(f"d{name}")[t] == m.T * rate(t)

        m.add_component(f"{name}_law", Constraint(m.t, rule=law))
    m.effort = Integral(m.t, wrt=m.t, rule=lambda m, t: 2 * m.u1[t] ** 2 + m.u2[t] ** 2)
    m.cost = Objective(expr=m.effort + price * m.T)
    found = compile(m).solve(tolerance=1e-6)
    spent = time.process_time() - started
    return {"s": spent, "ended": found.status.value, "energy_J": found.objective}


def random_missions(file, told):
    """Solve missions one after another; the seconds are those of the median."""
    from pyomo_quad.flight import Planner
    from pyomo_quad.scenario import load_scenario

    planner, spent, ended = Planner(), [], []
    for settings in told["missions"]:
        started = time.process_time()
        try:
            ended.append(planner.solve(load_scenario(file, settings)).status.value)
        except ValueError:
            ended.append("refused")
        spent.append(time.process_time() - started)
    counts = ", ".join(f"{ended.count(name)} {name}" for name in sorted(set(ended)))
    return {"s": float(np.median(spent)), "ended": counts}


def replanning(file, told):
    """Fly a scenario planned again in flight; the seconds are those that 95 % of solves keep."""
    from pyomo_quad.flight import Planner
    from pyomo_quad.flight.replanning import fly_replanned
    from pyomo_quad.scenario.tables import Knowledge

    # The seconds of the plan before take-off are not counted; it settles the passing times.
    planner = Planner()
    plan = planner.solve(scenario_of(file, told))
    scenario, given = plan.mission_flown, {"plan": plan}
    if "dynamics" in inspect.signature(fly_replanned).parameters:
        given["dynamics"] = planner.dynamics(scenario)
    flight = fly_replanned(scenario, Knowledge.ESTIMATED, planner=planner, **given)
    spent = [solve.solve_s for solve in flight.resolves]
    failed = sum(not solve.is_converged for solve in flight.resolves)
    ended = f"{len(spent)} solves, {failed} failed"
    return {"s": float(np.percentile(spent, 95)), "ended": ended, "energy_J": flight.energy_J}


if __name__ == "__main__":
    cyipopt.Problem = TimedProblem
    scipy.integrate.solve_ivp = timed(scipy.integrate.solve_ivp, "flights_s")
    import pyomo_quad

    name, checkout, scenario, told = sys.argv[1:]
    if Path(pyomo_quad.__file__).parents[1] != Path(checkout):
        raise SystemExit(f"{pyomo_quad.__file__} is not of {checkout}; set PYTHONPATH.")
    found = globals()[name](scenario, json.loads(told))
    found["peak_MiB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps(found | SPENT))
