"""The paper reproduced: its experiments under every power model, its claims, and the report."""
