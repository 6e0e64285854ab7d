"""A model discretised by Pyomo's own `dae.collocation`, made comparable with the engine.

Four faults of the stock transformation are set right here, none of them in the equations:

- it rounds times to 6 decimals, though its matrices are those of the exact points, so a
  parameter that holds the time is given the exact one;
- it rounds element boundaries too, and bisects the widest element where a model declares
  points inside its horizon, so equal elements are put into the set beforehand;
- it leaves such parameters without values at the new points;
- its `Integral` is the trapezoidal rule, so integrals are replaced by Radau quadrature, with
  weights found from the points alone.
"""

import tempfile
from itertools import pairwise
from pathlib import Path

import casadi
import numpy as np
from numpy.polynomial import legendre
from pyomo.environ import Constraint, Objective, Param, Suffix, TransformationFactory

# How the stock transformation names the equations of a derivative.
_SLOPE_EQUATION = "_disc_eq"


def radau_points(degree):
    """Return the zeros of P_d - P_(d-1), moved to (0, 1]; the last is 1.

    All of them are real, but the array is complex from NumPy 2.5 on.
    """
    coefficients = np.zeros(degree + 1)
    coefficients[-2:] = -1.0, 1.0
    points = (1.0 + np.sort(legendre.legroots(coefficients).real)) / 2
    points[-1] = 1.0
    return points


def radau_weights(degree):
    """Return the weights that integrate 1, t, ..., t^(d-1) exactly over [0, 1]."""
    powers = np.vander(radau_points(degree), increasing=True).T
    return np.linalg.solve(powers, 1.0 / np.arange(1, degree + 1))


class StockModel:
    """A discretised model, its collocation points and its quadrature.

    `integrands` maps the name of each Integral to its integrand, a function of (model, t).
    """

    def __init__(self, model, time, *, elements, degree, integrands):
        self.model, self.time = model, time
        start, end = time.first(), time.last()
        time.update(start + (end - start) * e / elements for e in range(1, elements))
        time.set_changed(True)
        # What the set's own generation of finite elements would have stored.
        time._fe = ends = sorted(time)
        TransformationFactory("dae.collocation").apply_to(
            model, wrt=time, nfe=elements, ncp=degree, scheme="LAGRANGE-RADAU"
        )
        self.labels = sorted(time)
        self.times = [ends[0]]
        self.weights = []
        for start, end in pairwise(ends):
            self.times.extend(start + (end - start) * radau_points(degree))
            self.weights.extend((end - start) * radau_weights(degree))
        self._fill_time_parameters()
        for name, integrand in integrands.items():
            model.find_component(name).set_value(
                sum(
                    w * integrand(model, t)
                    for w, t in zip(self.weights, self.labels[1:], strict=True)
                )
            )

    def _fill_time_parameters(self):
        for parameter in self.model.component_objects(Param, descend_into=True):
            if parameter.index_set() is self.time:
                for label, exact in zip(self.labels, self.times, strict=True):
                    parameter[label] = parameter._rule(parameter.parent_block(), exact)

    def rows(self):
        """Return (constraint, label of its time or None) for every active constraint."""
        return [
            (data, self._label(component, index))
            for component in self.model.component_objects(
                Constraint, active=True, descend_into=True
            )
            for index, data in component.items()
        ]

    def _label(self, component, index):
        if self.time not in component.index_set().subsets():
            return None
        return index[-1] if isinstance(index, tuple) else index

    def constraints(self):
        """Return active constraints by what the engine calls a row of theirs.

        That is the name without the time, and the label of the time, for an equation over time;
        for a condition, the constraint's own name and None.
        """
        found = {}
        for data, label in self.rows():
            found[data.name, None] = data
            if label is not None:
                index = data.index() if isinstance(data.index(), tuple) else (data.index(),)
                inner = f"[{','.join(str(k) for k in index[:-1])}]" if index[:-1] else ""
                found[data.parent_component().name + inner, label] = data
        return found

    def slopes(self):
        """Return (derivative, equation that the stock scheme ties it to states with) pairs."""
        return [
            (equations.parent_block().component(name.removesuffix(_SLOPE_EQUATION))[index], data)
            for equations in self.model.component_objects(Constraint, descend_into=True)
            if (name := equations.local_name).endswith(_SLOPE_EQUATION)
            for index, data in equations.items()
        ]

    def is_slope(self, constraint):
        """Say whether a constraint is of the scheme and not of the model."""
        return constraint.parent_component().local_name.endswith(_SLOPE_EQUATION)

    def nonlinear_program(self):
        """Return the program written as .nl and read by CasADi."""
        for suffix in self.model.component_objects(Suffix):
            suffix.deactivate()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "stock.nl"
            self.model.write(str(path), format="nl")
            program = casadi.NlpBuilder()
            program.import_nl(str(path))
        return program

    def optimum(self):
        """Return the best objective, as declared, that CasADi's own Ipopt finds."""
        program = self.nonlinear_program()
        solver = casadi.nlpsol(
            "stock",
            "ipopt",
            {
                "x": casadi.vertcat(*program.x),
                "f": program.f,
                "g": casadi.vertcat(*program.g),
            },
            {"ipopt.print_level": 0, "print_time": False, "ipopt.tol": 1e-10, "ipopt.sb": "yes"},
        )
        result = solver(
            x0=program.x_init,
            lbx=program.x_lb,
            ubx=program.x_ub,
            lbg=program.g_lb,
            ubg=program.g_ub,
        )
        assert solver.stats()["success"]
        # CasADi negates a maximum.
        (objective,) = self.model.component_data_objects(Objective, active=True)
        return objective.sense * float(result["f"])
