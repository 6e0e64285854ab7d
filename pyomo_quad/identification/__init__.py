"""Identification of a vehicle's parameters from logs of measured flights."""
