"""Collocation engine."""
