"""Flights simulated in RotorPy, a simulator by other authors, and import of RotorPy's vehicles.

The flights in RotorPy are compared with flights of the package's own vehicle model.
"""
