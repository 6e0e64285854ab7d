"""Comparison with RotorPy, a simulator by other authors, and import of RotorPy's vehicles."""
