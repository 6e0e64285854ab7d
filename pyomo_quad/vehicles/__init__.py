"""Estimation of vehicles from their owners' data, and comparison of vehicles with measurements."""
