"""Comparison with RotorPy, a simulator by other authors, and vehicle files made from it."""
