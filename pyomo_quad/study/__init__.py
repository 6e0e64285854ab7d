"""Studies of one scenario: checks of the mission, the complete run, and analyses of its plan.

The complete run plans the mission, simulates the plan and the baseline flights, and compares their
energies. Other studies are:

- tuning of an autopilot for the comparison;
- a lower bound on the energy;
- least energy over flight duration;
- flights in random winds;
- repeated flights on one battery charge.
"""
