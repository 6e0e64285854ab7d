"""Polar of a vehicle: power of steady flight at each airspeed, payload and wind."""
