"""Placeholder replaced by the floor's owner."""
