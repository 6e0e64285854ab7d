"""Vehicles from measured flights: reading logs, identifying parameters, predicting energies."""
