"""Polar of a vehicle: power of steady level flight over airspeed, payload and wind."""
