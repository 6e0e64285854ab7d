"""Reproduction of the paper: its experiments under every power model, its claims, and a report."""
