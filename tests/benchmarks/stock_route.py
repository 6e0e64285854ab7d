"""The route without this package: dae.collocation, an .nl file, CasADi's derivatives, cyipopt."""

import casadi
import cyipopt
import numpy as np

from tests.agreement.stock import StockModel
from tests.benchmarks.measuring import seconds

# Ipopt's defaults, but no early stop at a merely acceptable point.
_OPTIONS = {"print_level": 0, "sb": "yes", "acceptable_iter": 0}


class _Callbacks:
    """What cyipopt calls, from CasADi's functions of the whole program."""

    def __init__(self, program):
        stacked = casadi.vertcat(*program.x)
        # Scalar symbols: CasADi differentiates the flat graph several times quicker than the
        # matrix symbols that the .nl reader makes.
        flat = casadi.Function("flat", [stacked], [program.f, casadi.vertcat(*program.g)]).expand()
        x = casadi.SX.sym("x", stacked.shape[0])
        objective, rows = flat(x)
        multipliers = casadi.SX.sym("multipliers", rows.shape[0])
        factor = casadi.SX.sym("factor")
        jacobian = casadi.jacobian(rows, x)
        lagrangian = factor * objective + casadi.dot(multipliers, rows)
        hessian = casadi.tril(casadi.hessian(lagrangian, x)[0])
        self._objective = casadi.Function("objective", [x], [objective])
        self._gradient = casadi.Function("gradient", [x], [casadi.gradient(objective, x)])
        self._rows = casadi.Function("rows", [x], [rows])
        self._jacobian = casadi.Function("jacobian", [x], [jacobian])
        self._hessian = casadi.Function("hessian", [x, factor, multipliers], [hessian])
        self._jacobian_structure = jacobian.sparsity().get_triplet()
        self._hessian_structure = hessian.sparsity().get_triplet()
        self.iterations = 0

    def objective(self, x):
        return float(self._objective(x))

    def gradient(self, x):
        return np.array(self._gradient(x)).ravel()

    def constraints(self, x):
        return np.array(self._rows(x)).ravel()

    def jacobianstructure(self):
        return self._jacobian_structure

    def jacobian(self, x):
        return np.array(self._jacobian(x).nonzeros())

    def hessianstructure(self):
        return self._hessian_structure

    def hessian(self, x, multipliers, factor):
        return np.array(self._hessian(x, factor, multipliers).nonzeros())

    def intermediate(self, _mode, iteration, *_rest):
        self.iterations = iteration
        return True


def solve_by_stock_route(model, elements, degree, *, tolerance=1e-9):
    """Solve the declared mission; returns the numbers of one row of the benchmark.

    The energy is the Radau sum of the declared power, since the stock trapezoids would have
    the optimiser solve another problem.
    """
    started = seconds()
    stock = StockModel(
        model,
        model.time,
        elements=elements,
        degree=degree,
        integrands={"energy": lambda m, t: m.power.total[t]},
    )
    program = stock.nonlinear_program()
    built = seconds()
    callbacks = _Callbacks(program)
    derived = seconds()
    ipopt = cyipopt.Problem(
        n=len(program.x_init),
        m=len(program.g_lb),
        problem_obj=callbacks,
        lb=program.x_lb,
        ub=program.x_ub,
        cl=program.g_lb,
        cu=program.g_ub,
    )
    for name, setting in (_OPTIONS | {"tol": tolerance}).items():
        ipopt.add_option(name, setting)
    x, info = ipopt.solve(np.array(program.x_init))
    solved = seconds()
    if info["status"] not in (0, 1):
        raise RuntimeError(f"stock route: {info['status_msg']}")
    return {
        "energy_J": callbacks.objective(x),
        "variables": len(x),
        "iterations": callbacks.iterations,
        "discretise_s": built - started,
        "derivatives_s": derived - built,
        "solve_s": solved - derived,
    }
