"""Optimal control problems with a known answer, written as a Pyomo.DAE user would.

Each module states its problem and offers

- ``build()``: the Pyomo model;
- ``objective()``: the optimum;
- ``state(t)``, ``control(t)``, ``costate(t)``: where known, a mapping from component name (or
  name and index) to its values at times ``t``; the costate is the derivative of the optimum
  with respect to the state, of a maximum that of its negative;
- ``times(model)``: the free times, where there are any;
- ``KINKS``: the times where one of these jumps or bends.

``python -m tests.problems`` solves them all and prints a table.
"""
