"""The outside plant: what other people's dynamics make of our plans, and their vehicles here."""
