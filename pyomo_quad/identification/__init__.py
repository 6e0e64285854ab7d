"""Vehicles from their own flights: logs read, parameters identified, energies predicted."""
