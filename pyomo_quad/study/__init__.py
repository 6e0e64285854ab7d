"""Studies of one scenario, from a complete run to checks of the mission before the solve.

Some of the studies: comparison of the plan with flights of an autopilot, tuning of the autopilot,
lower bound on the energy, least energy against flight duration, flights in random winds, and
repeated flights on one battery charge.
"""
