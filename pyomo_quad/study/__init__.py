"""Studies of one scenario: checks of the mission, the complete run, and analyses of its plan.

The checks come before the solve. The complete run plans the mission, simulates the plan and
baseline flights, and compares their energies.

The analyses include the tuning of an autopilot for comparison with the plan, a lower bound on the
energy, and the least energy as a function of the flight duration. Other analyses are
flights in random winds, and repeated flights on one battery charge.
"""
