"""Vehicles from what their owners know, and library vehicles held against measurements."""
