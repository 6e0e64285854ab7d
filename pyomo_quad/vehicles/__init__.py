"""Estimation of vehicles from their owners' data, and comparison of models with measurements."""
