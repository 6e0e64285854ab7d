"""Nonlinear program (NLP) of a collocation problem: unknowns, bounds, derivatives, solution."""
