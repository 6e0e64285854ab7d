"""Studies of one scenario: checks of the mission, the complete run, and analyses of its plan.

The complete run plans the mission, simulates the plan and the baseline flights, and compares their
energies. The analyses include:

- the tuning of an autopilot for comparison with the plan;
- a lower bound on the energy;
- the least energy as a function of the flight duration;
- flights in random winds;
- repeated flights on one battery charge.
"""
