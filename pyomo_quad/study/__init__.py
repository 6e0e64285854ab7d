"""Studies of one scenario: run, comparison, lower bound, energy against time, checks."""
