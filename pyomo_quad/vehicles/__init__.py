"""Vehicles estimated from an owner's data, and comparison of vehicles with measurements."""
