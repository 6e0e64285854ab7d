"""Optimal control problems of the literature, each with its published optimum and its source.

Each module has a tuple `CASES`; `python -m tests.problems` solves them after the textbook problems.
"""
