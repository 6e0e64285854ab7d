"""Plans and controllers flown in RotorPy, and RotorPy's vehicles as vehicle files."""
